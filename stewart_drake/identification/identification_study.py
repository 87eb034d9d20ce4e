"""How good identifications are: simulated robots that are off in what is not weighed, and what is left of that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.identification.identify import identify
from stewart_drake.identification.parameters import COULOMB, KINDS, PARAMETERS, VISCOUS, of_robot
from stewart_drake.identification.simulated_logs import deviating, recorded
from stewart_drake.references import Reference
from stewart_drake.robot import RobotParameters


class Setting(NamedTuple):
    """What robots and logs of a study are.

    Attributes:
        guess: What the robots were drawn as.
        motion: By which they are identified.
        unseen: By which they are judged.
        rate: [Hz] of the logs.
        encoders: Of the readings.
        torque_noise: [N m] standard deviation of each torque.
        coulomb: [N m] of a motor, in the middle.
        viscous: [N m s/rad] likewise.
        duration: [s] of the log that is fitted.
        judged: [s] of that of the unseen motion.
    """

    guess: RobotParameters
    motion: Reference
    unseen: Reference
    rate: float
    encoders: EncoderOptions
    torque_noise: float
    coulomb: float
    viscous: float
    duration: float = 60.0
    judged: float = 20.0


class Trial(NamedTuple):
    """One robot's identification, judged by the truth.

    Attributes:
        payload: [-] error of the payload's mass over it.
        place: [m] of its place.
        coulomb: [-] largest error of a motor's, over it.
        viscous: [-] likewise.
        predicted: [-] error of an unseen log's torques over them, RMS, where no crank sticks.
        by_guess: [-] the same of the guess's torques.
        inside: (32,) whether the 95 % intervals hold the truth; NaN where there is none.
    """

    payload: float
    place: float
    coulomb: float
    viscous: float
    predicted: float
    by_guess: float
    inside: np.ndarray


def run_trial(setting: Setting, seed: int) -> Trial:
    """Identifies a robot of `simulated_logs.deviating` from one log.

    Args:
        setting: Whose.
        seed: Of the robot and the noise.
    """
    rng = np.random.default_rng(seed)
    guess = setting.guess
    truth = deviating(guess, rng, setting.coulomb, setting.viscous)
    logs = [
        recorded(guess, truth, motion, seconds, setting.rate, setting.encoders, setting.torque_noise, rng)
        for motion, seconds in ((setting.motion, setting.duration), (setting.unseen, setting.judged))
    ]
    found = identify(guess, logs[:1], validate=logs[1:])
    values, width = found.estimate.values, found.half_width
    off = np.abs(values - of_robot(guess) - found.estimate.told(truth - of_robot(guess)))
    load = truth - of_robot(guess)
    mass, place = found.payload

    def worst(part: slice) -> float:
        return float(np.abs(found.values[part] / truth[part] - 1.0).max())

    return Trial(
        abs(mass / load[0] - 1.0),
        float(np.linalg.norm(place - load[1:4] / load[0])),
        worst(COULOMB),
        worst(VISCOUS),
        found.predictions[-1].found,
        found.predictions[-1].guess,
        np.where(width > 0.0, off <= width, np.nan),
    )


def coverage(trials: Sequence[Trial]) -> dict[str, float]:
    """Share [-] of the intervals that hold the truth: of each kind, and under `all`; NaN where none had one."""
    inside = np.array([trial.inside for trial in trials])
    kinds = {kind: [at for at, own in enumerate(PARAMETERS) if own.kind == kind] for kind in KINDS}
    kinds["all"] = list(range(len(PARAMETERS)))  # type: ignore[index]
    shares = {}
    for kind, columns in kinds.items():
        some = inside[:, columns]
        shares[str(kind)] = float(np.nanmean(some)) if np.isfinite(some).any() else float("nan")
    return shares
