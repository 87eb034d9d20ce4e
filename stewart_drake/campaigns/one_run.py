"""What a worker does: one run in, one row out, whatever happens in it."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from stewart_drake.campaigns.tables import Row
from stewart_drake.errors import UNTRUSTED_CODE, ConfigurationError, RunFailure, raised_at
from stewart_drake.files.code_trust import code_rule
from stewart_drake.files.whole import NOT_FINITE, plain_json
from stewart_drake.logs.metric_table import MetricError, flat
from stewart_drake.logs.metrics import run_metrics

if TYPE_CHECKING:
    from stewart_drake.logs.log import SimulationLog
    from stewart_drake.scenario import Scenario

MAX_MESSAGE = 500

Measure = Callable[["SimulationLog"], Row]
"""Figures of a log, in values that JSON has; a function of a module that the workers can import."""


class RunFunction(Protocol):
    """Simulates a scenario; a function of a module that the workers can import."""

    def __call__(self, scenario: Scenario, /) -> SimulationLog:
        """See `simulation.run`."""


@dataclass(frozen=True)
class Task:
    """One run, in plain values that travel to any worker.

    Attributes:
        index: Number of the run.
        seed: Of the run.
        base: The scenario before the draws, as `Scenario.to_dict` gives it.
        changes: Scenario key -> value, see `Sweep.changes`.
        drawn: See `Sweep.draw`; goes into the row.
        measure: What goes into the row.
        code: Keys of the user's code that it may run, see `CodePath.key`.
    """

    index: int
    seed: int
    base: Mapping[str, Any]
    changes: Mapping[str, Any]
    drawn: Mapping[str, Any]
    measure: Measure
    code: frozenset[str] = frozenset()


def simulate(scenario: Scenario, **options: Any) -> SimulationLog:
    """What a study runs by default: `simulation.run`, which takes the options; one that was interrupted raises.

    Raises:
        KeyboardInterrupt: It was interrupted.
        StewartDrakeError: See `simulation.run`.
    """
    from stewart_drake.runs.simulation import run

    return uninterrupted(run(scenario, **options))


def uninterrupted(log: SimulationLog) -> SimulationLog:
    """A log, unless its run was interrupted: half a run is no result.

    Raises:
        KeyboardInterrupt: It was.
    """
    if log.status == "interrupted":
        raise KeyboardInterrupt
    return log


def simulate_unchecked(scenario: Scenario) -> SimulationLog:
    """The same without the check of its motion, for one that has been checked before."""
    return simulate(scenario, check=False)


def execute(function: RunFunction, task: Task) -> Row:
    """Runs `task` and turns whatever comes of it into a row; what ends the process is beyond it.

    Args:
        function: Simulates the scenario.
        task: What to run.

    Returns:
        index, seed, values (`task.drawn`) and `outcome`'s, in values that strict JSON has: see `whole.plain_json`.

    Raises:
        ConfigurationError: The user's code is not that of the task.
        KeyboardInterrupt: The run was interrupted; it is no row.
    """
    start = time.perf_counter()
    found = _outcome(function, task)
    named = found.pop(NOT_FINITE, {})
    row = plain_json(found)
    row[NOT_FINITE] = {**named, **row.get(NOT_FINITE, {})}
    return {**row, "wall_s": time.perf_counter() - start, "host": socket.gethostname(), "worker": os.getpid()}


def empty_row(task: Task, status: str, reason: str | None, message: str | None) -> Row:
    """A row of a run of which nothing else is known."""
    return {
        "index": task.index,
        "seed": task.seed,
        "values": dict(task.drawn),
        "status": status,
        "reason": reason,
        # Below the first line is the traceback of a user's code, which a log keeps.
        "message": None if not message else " ".join(message.splitlines()[0].split())[:MAX_MESSAGE],
    }


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


def _outcome(function: RunFunction, task: Task) -> Row:
    from stewart_drake.scenario import Scenario

    try:
        with code_rule(task.code):
            log = uninterrupted(function(Scenario.from_dict(task.base).replace(task.changes)))
        # A finite blow-up overflows in the squares; its row says so.
        with np.errstate(all="ignore"):
            return {**empty_row(task, log.status, log.reason, log.message), **task.measure(log)}
    except KeyboardInterrupt:
        raise
    except ConfigurationError as error:
        if error.reason == UNTRUSTED_CODE:
            raise  # it has changed in the midst of the study
        return empty_row(task, "rejected", error.reason, str(error))
    except RunFailure as error:
        return {**empty_row(task, "failed", error.reason, str(error)), "end_time": error.time, "leg": error.leg}
    except MetricError as error:
        return empty_row(task, "raised", error.reason, str(error))
    except BaseException as error:  # SystemExit, MemoryError and the like: a row each, or the sweep would lose the run
        name = type(error).__name__
        return empty_row(task, "raised", name, f"{str(error) or name}{raised_at(error)}")
