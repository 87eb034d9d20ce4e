"""Recorded motions, and motions by a user's class or function."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Positive, Real, Section, Text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import UserMade
from stewart_drake.base.registry import RECORDINGS
from stewart_drake.base.sampling import unwrapped
from stewart_drake.base.tables import POSE, read_numbers, refuse_back, refuse_cells
from stewart_drake.references.rows import CUTOFF, MOST_ROWS, SETTLE, RowsMotion

QUANTITIES = (("time", "s"), *POSE)
MAX_RECORDING_BYTES = 100_000_000
_MAX_STEP = 60.0  # [s] between rows.
DIFFERENCE = 1e-4  # [s] of differences, for a function that returns only a pose.


class RecordedReference(Section, key="reference"):
    """A recorded motion: the rows of a CSV or Parquet file, the first at t = 0.

    Times ascend. Angles may wrap: jumps by a whole turn are removed. Rows at 2.2 times the cutoff or faster are
    resampled on their median step, with the jitter of their times averaged out, and low-passed without delay; a line
    reports the change. Slower rows are way points of a cubic spline (not-a-knot). A run starts with the recording's
    velocity, and slows down along the path, to rest at its last row.
    """

    kind: Literal["recorded"] = "recorded"
    motion_file: Text
    """File of the motion, .csv, .parquet or .json, relative to the scenario file. Columns in any order, the unit in the
    name: `time_s` (or `_ms`), `roll_rad`, `pitch_rad`, `yaw_rad` (or `_deg`), `x_m`, `y_m`, `z_m` (or `_mm`); also in
    capitals, or with `pose_` before them as in a saved log. A .json is a recorded move of Reachy Mini in its maker's
    format: its head on its body."""
    time_scale: Positive = 1.0
    """[s] duration of one unit of the file's time: 0.001 for a file in milliseconds, 2 for half the speed."""
    cutoff: Positive | None = CUTOFF
    """[Hz] of the low pass, in the time of playing; null takes rows and times unchanged."""
    settle: Annotated[Real, Field(ge=1e-6, le=1e6)] = SETTLE
    """[s] in which it slows down to rest at the last row, half of it after the last row's time."""

    @property
    def of_platform(self) -> bool:
        """Whether its format is that of a product, whose poses are those of the platform, with a tool too."""
        return Path(self.motion_file).suffix.lower() in RECORDINGS.names

    @property
    def end(self) -> float:
        """[s] time from which it is at rest."""
        return self._motion.end

    @property
    def note(self) -> str:
        """Changes of the rows, for reports; empty if negligible."""
        return self._motion.note

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._motion.evaluate(time)

    @cached_property
    def _motion(self) -> RowsMotion:
        data, key = load_recording(self.motion_file), f"recorded motion {self.motion_file}"
        step = self.time_scale * float(np.median(np.diff(data[:, 0])))
        if step > _MAX_STEP:
            allowed = f"rows less than {_MAX_STEP:g} s apart; are the times in ms? name the column time_ms"
            raise ConfigurationError(key, f"rows {step:g} s apart", allowed)
        return RowsMotion(data[:, 0] * self.time_scale, data[:, 1:], self.cutoff, self.settle, key)


def load_recording(path: str | Path) -> np.ndarray:
    """A recorded motion (n, 7) [s, rad, m] from a file with `QUANTITIES`, checked, without jumps by whole turns."""
    path = Path(path)
    key = f"recorded motion {path}"
    if (ending := path.suffix.lower()) in RECORDINGS.names:
        rows: np.ndarray = RECORDINGS[ending](path)
        return rows
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ConfigurationError(key, path.suffix, "a file that ends in .csv, .parquet or .json")
    data = read_numbers(path, key, QUANTITIES, MAX_RECORDING_BYTES, MOST_ROWS)
    if len(data) < 4:
        raise ConfigurationError(key, f"{len(data)} rows", "at least 4 rows")
    refuse_cells(key, QUANTITIES, data, ~np.isfinite(data), "a finite number")
    refuse_back(key, data[:, 0])
    turns = data[:, 1:4]
    wrapped = np.abs(turns).max(axis=0) <= 2.0 * math.pi * (1.0 + 1e-9)
    data[:, 1:4] = np.where(wrapped, unwrapped(turns), turns)
    return data


class UserReference(UserMade, key="reference"):
    """Your own motion: `evaluate(time)` returns pose, rate and acceleration at a time [s], as in `Reference`.

    A plain function of time that returns the pose (6,) is enough. It must be smooth: rate and acceleration are then
    differences over `DIFFERENCE`.
    """

    asked = "evaluate(t) returns pose, rate and acceleration, (6,) each"

    def construct(self, offered: Mapping[str, Any]) -> Any:
        loaded = self.code.load(self.code_key)
        made = loaded if inspect.isfunction(loaded) else super().construct(offered)
        return made if hasattr(made, "evaluate") or not callable(made) else _PoseFunction(self, made)

    @property
    def note(self) -> str:
        """For reports, once it was evaluated; empty if it returns rates."""
        differences = type(vars(self).get("made")) is _PoseFunction
        return "rates of the motion are differences of its poses" if differences else ""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        times = np.asarray(time, dtype=float)
        answers = np.reshape([self._answer(t) for t in times.ravel().tolist()], (*times.shape, 3, 6))
        return answers[..., 0, :], answers[..., 1, :], answers[..., 2, :]

    def _answer(self, time: float) -> list[np.ndarray]:
        answer = self.made.evaluate(time)
        if isinstance(answer, str) or not isinstance(answer, Iterable):
            raise self.refusal(f"a {type(answer).__name__}")
        parts = [self.numbers(part) for part in answer]
        if [part.shape for part in parts] != [(6,)] * 3:
            raise self.refusal(", ".join(str(part.shape) for part in parts) or "nothing")
        return parts


class _PoseFunction:
    """A motion by a function from time [s] to pose (6,), with central differences, at times from 0."""

    def __init__(self, section: UserReference, pose: Callable[[float], object]) -> None:
        self._section, self._pose = section, pose

    def evaluate(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        middle, h = max(time, DIFFERENCE), DIFFERENCE
        before, here, after = (self._at(t) for t in (middle - h, middle, middle + h))
        acceleration = (after - 2.0 * here + before) / h**2
        rate = (after - before) / (2.0 * h) - (middle - time) * acceleration
        return self._at(time), rate, acceleration

    def _at(self, time: float) -> np.ndarray:
        pose = self._section.numbers(self._pose(time))
        if pose.shape != (6,):
            raise self._section.refusal(f"a result of shape {pose.shape}, not a pose (6,)")
        return pose
