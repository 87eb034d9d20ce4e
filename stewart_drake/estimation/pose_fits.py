"""The two least-squares problems of a calibration, one after the other.

First the errors of the rods' lengths, which exist for any guess where whole poses are measured; then the instrument's
errors, weighted by their covariance: the maximum of the likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.core import Estimate, Unidentifiable
from stewart_drake.estimation.geometry import OF_ROBOT, PARAMETERS, SIZE, PoseModel
from stewart_drake.estimation.poses import MeasurementNoise, Measurements
from stewart_drake.robot import RobotParameters

_CONFIDENCE = 0.95
_SEARCH = {"x_scale": 0.1, "xtol": 1e-12, "ftol": 1e-12, "gtol": None}
"""Steps are at most a tenth of `scales`: from a crude guess, a larger step may flip a motor's axis."""
_FIRST_CALLS = 10  # Evaluations of the errors in the first fit, at most: six suffice if the model fits at all.
_CALLS = 200  # The same in the last fit.
_LEAST_POSES = 4  # to locate the tracker's frames
FAR = 0.3  # [-] change of a parameter, in `scales`, that nobody's guess is off by.
_NO_PRIOR = np.zeros((0, SIZE))
_Function = Callable[[np.ndarray], np.ndarray]


def fewest_poses(free: np.ndarray, measurements: Measurements) -> int:
    """Fewest poses that determine numbers along free directions (`SIZE`, k)."""
    return free.shape[1] // int(measurements.measured.sum()) + 1


class ClosureFit(NamedTuple):
    """The smallest closures, at a step (k,) along identifiable `directions` (`SIZE`, k) [m, rad].

    `misfit` [-] is their size over their noise, `relative` (`OF_ROBOT`,) [-] the size of each change in `scales`,
    beyond what noise explains.
    """

    model: PoseModel
    measurements: Measurements
    directions: np.ndarray
    unidentifiable: tuple[Unidentifiable, ...]
    step: np.ndarray
    change: np.ndarray
    relative: np.ndarray
    misfit: float

    @property
    def score(self) -> float:
        return self.misfit if self.relative.max() <= FAR else np.inf

    def closures(self, angle: float = 0.0) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths at readings that are larger by `angle` [rad]."""
        at = self.model.platform(self.change, self.measurements.marker)
        return self.model.closures(self.change, at, self.measurements.angles + angle)

    def off(self) -> np.ndarray:
        """Errors (n,) of the rows: of the rods' lengths, or where not all is measured of the instrument."""
        errors = self.closures() if self.model.near is None else self.instrument_error(self.change)
        return np.asarray(np.abs(errors).max(axis=-1))

    def instrument_error(self, change: np.ndarray) -> np.ndarray:
        """Measured minus predicted poses (n, k) [rad, m]."""
        return self.model.tracker_error(change, self.predicted(change), self.measurements.marker)

    def predicted(self, change: np.ndarray) -> np.ndarray:
        """Poses (n, 4, 4) of P at the readings."""
        near = self.model.platform(change, self.measurements.marker)
        at, error = self.model.predicted(change, self.measurements.angles, near)
        if (error > geometry.CLOSED).any():
            key = f"{self.measurements.source}: row {int(error.argmax()) + 1}, crank_angle"
            got = f"readings at which no calibrated legs close: a rod is off by {error.max():.3g} m"
            raise ConfigurationError(key, got, "a pose that is not singular, and a guess close to the robot")
        return at


def _flat(slopes: np.ndarray) -> np.ndarray:
    """Slopes (..., k) as (m, k), even with k = 0."""
    return slopes.reshape(math.prod(slopes.shape[:-1]), slopes.shape[-1])


def _minimised(
    errors: _Function,
    slope: _Function,
    directions: np.ndarray,
    start: np.ndarray,
    calls: int,
    prior: np.ndarray = _NO_PRIOR,
) -> scipy.optimize.OptimizeResult:
    """The result of `scipy.optimize.least_squares` for the step along directions; errors and slope take the change.

    The products of the rows `prior` (m, `SIZE`) with the change are m more errors, the last ones.
    """
    more = prior @ directions

    def all_errors(step: np.ndarray) -> np.ndarray:
        return np.concatenate([errors(directions @ step).ravel(), more @ step])

    def all_slopes(step: np.ndarray) -> np.ndarray:
        return np.concatenate([_flat(slope(directions @ step) @ directions), more])

    if start.size == 0:
        fun = all_errors(start)
        return scipy.optimize.OptimizeResult(x=start, fun=fun, cost=0.5 * fun @ fun, jac=all_slopes(start))
    return scipy.optimize.least_squares(all_errors, start, all_slopes, max_nfev=calls, **_SEARCH)


def fit_closures(
    guess: RobotParameters,
    known: Collection[str],
    free: np.ndarray,
    noise: MeasurementNoise,
    measurements: Measurements,
) -> ClosureFit:
    """The first of the two least-squares problems: the smallest errors of the rods' lengths."""
    least = fewest_poses(free, measurements)
    if len(measurements) < least:
        allowed = f"at least {least} poses for {free.shape[1]} unknown numbers, better some 60"
        raise ConfigurationError(measurements.source, f"{len(measurements)} rows", allowed)
    model, size, nothing = located(guess, measurements, known), geometry.scales(guess), np.zeros(SIZE)
    observed, angles = measurements.marker, measurements.angles
    at = model.platform(nothing, observed)
    slope = model.whitening(nothing, at, angles, noise) @ model.tracker_slope(nothing, at, angles)
    white, ways = _flat(slope @ (size[:, None] * free)), free
    free, unidentifiable = core.identifiable(white, ways, size, geometry.LARGEST_DEVIATION, geometry.PREFERENCE)
    directions, cranks = size[:, None] * free, float(guess.crank_lengths.max())
    root = np.linalg.inv(np.linalg.qr(white @ ways.T @ free, mode="r"))
    spread = 3.0 * np.linalg.norm((free @ root)[:OF_ROBOT], axis=1)
    begin = np.zeros(directions.shape[1])
    if model.near is not None:
        start = ClosureFit(model, measurements, directions, unidentifiable, begin, nothing, nothing[:OF_ROBOT], 0.0)
        found = fit_tracker(start, whitening(start, noise))
        change = found.estimate.values
        relative = np.abs(change / size)[:OF_ROBOT] - spread
        return start._replace(step=found.step, change=change, relative=relative, misfit=found.ratio)
    unit = math.hypot(noise.position, guess.characteristic_length * noise.rotation, cranks * noise.encoder)
    result = _minimised(
        lambda change: model.closures(change, model.platform(change, observed), angles) / unit,
        lambda change: model.closure_slope(change, observed, angles) / unit,
        directions,
        begin,
        _FIRST_CALLS,
    )
    misfit = math.sqrt(2.0 * result.cost / (result.fun.size - result.x.size))
    change = directions @ result.x
    relative = np.abs(change / size)[:OF_ROBOT] - spread
    return ClosureFit(model, measurements, directions, unidentifiable, result.x, change, relative, misfit)


def whitening(start: ClosureFit, noise: MeasurementNoise) -> np.ndarray:
    """Weights (n, k, k) of the instrument's errors."""
    return start.model.whitening(start.change, start.predicted(start.change), start.measurements.angles, noise)


class TrackerFit(NamedTuple):
    """The most likely numbers, at a step (k,) along the directions."""

    estimate: Estimate
    ratio: float  # [-] errors over the stated noise.
    step: np.ndarray
    effective: float  # [-] how many numbers the data determine, rather than the prior.


def fit_tracker(start: ClosureFit, white: np.ndarray) -> TrackerFit:
    """The second of the two least-squares problems: the smallest errors of the instrument, weighted, with the prior."""
    model, directions, angles = start.model, start.directions, start.measurements.angles
    result = _minimised(
        lambda change: np.einsum("nij,nj->ni", white, start.instrument_error(change)),
        lambda change: white @ model.tracker_slope(change, start.predicted(change), angles, start.measurements.marker),
        directions,
        start.step,
        _CALLS,
        geometry.PRIOR,
    )
    count = result.fun.size - len(geometry.PRIOR)
    # Scaled by what the residuals say of the noise, so that noise which is larger than stated widens the intervals.
    try:
        root = np.linalg.inv(np.linalg.qr(result.jac, mode="r"))
    except np.linalg.LinAlgError:
        got, allowed = f"poses that do not determine {result.x.size} numbers", "more poses, or fewer numbers to fit"
        raise ConfigurationError(start.measurements.source, got, allowed) from None
    effective = float(np.sum((result.jac[:count] @ root) ** 2))
    freedom = max(1.0, count - effective)
    ratio = math.sqrt(float(np.sum(result.fun[:count] ** 2)) / freedom)
    estimate = Estimate(
        PARAMETERS,
        geometry.scales(model.guess),
        directions @ result.x,
        directions,
        ratio**2 * root @ root.T,
        result.jac.T @ result.jac,
        start.unidentifiable,
        float(stdtrit(freedom, 0.5 + 0.5 * _CONFIDENCE)),
    )
    return TrackerFit(estimate, ratio, result.x, effective)


def located(guess: RobotParameters, measurements: Measurements, known: Collection[str]) -> PoseModel:
    """The guess with the frames at which its own poses at the readings come nearest to the measured ones."""
    measured, plain = measurements.measured, PoseModel(guess, measured=measurements.measured)
    believed, good = plain.assembled(measurements.angles)
    observed, directions = measurements.marker[good], geometry.free_frames(known, measured)
    if len(observed) < (_LEAST_POSES if directions.size else 1) or not (measured.all() or good.all()):
        got = f"readings, of which only {len(observed)} of {len(measurements)} are possible for this robot"
        allowed = "readings in rad (or _deg), in the order of the legs, near the crank angles of the guess"
        raise ConfigurationError(f"{measurements.source}: crank_angle", got, allowed)
    plain = replace(plain, near=None if measured.all() else believed)
    if not directions.size:
        return plain
    base, marker, length = np.eye(4), np.eye(4), guess.characteristic_length
    size = np.array([length] * 3 + [1.0] * 3)
    if "base" not in known and (measured[2] or measured[3:].all()):
        # Turns from pose to pose are turned by the base alone; shifts nearly so, and they show it if no pose is turned.
        known_parts = size * np.repeat([measured[:3].all(), measured[3:].all()], 3)
        there, here = (
            np.concatenate(np.hsplit(known_parts * geometry.steps(poses), 2)) for poses in (observed, believed)
        )
        turn = Rotation.align_vectors(there, here)[0].as_matrix()
        if not measured[3:].any():
            turn = geometry.heading_of(turn)
        base = geometry.transform(turn, (observed[:, :3, 3] - believed[:, :3, 3] @ turn.T).mean(axis=0) * measured[3:])
    if "platform" not in known and measured[:3].all():
        turns = np.swapaxes(believed[:, :3, :3], -1, -2) @ base[:3, :3].T @ observed[:, :3, :3]
        marker = geometry.transform(Rotation.from_matrix(turns).mean().as_matrix(), np.zeros(3))
    elif "platform" not in known and measured[0]:
        # The vertical as the platform has it and as the instrument does.
        marker[:3, :3] = Rotation.align_vectors(believed[:, 2, :3], observed[:, 2, :3])[0].as_matrix()
    model = replace(plain, base=base, marker=marker)

    def error(frames: np.ndarray) -> np.ndarray:
        return (size[measured] * model.tracker_error(directions @ frames, believed, observed)).ravel()

    found = scipy.optimize.least_squares(error, np.zeros(directions.shape[1]), x_scale="jac")
    return model.with_frames(directions @ found.x)
