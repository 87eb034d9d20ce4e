"""Calibration of a robot's geometry from measured poses: the result, its tables and its report."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import numbers_to_csv
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.calibration_fit import best_closures, fit_closures, fit_tracker
from stewart_drake.estimation.core import Estimate, Result
from stewart_drake.estimation.geometry import OF_ROBOT, PARAMETERS, PER_LEG, SIZE, PoseModel
from stewart_drake.estimation.poses import MeasurementNoise, Measurements, load_measurements
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_SHARE = 1e-3  # [-] of an unidentifiable direction beyond which a parameter has no interval.
_NOISY = 2.0  # [-] errors over the stated noise from which on the stated noise, or the model, is doubtful.
_SAME = 1e-9  # [rad, m] less than any tracker's last digit, more than a file's.


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

    def rows(self) -> list[tuple[Any, ...]]:
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
    start = best_closures(partial(fit_closures, robot, known_frames, free, noise), robot, measurements)
    estimate, noise_ratio = fit_tracker(start, noise)
    known = tuple(frame for frame in geometry.FRAMES if frame in known_frames)
    held = tuple(kind for kind in geometry.KINDS if kind in hold)
    calibrated = geometry.as_robot(robot, estimate.values)
    return Calibration(calibrated, start.model, measurements, known, held, estimate, noise_ratio)
