"""Running a scenario: one engine, one log."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from stewart_drake.control.user_controller import user_code
from stewart_drake.errors import ConfigurationError, RunFailure, SafetyStop, drake_guard, raised_at
from stewart_drake.files.code import file_digests
from stewart_drake.files.whole import plain_json, signals_held
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import figures_of
from stewart_drake.logs.outcomes import RunRows, assess, find_warnings
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.checks import check_scenario, likely_cause, refuse_unrunnable
from stewart_drake.runs.engine import FastRun
from stewart_drake.safety import first_trip
from stewart_drake.sampling import steps_per, times_of
from stewart_drake.scenario import Scenario, load_scenario, require_scenario

if TYPE_CHECKING:
    from stewart_drake.runs.drake_run import DrakeRun

Engine: TypeAlias = "FastRun | DrakeRun"

CHUNK = 0.05  # [s] simulated time between two calls of `progress`.


def engine_of(scenario: Scenario) -> Engine:
    """The engine that `plant.engine` asks for."""
    if scenario.plant.engine == "reduced":
        return FastRun(scenario)
    # The closed form needs no Drake, which takes seconds to import.
    from stewart_drake.runs.drake_run import DrakeRun

    return DrakeRun(scenario)


def run(
    scenario: Scenario | str | Path,
    progress: Callable[[float], None] | None = None,
    check: bool = True,
    engine: Engine | None = None,
) -> SimulationLog:
    """Simulates a scenario, `run("paper_fig7")`.

    A run that breaks midway does not raise: its log so far comes back, with how it ended, see `outcomes.Status`.

    Args:
        scenario: What to run; a file, or the name of a shipped one, is read.
        progress: Called with the simulated time [s] regularly; its exceptions pass through, but KeyboardInterrupt,
            which ends the run as Ctrl-C does.
        check: Check the reference against `scenario.limits` first.
        engine: What `engine_of` has made of this scenario, for one run, closed afterwards; None makes one.

    Raises:
        ConfigurationError: Found before the run: an invalid scenario, a motion that the robot cannot do, or an engine
            of another scenario or that has run.
        UnreachablePoseError: The start pose is out of reach, with `check` off.
    """
    if isinstance(scenario, (str, Path)):
        scenario = load_scenario(scenario)
    require_scenario(scenario)
    refuse_unrunnable(scenario)
    if check:
        check_scenario(scenario)
    if engine is not None and (engine.closed or engine.scenario != scenario):
        got = f"one of {engine.scenario.name}{' that has run' if engine.closed else ''}"
        raise ConfigurationError("engine", got, "what engine_of has made of this scenario, for this run alone")
    engine = engine_of(scenario) if engine is None else engine
    # What lies on the disk now is what the run is made of.
    files = file_digests(scenario.to_dict())
    try:
        return _run_engine(engine, scenario, files, progress)
    except BaseException as error:
        # A notebook keeps the traceback. Its frames hold views of Contexts that are gone, and pydrake would hand one of
        # those out for the next Context at the same address: a crash.
        traceback.clear_frames(error.__traceback__)
        raise
    finally:
        engine.close()


def _run_engine(
    engine: Engine, scenario: Scenario, files: Mapping[str, str | None], progress: Callable[[float], None] | None
) -> SimulationLog:
    guard, time_step = user_code(scenario), scenario.plant.time_step
    with drake_guard("preparing the simulator"), guard:
        engine.prepare()
    total = int(scenario.duration / time_step + 1e-6)
    chunk = max(1, int(CHUNK / time_step))
    ended_by: RunFailure | KeyboardInterrupt | None = None
    start = time.perf_counter()
    try:
        for done in (*range(chunk, total, chunk), total):
            # What `progress` raises is not ours, so it stays outside of the guard.
            with drake_guard("simulation"), guard, np.errstate(all="ignore"):
                engine.advance(done)
            if progress is not None:
                progress(_nominal(engine.time, time_step))
    except (RunFailure, KeyboardInterrupt) as end:
        ended_by = end
    except MemoryError:
        ended_by = RunFailure("no memory is left to continue", reason="out_of_memory")
    except np.linalg.LinAlgError as error:
        ended_by = RunFailure(f"{error}{raised_at(error)}", reason="singular_matrix")
    wall = time.perf_counter() - start
    trip = ended_by.trip if isinstance(ended_by, SafetyStop) else None
    if trip is None and scenario.safety is not None:
        trip = first_trip(engine.safety_state(), scenario.controller.period, scenario.safety.monitor_names)
    when = ended_by.time if isinstance(ended_by, RunFailure) else None
    end_time = _nominal(engine.time if when is None else when, time_step)
    # A second Ctrl-C does not lose what the first has ended.
    with signals_held() as held, np.errstate(all="ignore"):
        # Metrics and outcome are those of every step of the plant, whatever rows the log keeps.
        rows = RunRows(scenario, engine.signals())
        figures, outcome = figures_of(rows), assess(rows, trip, end_time, ended_by)
        if held and ended_by is None:
            outcome = assess(rows, trip, end_time, KeyboardInterrupt())
        warnings = tuple(plain_json(each) for each in find_warnings(outcome.status, rows, trip))
        if outcome.status in ("failed", "lost", "stopped") and (cause := likely_cause(scenario)):
            first, *trace = (outcome.message or "").split("\n")
            outcome = outcome._replace(message="\n".join([f"{first}; likely cause: {cause}", *trace]))
        if outcome.outcome_time is not None:
            outcome = outcome._replace(outcome_time=_nominal(outcome.outcome_time, time_step))
        stride = steps_per("log_period", scenario.effective_log_period, time_step)
        log = SimulationLog(
            scenario=scenario,
            signals={name: values[::stride].copy() for name, values in rows.signals.items()},
            state_names=engine.state_names,
            **outcome._asdict(),
            end_time=end_time,
            warnings=warnings,
            safety=trip,
            wall_time=wall,
            versions=dict(_versions()),
            files=files,
            figures=figures,
        )
        held.clear()
    return log


@cache
def _versions() -> dict[str, str | None]:
    """Of what runs in this process: it goes on with the code that it has loaded."""
    return collect_versions()


def _nominal(time_on_grid: float, time_step: float) -> float:
    """Simulated time without the rounding of `sampling.on_grid`."""
    return float(times_of(np.round(time_on_grid / time_step), time_step))
