"""A robot's geometry and servos from measured poses: two least-squares problems in turn; or why poses do not fit.

First the errors of the rods' lengths, which exist for any guess where whole poses are measured; then the instrument's
errors, weighted by their covariance: the maximum of the likelihood. What is fitted is chosen by the Bayesian
information criterion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import AXES, numbers_to_csv
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.core import Estimate, Result, Unidentifiable
from stewart_drake.estimation.corrections import corrections
from stewart_drake.estimation.geometry import FITS, KINDS, OF_ROBOT, PARAMETERS, PER_LEG, SIZE, PoseModel
from stewart_drake.estimation.poses import INSTRUMENTS, MeasurementNoise, Measurements, load_measurements
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_CONFIDENCE = 0.95
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


class Choice(NamedTuple):
    """One of the things that could be fitted, and how well."""

    fit: str  # Of `geometry.FITS`.
    parameters: int
    noise_ratio: float  # [-] errors over the stated noise.
    criterion: float  # Bayesian information criterion; infinite where the poses are too few or it does not fit.
    problem: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """A calibrated robot, and how well it is known.

    Attributes:
        robot: The result. Its crank angles are its `servo_gains` times the encoder readings: its crank directions
            include the homing offsets.
        model: The guess, with the tracker's frames fitted to it.
        measurements: The measured poses.
        known_frames: Frames of the tracker that were known.
        hold: Parameters that kept their value.
        estimate: (84,) [m, rad, -] change of the guess's parameters and the tracker's frames, see `geometry`.
        noise_ratio: [-] errors over the stated noise; the intervals are scaled by it.
        fit: What was fitted, of `geometry.FITS`.
        choices: What could be fitted, with the criterion by which `fit` was chosen.
    """

    robot: RobotParameters
    model: PoseModel
    measurements: Measurements
    known_frames: tuple[str, ...]
    hold: tuple[str, ...]
    estimate: Estimate
    noise_ratio: float
    fit: str
    choices: tuple[Choice, ...]

    columns: ClassVar = ("leg", "parameter", "axis", "unit", "guess", "value", "half_width")
    about: ClassVar = (
        "Changes from the guess, with 95 % intervals. The true angle is servo gain times reading, minus the homing\n"
        "offset. The offset is part of the robot's crank directions, so that its crank angles are gains times readings."
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
        """(84,) [m, rad, -] of the guess's parameters and the tracker's frames."""
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
        """(n, 6) [rad, m] measured minus predicted poses of the marker.

        NaN where a coordinate is not measured, or the guess cannot be assembled.
        """
        return self._errors(np.zeros(SIZE))

    @cached_property
    def after(self) -> np.ndarray:
        """(n, 6) [rad, m] measured minus calibrated poses of the marker."""
        return self._errors(self.change)

    def _errors(self, change: np.ndarray) -> np.ndarray:
        observed = self.measurements.marker
        at, error = self.model.predicted(change, self.measurements.angles, self.model.platform(change, observed))
        errors = np.full((len(at), 6), np.nan)
        errors[:, self.model.measured] = self.model.tracker_error(change, at, observed)
        errors[error > geometry.CLOSED] = np.nan
        return errors

    @property
    def half_width(self) -> np.ndarray:
        """(84,) [m, rad, -] of the 95 % intervals; 0 for what was held or known, infinite if unidentifiable."""
        return np.where(self.estimate.undetermined, np.inf, self.estimate.half_width)

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
        """(6,) [rad] readings times servo gains, minus the true angles of the guess's convention."""
        return geometry.by_leg(self.change)[:, geometry.HOMING]

    def rows(self) -> list[tuple[object, ...]]:
        start, end = geometry.values_of(self.guess), OF_ROBOT
        numbers = np.stack([start, start + self.change[:end], self.half_width[:end]], axis=-1).tolist()
        return [(at // PER_LEG, *PARAMETERS[at][:3], *row) for at, row in enumerate(numbers)]

    def error_sizes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """RMS over the poses of position [m] and rotation [rad] error, before and after; NaN if not measured."""
        seen = self.model.measured

        def sizes(error: np.ndarray) -> tuple[float, float]:
            square = np.zeros(6)
            square[seen] = np.nanmean(error[:, seen] ** 2, axis=0)
            place, turn = np.sqrt([square[3:].sum(), square[:3].sum()])
            return float(place) if seen[3:].any() else np.nan, float(turn) if seen[:3].any() else np.nan

        return sizes(self.before), sizes(self.after)

    def summary(self) -> list[tuple[str, str]]:
        before, after = (
            f"{1e3 * place:.3g} mm, {1e3 * turn:.3g} mrad".removeprefix("nan mm, ").removesuffix(", nan mrad")
            for place, turn in self.error_sizes()
        )
        measured = self.model.measured
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
            *([] if measured.all() else [("measured", ", ".join(np.array(AXES)[measured]))]),
            ("pose error before (RMS)", before),
            ("pose error after (RMS)", after),
            ("remaining errors", ratio),
            ("widest 95 % intervals, ±", ", ".join(text.format(width) for text, width in widest.items())),
        ]
        for frame, kind, where, points in (
            ("base", "shaft_position", "where B is", "the shafts"),
            ("platform", "platform_joint", "where P is", "the platform's joints"),
        ):
            if measured.all() and frame not in self.known_frames and kind not in self.hold:
                line = f"{where} (6 numbers); it is placed so that {points} are closest to the guess's"
                rows.append(("not identifiable by any poses", line))
        rows += [("not identifiable by these poses", line) for line in self.unidentifiable]
        return [*rows, *self._offsets_and_frames()]

    def _offsets_and_frames(self) -> Iterator[tuple[str, str]]:
        offsets = ", ".join(f"{1e3 * offset:.3f}" for offset in self.homing_offsets)
        yield "homing offsets in the crank angles, which are servo gains times readings [mrad]", offsets
        yield "servo gains [-]", ", ".join(f"{gain:.4f}" for gain in self.robot.servo_gains)
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

    def choice_table(self) -> tuple[list[str], list[list[str]]]:
        """Header and rows: what could be fitted, and by what `fit` was chosen."""
        least = min(choice.criterion for choice in self.choices)
        rows = [
            [
                choice.fit + (" (chosen)" if choice.fit == self.fit else ""),
                str(choice.parameters),
                choice.problem or f"{choice.noise_ratio:.3g}",
                "" if choice.problem else f"{choice.criterion - least:.1f}",
            ]
            for choice in self.choices
        ]
        return ["fit", "numbers", "remaining errors over noise", "BIC above the least"], rows

    def robot_file(self) -> str:
        error = dict(self.summary())["pose error after (RMS)"]
        about = f"calibrated from {len(self.measurements)} measured poses: pose error {error} (RMS)"
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
    fit: str | None = None,
) -> Calibration:
    """Estimates a robot's geometry, homing offsets and servo gains from measured poses and encoder readings.

    Args:
        robot: The guess; its branches, masses and limits are kept.
        poses: Measured poses with readings, or a CSV file of them, see `load_measurements`.
        noise: Of instrument and encoders; only the ratios of its numbers act on the estimate. None for that of a
            tracker, or where no positions are measured of an IMU.
        known_frames: `base` if the tracker measures in B, `platform` if it measures the pose of P itself. Other
            frames are estimated, and then B is where the shafts lie nearest to those of the guess, and P where the
            platform's joints do.
        hold: Parameters that keep their value, of `geometry.KINDS`.
        fit: What to estimate, of `geometry.FITS`: homing offsets alone; with servo gains; geometry with offsets; or
            all. None for the best by the Bayesian information criterion.

    Returns:
        The calibrated robot, with intervals and residuals.

    Raises:
        ConfigurationError: Too few poses, or such as cannot be this robot's: wrong units, an inverted encoder, a
            single wrong row, another branch; the message names it where the residuals show it.
    """
    core.check_choices("hold", hold, KINDS)
    core.check_choices("fit", () if fit is None else (fit,), tuple(FITS))
    measurements = poses if isinstance(poses, Measurements) else load_measurements(poses)
    noise = INSTRUMENTS[measurements.instrument].noise if noise is None else noise
    if not set(geometry.FRAMES) <= set(known_frames):
        measurements.refuse_repeated()
    _refuse_plan(robot, measurements)
    # With what is held, two may be the same.
    held = {frozenset(set(KINDS) - set(FITS[name]) | set(hold)): name for name in ((fit,) if fit else reversed(FITS))}
    ways = {
        name: geometry.free_directions(robot, known_frames, kinds, measurements.measured)
        for kinds, name in held.items()
        if len(kinds) < len(KINDS) or len(held) == 1
    }
    # The richest shows best whether anything can fit.
    by_size = sorted(ways, key=lambda name: -ways[name].shape[1])
    richest = next((name for name in by_size if _least(ways[name], measurements) <= len(measurements)), by_size[-1])
    start = _explained(partial(_fit_closures, robot, known_frames, ways[richest], noise), robot, measurements)
    few = by_size[: by_size.index(richest)]
    choices = [Choice(name, ways[name].shape[1], np.inf, np.inf, "too few poses") for name in few]
    white, results = _whitening(start, noise), dict[str, tuple[_ClosureFit, Estimate, float]]()
    for name in by_size[by_size.index(richest) :]:
        try:
            begin = start if name == richest else _fit_closures(robot, known_frames, ways[name], noise, measurements)
            estimate, ratio, _ = _fit_tracker(begin, white)
        except ConfigurationError:
            if name == richest:
                raise
            choices.append(Choice(name, ways[name].shape[1], np.inf, np.inf, "does not fit"))
            continue
        results[name] = begin, estimate, ratio
        count, unknown = white.shape[0] * white.shape[1], estimate.directions.shape[1]
        # The richest fit shows whether the noise is larger than stated.
        errors = max(1, count - unknown) * (ratio / max(1.0, results[richest][2])) ** 2
        choices.append(Choice(name, unknown, ratio, errors + unknown * math.log(count)))
    best = min(choices, key=lambda choice: choice.criterion).fit
    start, estimate, noise_ratio = results[best]
    known = tuple(frame for frame in geometry.FRAMES if frame in known_frames)
    kept = tuple(kind for kind in KINDS if kind in hold or kind not in FITS[best])
    calibrated = geometry.as_robot(robot, estimate.values)
    fitted = estimate, noise_ratio, best, tuple(choices)
    return Calibration(calibrated, start.model, measurements, known, kept, *fitted)


def _refuse_plan(robot: RobotParameters, measurements: Measurements) -> None:
    """Raises a `ConfigurationError` if the poses are exactly those of the guess."""
    model = PoseModel(robot, measured=measurements.measured)
    believed, good = model.assembled(measurements.angles)
    if good.all() and np.abs(model.tracker_error(np.zeros(SIZE), believed, measurements.marker)).max() < _SAME:
        got = "the poses that the guess has at these crank angles"
        raise ConfigurationError(measurements.source, got, "measured poses; is this a plan, not measured yet?")


def _least(free: np.ndarray, measurements: Measurements) -> int:
    """Fewest poses that determine numbers along free directions (`SIZE`, k)."""
    return free.shape[1] // int(measurements.measured.sum()) + 1


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
    least = _least(free, measurements)
    if len(measurements) < least:
        allowed = f"at least {least} poses for {free.shape[1]} unknown numbers, better some 60"
        raise ConfigurationError(measurements.source, f"{len(measurements)} rows", allowed)
    model, size, nothing = located(guess, measurements, known), geometry.scales(guess), np.zeros(SIZE)
    observed, angles = measurements.marker, measurements.angles
    at = model.platform(nothing, observed)
    slope = model.whitening(nothing, at, angles, noise) @ model.tracker_slope(nothing, at, angles)
    slope = (slope @ (size[:, None] * free)).reshape(-1, free.shape[1])
    free, unidentifiable = core.identifiable(slope, free, size, geometry.LARGEST_DEVIATION, geometry.PREFERENCE)
    directions, cranks = size[:, None] * free, float(guess.crank_lengths.max())
    begin = np.zeros(directions.shape[1])
    if model.near is not None:
        start = _ClosureFit(model, measurements, directions, unidentifiable, begin, nothing, nothing[:OF_ROBOT], 0.0)
        estimate, ratio, step = _fit_tracker(start, _whitening(start, noise))
        relative = np.abs(estimate.values / size)[:OF_ROBOT]
        return start._replace(step=step, change=estimate.values, relative=relative, misfit=ratio)
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
    relative = np.abs(change / size)[:OF_ROBOT]
    return _ClosureFit(model, measurements, directions, unidentifiable, result.x, change, relative, misfit)


def _whitening(start: _ClosureFit, noise: MeasurementNoise) -> np.ndarray:
    """Weights (n, k, k) of the instrument's errors."""
    return start.model.whitening(start.change, start.predicted(start.change), start.measurements.angles, noise)


def _fit_tracker(start: _ClosureFit, white: np.ndarray) -> tuple[Estimate, float, np.ndarray]:
    """The second of the two least-squares problems: the smallest errors of the instrument, weighted.

    Returns the estimate, the size of the errors over the noise, and the step (k,) along the directions.
    """
    model, directions, angles = start.model, start.directions, start.measurements.angles
    result = _minimised(
        lambda change: np.einsum("nij,nj->ni", white, start.instrument_error(change)),
        lambda change: white @ model.tracker_slope(change, start.predicted(change), angles, start.measurements.marker),
        directions,
        start.step,
        _CALLS,
    )
    freedom = max(1, result.fun.size - result.x.size)
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
    return estimate, ratio, result.x


def located(guess: RobotParameters, measurements: Measurements, known: Collection[str]) -> PoseModel:
    """The guess with the frames at which its own poses at the readings come nearest to the measured ones."""
    measured, plain = measurements.measured, PoseModel(guess, measured=measurements.measured)
    believed, good = plain.assembled(measurements.angles)
    observed, fixed = measurements.marker[good], geometry.without_effect(measured)
    free = [at for at in range(OF_ROBOT, SIZE) if PARAMETERS[at].kind not in known and at not in fixed]
    if len(observed) < (_LEAST_POSES if free else 1) or not (measured.all() or good.all()):
        got = f"readings, of which only {len(observed)} of {len(measurements)} are possible for this robot"
        allowed = "readings in rad (or _deg), in the order of the legs, near the crank angles of the guess"
        raise ConfigurationError(f"{measurements.source}: crank_angle", got, allowed)
    plain = replace(plain, near=None if measured.all() else believed)
    if not free:
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
    off = None if start is None else start.off()
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
    if start.model.near is not None:
        return start
    by_angle = geometry.derivative(lambda step: start.closures(step[0]), np.eye(1))[..., 0]
    # With a leg's own angle its closure grows on the branch +1: the rod then pulls against the crank's motion.
    wrong = (np.sign(by_angle) == -guess.branches).all(axis=0)
    if wrong.any():
        leg = int(wrong.argmax())
        allowed = f"{-guess.branches[leg]}, the branch of the readings of {measurements.source}"
        raise ConfigurationError(f"robot.legs.{leg}.branch", int(guess.branches[leg]), allowed)
    return start
