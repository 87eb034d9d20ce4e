"""A hexapod on a rolling deck: tilt of its plate in the world, with and without the sensor of the deck.

Prints the table of docs/moving_base.md: `python diagrams/rolling_deck.py closed_form mujoco drake`, five minutes.
"""

import sys

import numpy as np

from stewart_drake import load_scenario, run
from stewart_drake.mechanics.kinematics import rotation_matrix

USES = {"none": "not read", "torques": "known to feedforward and safety layer", "level": "and the plate kept level"}


def tilt(attitude: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Angles [deg] of the plate's normal to the vertical, for roll, pitch, yaw of the deck and poses on it."""
    normal = (rotation_matrix(attitude) @ rotation_matrix(pose[:, :3]))[:, :, 2]
    return np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), normal[:, 2]))


def main(*kinds: str) -> None:
    """Runs, prints."""
    scenario = load_scenario("rolling_deck")
    print(
        "| plant | the deck's motion is | tilt RMS [deg] | largest [deg] | error on the deck, largest [mm] |\n"
        + "|---" * 5
        + "|"
    )
    for kind in kinds or ("closed_form",):
        for use, words in USES.items():
            log = run(scenario.replace({"plant": kind, "base_compensation": use}))
            angles, error = tilt(log["base_motion"][:, 9:], log["pose"]), np.linalg.norm(log["error"][:, 3:], axis=1)
            rms = np.sqrt(np.mean(angles**2))
            print(f"| {kind} | {words} | {rms:.3f} | {angles.max():.3f} | {1e3 * error.max():.4f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
