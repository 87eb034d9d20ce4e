"""What a calibration found, as numbers, as tables, and as the files that it leaves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.linalg

from stewart_drake.calibration.model import IN_THOUSANDTHS, NAMES, OF_LEG, OF_ROBOT, PER_LEG, FrameName, Name, pose_of
from stewart_drake.calibration.poses import Measurements
from stewart_drake.files.report import Report
from stewart_drake.files.tables import numbers_to_csv
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

_NOISY = 2.0  # [-] errors over the stated noise from which on the noise as stated, or the model, is doubtful
_SMALL, _NAMED = 0.05, 6
"""Share of an unidentifiable direction below which a parameter is not named in it, and how many are."""


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Report):
    """A calibrated robot, and how well it is known.

    Attributes:
        robot: The result. Its crank angles are the encoder readings: its crank directions include the homing offsets.
        guess: The robot that the calibration started from.
        measurements: The measured poses.
        known_frames: Frames of the tracker that were known.
        hold: Parameters that kept their value.
        change: (78,) [m, rad] of the guess's parameters and the tracker's frames, see `model`.
        half_width: (78,) [m, rad] of the 95 % intervals; 0 for what was held or known, infinite if unidentifiable.
        identifiable: Number of independent parameters that were estimated.
        unidentifiable: What these poses cannot determine, one sentence each.
        base: (4, 4) B in the tracker's frame.
        marker: (4, 4) the marker in P.
        before: (n, 6) [rad, m] measured minus predicted poses of the marker, with the tracker's frames fitted to the
            guess; NaN where the guess cannot be assembled.
        after: (n, 6) [rad, m] measured minus calibrated poses of the marker.
        noise_ratio: [-] errors over the stated noise; the intervals are scaled by it.
    """

    robot: RobotParameters
    guess: RobotParameters
    measurements: Measurements
    known_frames: tuple[FrameName, ...]
    hold: tuple[Name, ...]
    change: np.ndarray
    half_width: np.ndarray
    identifiable: int
    unidentifiable: tuple[str, ...]
    base: np.ndarray
    marker: np.ndarray
    before: np.ndarray
    after: np.ndarray
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
    def homing_offsets(self) -> np.ndarray:
        """(6,) [rad] readings minus the true angles of the guess's convention."""
        return self.change[:OF_ROBOT].reshape(LEGS, PER_LEG)[:, -1].copy()

    def rows(self) -> list[tuple[Any, ...]]:
        """A row of `columns` for each parameter of each leg, in SI units."""
        guess = self.guess
        lengths = guess.crank_lengths[:, None], guess.rod_lengths[:, None]
        start = np.concatenate([guess.shaft_positions, guess.platform_joints, *lengths, np.zeros((LEGS, 3))], axis=-1)
        columns = start.ravel(), start.ravel() + self.change[:OF_ROBOT], self.half_width[:OF_ROBOT]
        numbers = np.stack(columns, axis=-1).tolist()
        return [(at // PER_LEG, *own, *row) for at, (own, row) in enumerate(zip(OF_LEG * LEGS, numbers, strict=True))]

    def error_sizes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """RMS over the poses of position [m] and rotation [rad] error, before and after."""

        def sizes(error: np.ndarray) -> tuple[float, float]:
            square = np.nanmean(error**2, axis=0)
            return float(np.sqrt(square[3:].sum())), float(np.sqrt(square[:3].sum()))

        return sizes(self.before), sizes(self.after)

    def summary(self) -> list[tuple[str, str]]:
        before, after = (f"{1e3 * place:.3g} mm, {1e3 * turn:.3g} mrad" for place, turn in self.error_sizes())
        widest = 1e3 * self.half_width[:OF_ROBOT].reshape(LEGS, PER_LEG).max(axis=0)
        own = {name: [at for at, each in enumerate(OF_LEG) if each.name == name] for name in NAMES}
        widths = ", ".join(f"{name} {widest[at].max():.2g} m{OF_LEG[at[0]].unit}" for name, at in own.items())
        ratio = f"{self.noise_ratio:.3g} times the stated noise"
        if self.noise_ratio > _NOISY:
            ratio += ": the noise is larger than stated, or legs have play or bend; the intervals are widened by it"
        rows = [
            ("poses, parameters estimated", f"{len(self.measurements)}, {self.identifiable}"),
            ("pose error before (RMS)", before),
            ("pose error after (RMS)", after),
            ("remaining errors", ratio),
            ("widest 95 % intervals, ±", widths),
        ]
        for frame, name, where, points in (
            ("base", "shaft_position", "where B is", "the shafts"),
            ("platform", "platform_joint", "where P is", "the platform's joints"),
        ):
            if frame not in self.known_frames and name not in self.hold:
                line = f"{where} (6 numbers); it is placed so that {points} are closest to the guess's"
                rows.append(("not identifiable by any poses", line))
        return [*rows, *(("not identifiable by these poses", line) for line in self.unidentifiable), *self._frames()]

    def _frames(self) -> Iterator[tuple[str, str]]:
        offsets = ", ".join(f"{1e3 * offset:.3f}" for offset in self.homing_offsets)
        yield "homing offsets in the crank angles, which are the encoders' readings [mrad]", offsets
        for name, frame in (("B in the tracker's frame", self.base), ("marker in P", self.marker)):
            yield f"{name}, roll pitch yaw [rad] X Y Z [m]", " ".join(f"{x:.7g}" for x in pose_of(frame))

    def table(self) -> tuple[list[str], list[list[str]]]:
        changes, widths = (1e3 * each[:OF_ROBOT].reshape(LEGS, -1).T for each in (self.change, self.half_width))
        rows = [
            [name, *(_cell(*pair) for pair in zip(change, width, strict=True))]
            for name, change, width in zip(IN_THOUSANDTHS, changes, widths, strict=True)
        ]
        return ["", *(f"leg {leg}" for leg in range(LEGS))], rows

    def robot_file(self) -> str:
        about = f"calibrated from {len(self.measurements)} measured poses: pose error {self.summary()[2][1]} (RMS)"
        comments = "".join(f"# {name}: {text}\n" for name, text in self._frames())
        return f"{comments}{to_yaml({'about': about, **self.robot.to_dict()})}"

    def residuals_csv(self) -> str:
        """Errors of each pose before and after as CSV, [rad, m]."""
        parts = [*((f"turn_{axis}", "rad") for axis in "xyz"), *((axis, "m") for axis in "xyz")]
        names = [(f"{when}_{name}", unit) for when in ("before", "after") for name, unit in parts]
        numbers = np.arange(len(self.after))[:, None] + 1.0
        return numbers_to_csv([("row", ""), *names], np.concatenate([numbers, self.before, self.after], axis=-1))


def in_words(directions: np.ndarray, scales: np.ndarray) -> list[str]:
    """A sentence for each unidentifiable direction (`SIZE`, k), in `scales` (`SIZE`,) [m, rad], of few parameters."""
    if directions.shape[1] == 0:
        return []
    _, _, order = scipy.linalg.qr(directions.T, mode="economic", pivoting=True)
    own = order[: directions.shape[1]]
    shares = np.linalg.solve(directions[own].T, directions.T)
    sentences = []
    for row, first in zip(shares, own, strict=True):
        others = [at for at in np.argsort(-np.abs(row), kind="stable") if at != first and abs(row[at]) > _SMALL]
        amounts = row * scales / scales[first]
        (name, unit), names = _named(first), [(at, *_named(at)) for at in others[:_NAMED]]
        with_it = ", ".join(f"{other} by {amounts[at]:+.2g} m{its}" for at, other, its in names)
        more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
        sentences.append(name + (f": with each m{unit} more of it {with_it}{more}" if others else " on its own"))
    return sorted(sentences)


def _named(at: int) -> tuple[str, str]:
    if at < OF_ROBOT:
        return f"leg {at // PER_LEG} {OF_LEG[at % PER_LEG]}", OF_LEG[at % PER_LEG].unit
    frame, axis = divmod(at - OF_ROBOT, 6)
    what, unit = (("turn", "rad"), ("shift", "m"))[axis // 3]
    return f"the {('tracker', 'marker')[frame]}'s frame {what} {'xyz'[axis % 3]}", unit


def _cell(change: float, width: float) -> str:
    if width == 0.0:
        return "held"
    return f"{change:+.3f} ± {width:.2g}" if np.isfinite(width) else "unidentifiable"
