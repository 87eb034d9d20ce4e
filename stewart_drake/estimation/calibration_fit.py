"""The two least-squares problems of a calibration, one after the other; and why poses do not fit.

First the errors of the rods' lengths, which exist for any guess; then the tracker's errors, weighted by their
covariance: the maximum of the likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.core import Estimate, Unidentifiable
from stewart_drake.estimation.geometry import OF_ROBOT, PARAMETERS, PER_LEG, SIZE, PoseModel
from stewart_drake.estimation.poses import MeasurementNoise, Measurements
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_Function = Callable[[np.ndarray], np.ndarray]
_CONFIDENCE = 0.95
_SEARCH = {"x_scale": 0.1, "xtol": 1e-12, "ftol": 1e-12, "gtol": None}
"""Steps are a tenth of `scales` at most: a free step from a crude guess may flip a motor's axis."""
_FIRST_CALLS, _CALLS = 10, 200
"""Calls of the errors at most: six find a good fit, and a bad fit needs no minimum."""
_LEAST_POSES = 4  # To locate the tracker's frames.
_MISFIT = _BETTER = 5.0
"""[-] closures over their noise from which a reason is looked for, and how many times smaller one must make them."""
_FAR = 0.3  # [-] change of a parameter, in `scales`, by which nobody's guess is wrong.
_STRAY, _MOST_STRAYS, _SUSPECTS = 10.0, 0.2, 3
"""Error of a stray row over the usual one; largest share of stray rows; rows suspected."""
_DEGREE = math.pi / 180.0
_UNITS = (
    ("pose_x, y, z", slice(3, 6), 1e-3, "millimetres for metres"),
    ("pose_x, y, z", slice(3, 6), 1e3, "metres for millimetres"),
    ("pose_roll, pitch, yaw", slice(0, 3), _DEGREE, "degrees for radians"),
    ("pose_roll, pitch, yaw", slice(0, 3), 1.0 / _DEGREE, "radians for degrees"),
    ("crank_angle", slice(6, 12), _DEGREE, "degrees for radians"),
    ("crank_angle", slice(6, 12), 1.0 / _DEGREE, "radians for degrees"),
)


class ClosureFit(NamedTuple):
    """Least squares of the errors of the rods' lengths."""

    model: PoseModel
    measurements: Measurements
    directions: np.ndarray  # (`SIZE`, k) [m, rad] identifiable.
    unidentifiable: tuple[Unidentifiable, ...]
    step: np.ndarray  # (k,) along the directions.
    change: np.ndarray  # (`SIZE`,) [m, rad]
    relative: np.ndarray  # (`OF_ROBOT`,) [-] sizes of the changes in `scales`.
    misfit: float  # [-] size of the errors over their noise.

    @property
    def score(self) -> float:
        return self.misfit if self.relative.max() <= _FAR else np.inf

    def closures(self, angle: float = 0.0) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths at readings that are larger by `angle` [rad]."""
        at = self.model.platform(self.change, self.measurements.marker)
        return self.model.closures(self.change, at, self.measurements.angles + angle)


def _minimised(errors: _Function, slope: _Function, directions: np.ndarray, start: np.ndarray, calls: int) -> Any:
    """The result of `scipy.optimize.least_squares` for the step along directions; errors and slope take the change."""
    return scipy.optimize.least_squares(
        lambda step: errors(directions @ step).ravel(),
        start,
        lambda step: (slope(directions @ step) @ directions).reshape(-1, len(step)),
        max_nfev=calls,
        **_SEARCH,
    )


def fit_closures(
    guess: RobotParameters,
    known: Collection[str],
    free: np.ndarray,
    noise: MeasurementNoise,
    measurements: Measurements,
) -> ClosureFit:
    """The first of the two least-squares problems: the smallest errors of the rods' lengths."""
    least = free.shape[1] // 6 + 1
    if len(measurements) < least:
        allowed = f"at least {least} poses for {free.shape[1]} unknown numbers, better some 60"
        raise ConfigurationError(measurements.source, f"{len(measurements)} rows", allowed)
    model, size, nothing = located(guess, measurements, known), geometry.scales(guess), np.zeros(SIZE)
    observed, angles = measurements.marker, measurements.angles
    at = model.platform(nothing, observed)
    slope = model.whitening(nothing, at, angles, noise) @ model.tracker_slope(nothing, at, angles)
    slope = (slope @ (size[:, None] * free)).reshape(-1, free.shape[1])
    free, unidentifiable = core.identifiable(slope, free, size, geometry.LARGEST_DEVIATION)
    directions, cranks = size[:, None] * free, float(guess.crank_lengths.max())
    unit = math.hypot(noise.position, guess.characteristic_length * noise.rotation, cranks * noise.encoder)
    result = _minimised(
        lambda change: model.closures(change, model.platform(change, observed), angles) / unit,
        lambda change: model.closure_slope(change, observed, angles) / unit,
        directions,
        np.zeros(directions.shape[1]),
        _FIRST_CALLS,
    )
    misfit = math.sqrt(2.0 * result.cost / (result.fun.size - result.x.size))
    change = directions @ result.x
    relative = np.abs(change / size)[:OF_ROBOT]
    return ClosureFit(model, measurements, directions, unidentifiable, result.x, change, relative, misfit)


def fit_tracker(start: ClosureFit, noise: MeasurementNoise) -> tuple[Estimate, float]:
    """The second of the two least-squares problems: the smallest errors of the tracker; their size over the noise."""
    model, measurements, directions = start.model, start.measurements, start.directions
    observed, angles = measurements.marker, measurements.angles

    def predicted(change: np.ndarray) -> np.ndarray:
        at, error = model.predicted(change, angles, model.platform(change, observed))
        if (error > geometry.CLOSED).any():
            key = f"{measurements.source}: row {int(error.argmax()) + 1}, crank_angle"
            got = f"readings at which no calibrated legs close: a rod is off by {error.max():.3g} m"
            raise ConfigurationError(key, got, "a pose that is not singular, and a guess close to the robot")
        return at

    white = model.whitening(start.change, predicted(start.change), angles, noise)
    result = _minimised(
        lambda change: np.einsum("nij,nj->ni", white, model.tracker_error(change, predicted(change), observed)),
        lambda change: white @ model.tracker_slope(change, predicted(change), angles, observed),
        directions,
        start.step,
        _CALLS,
    )
    freedom = result.fun.size - result.x.size
    ratio = math.sqrt(2.0 * result.cost / freedom)
    # Scaled by the residuals, so that noise which is larger than stated widens the intervals.
    root = ratio * np.linalg.inv(np.linalg.qr(result.jac, mode="r"))
    estimate = Estimate(
        PARAMETERS,
        geometry.scales(model.guess),
        directions @ result.x,
        directions,
        root @ root.T,
        result.jac.T @ result.jac,
        start.unidentifiable,
        float(stdtrit(freedom, 0.5 + 0.5 * _CONFIDENCE)),
    )
    return estimate, ratio


def located(guess: RobotParameters, measurements: Measurements, known: Collection[str]) -> PoseModel:
    """The guess with the frames at which its own poses at the readings come nearest to the measured ones."""
    believed, good = PoseModel(guess).assembled(measurements.angles)
    observed = measurements.marker[good]
    if len(observed) < _LEAST_POSES:
        got = f"readings, of which only {len(observed)} of {len(measurements)} are possible for this robot"
        allowed = "readings in rad (or _deg), in the order of the legs, near the crank angles of the guess"
        raise ConfigurationError(f"{measurements.source}: crank_angle", got, allowed)
    free = [at for at in range(OF_ROBOT, SIZE) if PARAMETERS[at].kind not in known]
    if not free:
        return PoseModel(guess)
    base, marker, length = np.eye(4), np.eye(4), guess.characteristic_length
    size = np.array([length] * 3 + [1.0] * 3)
    if "base" not in known:
        # Turns from pose to pose are turned by the base alone; shifts nearly so, and they show it if no pose is turned.
        there, here = (np.concatenate(np.hsplit(size * _steps(frames), 2)) for frames in (observed, believed))
        turn = Rotation.align_vectors(there, here)[0].as_matrix()
        base = geometry.transform(turn, (observed[:, :3, 3] - believed[:, :3, 3] @ turn.T).mean(axis=0))
    if "platform" not in known:
        turns = np.swapaxes(believed[:, :3, :3], -1, -2) @ base[:3, :3].T @ observed[:, :3, :3]
        marker = geometry.transform(Rotation.from_matrix(turns).mean().as_matrix(), np.zeros(3))
    model = PoseModel(guess, base, marker)

    def error(frames: np.ndarray) -> np.ndarray:
        return (size * model.tracker_error(directions @ frames, believed, observed)).ravel()

    directions = np.eye(SIZE)[:, free]
    return model.with_frames(directions @ scipy.optimize.least_squares(error, np.zeros(len(free)), x_scale="jac").x)


def _steps(frames: np.ndarray) -> np.ndarray:
    """Turns and shifts (n, 6) [rad, m] to each of n frames from the one before it, in a ring."""
    return geometry.difference(frames, np.roll(frames, 1, axis=0))


def best_closures(
    fit: Callable[[Measurements], ClosureFit], guess: RobotParameters, measurements: Measurements
) -> ClosureFit:
    """The fit of measurements; refuses them if others, that are right if something is wrong, fit much better."""
    start, reason, best = None, None, np.inf
    try:
        start = fit(measurements)
        best = max(start.misfit / _BETTER, _MISFIT if start.score == np.inf else 0.0)
    except ConfigurationError as error:
        reason = error
    for table, *message in _alternatives(guess, measurements, start) if start is None or start.score > _MISFIT else ():
        try:
            score = fit(Measurements.of_table(table, measurements.source)).score
        except ConfigurationError:
            continue
        if score < best:
            best, reason = score, ConfigurationError(*message)
            if score <= _MISFIT:
                break
    if reason is not None:
        raise reason
    assert start is not None
    if start.score == np.inf:
        at = int(start.relative.argmax())
        parameter = PARAMETERS[at]._replace(owner="")
        off = f"{abs(start.change[at]):.3g} {parameter.unit}"
        got = f"poses that give a {parameter} of leg {at // PER_LEG} {off} off the guess"
        allowed = "readings of this robot; is it another one, or are two encoders swapped?"
        raise ConfigurationError(measurements.source, got, allowed)
    by_angle = geometry.derivative(lambda step: start.closures(step[0]), np.eye(1))[..., 0]
    # With a leg's own angle its closure grows on the branch +1: the rod then pulls against the crank's motion.
    wrong = (np.sign(by_angle) == -guess.branches).all(axis=0)
    if wrong.any():
        leg = int(wrong.argmax())
        allowed = f"{-guess.branches[leg]}, the branch of the readings of {measurements.source}"
        raise ConfigurationError(f"robot.legs.{leg}.branch", int(guess.branches[leg]), allowed)
    return start


def _alternatives(
    guess: RobotParameters, measurements: Measurements, start: ClosureFit | None
) -> Iterator[tuple[np.ndarray, str, str, str]]:
    """Tables (n, 12) that would be right if units, rows or signs were wrong, and key, value and remedy of the error."""
    source, table = measurements.source, measurements.table
    for key, columns, factor, units in _UNITS:
        scaled = table.copy()
        scaled[:, columns] *= factor
        got = f"numbers that fit if they are multiplied by {factor:.4g}"
        yield scaled, f"{source}: {key}", got, f"the unit in the column's name; perhaps {units}?"
    strays = _stray_rows(guess, measurements)
    suspects = [strays] if 0 < len(strays) <= _MOST_STRAYS * len(measurements) else []
    if start is not None:
        off = np.abs(start.closures()).max(axis=-1)
        suspects += [[row] for row in np.argsort(-off)[:_SUSPECTS].tolist()]
    for rows in suspects:
        got, allowed = "a pose that does not fit the others", "pose and readings at rest"
        yield np.delete(table, rows, axis=0), f"{source}: row {rows[0] + 1}", got, allowed
    for leg in range(LEG_COUNT):
        inverted = table * np.where(np.arange(12) == 6 + leg, -1.0, 1.0)
        got, allowed = "readings that fit with the other sign", "angles with the sign of the guess's crank angle"
        yield inverted, f"{source}: crank_angle_{leg}", got, allowed


def _stray_rows(guess: RobotParameters, measurements: Measurements) -> list[int]:
    """Rows turned or shifted from their neighbours otherwise than the guess's poses, or without one; worst first."""
    believed, good = PoseModel(guess).assembled(measurements.angles)
    far = np.where(good, 0.0, np.inf)
    if good.any():
        turns_and_shifts = (_steps(frames).reshape(-1, 2, 3) for frames in (measurements.marker[good], believed))
        observed, expected = (np.linalg.norm(steps, axis=-1) for steps in turns_and_shifts)
        off = np.abs(observed - expected)
        most = (off / (np.median(off, axis=0) + 1e-12)).max(axis=-1)
        far[good] = np.minimum(most, np.roll(most, -1))
    return [row for row in np.argsort(-far, kind="stable").tolist() if far[row] > _STRAY]
