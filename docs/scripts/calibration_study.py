"""Measures what a calibration is worth, and writes docs/results/calibration.md: `make results/calibration`.

For each setting: robots that are off in every parameter, 60 measured poses, other poses to assess it by.
"""

import time
from pathlib import Path

import numpy as np
from simulated_calibration import coverage, gains, run_trial

from stewart_drake.base.markdown import markdown_table
from stewart_drake.estimation.geometry import FRAMES, PER_LEG, table_names
from stewart_drake.estimation.poses import MeasurementNoise, Measurements, candidate_poses, plan_poses
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.scenario.scenario import load_scenario

OUT = Path(__file__).parents[1] / "results" / "calibration.md"
ROBOTS = 100
POSES = UNSEEN = 60
SETTINGS = (
    ("paper", "planned", ()),
    ("paper", "at random", ()),
    ("paper", "planned", FRAMES),
    ("servo_hexapod", "planned", ()),
    ("reachy_mini", "planned", ()),
)
SHOWN = (0, 1, 4)
"""Settings with a column of widths."""
NOISE = MeasurementNoise(position=2e-5, rotation=1e-4)
TEXT = """# What a calibration is worth

How exactly does `calibrate` find a robot's geometry, and how far off is the robot then?
Command: `make results/calibration`.

{table}

- {robots} robots a row, off by up to ±1 mm and ±1 mrad (uniform) in each of their {numbers} parameters, are
  calibrated from {poses} poses and tested at {unseen} others: RMS, medians over the robots. The last column is the
  share of the 95 % intervals that hold the truth: over all parameters, and from the least to the most of a kind.
- The tracker has noise of 0.02 mm and 0.1 mrad per coordinate, the encoders have 17 bits.
- *Estimated* frames: the positions of the tracker and of its marker are unknown, and fitted with the geometry. That
  hides a good part of the error before.

Half widths of the 95 % intervals with estimated frames, medians over legs and robots:

{widths}
"""
HEADER = (
    "robot",
    "poses",
    "frames",
    "before [mm], [mrad]",
    "after [mm], [mrad]",
    "times smaller: median",
    "worst robot",
    "intervals that hold the truth",
)


def poses(robot, limits, seed):
    """As many poses at random within the limits."""
    pose = candidate_poses(robot, POSES, limits, np.random.default_rng(seed))
    return Measurements(pose, inverse_kinematics(robot, pose))


def rows():
    """A row of the first table for each setting, and the coverage and the widths of each."""
    for name, kind, known in SETTINGS:
        robot, limits = load_robot(name), load_scenario("paper_fig7", [f"robot={name}"]).limits
        start = time.process_time()
        planned = (
            plan_poses(robot, POSES, limits, NOISE, known).targets if kind == "planned" else poses(robot, limits, 1)
        )
        unseen = poses(robot, limits, 2)
        trials = [run_trial(robot, planned, unseen, NOISE, seed, known) for seed in range(ROBOTS)]
        before, after = (np.median([getattr(t, when) for t in trials], axis=0) for when in ("before", "after"))
        gain, inside = gains(trials), coverage(trials)
        widths = np.median([t.width for t in trials], axis=(0, 1))
        print(name, kind, known, gain.min(axis=0), inside["all"], f"{time.process_time() - start:.0f} s", flush=True)
        frames = "known" if known else "estimated"
        errors = [f"{1e3 * e[0]:.3f}, {1e3 * e[1]:.2f}" for e in (before, after)]
        least = ", ".join(f"{g:.0f}" for g in gain.min(axis=0))
        middle = ", ".join(f"{g:.0f}" for g in np.median(gain, axis=0))
        kinds = [value for key, value in inside.items() if key != "all"]
        share = f"{100 * inside['all']:.1f} % ({100 * min(kinds):.1f} to {100 * max(kinds):.1f} %)"
        yield (f"`{name}`", kind, frames, *errors, middle, least, share), widths


def main():
    """Runs the study."""
    table, widths = zip(*rows(), strict=True)
    # Of the paper's robot by planned and by random poses, and of Reachy Mini, with frames that are estimated.
    columns = [f"`{SETTINGS[at][0]}`, {SETTINGS[at][1]}" for at in SHOWN]
    rows_of_widths = [
        (name, *(f"{1e3 * widths[at][place]:.3f}" for at in SHOWN)) for place, name in enumerate(table_names())
    ]
    text = TEXT.format(
        robots=ROBOTS,
        numbers=6 * PER_LEG,
        poses=POSES,
        unseen=UNSEEN,
        table=markdown_table(HEADER, table),
        widths=markdown_table(("", *columns), rows_of_widths),
    )
    OUT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
