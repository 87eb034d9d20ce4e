"""One run in, one row out, whatever happens in it; rows are kept in a folder as they come."""

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
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from stewart_drake.control.features import CostScales
from stewart_drake.errors import ConfigurationError, RunFailure, raised_at
from stewart_drake.files.code import file_digests, trusting_code
from stewart_drake.files.whole import NOT_FINITE, append, checksum, locked_folder, plain_json, unseal, write_atomically
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import MetricError, columns, error_norms, flat, run_cost, run_metrics
from stewart_drake.logs.versions import collect_versions
from stewart_drake.registry import REGISTERED
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.studies.workers import DEAD, Workers, run_jobs

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario

Key = TypeVar("Key", int, str)
Row = dict[str, Any]
Measure = Callable[[SimulationLog], Row]
"""Figures of a log, in values that JSON has; a function that the workers can import."""
RunFunction = Callable[["Scenario"], SimulationLog]

ROWS, HEADER = "rows.jsonl", "study.json"
CODE = ("stewart-drake", "drake", "numpy", "scipy", "source")  # Versions on which every number depends
MAX_MESSAGE = 500
TRACE_POINTS = 240  # Of the error over time that a row keeps; each the largest error of its share of the run


def simulate(scenario: Scenario, **options: Any) -> SimulationLog:
    """`simulation.run`, which takes the options; a run that was interrupted is no result and raises."""
    from stewart_drake.runs.simulation import run

    log = run(scenario, **options)
    if log.status == "interrupted":
        raise KeyboardInterrupt
    return log


simulate_unchecked = partial(simulate, check=False)


@dataclass(frozen=True)
class Task:
    index: int
    seed: int
    base: Mapping[str, Any]
    changes: Mapping[str, Any]
    drawn: Mapping[str, Any] = field(default_factory=dict)
    """What tells the run from others; `values` of its row."""
    measure: Measure | None = None
    function: RunFunction = simulate
    trust_code: bool = False
    """Whether code that the changes name may run."""

    def row(self, status: str, reason: str | None, message: str | None) -> Row:
        # Below the first line is the traceback of a user's code, which a log keeps.
        text = None if not message else " ".join(message.splitlines()[0].split())[:MAX_MESSAGE]
        named = {"index": self.index, "seed": self.seed, "values": dict(self.drawn)}
        return {**named, "status": status, "reason": reason, "message": text}


def execute(task: Task) -> Row:
    """Runs a task and turns whatever comes of it into a row, in values that strict JSON has."""
    start = time.perf_counter()
    result = _result(task)
    named = result.pop(NOT_FINITE, {})
    row = plain_json(result)
    named |= row.get(NOT_FINITE, {})
    row[NOT_FINITE] = ", ".join(f"{name} {value}" for name, value in named.items() if "." not in name) or None
    return {**row, "wall_s": time.perf_counter() - start, "host": socket.gethostname(), "worker": os.getpid()}


def _result(task: Task) -> Row:
    from stewart_drake.scenario import Scenario

    try:
        with trusting_code(task.trust_code):
            log = task.function(Scenario.from_dict(task.base).replace(task.changes))
        # A finite blow-up overflows in the squares; its row says so.
        with np.errstate(all="ignore"):
            return {**task.row(log.status, log.reason, log.message), **(task.measure or measure)(log)}
    except KeyboardInterrupt:
        raise
    except ConfigurationError as error:
        return task.row("rejected", error.reason, str(error))
    except RunFailure as error:
        return {**task.row("failed", error.reason, str(error)), "end_time": error.time, "leg": error.leg}
    except MetricError as error:
        return task.row("raised", error.reason, str(error))
    except BaseException as error:  # SystemExit, MemoryError and the like: a row each
        name = type(error).__name__
        return task.row("raised", name, f"{str(error) or name}{raised_at(error)}")


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


def measure(log: SimulationLog) -> Row:
    return {**outcome(log), **flat(run_metrics(log), log.scenario), "simulation_s": log.wall_time}


def measure_cost(log: SimulationLog, scales: CostScales) -> Row:
    return {**outcome(log), "cost": run_cost(run_metrics(log), log.status, log.scenario.controller.period, scales)}


def measure_run(log: SimulationLog, band: float, scales: CostScales | None = None) -> Row:
    """Figures of a run: those of every sweep, settling into `band` [mm], its cost and the trace of its error."""
    rotation, position = error_norms(log)
    pose = np.hypot(1e3 * log.scenario.robot.characteristic_length * np.radians(rotation), position)
    figures = measure(log)
    if scales is not None:
        figures["cost"] = run_cost(figures, log.status, log.scenario.controller.period, scales)
    settled = settling_time(log.time, pose, band) if log.reached_end else None

    def thinned(values: np.ndarray) -> list[float]:
        parts = np.array_split(values, min(TRACE_POINTS, len(values))) if len(values) else []
        return [float(f"{np.max(part):.4g}") for part in parts]

    return {**figures, "settling_s": settled, "trace": {"time": thinned(log.time), "pose_mm": thinned(pose)}}


def measure_band(log: SimulationLog, frequency: float, axis: int, window: float) -> Row:
    """Amplitude ratio and phase over the last `window` [s] of a run along a sine of `frequency` [Hz] on `axis`."""
    row = outcome(log) | dict.fromkeys(("ratio", "phase_deg", "rest"))
    if not log.reached_end:
        return row
    rows = log.time > log.time[-1] - window + 1e-9
    reference, pose = log["reference"][rows, axis], log["pose"][rows, axis]
    response, rest = sine_response(log.time[rows], reference, pose, frequency)
    return {**row, "ratio": abs(response), "phase_deg": float(np.degrees(np.angle(response))), "rest": rest}


def settling_time(time: np.ndarray, size: np.ndarray, band: float) -> float | None:
    """Time after which `size` stays within `band`: 0 where it never leaves it, None where it ends outside."""
    outside = ~(size <= band)
    if not len(time) or outside[-1]:
        return None
    last = np.flatnonzero(outside)
    return float(time[last[-1] + 1]) if len(last) else 0.0


def sine_response(
    time: np.ndarray, reference: np.ndarray, response: np.ndarray, frequency: float
) -> tuple[complex, float]:
    """Ratio of a response (n,) to a sine (n,) of `frequency` [Hz]: amplitude and, as its angle, phase.

    Also the RMS of what the least-squares fit leaves of the response, as a part of the RMS of the fitted sine.
    """
    angle = 2.0 * np.pi * frequency * np.asarray(time)
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    solution, *_ = np.linalg.lstsq(basis, np.stack([reference, response], axis=1), rcond=None)
    wanted, actual = solution[0] + 1j * solution[1]
    rest = response - basis @ solution[:, 1]
    return complex(actual / wanted), float(np.sqrt(2.0 * np.mean(rest**2)) / abs(actual))


# --- rows in a folder ---


class KeptRuns:
    """Rows of runs in a folder, which is this process's alone within the context: a sealed line each.

    A line begins with the digest of what is done. One that was damaged, or never finished, is run again.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
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

    def __exit__(self, *details: Any) -> None:
        self._open.__exit__(*details)

    def rows(self, keys: Sequence[Key], task: Callable[[Key], Task]) -> list[Row]:
        digests = {key: f"{self._digest}/{key}" for key in keys}
        missing = [key for key in digests if digests[key] not in self._kept]
        self._done += len(keys) - len(missing)
        self._progress(float(self._done))

        def keep(key: Key, row: Row) -> None:
            append(self._stream, {"key": digests[key], **row})
            self._kept[digests[key]] = row
            self._done += 1
            self._progress(float(self._done))

        def died(key: Key) -> Row:
            return task(key).row("failed", "worker_died", DEAD)

        run_jobs(missing, lambda key: (execute, (task(key),)), keep, self._workers, died)
        return [self._kept[digests[key]] for key in keys]

    def _keep(self, line: bytes) -> bool:
        """Takes the row of a line that is whole and as it was written."""
        with suppress(ConfigurationError):
            row = unseal(line if line.endswith(b"\n") else b"", ROWS, "a study")
            self._kept[row.pop("key")] = row
            return True
        return False

    def _refuse_another(self) -> None:
        header = self.folder / HEADER
        try:
            there = header.exists() or (self.folder / ROWS).exists()
            unlike = _unequal(json.loads(header.read_bytes()), self._identity) if there else []
        except (OSError, ValueError, RecursionError):
            unlike = [f"{HEADER}, which cannot be read"]
        # Rows know too what they are of.
        if unlike and not any(key.startswith(self._digest) for key in self._kept):
            allowed = "a new folder, or one with the same study by the same version; --restart replaces it"
            raise ConfigurationError("--out", str(self.folder), f"{allowed}; it differs in {', '.join(unlike[:5])}")


def _unequal(one: Any, other: Any, name: str = "") -> list[str]:
    """Dotted keys at which two documents differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        keys = dict.fromkeys([*one, *other])
        return [n for k in keys for n in _unequal(one.get(k), other.get(k), f"{name}.{k}" if name else k)]
    return [] if one == other else [name]


def identity(work: Mapping[str, Any], scenarios: Iterable[Scenario] = ()) -> dict[str, Any]:
    """What results depend on, so that kept ones are known again: the work, its files, weights, the code."""
    versions = collect_versions()
    texts = {text for scenario in scenarios if (text := scenario.tuner.content()) is not None}
    return {
        **work,
        "files": file_digests(work),
        "weights": sorted(map(checksum, texts)),
        "columns": checksum([asdict(column) for column in columns(*scenarios)])[:8],
        "kinds": checksum([each.added_code() for each in REGISTERED])[:8],
        "versions": {name: versions[name] for name in CODE},
    }
