"""A robot's geometry from measured poses: two least-squares problems, one after the other.

First the closures of the legs, which have a value at whatever guess; then the tracker's errors, weighed by the inverse
root of their covariance, to which the encoders' noise comes by way of forward kinematics. The second are what tracker
and encoders get wrong and nothing else, so that their minimum is the maximum of the likelihood, to first order in the
encoders' noise. (Minimal closures are not: the pose's noise is in their derivatives as well, and biases them.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.optimize
from scipy.special import stdtrit

from stewart_drake.calibration.frames import guess_error, located, refuse_units, stray_rows
from stewart_drake.calibration.measurements import MeasurementNoise, Measurements, load_measurements
from stewart_drake.calibration.model import CLOSED, Frame
from stewart_drake.calibration.parameters import (
    FRAMES,
    NAMES,
    SIZE,
    FrameName,
    Name,
    as_robot,
    free_directions,
    scales,
)
from stewart_drake.calibration.result import Calibration
from stewart_drake.calibration.suspects import Start, explain_misfit
from stewart_drake.calibration.untold import SHARE, in_words, told_and_untold
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters

_CONFIDENCE = 0.95
_FITTED = 1e-12
"""Relative change at which a minimum counts as found."""
_TRUST = 0.1
"""[-] size of the first step at most, in `parameters.scales`."""
_NEARBY, _EXACT = 20, 200
"""Calls of the errors at most: ten find what fits, and what does not fit needs no minimum."""


def calibrate(
    robot: RobotParameters,
    poses: Measurements | str | Path,
    noise: MeasurementNoise | None = None,
    known_frames: Collection[FrameName] = (),
    hold: Collection[Name] = (),
) -> Calibration:
    """The robot that measured poses and encoder readings belong to.

    Args:
        robot: The guess; of it the branches, masses and limits are kept.
        poses: Measured poses with readings, or a CSV file of them, see `load_measurements`.
        noise: Of tracker and encoders; only the ratios of its numbers act on the estimate.
        known_frames: `base` if the tracker measures in B, `platform` if it measures the pose of P itself. Other
            frames are estimated, and then B is where the shafts lie nearest to those of the guess, and P where the
            platform's joints do.
        hold: Parameters that keep their value, of `parameters.NAMES`.

    Returns:
        The calibrated robot, whose crank angles are the encoders' readings, with intervals and residuals.

    Raises:
        ConfigurationError: Too few poses, or such as cannot be this robot's: units, swapped or inverted encoders,
            single wrong rows, another branch; each is named where the residuals tell.
    """
    for key, given, allowed in (("known_frames", known_frames, FRAMES), ("hold", hold, NAMES)):
        if strange := sorted(set(given) - set(allowed)):
            raise ConfigurationError(key, strange[0], f"some of {', '.join(allowed)}")
    measurements = poses if isinstance(poses, Measurements) else load_measurements(poses)
    noise = MeasurementNoise() if noise is None else noise
    refuse_units(robot, measurements)
    strays = stray_rows(robot, measurements)
    start = explain_misfit(lambda each: nearby(robot, each, noise, known_frames, hold), measurements, strays)
    return _result(fitted(start, noise), noise, known_frames, hold)


def nearby(
    guess: RobotParameters,
    measurements: Measurements,
    noise: MeasurementNoise,
    known: Collection[FrameName] = (),
    held: Collection[Name] = (),
) -> Start:
    """The first of the two least-squares problems: the smallest closures.

    Raises:
        ConfigurationError: Too few poses; as for `located`.
    """
    free = free_directions(guess, known, held)
    least = free.shape[1] // 6 + 1
    if len(measurements) < least:
        allowed = f"at least {least} poses for {free.shape[1]} unknown numbers, better some 60"
        raise ConfigurationError(measurements.source, f"{len(measurements)} rows", allowed)
    model, size = located(guess, measurements, known), scales(guess)
    nothing = np.zeros(SIZE)
    seen = model.measured(nothing, measurements)
    white = model.whitening(nothing, measurements.angles, seen, noise)
    by_free = white @ model.tracker_error(nothing, measurements, seen)[1] @ (size[:, None] * free)
    told, untold = (free @ part for part in told_and_untold(by_free.reshape(-1, free.shape[1])))
    ways = size[:, None] * told
    cranks = float(guess.crank_lengths.max())
    unit = math.hypot(noise.position, guess.characteristic_length * noise.rotation, cranks * noise.encoder)

    def closure(step: np.ndarray) -> np.ndarray:
        return model.closure_error(ways @ step, measurements)[0].ravel() / unit

    def slope(step: np.ndarray) -> np.ndarray:
        return (model.closure_error(ways @ step, measurements)[1] @ ways).reshape(-1, ways.shape[1]) / unit

    step = _minimum(closure, slope, np.zeros(ways.shape[1]), _NEARBY)
    left = closure(step)
    misfit = math.sqrt(float(left @ left) / (left.size - step.size))
    return Start(model, measurements, told, untold, step, misfit)


def fitted(start: Start, noise: MeasurementNoise) -> Fit:
    """The second of the two least-squares problems: the smallest errors of the tracker.

    Raises:
        ConfigurationError: Poses at which the calibrated legs cannot be assembled.
    """
    model, measurements = start.model, start.measurements
    ways = scales(model.guess)[:, None] * start.told

    def predicted(step: np.ndarray) -> Frame:
        change = ways @ step
        at, off = model.predicted(change, measurements.angles, model.measured(change, measurements))
        if (off > CLOSED).any():
            key = f"{measurements.source}: row {int(off.argmax()) + 1}, theta"
            got = f"readings at which no calibrated legs close: a rod is off by {off.max():.3g} m"
            raise ConfigurationError(key, got, "a pose that is not singular, and a guess close to the robot")
        return at

    def error(step: np.ndarray) -> np.ndarray:
        found, _ = model.tracker_error(ways @ step, measurements, predicted(step))
        return np.einsum("nij,nj->ni", white, found).ravel()

    def slope(step: np.ndarray) -> np.ndarray:
        _, found = model.tracker_error(ways @ step, measurements, predicted(step))
        return (white @ found @ ways).reshape(-1, ways.shape[1])

    white = model.whitening(ways @ start.step, measurements.angles, predicted(start.step), noise)
    step = _minimum(error, slope, start.step, _EXACT)
    found, _ = model.tracker_error(ways @ step, measurements, predicted(step))
    return Fit(start, ways @ step, found, error(step), slope(step))


def _minimum(
    error: Callable[[np.ndarray], np.ndarray],
    slope: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    most: int,
) -> np.ndarray:
    """Where the sum of the squares is smallest, in so many calls at most.

    A region of trust begins with `_TRUST`: a free first step from a crude guess may turn a motor's axis over, which
    is another minimum.
    """
    tolerances = {"xtol": _FITTED, "ftol": _FITTED, "gtol": None}
    found = scipy.optimize.least_squares(error, start, slope, x_scale=_TRUST, max_nfev=most, **tolerances)
    return np.asarray(found.x)


@dataclass(frozen=True, eq=False)
class Fit:
    """What the least-squares problems leave.

    Attributes:
        start: From where.
        change: (`SIZE`,) [m, rad].
        error: (n, 6) [rad, m] measured minus predicted poses of the marker.
        white: (6 n,) [-] the same over their standard deviations.
        derivative: (6 n, k) [-] of the last by the told directions.
    """

    start: Start
    change: np.ndarray
    error: np.ndarray
    white: np.ndarray
    derivative: np.ndarray

    @property
    def freedom(self) -> int:
        """How many more numbers were measured than estimated."""
        return self.derivative.shape[0] - self.derivative.shape[1]

    @property
    def noise_ratio(self) -> float:
        """[-] size of the errors over that of the stated noise."""
        return math.sqrt(float(self.white @ self.white) / self.freedom)


def _result(fit: Fit, noise: MeasurementNoise, known: Collection[FrameName], held: Collection[Name]) -> Calibration:
    model, measurements = fit.start.model, fit.start.measurements
    guess, size = model.guess, scales(model.guess)
    # Scaled by what the residuals say of the noise, so that noise which is larger than stated widens the intervals.
    root = np.linalg.inv(np.linalg.qr(fit.derivative, mode="r"))
    deviation = size * np.linalg.norm(fit.start.told @ root, axis=1) * fit.noise_ratio
    half_width = deviation * float(stdtrit(fit.freedom, 0.5 + 0.5 * _CONFIDENCE))
    half_width[np.linalg.norm(fit.start.untold, axis=1) > SHARE] = np.inf
    base, marker = model.frames(fit.change)
    return Calibration(
        robot=as_robot(guess, fit.change),
        guess=guess,
        measurements=measurements,
        noise=noise,
        known_frames=tuple(name for name in FRAMES if name in known),
        hold=tuple(name for name in NAMES if name in held),
        change=fit.change,
        half_width=half_width,
        told=fit.start.told.shape[1],
        untold=tuple(in_words(fit.start.untold, size)),
        base=base,
        marker=marker,
        before=guess_error(model, measurements),
        after=fit.error,
        noise_ratio=fit.noise_ratio,
    )
