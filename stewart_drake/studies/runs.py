"""One run in, one row out, whatever happens in it; rows are kept in a folder as they come."""

from __future__ import annotations

import hashlib
import json
import os
import socket
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from stewart_drake.errors import ConfigurationError, RunFailure, raised_at
from stewart_drake.files.code import file_digests, trusting_code
from stewart_drake.files.whole import NOT_FINITE, checksum, locked_folder, plain_json, write_atomically
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import MetricError, added_code, columns, flat
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.versions import collect_versions
from stewart_drake.registry import REGISTERED
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.studies.workers import DEAD, Workers, run_jobs

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario

Key = TypeVar("Key", int, str)
Row = dict[str, Any]
"""Column -> plain value."""
Measure = Callable[[SimulationLog], Row]
"""Figures of a log, in values that JSON has; a function that the workers can import."""
RunFunction = Callable[["Scenario"], SimulationLog]
"""Simulates a scenario; likewise."""

ROWS, HEADER = "rows.jsonl", "study.json"
CODE = ("stewart-drake", "drake", "numpy", "scipy", "source")
"""Versions on which every number depends."""
MAX_MESSAGE = 500


def simulate(scenario: Scenario, **options: Any) -> SimulationLog:
    """`simulation.run`, which takes the options; a run that was interrupted is no result and raises."""
    from stewart_drake.runs.simulation import run

    log = run(scenario, **options)
    if log.status == "interrupted":
        raise KeyboardInterrupt
    return log


def simulate_unchecked(scenario: Scenario) -> SimulationLog:
    """The same without the check of its motion."""
    return simulate(scenario, check=False)


def outcome(log: SimulationLog) -> Row:
    """How a run ended, see `metric_table.OUTCOME`, but for status, reason and message."""
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
    """How a run ended, and its metrics by column."""
    return {**outcome(log), **flat(run_metrics(log), log.scenario), "simulation_s": log.wall_time}


@dataclass(frozen=True)
class Task:
    """One run, in plain values that travel to any worker.

    Attributes:
        index: Number of the run.
        seed: Of the run.
        base: The scenario before the changes, as `families.given_again` gives it.
        changes: Scenario key -> value.
        drawn: What tells the run from others; goes into the row.
        measure: What goes into the row.
        function: Simulates it.
        trust_code: Whether code that the changes name may run.
    """

    index: int
    seed: int
    base: Mapping[str, Any]
    changes: Mapping[str, Any]
    drawn: Mapping[str, Any]
    measure: Measure = measure
    function: RunFunction = simulate
    trust_code: bool = False

    def row(self, status: str, reason: str | None, message: str | None) -> Row:
        """A row of which nothing else is known."""
        # Below the first line is the traceback of a user's code, which a log keeps.
        text = None if not message else " ".join(message.splitlines()[0].split())[:MAX_MESSAGE]
        named = {"index": self.index, "seed": self.seed, "values": dict(self.drawn)}
        return {**named, "status": status, "reason": reason, "message": text}


def execute(task: Task) -> Row:
    """Runs a task and turns whatever comes of it into a row, in values that strict JSON has: see `whole.plain_json`.

    Raises:
        KeyboardInterrupt: The run was interrupted; it is no row.
    """
    start = time.perf_counter()
    found = _outcome(task)
    named = found.pop(NOT_FINITE, {})
    row = plain_json(found)
    row[NOT_FINITE] = {**named, **row.get(NOT_FINITE, {})}
    return {**row, "wall_s": time.perf_counter() - start, "host": socket.gethostname(), "worker": os.getpid()}


def _outcome(task: Task) -> Row:
    from stewart_drake.scenario import Scenario

    try:
        with trusting_code(task.trust_code):
            log = task.function(Scenario.from_dict(task.base).replace(task.changes))
        # A finite blow-up overflows in the squares; its row says so.
        with np.errstate(all="ignore"):
            return {**task.row(log.status, log.reason, log.message), **task.measure(log)}
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


class KeptRuns:
    """Rows of runs: `study.json` says on what they depend, `rows.jsonl` has a line each, known by a digest.

    A context manager: within it, the folder is this process's alone.

    Args:
        folder: Where.
        identity: What the rows depend on, in plain values, see `identity`.
        where: Where the runs go; None for processes of this machine.
        tell: Called with the number of runs done.
        restart: Throw away what is in the folder.
        products: Names of files that are made of the rows: they never stand beside rows of another identity.

    Raises:
        ConfigurationError: The folder holds another study, is in use, or cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        where: Workers | None = None,
        tell: Callable[[float], None] | None = None,
        restart: bool = False,
        products: Sequence[str] = (),
    ) -> None:
        self.folder, self._identity, self._products = folder, json.loads(json.dumps(identity)), products
        self._digest, self._restart, self._done = checksum(self._identity), restart, 0
        self._workers, self._tell = where or Workers(), tell or (lambda _: None)
        self._open = ExitStack()
        self._kept: dict[str, Row] = {}

    def __enter__(self) -> Self:
        prepare_folder(self.folder)
        path, header = self.folder / ROWS, self.folder / HEADER
        with ExitStack() as opened:
            opened.enter_context(locked_folder(self.folder))
            if self._restart:
                for name in (*self._products, ROWS, HEADER):
                    (self.folder / name).unlink(missing_ok=True)
            different = self._difference(header)
            if different:
                allowed = "a new folder, the same work by the same version, or --restart to throw away what is there"
                raise ConfigurationError("--out", str(self.folder), f"{allowed}; {different}")
            write_atomically(header, (json.dumps(self._identity, indent=1) + "\n").encode())
            try:
                self._stream = opened.enter_context(path.open("a+b", buffering=0))
                self._stream.seek(0)
                content = self._stream.read()
                # A last line that is not finished is that of a process which was killed.
                self._stream.truncate(content.rfind(b"\n") + 1)
            except OSError as error:
                raise ConfigurationError(str(path), error.strerror, "a file that can be written to") from None
            self._kept = dict(_rows(content))
            self._open = opened.pop_all()
        return self

    def __exit__(self, *details: Any) -> None:
        self._open.__exit__(*details)

    def rows(self, keys: Sequence[Key], task: Callable[[Key], Task]) -> list[Row]:
        """The row of each key; what is missing is run as its task says.

        Raises:
            StewartDrakeError: There are no workers (any more); rows done are kept.
            KeyboardInterrupt: Rows done are kept.
        """
        digests = {key: checksum([self._digest, key]) for key in keys}
        missing = [key for key in digests if digests[key] not in self._kept]
        self._progress(len(keys) - len(missing))

        def keep(key: Key, row: Row) -> None:
            line = json.dumps({"key": digests[key], **row}, allow_nan=False).encode() + b"\n"
            try:
                self._stream.write(line)
            except OSError as error:
                raise ConfigurationError(str(self.folder / ROWS), error.strerror, "a disk with room for it") from None
            self._kept[digests[key]] = row
            self._progress(1)

        def died(key: Key) -> Row:
            return task(key).row("failed", "worker_died", DEAD)

        run_jobs(missing, lambda key: (execute, (task(key),)), keep, self._workers, died)
        return [self._kept[digests[key]] for key in keys]

    def _progress(self, more: int) -> None:
        self._done += more
        self._tell(float(self._done))

    def _difference(self, header: Path) -> str:
        """In words, what tells the folder from one of this identity; empty where nothing does."""
        try:
            kept = json.loads(header.read_bytes())
        except (OSError, ValueError):
            there = [name for name in (ROWS, *self._products) if (self.folder / name).exists()]
            return f"{there[0]} is there without a {HEADER} that can be read" if there else ""
        names = _unequal(kept, self._identity)
        changed = [name for name in names if name == "columns" or name.startswith("versions.")]
        if changed:
            return f"it was made by another version ({', '.join(changed)})"
        return f"it differs in {', '.join(names[:5])}{' and more' if len(names) > 5 else ''}" if names else ""


def _rows(content: bytes) -> Iterable[tuple[str, Row]]:
    for line in content.splitlines():
        try:
            row = json.loads(line)
            yield row.pop("key"), row
        except (ValueError, KeyError, TypeError, AttributeError):
            continue  # run again


def _unequal(one: Any, other: Any, name: str = "") -> list[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        keys = dict.fromkeys([*one, *other])
        return [n for k in keys for n in _unequal(one.get(k), other.get(k), f"{name}.{k}" if name else k)]
    return [] if one == other and type(one) is type(other) else [name]


def identity(
    work: Mapping[str, Any],
    scenarios: Iterable[Scenario] = (),
    versions: Mapping[str, str | None] | None = None,
    more: Iterable[str] = (),
) -> dict[str, Any]:
    """What results depend on, in plain values, so that kept ones are known again: the work, its files, the code.

    Args:
        work: What is computed, in plain values.
        scenarios: Of the work; of networks the weights count, and not what their file is called.
        versions: From `collect_versions`; None collects them.
        more: Names of versions beside `CODE`.

    Raises:
        ConfigurationError: A weights file cannot be read.
    """
    versions = collect_versions() if versions is None else versions
    texts = {text for scenario in scenarios if (text := scenario.tuner.content()) is not None}
    return {
        **work,
        "files": file_digests(work),
        "weights": sorted(hashlib.sha256(text.encode()).hexdigest()[:24] for text in texts),
        "columns": checksum([[asdict(column) for column in columns(*scenarios)], added_code()])[:8],
        "kinds": checksum([each.added_code() for each in REGISTERED])[:8],
        "versions": {name: versions[name] for name in (*CODE, *more)},
    }
