"""A robot's geometry from measured poses: two least-squares problems, one after the other.

First the closures of the legs, which have a value at whatever guess; then the tracker's errors, weighed by the inverse
root of their covariance, to which the encoders' noise comes by way of forward kinematics. The second are what tracker
and encoders get wrong and nothing else, so that their minimum is the maximum of the likelihood, to first order in the
encoders' noise. (Minimal closures are not: the pose's noise is in their derivatives as well, and biases them.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import scipy.optimize
from scipy.special import stdtrit

from stewart_drake.calibration.frames import STILL, Frame, derivative
from stewart_drake.calibration.hints import LEAST, Start, explained, stray_rows
from stewart_drake.calibration.measurements import MeasurementNoise, Measurements, load_measurements
from stewart_drake.calibration.model import CLOSED, Model
from stewart_drake.calibration.parameters import (
    FRAMES,
    LARGEST,
    NAMES,
    OF_ROBOT,
    SIZE,
    FrameName,
    Name,
    as_robot,
    free_directions,
    scales,
)
from stewart_drake.calibration.result import Calibration, in_words
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters

_CONFIDENCE = 0.95
_FITTED = 1e-12
"""Relative change at which a minimum counts as found."""
_SHARE = 1e-3
"""[-] of an untold direction beyond which a parameter has no interval."""
_TRUST = 0.1
"""[-] size of the first step at most, in `parameters.scales`: a free first step from a crude guess may turn a motor's
axis over, which is another minimum."""
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
        ConfigurationError: Too few poses, or such as cannot be this robot's: wrong units, an inverted encoder, a
            single wrong row, another branch; each is named where the residuals tell.
    """
    for key, given, allowed in (("known_frames", known_frames, FRAMES), ("hold", hold, NAMES)):
        if strange := sorted(set(given) - set(allowed)):
            raise ConfigurationError(key, strange[0], f"some of {', '.join(allowed)}")
    measurements = poses if isinstance(poses, Measurements) else load_measurements(poses)
    noise = MeasurementNoise() if noise is None else noise
    strays = stray_rows(robot, measurements)
    start = explained(lambda each: nearby(robot, each, noise, known_frames, hold), measurements, strays)
    return fitted(start, noise, known_frames, hold)


def nearby(
    guess: RobotParameters,
    measurements: Measurements,
    noise: MeasurementNoise,
    known: Collection[FrameName] = (),
    held: Collection[Name] = (),
) -> Start:
    """The first of the two least-squares problems: the smallest closures."""
    free = free_directions(guess, known, held)
    least = free.shape[1] // 6 + 1
    if len(measurements) < least:
        allowed = f"at least {least} poses for {free.shape[1]} unknown numbers, better some 60"
        raise ConfigurationError(measurements.source, f"{len(measurements)} rows", allowed)
    model, size, nothing = located(guess, measurements, known), scales(guess)[:, None], np.zeros(SIZE)
    marker, angles = measurements.marker, measurements.angles
    at = model.measured(nothing, marker)
    slope = model.whitening(nothing, at, angles, noise) @ model.tracker_slope(nothing, at, angles) @ (size * free)
    told, untold = (free @ part for part in _told_and_untold(slope.reshape(-1, free.shape[1])))
    ways = size * told
    cranks = float(guess.crank_lengths.max())
    unit = math.hypot(noise.position, guess.characteristic_length * noise.rotation, cranks * noise.encoder)

    def closure(step: np.ndarray) -> np.ndarray:
        change = ways @ step
        return model.closures(change, model.measured(change, marker), angles).ravel() / unit

    def by_step(step: np.ndarray) -> np.ndarray:
        return derivative(lambda more: closure(step + more), len(step))

    step = _minimum(closure, by_step, np.zeros(ways.shape[1]), _NEARBY)
    left = closure(step)
    return Start(model, measurements, told, untold, step, math.sqrt(float(left @ left) / (left.size - step.size)))


def fitted(start: Start, noise: MeasurementNoise, known: Collection[FrameName], held: Collection[Name]) -> Calibration:
    """The second of the two least-squares problems: the smallest errors of the tracker."""
    model, measurements, guess = start.model, start.measurements, start.model.guess
    marker, angles, size = measurements.marker, measurements.angles, scales(guess)
    ways = size[:, None] * start.told

    def predicted(step: np.ndarray) -> Frame:
        at, off = model.predicted(ways @ step, angles, model.measured(ways @ step, marker))
        if (off > CLOSED).any():
            key = f"{measurements.source}: row {int(off.argmax()) + 1}, crank_angle"
            got = f"readings at which no calibrated legs close: a rod is off by {off.max():.3g} m"
            raise ConfigurationError(key, got, "a pose that is not singular, and a guess close to the robot")
        return at

    def error(step: np.ndarray) -> np.ndarray:
        found = model.tracker_error(ways @ step, predicted(step), marker)
        return np.einsum("nij,nj->ni", white, found).ravel()

    def slope(step: np.ndarray) -> np.ndarray:
        found = model.tracker_slope(ways @ step, predicted(step), angles, marker)
        return (white @ found @ ways).reshape(-1, ways.shape[1])

    white = model.whitening(ways @ start.step, predicted(start.step), angles, noise)
    step = _minimum(error, slope, start.step, _EXACT)
    left, by_step, change = error(step), slope(step), ways @ step
    freedom = left.size - step.size
    ratio = math.sqrt(float(left @ left) / freedom)
    # Scaled by what the residuals say of the noise, so that noise which is larger than stated widens the intervals.
    deviation = size * np.linalg.norm(start.told @ np.linalg.inv(np.linalg.qr(by_step, mode="r")), axis=1) * ratio
    half_width = deviation * float(stdtrit(freedom, 0.5 + 0.5 * _CONFIDENCE))
    half_width[np.linalg.norm(start.untold, axis=1) > _SHARE] = np.inf
    base, placed = model.frames(change)
    return Calibration(
        robot=as_robot(guess, change),
        guess=guess,
        measurements=measurements,
        noise=noise,
        known_frames=tuple(name for name in FRAMES if name in known),
        hold=tuple(name for name in NAMES if name in held),
        change=change,
        half_width=half_width,
        told=start.told.shape[1],
        untold=tuple(in_words(start.untold, size)),
        base=base,
        marker=placed,
        before=_guess_error(model, measurements),
        after=model.tracker_error(change, predicted(step), marker),
        noise_ratio=ratio,
    )


def located(guess: RobotParameters, measurements: Measurements, known: Collection[FrameName]) -> Model:
    """The guess with the frames at which its own poses at the readings come nearest to the measured ones."""
    believed, good = Model(guess).assembled(measurements.angles)
    seen = measurements.marker.rows(good)
    if len(seen.shift) < LEAST:
        got = f"readings of which {len(seen.shift)} of {len(measurements)} can be those of this robot"
        allowed = "readings in rad (or _deg), in the order of the legs, near to crank angles of the guess"
        raise ConfigurationError(f"{measurements.source}: crank_angle", got, allowed)
    free = [OF_ROBOT + 6 * FRAMES.index(frame) + axis for frame in FRAMES if frame not in known for axis in range(6)]
    if not free:
        return Model(guess)
    base, marker, length = STILL, STILL, guess.characteristic_length
    if "base" not in known:
        # Turns from pose to pose are turned by the base alone; shifts nearly so, and tell it where no pose is turned.
        there, here = (np.concatenate([length * turns, shifts]) for turns, shifts in (seen.steps(), believed.steps()))
        turn = _rotation(np.einsum("ni,nj->ij", there, here))
        base = Frame(turn, (seen.shift - believed.shift @ turn.T).mean(axis=0))
    if "platform" not in known:
        turns = np.swapaxes(believed.turn, -1, -2) @ base.turn.T @ seen.turn
        marker = Frame(_rotation(turns.sum(axis=0)), np.zeros(3))
    model, size = Model(guess, base, marker), np.array([length] * 3 + [1.0] * 3)

    def change(step: np.ndarray) -> np.ndarray:
        made = np.zeros(SIZE)
        made[free] = step
        return made

    def error(step: np.ndarray) -> np.ndarray:
        return (size * model.tracker_error(change(step), believed, seen)).ravel()

    return model.with_frames(change(scipy.optimize.least_squares(error, np.zeros(len(free)), x_scale="jac").x))


def _rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix."""
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _guess_error(model: Model, measurements: Measurements) -> np.ndarray:
    """Measured minus believed poses of the marker (n, 6) [rad, m]; NaN where the guess cannot be assembled."""
    nothing = np.zeros(SIZE)
    at, off = model.predicted(nothing, measurements.angles, model.measured(nothing, measurements.marker))
    return np.where((off <= CLOSED)[:, None], model.tracker_error(nothing, at, measurements.marker), np.nan)


def _told_and_untold(derivative: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal directions (k, told) and (k, rest) of k parameters, from derivatives (m, k) of whitened errors."""
    _, sigma, directions = np.linalg.svd(derivative, full_matrices=True)
    told = np.zeros(len(directions), dtype=bool)
    told[: len(sigma)] = sigma * LARGEST >= 1.0
    return directions[told].T, directions[~told].T


def _minimum(
    error: Callable[[np.ndarray], np.ndarray],
    slope: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    most: int,
) -> np.ndarray:
    """Where the sum of the squares is smallest, in so many calls at most."""
    tolerances = {"xtol": _FITTED, "ftol": _FITTED, "gtol": None}
    found = scipy.optimize.least_squares(error, start, slope, x_scale=_TRUST, max_nfev=most, **tolerances)
    return np.asarray(found.x)
