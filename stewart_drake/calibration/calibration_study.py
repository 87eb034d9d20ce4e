"""How good calibrations are: simulated robots that are off by a millimetre, and what is left of that."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from stewart_drake.calibration.fit import calibrate
from stewart_drake.calibration.frames import located
from stewart_drake.calibration.measurements import MeasurementNoise, Measurements
from stewart_drake.calibration.model import STILL, Frame
from stewart_drake.calibration.parameters import (
    OF_LEG,
    OF_ROBOT,
    PER_LEG,
    FrameName,
    change_to,
    exponential,
    logarithm,
)
from stewart_drake.calibration.simulate import aligned, deviating, measured
from stewart_drake.mechanics.kinematics import forward_kinematics, rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS


@dataclass(frozen=True, eq=False)
class Trial:
    """One robot's calibration, judged by the truth.

    Attributes:
        before: [m, rad] RMS error of unseen poses' position and rotation by the guess.
        after: [m, rad] the same by the calibrated robot.
        inside: (6, 11) bool, whether the 95 % intervals hold the truth.
        width: (6, 11) [m, rad] half widths.
        noise_ratio: [-] see `Calibration`.
    """

    before: tuple[float, float]
    after: tuple[float, float]
    inside: np.ndarray
    width: np.ndarray
    noise_ratio: float


def run_trial(
    guess: RobotParameters,
    targets: Measurements,
    unseen: Measurements,
    noise: MeasurementNoise,
    seed: int,
    known_frames: Collection[FrameName] = (),
) -> Trial:
    """Calibrates a robot that is off in every parameter by up to 1 mm or 1 mrad either way.

    Frames that are not known lie anywhere: the tracker some metres away, the marker some centimetres.

    Args:
        guess: What it was drawn as.
        targets: Poses that are measured.
        unseen: Poses at which it is judged, by encoder readings with their steps.
        noise: Of tracker and encoders.
        seed: Of the deviations, the frames and the noise.
        known_frames: As for `calibrate`.
    """
    rng = np.random.default_rng(seed)
    truth = deviating(guess, rng)
    base = Frame(exponential(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-3.0, 3.0, 3))
    marker = Frame(exponential(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.05, 0.05, 3))
    base, marker = (STILL if "base" in known_frames else base), (STILL if "platform" in known_frames else marker)
    seen = measured(truth, targets, noise, rng, base, marker)
    found = calibrate(guess, seen, noise, known_frames)
    tracker_free = MeasurementNoise(position=1e-300, rotation=1e-300, encoder=noise.encoder)
    right = measured(truth, unseen, tracker_free, rng, base, marker)
    believed = located(guess, seen, known_frames)
    same = aligned(truth, guess, known_frames)
    off = (found.change - change_to(guess, same))[:OF_ROBOT].reshape(LEGS, PER_LEG)
    width = found.half_width[:OF_ROBOT].reshape(LEGS, PER_LEG)
    return Trial(
        _error(guess, believed.base, believed.marker, right, unseen),
        _error(found.robot, found.base, found.marker, right, unseen),
        np.abs(off) <= width,
        width,
        found.noise_ratio,
    )


def coverage(trials: Collection[Trial]) -> dict[str, float]:
    """Share [-] of the intervals that hold the truth: of each parameter, and under `all`."""
    inside = np.mean([trial.inside.mean(axis=0) for trial in trials], axis=0)
    names = [f"{own.name} {own.axis}".strip() for own in OF_LEG]
    return {**dict(zip(names, inside.tolist(), strict=True)), "all": float(inside.mean())}


def gains(trials: Collection[Trial]) -> np.ndarray:
    """(n, 2) [-] how many times smaller the errors of unseen poses have become, position and rotation."""
    return np.array([np.divide(trial.before, trial.after) for trial in trials])


def _error(
    robot: RobotParameters, base: Frame, marker: Frame, right: Measurements, near: Measurements
) -> tuple[float, float]:
    """RMS [m, rad] of the marker's predicted poses at readings."""
    pose = forward_kinematics(robot, right.angles, near.pose)
    there = base.after(Frame(rotation_matrix(pose[:, :3]), pose[:, 3:])).after(marker)
    place = np.linalg.norm(there.shift - right.position, axis=-1)
    turn = np.linalg.norm(logarithm(right.rotation @ np.swapaxes(there.turn, -1, -2)), axis=-1)
    return float(np.sqrt(np.mean(place**2))), float(np.sqrt(np.mean(turn**2)))
