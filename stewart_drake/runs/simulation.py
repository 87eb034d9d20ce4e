"""Simulates a scenario and returns its log."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from stewart_drake.base.arguments import checked
from stewart_drake.base.atomic_files import signals_held
from stewart_drake.base.code import file_digests
from stewart_drake.base.errors import ConfigurationError, RunFailure, SafetyStop, drake_guard, raised_at
from stewart_drake.base.sampling import steps_per, times_of
from stewart_drake.control.user_controller import user_code
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import assessed
from stewart_drake.logs.outcomes import RunRows
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.checks import check_scenario, likely_cause, refuse_unrunnable
from stewart_drake.runs.engine import Run, SteppedRun
from stewart_drake.safety import first_trip
from stewart_drake.scenario.scenario import Scenario, load_scenario

PROGRESS_INTERVAL = 0.05  # [s] of simulated time between two calls of `progress`.


def run_of(scenario: Scenario) -> Run:
    """The run of a scenario, by its kind of plant."""
    if not scenario.plant.in_diagram:
        return SteppedRun(scenario)
    # Importing Drake takes seconds.
    from stewart_drake.runs.diagram_run import DiagramRun

    return DiagramRun(scenario)


@checked
def run(
    scenario: Scenario | str | Path,
    progress: Callable[[float], None] | None = None,
    check: bool = True,
    prepared: Run | None = None,
) -> SimulationLog:
    """Simulates a scenario, `run("paper_fig7")`.

    A run that fails midway does not raise; its log has the rows so far and the outcome, see `outcomes.OUTCOMES`.

    Args:
        scenario: A scenario, a file, or the name of a shipped one.
        progress: Called regularly with the simulated time [s]. A KeyboardInterrupt from it ends the run; other
            exceptions pass through.
        check: Whether to check the reference against `scenario.limits` first.
        prepared: The result of `run_of` for this scenario, closed afterwards; None makes one.

    Raises:
        ConfigurationError: The scenario is invalid, the robot cannot do the motion, or `prepared` is of another
            scenario or was used before.
        UnreachablePoseError: The start pose is out of reach, with `check` off.
    """
    if isinstance(scenario, (str, Path)):
        scenario = load_scenario(scenario)
    refuse_unrunnable(scenario)
    if check:
        check_scenario(scenario)
    if prepared is not None and (prepared.closed or prepared.scenario != scenario):
        got = f"one of {prepared.scenario.name}{' that has run' if prepared.closed else ''}"
        raise ConfigurationError("prepared", got, "what run_of has made of this scenario, for this run alone")
    prepared = run_of(scenario) if prepared is None else prepared
    # Digests before the run, as a file may change during it.
    files = file_digests(scenario.to_dict())
    try:
        return _simulate(prepared, scenario, files, progress)
    except BaseException as error:
        # A notebook keeps the traceback, and its frames views of freed Contexts. pydrake would return such a view for
        # the next Context at the same address, and crash.
        traceback.clear_frames(error.__traceback__)
        raise
    finally:
        prepared.close()


def _simulate(
    prepared: Run, scenario: Scenario, files: Mapping[str, str | None], progress: Callable[[float], None] | None
) -> SimulationLog:
    guard, time_step = user_code(scenario), scenario.plant.time_step
    with drake_guard("preparing the simulator"), guard:
        prepared.prepare()
    total = int(scenario.duration / time_step + 1e-6)
    chunk = max(1, int(PROGRESS_INTERVAL / time_step))
    ended_by: RunFailure | KeyboardInterrupt | None = None
    start = time.perf_counter()
    try:
        for done in (*range(chunk, total, chunk), total):
            # `progress` is outside of the guard, so that its exceptions stay as they are.
            with drake_guard("simulation"), guard, np.errstate(all="ignore"):
                prepared.advance(done)
            if progress is not None:
                progress(_nominal(prepared.time, time_step))
    except (RunFailure, KeyboardInterrupt) as end:
        ended_by = end
    except MemoryError:
        ended_by = RunFailure("no memory is left to continue", reason="out_of_memory")
    except np.linalg.LinAlgError as error:
        ended_by = RunFailure(f"{error}{raised_at(error)}", reason="singular_matrix")
    wall = time.perf_counter() - start
    trip = ended_by.trip if isinstance(ended_by, SafetyStop) else None
    if trip is None and scenario.safety is not None:
        trip = first_trip(prepared.safety_state(), scenario.controller.period, scenario.safety.monitor_names)
    when = ended_by.time if isinstance(ended_by, RunFailure) else None
    end_time = _nominal(prepared.time if when is None else when, time_step)
    # A second Ctrl-C must not lose the log.
    with signals_held() as held, np.errstate(all="ignore"):
        # Metrics and outcome use all steps of the plant; the log has one row per stride.
        rows = RunRows(scenario, prepared.signals())
        fields = assessed(rows, trip, end_time, ended_by)
        if held and ended_by is None:
            fields = assessed(rows, trip, end_time, KeyboardInterrupt())
        ended = end_time if fields["outcome_time"] is None else fields["outcome_time"]
        if fields["status"] in ("failed", "lost", "stopped") and (cause := likely_cause(scenario, ended)):
            first, *trace = (fields["message"] or "").split("\n")
            fields["message"] = "\n".join([f"{first}; likely cause: {cause}", *trace])
        if fields["outcome_time"] is not None:
            fields["outcome_time"] = _nominal(ended, time_step)
        stride = steps_per("log_period", scenario.effective_log_period, time_step)
        log = SimulationLog(
            scenario=scenario,
            signals={name: values[::stride].copy() for name, values in rows.signals.items()},
            state_names=prepared.state_names,
            **fields,
            wall_time=wall,
            versions=dict(_versions()),
            files=files,
        )
        held.clear()
    return log


@cache
def _versions() -> dict[str, str | None]:
    """Versions at the first run: a process continues with the code that it has loaded."""
    return collect_versions()


def _nominal(time_on_grid: float, time_step: float) -> float:
    """Simulated time [s] as a multiple of the step, without the rounding of `sampling.on_grid`."""
    return float(times_of(np.round(time_on_grid / time_step), time_step))
