"""Rows of a run on a machine, in a file as they come, and the log that they give, whole or cut off."""

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

from stewart_drake.base.atomic_files import check_file, seal, unseal
from stewart_drake.base.code import file_digests
from stewart_drake.base.errors import ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.logs.metrics import assessed
from stewart_drake.logs.outcomes import RunRows
from stewart_drake.logs.rows import Rows, side_by_side
from stewart_drake.logs.signals import signals_of
from stewart_drake.logs.versions import collect_versions
from stewart_drake.mechanics.kinematics import forward_kinematics
from stewart_drake.scenario.scenario import Scenario

JOURNAL = "rows.journal"  # In the results folder, until the log is there.
WRITTEN_EVERY, SYNCED_EVERY = 0.05, 1.0  # [s] that a killed process loses, and a computer without power.
_MAX_BYTES, _LONGEST_HEAD = 10**10, 10**8


class Journal:
    """Rows of named numbers, in memory and in a file. A thread writes them: no tick waits for a disk.

    Where the disk is full, memory still has them.

    Args:
        scenario: As run.
        path: The file; None for memory alone.
        most: Rows that memory keeps, the latest; None for all.
    """

    def __init__(self, scenario: Scenario, path: Path | None = None, most: int | None = None) -> None:
        self._about = {"versions": collect_versions(), "files": file_digests(scenario.to_dict())}
        self.scenario, self._path = scenario, path
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._rows = Rows({}, most)
        self._over, self._thread = threading.Event(), threading.Thread(target=self._write, daemon=True)

    def __len__(self) -> int:
        return len(self._rows)

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row: `time` [s] first, then numbers or arrays of the names and shapes of the first row."""
        self._rows.append(np.concatenate([np.ravel(value) for value in row.values()]))
        if not self._shapes:
            self._shapes = {name: np.shape(value) for name, value in row.items()}
            self._rows.places = side_by_side(self._shapes)
            if self._path is not None:
                self._thread.start()

    def close(self) -> None:
        """Writes what is left; may be called twice."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def log_fields(self, ended_by: RunFailure | KeyboardInterrupt | None, **known: Any) -> dict[str, Any]:
        """The fields of a `SimulationLog` of the rows, see `fields_of`."""
        return fields_of(self.scenario, self._rows.columns(), ended_by, **self._about, **known)

    def _write(self) -> None:
        head = {"scenario": self.scenario.to_dict(), "shapes": self._shapes, **self._about}
        assert self._path is not None
        with suppress(OSError), self._path.open("wb") as stream:
            stream.write(json.dumps(seal(json.loads(json.dumps(head)))).encode() + b"\n")
            stream.flush()
            written, synced, over = 0, -np.inf, False
            while not over:
                over = self._over.wait(WRITTEN_EVERY)
                rows = self._rows.since(written)
                stream.write(b"".join(_sealed(row, written + k) for k, row in enumerate(rows)))
                written += len(rows)
                stream.flush()
                if over or time.monotonic() - synced > SYNCED_EVERY:
                    os.fsync(stream.fileno())
                    synced = time.monotonic()


def _sealed(row: np.ndarray, number: int) -> bytes:
    """The bytes of a row with a checksum of these and of the row's place."""
    content = row.tobytes()
    return content + np.float64(crc32(content, number)).tobytes()


def cut_off(path: Path) -> dict[str, Any]:
    """The fields of a `SimulationLog` of a journal whose process was killed, up to a row that is not as written.

    A disk that lost power may have zeros, or old content, where rows should be.
    """
    what = f"log {path}"
    with check_file(path, what, _MAX_BYTES).open("rb") as stream:
        about = unseal(stream.readline(_LONGEST_HEAD), what, "drive")
        shapes = {name: tuple(shape) for name, shape in about.pop("shapes").items()}
        width = sum(int(np.prod(shape)) for shape in shapes.values()) + 1
        numbers = np.fromfile(stream)
    rows = numbers[: len(numbers) // width * width].reshape(-1, width)
    good = np.array([row.tobytes() == _sealed(row[:-1], number) for number, row in enumerate(rows)], dtype=bool)
    whole = len(rows) if good.all() else int(good.argmin())
    if not whole:
        raise ConfigurationError(what, "no row", "a run that has begun")
    end, why = float(rows[whole - 1, 0]), "its process was killed"
    if good[whole:].any():
        why = f"row {whole} of its file is damaged, and {good[whole:].sum()} good ones behind it are left out"
    failure = RunFailure(f"the run was cut off after {end:.1f} s: {why}", reason="cut_off")
    scenario = Scenario.from_dict(about.pop("scenario"))
    columns = {name: rows[:whole, place] for name, place in side_by_side(shapes).items()}
    return fields_of(scenario, columns, failure, wall_time=end, **about)


def fields_of(
    scenario: Scenario,
    columns: Mapping[str, np.ndarray],
    ended_by: RunFailure | KeyboardInterrupt | None,
    safety: Mapping[str, Any] | None = None,
    **known: Any,
) -> dict[str, Any]:
    """The fields of a `SimulationLog` of what was logged on a machine; `safety`: the first trip of that layer."""
    with np.errstate(all="ignore"):
        rows = RunRows(scenario, _signals(scenario, dict(columns)) if columns else {})
        end = float(rows.time[-1]) if len(rows.time) else 0.0
        told = assessed(rows, safety, end, ended_by)
    return {"scenario": scenario, "signals": rows.signals, **told, **known}


def _signals(scenario: Scenario, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """As of a run: the pose is that which the machine tells, or else that of the angles that it reads or is told."""
    angles, poses, sent = values["reading"], values.pop("told_pose"), values.pop("sent")
    motors = scenario.controller_model.motors
    if motors.holds and not np.isfinite(angles).any():
        angles = sent
    of_angles, guess = [], values["reference"][0, :6]
    for row in angles:
        # Angles that no pose has are no reason to lose a log.
        with suppress(StewartDrakeError):
            guess = forward_kinematics(scenario.robot, row, guess)
        of_angles.append(guess)
    told = bool(np.isfinite(poses).all())
    pose = poses if told else np.array(of_angles)
    rate = np.gradient(pose, values["time"], axis=0) if len(pose) > 1 else np.zeros_like(pose)
    values |= {"measured": np.concatenate([pose, rate], axis=1), "loop_gap": np.zeros((len(pose), 6))}
    if motors.by_torque:
        values["torque_applied"] = sent
    if told and "measurement" not in values:
        values["measured_pose"] = np.array(of_angles)
    return signals_of(values)
