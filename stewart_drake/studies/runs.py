"""Runs a scenario as a row of a table, also if the run fails, and keeps the rows in a folder as they come."""

from __future__ import annotations

import json
import logging
import os
import socket
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np

from stewart_drake.analysis.response import sine_response
from stewart_drake.base.atomic_files import (
    NOT_FINITE,
    Document,
    append,
    checksum,
    locked_folder,
    plain_json,
    unseal,
    write_atomically,
)
from stewart_drake.base.code import file_digests
from stewart_drake.base.errors import ConfigurationError, RunFailure, raised_at
from stewart_drake.base.registry import REGISTERED
from stewart_drake.control.features import CostScales
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import MetricError, columns, flat, run_cost, run_metrics
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.workers import DIED_TWICE, Workers, run_jobs

Row = Document  # Column -> value.
Measure = Callable[[SimulationLog], Row]
"""Figures of a log as JSON values, by a function that the workers can import."""
RunFunction = Callable[[Scenario], SimulationLog]

ROWS, HEADER = "rows.jsonl", "study.json"
VERSIONS = ("stewart-drake", "drake", "numpy", "scipy", "source")  # Versions on which every number depends.
MAX_MESSAGE = 500  # Characters.
TRACE_POINTS = 240  # Points of the error over time in a row, the largest error of their parts of the run.


def simulate(scenario: Scenario, check: bool = True) -> SimulationLog:
    """Runs a scenario, see `simulation.run`; raises KeyboardInterrupt if the run was interrupted."""
    from stewart_drake.runs.simulation import run

    log = run(scenario, check=check)
    if log.status == "interrupted":
        raise KeyboardInterrupt
    return log


simulate_unchecked = partial(simulate, check=False)

# --- figures of a run ---


def outcome(log: SimulationLog) -> Row:
    safety = log.safety or dict.fromkeys(("monitor", "time", "worst"))
    return {
        "outcome_time": log.outcome_time,
        "safety_monitor": safety["monitor"],
        "safety_time": safety["time"],
        "safety_level": safety["worst"],
        "warnings": ", ".join(warning["name"] for warning in log.warnings) or None,
        "end_time": log.end_time,
        "leg": log.leg,
    }


def measure_all(log: SimulationLog) -> Row:
    return {**outcome(log), **flat(run_metrics(log), log.scenario), "simulation_s": log.wall_time}


def measure_cost(log: SimulationLog, scales: CostScales) -> Row:
    return {**outcome(log), "cost": run_cost(run_metrics(log), log.status, log.scenario.controller.period, scales)}


def measure_tracking(log: SimulationLog, band: float, scales: CostScales | None = None) -> Row:
    """All figures of a run, its settling time into `band` [mm], its cost and the trace of its error."""
    rotation, position = log.error_norms
    pose = np.hypot(1e3 * log.scenario.robot.characteristic_length * np.radians(rotation), position)
    figures = measure_all(log)
    if scales is not None:
        figures["cost"] = run_cost(figures, log.status, log.scenario.controller.period, scales)
    settled = settling_time(log.time, pose, band) if log.reached_end else None

    def thinned(values: np.ndarray) -> list[float]:
        parts = np.array_split(values, min(TRACE_POINTS, len(values))) if len(values) else []
        return [float(f"{np.max(part):.4g}") for part in parts]

    return {**figures, "settling_s": settled, "trace": {"time": thinned(log.time), "pose_mm": thinned(pose)}}


def measure_response(log: SimulationLog, frequency: float, axis: int, window: float) -> Row:
    """Amplitude ratio and phase over the last `window` [s] of a run along a sine of `frequency` [Hz] on `axis`."""
    row = outcome(log) | dict.fromkeys(("ratio", "phase_deg", "rest"))
    if not log.reached_end:
        return row
    rows = log.time > log.time[-1] - window + 1e-9
    reference, pose = log["reference"][rows, axis], log["pose"][rows, axis]
    response, rest = sine_response(log.time[rows], reference, pose, frequency)
    return {**row, "ratio": abs(response), "phase_deg": float(np.degrees(np.angle(response))), "rest": rest}


def settling_time(time: np.ndarray, size: np.ndarray, band: float) -> float | None:
    """Time after which `size` stays within `band`: 0 if it never leaves it, None if it ends outside."""
    outside = ~(size <= band)
    if not len(time) or outside[-1]:
        return None
    last = np.flatnonzero(outside)
    return float(time[last[-1] + 1]) if len(last) else 0.0


# --- a run ---


@dataclass(frozen=True)
class Trial:
    """A run of a scenario with some keys changed, and the measure of its log."""

    key: str  # Unique in an experiment.
    base: Mapping[str, object]  # Scenario in plain values.
    changes: Mapping[str, object]  # Scenario key -> value.
    labels: Mapping[str, object] = field(default_factory=dict)  # Further columns of the row.
    measure: Measure = measure_all
    function: RunFunction = simulate
    trust_code: bool = False  # Whether code that the changes name may run.

    def scenario(self) -> Scenario:
        return Scenario.from_dict(self.base).replace(self.changes, self.trust_code)


def execute(trial: Trial) -> Row:
    """Runs a trial; its result or its error becomes a row of strict JSON values."""
    start, figures = time.perf_counter(), Row()
    try:
        log = trial.function(trial.scenario())
        # Squares of large numbers may overflow; `not_finite` in the row shows it.
        with np.errstate(all="ignore"):
            figures = {**ending(log.status, log.reason, log.message), **trial.measure(log)}
    except KeyboardInterrupt:
        raise
    except ConfigurationError as error:
        figures = ending("rejected", error.reason, str(error))
    except RunFailure as error:
        figures = {**ending("failed", error.reason, str(error)), "end_time": error.time, "leg": error.leg}
    except MetricError as error:
        figures = ending("raised", error.reason, str(error))
    except BaseException as error:  # Also SystemExit and MemoryError.
        name = type(error).__name__
        figures = ending("raised", name, f"{str(error) or name}{raised_at(error)}")
    named = figures.pop(NOT_FINITE, {})
    row = plain_json(figures)
    named |= row.get(NOT_FINITE, {})
    row[NOT_FINITE] = ", ".join(f"{name} {value}" for name, value in named.items() if "." not in name) or None
    return {**row, "wall_s": time.perf_counter() - start, "host": socket.gethostname(), "worker": os.getpid()}


def ending(status: str, reason: str | None, message: str | None) -> Row:
    # Further lines are the traceback of a user's code, which is in the log.
    text = None if not message else " ".join(message.splitlines()[0].split())[:MAX_MESSAGE]
    return {"status": status, "reason": reason, "message": text}


# --- rows in a folder ---


class RowStore:
    """Rows of trials in a folder, as sealed lines of a file; the folder is locked within the context.

    The key of a line has the digest of the identity. Damaged or incomplete lines are dropped and run again.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, object],
        workers: Workers | None = None,
        progress: Callable[[float], None] | None = None,
        restart: bool = False,
    ) -> None:
        self.folder, self._identity = folder, json.loads(json.dumps(identity))
        self._workers, self._progress, self._restart = workers or Workers(), progress or (lambda _: None), restart
        self._digest, self._done, self._kept = checksum(self._identity), 0, dict[str, Row]()
        self._open = ExitStack()

    def __enter__(self) -> Self:
        prepare_folder(self.folder)
        with ExitStack() as opened:
            opened.enter_context(locked_folder(self.folder))
            if self._restart:
                for name in (ROWS, HEADER):
                    (self.folder / name).unlink(missing_ok=True)
            path = self.folder / ROWS
            lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
            intact = [line for line in lines if self._keep(line)]
            self._refuse_another()
            write_atomically(self.folder / HEADER, (json.dumps(self._identity, indent=1) + "\n").encode())
            if len(intact) < len(lines):
                bad = f"{path}: {len(lines) - len(intact)} of {len(lines)} rows are damaged and run again"
                logging.getLogger("stewart_drake").warning(f"stewart-drake: {bad}")
                write_atomically(path, b"".join(intact))
            self._stream = opened.enter_context(path.open("ab", buffering=0))
            self._open = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def rows(self, trials: Sequence[Trial]) -> list[Row]:
        """Rows of some trials with their labels; runs the missing ones, one per key."""
        trials = list(trials)  # Trials of a sweep are drawn at this point.
        keys = [f"{self._digest}/{trial.key}" for trial in trials]
        missing = {key: trial for key, trial in zip(keys, trials, strict=True) if key not in self._kept}

        def keep(key: str, row: Row) -> None:
            append(self._stream, {"key": key, **row})
            self._kept[key] = row
            advance(1)

        def advance(count: int) -> None:
            self._done += count
            self._progress(float(self._done))

        def died(_: str) -> Row:
            return ending("failed", "worker_died", DIED_TWICE)

        advance(len(keys) - len(missing))
        run_jobs(missing, lambda key: (execute, (missing[key],)), keep, self._workers, died)
        return [{**plain_json(trial.labels), **self._kept[key]} for key, trial in zip(keys, trials, strict=True)]

    def _keep(self, line: bytes) -> bool:
        """Reads the row of a line; returns whether the line is complete and unchanged."""
        with suppress(ConfigurationError):
            row = unseal(line if line.endswith(b"\n") else b"", ROWS, "a study")
            self._kept[row.pop("key")] = row
            return True
        return False

    def _refuse_another(self) -> None:
        header = self.folder / HEADER
        try:
            exists = header.exists() or (self.folder / ROWS).exists()
            before = json.loads(header.read_bytes()) if exists else self._identity
            changed = _changed_keys(before, self._identity)
        except (OSError, ValueError, RecursionError, AttributeError):
            changed = [f"{HEADER}, which cannot be read"]
        # The keys of rows have the digest too.
        if changed and not any(key.startswith(self._digest) for key in self._kept):
            allowed = "a new folder, or one with the same study by the same version; --restart replaces it"
            raise ConfigurationError("--out", str(self.folder), f"{allowed}; it differs in {', '.join(changed[:5])}")


def _changed_keys(before: Document, now: Document) -> list[str]:
    """Keys with other values, and in place of `files` the names of changed files."""
    keys = [key for key, value in now.items() if before.get(key) != value]
    files = [name for name, digest in now["files"].items() if before.get("files", {}).get(name) != digest]
    return [*(key for key in keys if key != "files"), *(files or ["files"] * ("files" in keys))]


def identity(work: Mapping[str, object], scenarios: Iterable[Scenario] = ()) -> dict[str, object]:
    """All that rows depend on: the work, its files, weights, columns, the user's kinds, and versions."""
    versions = collect_versions()
    texts = {text for scenario in scenarios if (text := scenario.tuner.content()) is not None}
    return {
        **work,
        "files": file_digests(work),
        "weights": sorted(map(checksum, texts)),
        "columns": checksum([asdict(column) for column in columns(*scenarios)])[:8],
        "kinds": checksum([family.added_code() for family in REGISTERED])[:8],
        "versions": {name: versions[name] for name in VERSIONS},
    }
