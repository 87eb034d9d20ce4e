"""A robot's geometry and servos from measured poses, or why poses do not fit.

What is fitted is chosen by the Akaike information criterion: what predicts poses best.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import AXES, numbers_to_csv
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.core import Estimate, Result
from stewart_drake.estimation.corrections import corrections
from stewart_drake.estimation.geometry import CHOSEN, FITS, KEPT, KINDS, OF_ROBOT, PARAMETERS, PER_LEG, SIZE, PoseModel
from stewart_drake.estimation.pose_fits import ClosureFit, fewest_poses, fit_closures, fit_tracker, whitening
from stewart_drake.estimation.poses import INSTRUMENTS, MeasurementNoise, Measurements, load_measurements
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_NOISY = 2.0  # Ratio of errors to the stated noise above which this noise, or the model, is doubtful.
_DOUBTFUL = 3.0  # The same, above which there is a warning.
_SAME = 1e-9  # [rad, m] less than any tracker's last digit, more than a file's.
_HOPELESS = 3.0  # [-] closures over those of the richest fit, from which a simpler one is not tried to the end.
_MISFIT = _BETTER = 5.0
"""[-] closures over their noise from which a reason is looked for, and how many times smaller one must make them."""


class Choice(NamedTuple):
    """One of the things that could be fitted, and how well."""

    fit: str  # Of `geometry.FITS`.
    parameters: int
    noise_ratio: float  # [-] errors over the stated noise.
    criterion: float  # Akaike information criterion; infinite where the poses are too few or it does not fit.
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
        "offset, counted as in the guess. In the robot's file the offset is in the crank directions: there a crank\n"
        "angle is servo gain times reading, as `model.home` is zero."
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
            f"{1e3 * place:.3g} mm, {math.degrees(turn):.3g} deg".removeprefix("nan mm, ").removesuffix(", nan deg")
            for place, turn in self.error_sizes()
        )
        measured = self.model.measured
        widest: dict[str, float] = {}
        for parameter, width in zip(
            geometry.LEG_PARAMETERS, geometry.by_leg(self.half_width, display=True).max(axis=0), strict=True
        ):
            key = f"{parameter.kind} {{:.2g}} {parameter.display[0]}"
            if parameter.kind in FITS[self.fit]:
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
            ("widest 95 % intervals, ±", ", ".join(text.format(width) for text, width in widest.items()) or "none"),
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
        offsets = ", ".join(f"{offset:.3f}" for offset in np.degrees(self.homing_offsets))
        yield "homing offsets in the crank angles, which are servo gains times readings [deg]", offsets
        yield "servo gains [-]", ", ".join(f"{gain:.4f}" for gain in self.robot.servo_gains)
        for name, frame in (("B in the tracker's frame", self.base), ("marker in P", self.marker)):
            yield f"{name}, roll pitch yaw [rad] X Y Z [m]", " ".join(f"{x:.7g}" for x in geometry.pose_of(frame))

    def warnings(self) -> Iterator[str]:
        """What to know before the robot is used, a line each."""
        if self.fit == KEPT:
            yield "nothing is changed: any change that these poses suggest is likely to be noise; the file is the guess"
        if self.noise_ratio > _DOUBTFUL:
            yield (
                f"errors are {self.noise_ratio:.3g} times the noise of the instrument: is --with, or --position-noise "
                "and --rotation-noise, what measured this? Does the robot differ in more than what was fitted?"
            )
        of_servos = np.array([each.kind in FITS[self.fit] for each in PARAMETERS]) & (geometry.PRIOR.any(axis=0))
        if lost := int((of_servos & self.estimate.undetermined).sum()):
            yield f"{lost} of {of_servos.sum()} offsets and gains are not determined, keep the guess: more, other poses"
        vague = of_servos & (self.half_width > np.abs(self.change))
        if self.fit in ("offsets", "servos") and 2 * vague.sum() > of_servos.sum():
            yield (
                f"of {of_servos.sum()} offsets and gains {vague.sum()} changed by less than their 95 % intervals; "
                "more poses, or a better instrument, tell them better"
            )

    def table(self) -> tuple[list[str], list[list[str]]]:
        def cell(change: float, width: float) -> str:
            if width == 0.0:
                return "held"
            return f"{change:+.3f} ± {width:.2g}" if np.isfinite(width) else "unidentifiable"

        changes, widths = (geometry.by_leg(numbers, display=True) for numbers in (self.change, self.half_width))
        rows = [
            [name, *map(cell, changes[:, at], widths[:, at])]
            for at, name in enumerate(geometry.table_names())
            if geometry.LEG_PARAMETERS[at].kind in FITS[self.fit]
        ]
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
        return ["fit", "numbers", "remaining errors over noise", "AIC above the least"], rows

    def robot_file(self) -> str:
        error = dict(self.summary())["pose error after (RMS)"]
        about = f"calibrated from {len(self.measurements)} measured poses: pose error {error} (RMS)"
        if self.fit == KEPT:
            about = f"as guessed: {len(self.measurements)} measured poses tell nothing better, pose error {error} (RMS)"
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
            all. None for the best by the Akaike information criterion, which may be to keep the guess.

    Returns:
        The calibrated robot, with intervals and residuals.

    Raises:
        ConfigurationError: Too few poses, or such as cannot be this robot's: wrong units, an inverted encoder, a
            single wrong row, another branch; the message names it where the residuals show it.
    """
    core.check_choices("hold", hold, KINDS)
    core.check_choices("fit", () if fit is None else (fit,), CHOSEN)
    measurements = poses if isinstance(poses, Measurements) else load_measurements(poses)
    noise = INSTRUMENTS[measurements.instrument].noise if noise is None else noise
    if not set(geometry.FRAMES) <= set(known_frames):
        measurements.refuse_repeated()
    _refuse_plan(robot, measurements)
    ways = _ways(robot, known_frames, hold, fit, measurements.measured)
    enough = [name for name in ways if fewest_poses(ways[name], measurements) <= len(measurements)] or [*ways][-1:]
    if fit is None:
        ways[KEPT] = geometry.free_frames(known_frames, measurements.measured)
        enough.append(KEPT)
    few = [Choice(name, ways[name].shape[1], np.inf, np.inf, "too few poses") for name in ways if name not in enough]

    def closures(name: str, some: Measurements = measurements) -> ClosureFit:
        return fit_closures(robot, known_frames, ways[name], noise, some)

    # The richest shows best whether anything can fit.
    start = _explained(partial(closures, enough[0]), robot, measurements)
    choices, fits = _choices(enough, start, closures, noise)
    # The simplest of equals.
    best = min(reversed(choices), key=lambda choice: round(choice.criterion, 3)).fit
    estimate, noise_ratio = fits[best]
    known = tuple(frame for frame in geometry.FRAMES if frame in known_frames)
    kept = tuple(kind for kind in KINDS if kind in hold or kind not in FITS[best])
    calibrated = robot if best == KEPT else geometry.as_robot(robot, estimate.values)
    fitted = estimate, noise_ratio, best, (*few, *choices)
    return Calibration(calibrated, start.model, measurements, known, kept, *fitted)


def _ways(
    robot: RobotParameters, known: Collection[str], hold: Collection[str], fit: str | None, measured: np.ndarray
) -> dict[str, np.ndarray]:
    """What can be fitted, the richest first: free directions by the name of a fit; with what is held two may be one."""
    # Angles alone say nothing of the robot's size, and little of its shape.
    names = (fit,) if fit else CHOSEN if measured.all() else ("offsets", "servos")
    held = {frozenset(set(KINDS) - set(FITS[name]) | set(hold)): name for name in reversed(names)}
    some = {kinds: name for kinds, name in held.items() if len(kinds) < len(KINDS)} or held
    ways = {name: geometry.free_directions(robot, known, kinds, measured) for kinds, name in some.items()}
    return dict(sorted(ways.items(), key=lambda way: -way[1].shape[1]))


def _choices(
    names: Sequence[str], start: ClosureFit, closures: Callable[[str], ClosureFit], noise: MeasurementNoise
) -> tuple[list[Choice], dict[str, tuple[Estimate, float]]]:
    """The fits and their criteria; `start` is that of the first, which is the richest."""
    choices, fits, white = list[Choice](), dict[str, tuple[Estimate, float]](), whitening(start, noise)
    count, largest = white.shape[0] * white.shape[1], 1.0
    for name in names:
        begin = closures(name) if fits else start
        unknown = begin.directions.shape[1]
        if fits and begin.misfit > _HOPELESS * max(1.0, start.misfit):
            choices.append(Choice(name, unknown, np.inf, np.inf, "do not fit"))
            continue
        estimate, ratio, _, effective = fit_tracker(begin, white)
        fits[name] = estimate, ratio
        # The richest fit shows whether the noise is larger than stated.
        largest = largest if len(fits) > 1 else max(largest, ratio)
        errors = max(1.0, count - effective) * (ratio / largest) ** 2
        # Numbers that the prior decides cannot fit the noise.
        choices.append(Choice(name, unknown, ratio, errors + 2.0 * effective))
    return choices, fits


def _refuse_plan(robot: RobotParameters, measurements: Measurements) -> None:
    """Raises a `ConfigurationError` if the poses are exactly those of the guess."""
    model = PoseModel(robot, measured=measurements.measured)
    believed, good = model.assembled(measurements.angles)
    if good.all() and np.abs(model.tracker_error(np.zeros(SIZE), believed, measurements.marker)).max() < _SAME:
        got = "the poses that the guess has at these crank angles"
        raise ConfigurationError(measurements.source, got, "measured poses; is this a plan, not measured yet?")


def _explained(
    fit: Callable[[Measurements], ClosureFit], guess: RobotParameters, measurements: Measurements
) -> ClosureFit:
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
        unit, factor = parameter.display
        size = f"{factor * abs(start.change[at]):.3g} {unit}"
        got = f"poses that give a {parameter} of leg {at // PER_LEG} {size} off the guess"
        allowed = "readings of this robot; is it another one, or are two encoders swapped?"
        allowed += "" if measurements.measured.all() else " Or has the IMU other axes than x, y level and z up?"
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
