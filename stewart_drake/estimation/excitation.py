"""Excitation for identification: a finite Fourier series within the limits, of least condition number.

J. Swevers et al., "Optimal robot excitation and identification" (IEEE Trans. Robotics and Automation 13, 1997).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import NamedTuple

import numpy as np

from stewart_drake.analysis.feasibility import bisect
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation.torques import free_directions, samples_of_motion, scales, values_of
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.references.motions import AdjustedReference, SineReference, SumReference
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.scenario.limits import ReferenceLimits, limit_margins

HARMONICS = (2, 3, 5, 8, 13, 21, 31)
PERIOD = 19.937
"""[s] of the motion: sines of 0.1 to 1.55 Hz; in every period coarse encoders have other errors."""
ROOM, SERVO_ROOM = 1.15, 1.5
"""[-] factors by which the motion could be larger within the limits: a reserve, as the robot differs from the guess and
servos overshoot."""
_SAMPLES = 240
_BEGINNINGS, _CHANGES = 20, 400
MOTIONS = _BEGINNINGS + _CHANGES  # Number of motions that are tried.
_FADE = 2.0
_ROUNDING = 1e-9  # [-] of the largest singular value


class Excitation(NamedTuple):
    """A motion from rest that excites the parameters."""

    reference: AdjustedReference
    condition: float  # [-] condition number in the parameters' scales.
    random_condition: float  # [-] the same of random motions.


def excite(
    robot: RobotParameters,
    limits: ReferenceLimits | None = None,
    hold: Collection[str] = (),
    gravity: Gravity = STANDARD_GRAVITY,
    seed: int = 0,
    changes: int = _CHANGES,
    room: float = ROOM,
    progress: Callable[[float], None] = lambda _: None,
) -> Excitation:
    """Designs a motion.

    Args:
        robot: The guess.
        limits: Limits of the motion.
        hold: As for `identify`.
        gravity: [m/s^2].
        seed: Of the random motions.
        changes: Number of changes to try.
        room: [-] by which the motion could be larger within the limits.
        progress: Gets the number of motions tried, of `_BEGINNINGS + changes`.

    Raises:
        ConfigurationError: No motion at all is within the limits.
    """
    limits = ReferenceLimits() if limits is None else limits
    rng = np.random.default_rng(seed)
    size, values = scales(robot), values_of(robot)
    ways = size[:, None] * free_directions(hold)
    time = np.linspace(0.0, PERIOD, _SAMPLES, endpoint=False)

    def motion(waves: np.ndarray, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return _reference(robot, scale * waves).evaluate(time)

    def feasible(waves: np.ndarray, scale: float) -> bool:
        margins = limit_margins(robot, limits, *motion(waves, room * scale), gravity)
        return not any((values < 0.0).any() or np.isnan(values).any() for values in margins.values())

    def condition(waves: np.ndarray) -> float:
        samples = samples_of_motion(robot, time, motion(waves), gravity)
        rows = (samples.derivative(values) * samples.used[..., None] @ ways).reshape(-1, ways.shape[1])
        sigma = np.linalg.svd(rows, compute_uv=False)
        return float(sigma[0] / sigma[sigma > _ROUNDING * sigma[0]][-1])

    length = np.array([1.0] * 3 + [robot.characteristic_length] * 3)
    motions: list[tuple[float, np.ndarray]] = []
    for beginning in range(_BEGINNINGS if feasible(np.zeros((2, len(HARMONICS), 6)), 0.0) else 0):
        waves = rng.standard_normal((2, len(HARMONICS), 6)) * length / np.sqrt(HARMONICS)[:, None]
        largest = bisect(partial(feasible, waves), 0.0, 1.0)
        if largest > 0.0:
            motions.append((condition(largest * waves), largest * waves))
        progress(beginning + 1.0)
    if not motions:
        raise ConfigurationError("limits", "no motion within them", "limits that leave room about home")
    random_condition = float(np.median([number for number, _ in motions]))
    best, waves = min(motions, key=lambda motion: motion[0])
    spread = 0.3
    for change in range(changes):
        other = _changed(waves, spread, rng)
        better = feasible(other, 1.0) and (now := condition(other)) < best
        if better:
            best, waves = now, other
        # With one success in five the steps keep their size.
        spread = float(np.clip(spread * (1.5 if better else 0.9), 0.01, 1.0))
        progress(_BEGINNINGS + change + 1.0)
    faded = AdjustedReference(motion=_reference(robot, waves), fade_in=_FADE)
    return Excitation(faded, best, random_condition)


def _changed(waves: np.ndarray, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Amplitudes changed at random by about a share `spread`, together and one by one."""
    other = waves * (1.0 + spread * rng.standard_normal(waves.shape))
    other += spread * rng.standard_normal(waves.shape) * np.abs(waves).mean(axis=(0, 1))
    return np.asarray(other * np.exp(0.3 * spread * rng.standard_normal()))


def _reference(robot: RobotParameters, waves: np.ndarray) -> SumReference:
    """The series of sine and cosine amplitudes (2, harmonics, 6) [rad, m] about home."""
    parts = [
        SineReference(
            center=tuple(robot.home_pose.tolist()),
            amplitude=tuple(np.hypot(sine, cosine).tolist()),
            angular_frequency=(2.0 * np.pi * harmonic / PERIOD,) * 6,
            phase=tuple(np.arctan2(cosine, sine).tolist()),
        )
        for harmonic, sine, cosine in zip(HARMONICS, *waves, strict=True)
    ]
    return SumReference(parts=tuple(parts))
