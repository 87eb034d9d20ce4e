"""A motion recorded in a file."""

from __future__ import annotations

import csv
import math
import re
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal

import numpy as np
from pydantic import Field

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.parquet_files import refuse_bomb
from stewart_drake.files.whole import open_checked
from stewart_drake.sampling import unwrapped
from stewart_drake.section import Positive, Real, Section, Text

COLUMNS = ("time", "roll", "pitch", "yaw", "x", "y", "z")
"""[s, rad, rad, rad, m, m, m] of a recording, in any order; further columns are left alone."""
MAX_RECORDING_BYTES = 100_000_000
MAX_RECORDING_ROWS = 1_000_000
MAX_COLUMNS, MAX_HEADER_BYTES = 1000, 100_000
"""Of a CSV file."""


class RecordedReference(Section, key="reference"):
    """A cubic spline through the rows of a CSV or Parquet file; its first row is t = 0.

    The file has a header with the columns `time` [s], `roll`, `pitch`, `yaw` [rad], `x`, `y`, `z` [m]; times ascend,
    evenly spaced or not. Angles may wrap: jumps by a whole turn are taken out, and the first row is within half a turn.
    The spline (not-a-knot) goes through every row, its acceleration through the noise of the rows as well, so filter a
    recording first. A run starts with the recording's own velocity; after the last row the motion coasts to rest,
    acceleration being continuous.
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
        path: .csv or .parquet file with the columns `COLUMNS`.

    Returns:
        (n, 7) [s, rad, rad, rad, m, m, m] time ascending, roll, pitch, yaw, X, Y, Z. Angles without jumps by whole
        turns, the first within half a turn; one that is ever beyond a turn is no wrapped angle, and stays as it is.

    Raises:
        ConfigurationError: Not readable, of another kind, too large, a column missing, fewer than 4 rows, a cell that
            is not a finite number, times that do not ascend.
    """
    path = Path(path)
    key = f"recorded motion {path}"
    import pyarrow as pa

    try:
        if path.suffix.lower() not in (".csv", ".parquet"):
            raise ConfigurationError(key, path.suffix, "a file that ends in .csv or .parquet")
        with open_checked(path, key, MAX_RECORDING_BYTES) as stream:
            columns = (_read_csv if path.suffix.lower() == ".csv" else _read_parquet)(stream, key)
    except (OSError, ValueError, TypeError, KeyError, MemoryError, csv.Error, pa.ArrowException) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise ConfigurationError(key, text, "a table of numbers with a header") from None
    data = np.stack(columns, axis=-1)
    if len(data) < 4:
        raise ConfigurationError(key, f"{len(data)} rows", "at least 4 rows")
    for name, column in zip(COLUMNS, columns, strict=True):
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


def _read_csv(stream: BinaryIO, key: str) -> list[np.ndarray]:
    """Values of `COLUMNS`, (n,) each."""
    import pyarrow as pa
    import pyarrow.csv as pc

    head = stream.read(MAX_HEADER_BYTES).decode("utf-8-sig", "replace").lstrip("\r\n")
    line = re.split("[\r\n]", head, maxsplit=1)[0]
    if len(line) == len(head) and stream.read(1):
        raise ConfigurationError(key, f"a first line of over {MAX_HEADER_BYTES} bytes", "a table with a header")
    names = next(csv.reader([line]), [])
    if not line:
        raise ConfigurationError(key, "no header", "a table of numbers with a header")
    if len(names) > MAX_COLUMNS:
        raise ConfigurationError(key, f"{len(names)} columns", f"at most {MAX_COLUMNS}")
    _refuse_missing(names, key)
    stream.seek(0)
    kinds = pc.ConvertOptions(include_columns=COLUMNS, column_types=dict.fromkeys(COLUMNS, pa.float64()))
    batches: list[list[np.ndarray]] = []
    rows = 0
    for batch in pc.open_csv(stream, convert_options=kinds):
        rows += batch.num_rows
        if rows > MAX_RECORDING_ROWS:
            raise ConfigurationError(key, f"at least {rows} rows", f"at most {MAX_RECORDING_ROWS} rows")
        batches.append([column.to_numpy(zero_copy_only=False) for column in batch.columns])
    return [np.concatenate(parts) for parts in zip(*batches, strict=True)] or [np.empty(0)] * len(COLUMNS)


def _read_parquet(stream: BinaryIO, key: str) -> list[np.ndarray]:
    """Values of `COLUMNS`, (n,) each."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(stream)
    _refuse_missing(file.schema_arrow.names, key)
    refuse_bomb(file, key, COLUMNS, MAX_RECORDING_ROWS)
    table = file.read(columns=list(COLUMNS))
    return [table.column(name).cast(pa.float64()).to_numpy() for name in COLUMNS]


def _refuse_missing(names: list[str], key: str) -> None:
    missing = [name for name in COLUMNS if names.count(name) != 1]
    if missing:
        found = f"{names.count(missing[0])} columns {missing[0]} among {', '.join(names)}"
        raise ConfigurationError(key, found, f"one column each of {', '.join(COLUMNS)}")
