"""A robot's geometry from measured poses: two least-squares problems, one after the other; or why poses do not fit.

First the errors of the rods' lengths, which exist for any guess; then the tracker's errors, weighted by their
covariance: the maximum of the likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import numbers_to_csv
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.core import Estimate, Result, Unidentifiable
from stewart_drake.estimation.corrections import corrections
from stewart_drake.estimation.geometry import OF_ROBOT, PARAMETERS, PER_LEG, SIZE, PoseModel
from stewart_drake.estimation.poses import MeasurementNoise, Measurements, load_measurements
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_CONFIDENCE = 0.95
_SHARE = 1e-3  # [-] of an unidentifiable direction beyond which a parameter has no interval
_NOISY = 2.0  # Ratio of errors to the stated noise above which this noise, or the model, is doubtful.
_SEARCH = {"x_scale": 0.1, "xtol": 1e-12, "ftol": 1e-12, "gtol": None}
"""Steps are at most a tenth of `scales`: from a crude guess, a larger step may flip a motor's axis."""
_FIRST_CALLS = 10  # Evaluations of the errors in the first fit, at most: six suffice if the model fits at all.
_CALLS = 200  # The same in the last fit.
_LEAST_POSES = 4  # to locate the tracker's frames
_SAME = 1e-9  # [rad, m] less than any tracker's last digit, more than a file's.
_MISFIT = _BETTER = 5.0
"""[-] closures over their noise from which a reason is looked for, and how many times smaller one must make them."""
_FAR = 0.3  # [-] change of a parameter, in `scales`, that nobody's guess is off by.
_Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """A calibrated robot, and how well it is known.

    Attributes:
        robot: The result. Its crank angles are the encoder readings: its crank directions include the homing offsets.
        model: The guess, with the tracker's frames fitted to it.
        measurements: The measured poses.
        known_frames: Frames of the tracker that were known.
        hold: Parameters that kept their value.
        estimate: (78,) [m, rad] change of the guess's parameters and the tracker's frames, see `geometry`.
        noise_ratio: [-] errors over the stated noise; the intervals are scaled by it.
    """

    robot: RobotParameters
    model: PoseModel
    measurements: Measurements
    known_frames: tuple[str, ...]
    hold: tuple[str, ...]
    estimate: Estimate
    noise_ratio: float

    columns: ClassVar = ("leg", "parameter", "axis", "unit", "guess", "value", "half_width")
    about: ClassVar = (
        "Changes from the guess, with 95 % intervals. The homing offset is reading minus true angle. It is part of\n"
        "the robot's crank directions, so that its crank angles are the readings."
    )
    picture: ClassVar = "Errors of the poses and changes of the parameters"

    @property
    def title(self) -> str:
        return f"Calibration from {self.measurements.source}"

    @property
    def guess(self) -> RobotParameters:
        """The robot that the calibration started from."""
        return self.model.guess

    @property
    def change(self) -> np.ndarray:
        """(78,) [m, rad] of the guess's parameters and the tracker's frames."""
        return self.estimate.values

    @property
    def base(self) -> np.ndarray:
        """(4, 4) B in the tracker's frame."""
        return self.model.frames(self.change)[0]

    @property
    def marker(self) -> np.ndarray:
        """(4, 4) the marker in P."""
        return self.model.frames(self.change)[1]

    @cached_property
    def before(self) -> np.ndarray:
        """(n, 6) [rad, m] measured minus predicted poses of the marker; NaN where the guess cannot be assembled."""
        return self._errors(np.zeros(SIZE))

    @cached_property
    def after(self) -> np.ndarray:
        """(n, 6) [rad, m] measured minus calibrated poses of the marker."""
        return self._errors(self.change)

    def _errors(self, change: np.ndarray) -> np.ndarray:
        observed = self.measurements.marker
        at, error = self.model.predicted(change, self.measurements.angles, self.model.platform(change, observed))
        return np.where((error <= geometry.CLOSED)[:, None], self.model.tracker_error(change, at, observed), np.nan)

    @property
    def half_width(self) -> np.ndarray:
        """(78,) [m, rad] of the 95 % intervals; 0 for what was held or known, infinite if unidentifiable."""
        size = self.estimate.scales
        shares = [np.abs(each.direction) * size[each.at] / size for each in self.estimate.unidentifiable]
        return np.where(np.max(shares, axis=0, initial=0.0) > _SHARE, np.inf, self.estimate.half_width)

    @property
    def identifiable(self) -> int:
        """Number of independent parameters that were estimated."""
        return self.estimate.directions.shape[1]

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """What these poses cannot determine, one sentence each."""
        return self.estimate.unidentifiable_sentences()

    @property
    def homing_offsets(self) -> np.ndarray:
        """(6,) [rad] readings minus the true angles of the guess's convention."""
        return geometry.by_leg(self.change)[:, geometry.HOMING]

    def rows(self) -> list[tuple[object, ...]]:
        start, end = geometry.values_of(self.guess), OF_ROBOT
        numbers = np.stack([start, start + self.change[:end], self.half_width[:end]], axis=-1).tolist()
        return [(at // PER_LEG, *PARAMETERS[at][:3], *row) for at, row in enumerate(numbers)]

    def error_sizes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """RMS over the poses of position [m] and rotation [rad] error, before and after."""

        def sizes(error: np.ndarray) -> tuple[float, float]:
            square = np.nanmean(error**2, axis=0)
            return float(np.sqrt(square[3:].sum())), float(np.sqrt(square[:3].sum()))

        return sizes(self.before), sizes(self.after)

    def summary(self) -> list[tuple[str, str]]:
        before, after = (f"{1e3 * place:.3g} mm, {1e3 * turn:.3g} mrad" for place, turn in self.error_sizes())
        widest: dict[str, float] = {}
        for parameter, width in zip(
            geometry.LEG_PARAMETERS, geometry.by_leg(self.half_width, display=True).max(axis=0), strict=True
        ):
            key = f"{parameter.kind} {{:.2g}} {parameter.display[0]}"
            widest[key] = max(width, widest.get(key, 0.0))
        ratio = f"{self.noise_ratio:.3g} times the stated noise"
        if self.noise_ratio > _NOISY:
            ratio += ": the noise is larger than stated, or legs have play or bend; the intervals are widened by it"
        rows = [
            ("poses, parameters estimated", f"{len(self.measurements)}, {self.identifiable}"),
            ("pose error before (RMS)", before),
            ("pose error after (RMS)", after),
            ("remaining errors", ratio),
            ("widest 95 % intervals, ±", ", ".join(text.format(width) for text, width in widest.items())),
        ]
        for frame, kind, where, points in (
            ("base", "shaft_position", "where B is", "the shafts"),
            ("platform", "platform_joint", "where P is", "the platform's joints"),
        ):
            if frame not in self.known_frames and kind not in self.hold:
                line = f"{where} (6 numbers); it is placed so that {points} are closest to the guess's"
                rows.append(("not identifiable by any poses", line))
        rows += [("not identifiable by these poses", line) for line in self.unidentifiable]
        return [*rows, *self._offsets_and_frames()]

    def _offsets_and_frames(self) -> Iterator[tuple[str, str]]:
        offsets = ", ".join(f"{1e3 * offset:.3f}" for offset in self.homing_offsets)
        yield "homing offsets in the crank angles, which are the encoders' readings [mrad]", offsets
        for name, frame in (("B in the tracker's frame", self.base), ("marker in P", self.marker)):
            yield f"{name}, roll pitch yaw [rad] X Y Z [m]", " ".join(f"{x:.7g}" for x in geometry.pose_of(frame))

    def table(self) -> tuple[list[str], list[list[str]]]:
        def cell(change: float, width: float) -> str:
            if width == 0.0:
                return "held"
            return f"{change:+.3f} ± {width:.2g}" if np.isfinite(width) else "unidentifiable"

        changes, widths = (geometry.by_leg(numbers, display=True) for numbers in (self.change, self.half_width))
        rows = [[name, *map(cell, changes[:, at], widths[:, at])] for at, name in enumerate(geometry.table_names())]
        return ["", *(f"leg {leg}" for leg in range(LEG_COUNT))], rows

    def robot_file(self) -> str:
        about = f"calibrated from {len(self.measurements)} measured poses: pose error {self.summary()[2][1]} (RMS)"
        return core.robot_yaml(about, [f"{name}: {text}" for name, text in self._offsets_and_frames()], self.robot)

    def residuals_csv(self) -> str:
        """Errors of each pose before and after as CSV, [rad, m]."""
        parts = [*((f"turn_{axis}", "rad") for axis in "xyz"), *((axis, "m") for axis in "xyz")]
        names = [(f"{when}_{name}", unit) for when in ("before", "after") for name, unit in parts]
        numbers = np.arange(len(self.after))[:, None] + 1.0
        return numbers_to_csv([("row", ""), *names], np.concatenate([numbers, self.before, self.after], axis=-1))


def calibrate(
    robot: RobotParameters,
    poses: Measurements | str | Path,
    noise: MeasurementNoise | None = None,
    known_frames: Collection[str] = (),
    hold: Collection[str] = (),
) -> Calibration:
    """Estimates a robot's geometry and homing offsets from measured poses and encoder readings.

    Args:
        robot: The guess; its branches, masses and limits are kept.
        poses: Measured poses with readings, or a CSV file of them, see `load_measurements`.
        noise: Of tracker and encoders; only the ratios of its numbers act on the estimate.
        known_frames: `base` if the tracker measures in B, `platform` if it measures the pose of P itself. Other
            frames are estimated, and then B is where the shafts lie nearest to those of the guess, and P where the
            platform's joints do.
        hold: Parameters that keep their value, of `geometry.KINDS`.

    Returns:
        The calibrated robot, whose crank angles are the encoders' readings, with intervals and residuals.

    Raises:
        ConfigurationError: Too few poses, or such as cannot be this robot's: wrong units, an inverted encoder, a
            single wrong row, another branch; the message names it where the residuals show it.
    """
    free = geometry.free_directions(robot, known_frames, hold)
    measurements = poses if isinstance(poses, Measurements) else load_measurements(poses)
    noise = MeasurementNoise() if noise is None else noise
    believed, good = PoseModel(robot).assembled(measurements.angles)
    if good.all() and np.abs(geometry.difference(believed, measurements.marker)).max() < _SAME:
        got = "the poses that the guess has at these crank angles"
        raise ConfigurationError(measurements.source, got, "measured poses; is this a plan, not measured yet?")
    fit = partial(_fit_closures, robot, known_frames, free, noise)
    start = _explained(fit, robot, measurements)
    estimate, noise_ratio = _fit_tracker(start, noise)
    known = tuple(frame for frame in geometry.FRAMES if frame in known_frames)
    held = tuple(kind for kind in geometry.KINDS if kind in hold)
    calibrated = geometry.as_robot(robot, estimate.values)
    return Calibration(calibrated, start.model, measurements, known, held, estimate, noise_ratio)


class _ClosureFit(NamedTuple):
    """The smallest closures, at a step (k,) along identifiable `directions` (`SIZE`, k) [m, rad].

    `misfit` [-] is their size over their noise, `relative` (`OF_ROBOT`,) [-] the size of each change in `scales`.
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


def _fit_closures(
    guess: RobotParameters,
    known: Collection[str],
    free: np.ndarray,
    noise: MeasurementNoise,
    measurements: Measurements,
) -> _ClosureFit:
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
    return _ClosureFit(model, measurements, directions, unidentifiable, result.x, change, relative, misfit)


def _fit_tracker(start: _ClosureFit, noise: MeasurementNoise) -> tuple[Estimate, float]:
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
    # Scaled by what the residuals say of the noise, so that noise which is larger than stated widens the intervals.
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
        there, here = (np.concatenate(np.hsplit(size * geometry.steps(frames), 2)) for frames in (observed, believed))
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


def _explained(
    fit: Callable[[Measurements], _ClosureFit], guess: RobotParameters, measurements: Measurements
) -> _ClosureFit:
    """The fit of measurements; refuses them if others, that are right if something is wrong, fit much better."""
    start, reason, best = None, None, np.inf
    try:
        start = fit(measurements)
        best = max(start.misfit / _BETTER, _MISFIT if start.score == np.inf else 0.0)
    except ConfigurationError as error:
        reason = error
    off = None if start is None else np.abs(start.closures()).max(axis=-1)
    for table, *message in corrections(guess, measurements, off) if start is None or start.score > _MISFIT else ():
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
