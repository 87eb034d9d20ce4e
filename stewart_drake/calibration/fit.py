"""A robot's geometry from measured poses: two least-squares problems, one after the other; or why poses do not fit.

First the legs' closures, from any guess; then tracker errors over their covariance: the maximum of the likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.optimize
from scipy.special import stdtrit

from stewart_drake.calibration.model import (
    CLOSED,
    FRAMES,
    LARGEST,
    NAMES,
    OF_LEG,
    OF_ROBOT,
    PER_LEG,
    SIZE,
    STILL,
    FrameName,
    Model,
    Name,
    as_robot,
    derivative,
    difference,
    free_directions,
    scales,
    transform,
)
from stewart_drake.calibration.poses import MeasurementNoise, Measurements, load_measurements
from stewart_drake.calibration.result import Calibration, in_words
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

_CONFIDENCE = 0.95
_SHARE = 1e-3  # [-] of an unidentifiable direction beyond which a parameter has no interval
_SEARCH = {"x_scale": 0.1, "xtol": 1e-12, "ftol": 1e-12, "gtol": None}
"""Steps are a tenth of `model.scales` at most: a free one from a crude guess may turn a motor's axis over."""
_NEARBY, _EXACT = 10, 200
"""Calls of the errors at most: six find what fits, and what does not fit needs no minimum."""
_LEAST = 4
_SAME = 1e-9  # [rad, m] less than any tracker's last digit, more than a file's.
_MISFIT = _BETTER = 5.0
"""[-] closures over their noise from which a reason is looked for, and how many times smaller one must make them."""
_FAR = 0.3  # [-] change of a parameter, in `model.scales`, that nobody's guess is off by.
_APART, _FEW, _ROWS = 10.0, 0.2, 3
"""A stray is off so many times further than usual; share of rows that can be strays; rows suspected."""
_DEGREE = math.pi / 180.0
_UNITS = (
    ("pose_x, y, z", slice(3, 6), 1e-3, "millimetres for metres"),
    ("pose_x, y, z", slice(3, 6), 1e3, "metres for millimetres"),
    ("pose_roll, pitch, yaw", slice(0, 3), _DEGREE, "degrees for radians"),
    ("pose_roll, pitch, yaw", slice(0, 3), 1.0 / _DEGREE, "radians for degrees"),
    ("crank_angle", slice(6, 12), _DEGREE, "degrees for radians"),
    ("crank_angle", slice(6, 12), 1.0 / _DEGREE, "radians for degrees"),
)


def calibrate(
    robot: RobotParameters,
    poses: Measurements | str | Path,
    noise: MeasurementNoise | None = None,
    known_frames: Collection[FrameName] = (),
    hold: Collection[Name] = (),
) -> Calibration:
    """Estimates a robot's geometry and homing offsets from measured poses and encoder readings.

    Args:
        robot: The guess; its branches, masses and limits are kept.
        poses: Measured poses with readings, or a CSV file of them, see `load_measurements`.
        noise: Of tracker and encoders; only the ratios of its numbers act on the estimate.
        known_frames: `base` if the tracker measures in B, `platform` if it measures the pose of P itself. Other
            frames are estimated, and then B is where the shafts lie nearest to those of the guess, and P where the
            platform's joints do.
        hold: Parameters that keep their value, of `model.NAMES`.

    Returns:
        The calibrated robot, whose crank angles are the encoders' readings, with intervals and residuals.

    Raises:
        ConfigurationError: Too few poses, or such as cannot be this robot's: wrong units, an inverted encoder, a
            single wrong row, another branch; the message names it where the residuals show it.
    """
    for key, given, allowed in (("known_frames", known_frames, FRAMES), ("hold", hold, NAMES)):
        if strange := sorted(set(given) - set(allowed)):
            raise ConfigurationError(key, strange[0], f"some of {', '.join(allowed)}")
    measurements = poses if isinstance(poses, Measurements) else load_measurements(poses)
    noise = MeasurementNoise() if noise is None else noise
    believed, good = Model(robot).assembled(measurements.angles)
    if good.all() and np.abs(difference(believed, measurements.marker)).max() < _SAME:
        got = "the poses that the guess has at these crank angles"
        raise ConfigurationError(measurements.source, got, "measured poses; is this a plan, not measured yet?")
    start = _explained(partial(_nearby, robot, noise=noise, known=known_frames, held=hold), robot, measurements)
    return _fitted(start, noise, known_frames, hold)


class _Start(NamedTuple):
    """A step (k,) along identifiable `ways` (`SIZE`, k) [m, rad]; directions (`SIZE`, j) in `scales` that are not.

    `misfit` [-] is the size of the closures over their noise.
    """

    model: Model
    measurements: Measurements
    ways: np.ndarray
    unidentifiable: np.ndarray
    step: np.ndarray
    misfit: float

    @property
    def change(self) -> np.ndarray:
        return np.asarray(self.ways @ self.step)

    @property
    def relative(self) -> np.ndarray:
        """Change (`OF_ROBOT`,) [-] of each parameter of the robot, in `scales`."""
        return np.abs(self.change / scales(self.model.guess))[:OF_ROBOT]

    @property
    def score(self) -> float:
        return self.misfit if self.relative.max() <= _FAR else np.inf

    def closures(self, angle: float = 0.0) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths at readings that are larger by `angle` [rad]."""
        at = self.model.platform(self.change, self.measurements.marker)
        return self.model.closures(self.change, at, self.measurements.angles + angle)


def _nearby(
    guess: RobotParameters,
    measurements: Measurements,
    noise: MeasurementNoise,
    known: Collection[FrameName],
    held: Collection[Name],
) -> _Start:
    """The first of the two least-squares problems: the smallest errors of the rods' lengths."""
    free = free_directions(guess, known, held)
    least = free.shape[1] // 6 + 1
    if len(measurements) < least:
        allowed = f"at least {least} poses for {free.shape[1]} unknown numbers, better some 60"
        raise ConfigurationError(measurements.source, f"{len(measurements)} rows", allowed)
    model, size, nothing = located(guess, measurements, known), scales(guess)[:, None], np.zeros(SIZE)
    observed, angles = measurements.marker, measurements.angles
    at = model.platform(nothing, observed)
    slope = model.whitening(nothing, at, angles, noise) @ model.tracker_slope(nothing, at, angles) @ (size * free)
    _, sigma, directions = np.linalg.svd(slope.reshape(-1, free.shape[1]), full_matrices=True)
    directions, count = free @ directions.T, int((sigma * LARGEST >= 1.0).sum())
    ways, cranks = size * directions[:, :count], float(guess.crank_lengths.max())
    unit = math.hypot(noise.position, guess.characteristic_length * noise.rotation, cranks * noise.encoder)

    def closures(step: np.ndarray) -> np.ndarray:
        return model.closures(ways @ step, model.platform(ways @ step, observed), angles).ravel() / unit

    def by_step(step: np.ndarray) -> np.ndarray:
        return (model.closure_slope(ways @ step, observed, angles) @ ways).reshape(-1, count) / unit

    result = scipy.optimize.least_squares(closures, np.zeros(count), by_step, max_nfev=_NEARBY, **_SEARCH)
    misfit = math.sqrt(2.0 * result.cost / (result.fun.size - count))
    return _Start(model, measurements, ways, directions[:, count:], result.x, misfit)


def _fitted(
    start: _Start, noise: MeasurementNoise, known: Collection[FrameName], held: Collection[Name]
) -> Calibration:
    """The second of the two least-squares problems: the smallest errors of the tracker."""
    model, measurements, ways, guess = start.model, start.measurements, start.ways, start.model.guess
    observed, angles, nothing = measurements.marker, measurements.angles, np.zeros(SIZE)

    def predicted(step: np.ndarray) -> np.ndarray:
        at, off = model.predicted(ways @ step, angles, model.platform(ways @ step, observed))
        if (off > CLOSED).any():
            key = f"{measurements.source}: row {int(off.argmax()) + 1}, crank_angle"
            got = f"readings at which no calibrated legs close: a rod is off by {off.max():.3g} m"
            raise ConfigurationError(key, got, "a pose that is not singular, and a guess close to the robot")
        return at

    def error(step: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj->ni", white, model.tracker_error(ways @ step, predicted(step), observed)).ravel()

    def by_step(step: np.ndarray) -> np.ndarray:
        slope = model.tracker_slope(ways @ step, predicted(step), angles, observed)
        return (white @ slope @ ways).reshape(-1, ways.shape[1])

    white = model.whitening(start.change, predicted(start.step), angles, noise)
    result = scipy.optimize.least_squares(error, start.step, by_step, max_nfev=_EXACT, **_SEARCH)
    change, freedom = ways @ result.x, result.fun.size - result.x.size
    ratio = math.sqrt(2.0 * result.cost / freedom)
    # Scaled by what the residuals say of the noise, so that noise which is larger than stated widens the intervals.
    deviation = ratio * np.linalg.norm(ways @ np.linalg.inv(np.linalg.qr(result.jac, mode="r")), axis=1)
    half_width = deviation * float(stdtrit(freedom, 0.5 + 0.5 * _CONFIDENCE))
    half_width[np.linalg.norm(start.unidentifiable, axis=1) > _SHARE] = np.inf
    believed, off = model.predicted(nothing, angles, model.platform(nothing, observed))
    before = np.where((off <= CLOSED)[:, None], model.tracker_error(nothing, believed, observed), np.nan)
    base, marker = model.frames(change)
    return Calibration(
        robot=as_robot(guess, change),
        guess=guess,
        measurements=measurements,
        known_frames=tuple(name for name in FRAMES if name in known),
        hold=tuple(name for name in NAMES if name in held),
        change=change,
        half_width=half_width,
        identifiable=ways.shape[1],
        unidentifiable=tuple(in_words(start.unidentifiable, scales(guess))),
        base=base,
        marker=marker,
        before=before,
        after=model.tracker_error(change, predicted(result.x), observed),
        noise_ratio=ratio,
    )


def located(guess: RobotParameters, measurements: Measurements, known: Collection[FrameName]) -> Model:
    """The guess with the frames at which its own poses at the readings come nearest to the measured ones."""
    believed, good = Model(guess).assembled(measurements.angles)
    observed = measurements.marker[good]
    if len(observed) < _LEAST:
        got = f"readings, of which only {len(observed)} of {len(measurements)} are possible for this robot"
        allowed = "readings in rad (or _deg), in the order of the legs, near the crank angles of the guess"
        raise ConfigurationError(f"{measurements.source}: crank_angle", got, allowed)
    free = [OF_ROBOT + 6 * FRAMES.index(frame) + axis for frame in FRAMES if frame not in known for axis in range(6)]
    if not free:
        return Model(guess)
    base, marker, length = STILL, STILL, guess.characteristic_length
    size = np.array([length] * 3 + [1.0] * 3)
    if "base" not in known:
        # Turns from pose to pose are turned by the base alone; shifts nearly so, and tell it where no pose is turned.
        there, here = (np.concatenate(np.hsplit(size * _steps(each), 2)) for each in (observed, believed))
        turn = _rotation(there.T @ here)
        base = transform(turn, (observed[:, :3, 3] - believed[:, :3, 3] @ turn.T).mean(axis=0))
    if "platform" not in known:
        turns = np.swapaxes(believed[:, :3, :3], -1, -2) @ base[:3, :3].T @ observed[:, :3, :3]
        marker = transform(_rotation(turns.sum(axis=0)), np.zeros(3))
    model = Model(guess, base, marker)

    def change(step: np.ndarray) -> np.ndarray:
        made = np.zeros(SIZE)
        made[free] = step
        return made

    def error(step: np.ndarray) -> np.ndarray:
        return (size * model.tracker_error(change(step), believed, observed)).ravel()

    return model.with_frames(change(scipy.optimize.least_squares(error, np.zeros(len(free)), x_scale="jac").x))


def _rotation(matrix: np.ndarray) -> np.ndarray:
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _steps(frame: np.ndarray) -> np.ndarray:
    """Turns and shifts (n, 6) [rad, m] to each of n transforms from the one before it, in a ring."""
    return difference(frame, np.roll(frame, 1, axis=0))


def _explained(fit: Callable[[Measurements], _Start], guess: RobotParameters, measurements: Measurements) -> _Start:
    """The fit of measurements; refuses them if others, that are right if something is wrong, fit much better."""
    start, reason, best = None, None, np.inf
    try:
        start = fit(measurements)
        best = max(start.misfit / _BETTER, _MISFIT if start.score == np.inf else 0.0)
    except ConfigurationError as error:
        reason = error
    for table, *why in _others(guess, measurements, start) if start is None or start.score > _MISFIT else ():
        try:
            score = fit(Measurements(table[:, :6], table[:, 6:], measurements.source)).score
        except ConfigurationError:
            continue
        if score < best:
            best, reason = score, ConfigurationError(*why)
            if score <= _MISFIT:
                break
    if reason is not None:
        raise reason
    assert start is not None
    if start.score == np.inf:
        leg, at = divmod(int(start.relative.argmax()), PER_LEG)
        off = f"{abs(start.change[PER_LEG * leg + at]):.3g} {OF_LEG[at].unit}"
        got = f"poses that give a {OF_LEG[at]} of leg {leg} {off} off the guess"
        allowed = "readings of this robot; is it another one, or are two encoders swapped?"
        raise ConfigurationError(measurements.source, got, allowed)
    by_angle = derivative(lambda step: start.closures(step[0]), 1)[..., 0]
    # By a leg's own angle its closure grows on the branch +1: the rod then pulls against the crank's motion.
    wrong = (np.sign(by_angle) == -guess.branches).all(axis=0)
    if wrong.any():
        leg = int(wrong.argmax())
        allowed = f"{-guess.branches[leg]}, the branch of the readings of {measurements.source}"
        raise ConfigurationError(f"robot.legs.{leg}.branch", int(guess.branches[leg]), allowed)
    return start


def _others(
    guess: RobotParameters, measurements: Measurements, start: _Start | None
) -> Iterator[tuple[np.ndarray, str, str, str]]:
    """Poses and readings (n, 12) that would be right if units, rows or signs were wrong, and what to say of it."""
    source, table = measurements.source, measurements.table
    for key, columns, factor, what in _UNITS:
        scaled = table.copy()
        scaled[:, columns] *= factor
        got = f"numbers that fit if they are multiplied by {factor:.4g}"
        yield scaled, f"{source}: {key}", got, f"the unit in the column's name; perhaps {what}?"
    strays = _stray_rows(guess, measurements)
    suspects = [strays] if 0 < len(strays) <= _FEW * len(measurements) else []
    if start is not None:
        off = np.abs(start.closures()).max(axis=-1)
        suspects += [[row] for row in np.argsort(-off)[:_ROWS].tolist()]
    for rows in suspects:
        got, allowed = "a pose that does not fit the others", "pose and readings at rest"
        yield np.delete(table, rows, axis=0), f"{source}: row {rows[0] + 1}", got, allowed
    for leg in range(LEGS):
        inverted = table * np.where(np.arange(12) == 6 + leg, -1.0, 1.0)
        got, allowed = "readings that fit with the other sign", "angles with the sign of the guess's crank angle"
        yield inverted, f"{source}: crank_angle_{leg}", got, allowed


def _stray_rows(guess: RobotParameters, measurements: Measurements) -> list[int]:
    """Rows turned or shifted from their neighbours as the guess is not, or where it is none; the worst first."""
    believed, good = Model(guess).assembled(measurements.angles)
    far = np.where(good, 0.0, np.inf)
    if good.any():
        turns_and_shifts = (_steps(each).reshape(-1, 2, 3) for each in (measurements.marker[good], believed))
        observed, steps = (np.linalg.norm(each, axis=-1) for each in turns_and_shifts)
        off = np.abs(observed - steps)
        most = (off / (np.median(off, axis=0) + 1e-12)).max(axis=-1)
        far[good] = np.minimum(most, np.roll(most, -1))
    return [row for row in np.argsort(-far, kind="stable").tolist() if far[row] > _APART]
