"""Rows of a drive, written to a file as they come, and the log of a complete or a killed drive."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from stewart_drake.base.atomic_files import Document, check_file, seal, unseal
from stewart_drake.base.code import file_digests
from stewart_drake.base.errors import ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.logs.metrics import assessed
from stewart_drake.logs.outcomes import RunRows
from stewart_drake.logs.rows import Rows, row_layout
from stewart_drake.logs.signals import signals_of
from stewart_drake.logs.versions import collect_versions
from stewart_drake.mechanics.kinematics import forward_kinematics
from stewart_drake.scenario.scenario import Scenario

JOURNAL = "rows.journal"  # In the results folder, until the log is written.
WRITE_INTERVAL = 0.05  # [s] of rows that a killed process loses.
SYNC_INTERVAL = 1.0  # [s] of rows that a computer loses without power.
_MAX_BYTES = 10**10
_MAX_HEADER_BYTES = 10**8
LogFields = dict[str, Any]  # Arguments of a `SimulationLog`.


class Journal:
    """Rows of named numbers, in memory and in a file that a thread writes, so that no tick waits for a disk.

    If the disk is full, the rows are in memory only.

    Args:
        scenario: Scenario of the log.
        path: File, or None for memory only.
        max_rows: Rows in memory at least, the latest; None for all.
    """

    def __init__(self, scenario: Scenario, path: Path | None = None, max_rows: int | None = None) -> None:
        self._about = {"versions": collect_versions(), "files": file_digests(scenario.to_dict())}
        self.scenario, self._path = scenario, path
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._rows = Rows({}, max_rows)
        self._closed, self._thread = threading.Event(), threading.Thread(target=self._write, daemon=True)

    def __len__(self) -> int:
        return len(self._rows)

    def append(self, row: Mapping[str, float | np.ndarray]) -> None:
        """Adds a row: `time` [s] first, then numbers or arrays, with the same names and shapes in every row."""
        self._rows.append(np.concatenate([np.ravel(value) for value in row.values()]))
        if not self._shapes:
            self._shapes = {name: np.shape(value) for name, value in row.items()}
            self._rows.places = row_layout(self._shapes)
            if self._path is not None:
                self._thread.start()

    def close(self) -> None:
        """Writes the last rows; may be called twice."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def log_fields(self, ended_by: RunFailure | KeyboardInterrupt | None, **known: Any) -> LogFields:
        """Fields of a `SimulationLog` of these rows, see `fields_of`; `known` are further ones."""
        return fields_of(self.scenario, self._rows.columns(), ended_by, **self._about, **known)

    def _write(self) -> None:
        header = {"scenario": self.scenario.to_dict(), "shapes": self._shapes, **self._about}
        assert self._path is not None
        with suppress(OSError), self._path.open("wb") as stream:
            stream.write(json.dumps(seal(json.loads(json.dumps(header)))).encode() + b"\n")
            stream.flush()
            written, synced, closed = 0, -np.inf, False
            while not closed:
                closed = self._closed.wait(WRITE_INTERVAL)
                rows = self._rows.since(written)
                stream.write(b"".join(_sealed(row, written + k) for k, row in enumerate(rows)))
                written += len(rows)
                stream.flush()
                if closed or time.monotonic() - synced > SYNC_INTERVAL:
                    os.fsync(stream.fileno())
                    synced = time.monotonic()


def _sealed(row: np.ndarray, number: int) -> bytes:
    """Bytes of a row, with a checksum over them and the row's number."""
    content = row.tobytes()
    return content + np.float64(crc32(content, number)).tobytes()


def cut_off(path: Path) -> LogFields:
    """Fields of a `SimulationLog` from the journal of a killed drive, up to its first damaged row.

    After a power failure a disk may have zeros or old content in place of rows.
    """
    key = f"log {path}"
    with check_file(path, key, _MAX_BYTES).open("rb") as stream:
        about = unseal(stream.readline(_MAX_HEADER_BYTES), key, "drive")
        shapes = {name: tuple(shape) for name, shape in about.pop("shapes").items()}
        width = sum(int(np.prod(shape)) for shape in shapes.values()) + 1
        numbers = np.fromfile(stream)
    rows = numbers[: len(numbers) // width * width].reshape(-1, width)
    good = np.array([row.tobytes() == _sealed(row[:-1], number) for number, row in enumerate(rows)], dtype=bool)
    count = len(rows) if good.all() else int(good.argmin())
    if not count:
        raise ConfigurationError(key, "no row", "a run that has begun")
    end, why = float(rows[count - 1, 0]), "its process was killed"
    if good[count:].any():
        why = f"row {count} of its file is damaged, and {good[count:].sum()} good ones behind it are left out"
    failure = RunFailure(f"the run was cut off after {end:.1f} s: {why}", reason="cut_off")
    scenario = Scenario.from_dict(about.pop("scenario"))
    columns = {name: rows[:count, place] for name, place in row_layout(shapes).items()}
    return fields_of(scenario, columns, failure, wall_time=end, **about)


def fields_of(
    scenario: Scenario,
    columns: Mapping[str, np.ndarray],
    ended_by: RunFailure | KeyboardInterrupt | None,
    safety: Document | None = None,
    **known: Any,
) -> LogFields:
    """Fields of a `SimulationLog` from the columns of a drive and the first trip of the `safety` layer."""
    with np.errstate(all="ignore"):
        rows = RunRows(scenario, _signals(scenario, dict(columns)) if columns else {})
        end = float(rows.time[-1]) if len(rows.time) else 0.0
        outcome = assessed(rows, safety, end, ended_by)
    return {"scenario": scenario, "signals": rows.signals, **outcome, **known}


def _signals(scenario: Scenario, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Signals of a log, with the machine's pose, or that of its measured or else its commanded crank angles."""
    angles, pose, sent = values["reading"], values.pop("reported_pose"), values.pop("sent")
    motors = scenario.controller_model.motors
    if motors.holds and not np.isfinite(angles).any():
        angles = sent
    rows, guess = [], values["reference"][0, :6]
    for row in angles:
        # At impossible angles the last pose stays.
        with suppress(StewartDrakeError):
            guess = forward_kinematics(scenario.robot, row, guess)
        rows.append(guess)
    pose_of_angles, reported = np.array(rows), bool(np.isfinite(pose).all())
    pose = pose if reported else pose_of_angles
    rate = np.gradient(pose, values["time"], axis=0) if len(pose) > 1 else np.zeros_like(pose)
    values |= {"measured": np.concatenate([pose, rate], axis=1), "loop_gap": np.zeros((len(pose), 6))}
    if motors.by_torque:
        values["torque_applied"] = sent
    if reported and "measurement" not in values:
        values["measured_pose"] = pose_of_angles
    return signals_of(values)
