"""Where the rows of a run go while it goes on: into memory, or into a file that keeps memory flat."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import psutil

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.logs.log import ROW_GROUP, UNFINISHED, SimulationLog, load_log, write_log
from stewart_drake.scenario import Scenario

if TYPE_CHECKING:
    import pyarrow as pa

PICTURE_ROWS = 100_000
"""Of a log in a file that come back into memory, for pictures."""
COLUMNS = 140
"""Numbers in a row, at most."""

_FLUSH_TIME = 2.0
"""[s] of wall-clock time after which rows are written, however few."""
_WORKING = 300e6
"""[byte] that a run takes besides its rows."""


class LogRows:
    """Takes the rows of a run as they come. This one keeps them all in memory."""

    _held: ClassVar[float | None] = None
    """Rows that are in memory at a time; None for all."""

    def __init__(self) -> None:
        self._waiting: list[Mapping[str, np.ndarray]] = []

    def check(self, scenario: Scenario) -> None:
        """Called before the run.

        Raises:
            ConfigurationError: There is not enough memory for the rows.
        """
        # All of them are there twice in the end.
        rows = 2.0 * scenario.duration / scenario.effective_log_period if self._held is None else self._held
        need, free = _WORKING + 8.0 * COLUMNS * rows, psutil.virtual_memory().available
        if need > free:
            allowed = (
                f"one at which the run fits into memory: it takes {need / 1e9:.3g} GB, and {free / 1e9:.3g} are free"
            )
            raise ConfigurationError("log_period", scenario.effective_log_period, allowed)

    def begin(self, header: SimulationLog) -> None:
        """Called once; `header` has no signals, and the outcome that holds if nothing is heard of the run again."""

    def add(self, signals: Mapping[str, np.ndarray]) -> None:
        """The next rows."""
        self._waiting.append(signals)

    def end(self, log: SimulationLog) -> SimulationLog:
        """`log`, which has no signals, with the rows."""
        return replace(log, signals=_joined(self._waiting))


class NoRows(LogRows):
    """Drops all rows; the figures of a run do without."""

    _held = 0.0

    def add(self, signals: Mapping[str, np.ndarray]) -> None:
        """See `LogRows.add`."""
        self._waiting = [{name: values[:0] for name, values in signals.items()}]


class RowsInFile(LogRows):
    """Writes rows to numbered parts as they come, and in the end all of them to `log.parquet`.

    A process that is killed leaves the parts, which `load_log` reads.

    Args:
        folder: It exists, and nobody else writes there.
    """

    _held = 3.0 * ROW_GROUP

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder, self._parts = folder, folder / UNFINISHED
        self._header: SimulationLog | None = None
        self._rows = self._written = 0
        self._flushed = time.monotonic()

    def begin(self, header: SimulationLog) -> None:
        """See `LogRows.begin`."""
        self._header = header
        self._parts.mkdir(exist_ok=True)

    def add(self, signals: Mapping[str, np.ndarray]) -> None:
        """See `LogRows.add`.

        Raises:
            RunFailure: The disk is full, or the like.
        """
        super().add(signals)
        self._rows += len(signals["time"])
        if self._rows >= ROW_GROUP or time.monotonic() - self._flushed > _FLUSH_TIME:
            self._flush()

    def end(self, log: SimulationLog) -> SimulationLog:
        """See `LogRows.end`; of more than `PICTURE_ROWS` rows only every so many come back, the file has all.

        Raises:
            RunFailure: The disk is full, or the like.
        """
        self._flush()
        parts = [self._part(index) for index in range(self._written)]
        path = self.folder / "log.parquet"
        self._write(log, (load_log(part).table() for part in parts), path)
        for part in parts:
            part.unlink()
        self._parts.rmdir()
        return replace(log, signals=load_log(path, PICTURE_ROWS).signals)

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        if not self._waiting and self._written:
            return
        assert self._header is not None
        part = replace(self._header, signals=_joined(self._waiting))
        self._write(part, [part.table()], self._part(self._written))
        self._waiting, self._rows, self._written = [], 0, self._written + 1

    def _write(self, log: SimulationLog, tables: Iterable[pa.Table], path: Path) -> None:
        """Writes a log so that `path` is there only once it is whole."""
        unfinished = path.with_suffix(".part")
        try:
            with unfinished.open("w+b") as stream:
                write_log(log, tables, stream)
            unfinished.replace(path)
        except OSError as error:
            unfinished.unlink(missing_ok=True)
            why = error.strerror or str(error)
            text = f"rows of the log cannot be written ({why}); those before are in {self.folder}"
            raise RunFailure(text, reason="disk_full") from error

    def _part(self, index: int) -> Path:
        return self._parts / f"{index:06d}.parquet"


def _joined(parts: list[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}
