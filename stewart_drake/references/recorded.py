"""A motion recorded in a file."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Positive, Real, Section, Text
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.tables import read_numbers
from stewart_drake.sampling import unwrapped

QUANTITIES = (
    ("time", "s"),
    *((f"pose_{name}", "rad") for name in ("roll", "pitch", "yaw")),
    *((f"pose_{name}", "m") for name in ("x", "y", "z")),
)
"""Columns of a recording with their units, in any order; further ones are left alone."""
MAX_RECORDING_BYTES = 100_000_000
MAX_RECORDING_ROWS = 1_000_000


class RecordedReference(Section, key="reference"):
    """A cubic spline through the rows of a CSV or Parquet file; its first row is t = 0.

    The file has the columns `time_s`, `pose_roll_rad`, `pose_pitch_rad`, `pose_yaw_rad`, `pose_x_m`, `pose_y_m`,
    `pose_z_m` (`_ms`, `_deg`, `_mm` will do), as a saved log has; times ascend, evenly spaced or not. Angles may wrap:
    jumps by a whole turn are taken out, and the first row is within half a turn. The spline (not-a-knot) goes through
    every row, its acceleration through the noise of the rows as well, so filter a recording first. A run starts with
    the recording's own velocity; after the last row the motion coasts to rest, acceleration being continuous.
    """

    kind: Literal["recorded"] = "recorded"
    motion_file: Text
    """Path of a .csv or .parquet file, relative to the scenario file."""
    time_scale: Positive = 1.0
    """[s] that one unit of the file's time lasts: 0.001 for a file in milliseconds, 2 for half the speed."""
    settle: Annotated[Real, Field(ge=1e-6, le=1e6)] = 0.25
    """[s] from the last row to rest."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`.

        Raises:
            ConfigurationError: The file cannot be read or used; it is read at the first call.
        """
        time = np.asarray(time, dtype=float)
        end, splines = self._motion
        pose, rate, acceleration = (spline(np.clip(time, 0.0, end)) for spline in splines)
        started = (time >= 0.0)[..., None]
        rate, acceleration = np.where(started, rate, 0.0), np.where(started, acceleration, 0.0)
        # The rate goes on as a cubic of s, with the recording's last value and slope at s = 0 and neither at s = 1.
        s = np.clip((time - end) / self.settle, 0.0, 1.0)[..., None]
        t = self.settle
        pose = (
            pose + rate * t * (s - s**3 + 0.5 * s**4) + acceleration * t**2 * s**2 * (0.5 - 2.0 / 3.0 * s + 0.25 * s**2)
        )
        slowed = rate * (1.0 + 2.0 * s) * (1.0 - s) ** 2 + acceleration * t * s * (1.0 - s) ** 2
        return pose, slowed, rate / t * 6.0 * s * (s - 1.0) + acceleration * (1.0 - s) * (1.0 - 3.0 * s)

    @cached_property
    def _motion(self) -> tuple[float, tuple[Any, Any, Any]]:
        """Time of the last row [s] and the splines of pose, rate and acceleration."""
        from scipy.interpolate import CubicSpline

        key = f"recorded motion {self.motion_file}"
        data = load_recording(self.motion_file)
        time = (data[:, 0] - data[0, 0]) * self.time_scale
        with np.errstate(all="ignore"):
            try:
                spline = CubicSpline(time, data[:, 1:], axis=0)
            except (ValueError, np.linalg.LinAlgError) as error:
                text = " ".join(str(error).split())
                raise ConfigurationError(key, text, "times and poses that a spline can join") from None
            if not np.isfinite(spline.c).all():
                raise ConfigurationError(key, "infinite accelerations", "times and poses that a spline can join")
        return float(time[-1]), (spline, spline.derivative(1), spline.derivative(2))


def load_recording(path: str | Path) -> np.ndarray:
    """Reads a recorded motion.

    Args:
        path: .csv or .parquet file with columns of `QUANTITIES`, see `files.tables`.

    Returns:
        (n, 7) [s, rad, rad, rad, m, m, m] time ascending, roll, pitch, yaw, X, Y, Z. Angles without jumps by whole
        turns, the first within half a turn; one that is ever beyond a turn is no wrapped angle, and stays as it is.

    Raises:
        ConfigurationError: Not readable, of another kind, too large, a column missing, fewer than 4 rows, a cell that
            is not a finite number, times that do not ascend.
    """
    path = Path(path)
    key = f"recorded motion {path}"
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ConfigurationError(key, path.suffix, "a file that ends in .csv or .parquet")
    data = read_numbers(path, key, QUANTITIES, MAX_RECORDING_BYTES, MAX_RECORDING_ROWS)
    if len(data) < 4:
        raise ConfigurationError(key, f"{len(data)} rows", "at least 4 rows")
    for (name, _), column in zip(QUANTITIES, data.T, strict=True):
        if not np.isfinite(column).all():
            row = int(np.argmin(np.isfinite(column)))
            raise ConfigurationError(f"{key}: {name}", f"{column[row]} in row {row + 1}", "finite numbers")
    back = np.diff(data[:, 0]) <= 0.0
    if back.any():
        row = int(back.argmax())
        got = f"{data[row + 1, 0]:g} after {data[row, 0]:g} in row {row + 2}"
        raise ConfigurationError(f"{key}: time", got, "ascending times")
    turns = data[:, 1:4]
    wrapped = np.abs(turns).max(axis=0) <= 2.0 * math.pi * (1.0 + 1e-9)
    data[:, 1:4] = np.where(wrapped, unwrapped(turns), turns)
    return data
