"""Running a scenario: one engine, one log."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.config import to_plain
from stewart_drake.control.base import checked_legs
from stewart_drake.control.user_controller import user_code
from stewart_drake.errors import (
    ConfigurationError,
    RunFailure,
    SafetyStop,
    UnreachablePoseError,
    drake_guard,
    raised_at,
)
from stewart_drake.families import user_parts
from stewart_drake.files.code import ControllerError, file_digests
from stewart_drake.files.whole import plain_json
from stewart_drake.logs.log import MAX_ROWS, SimulationLog
from stewart_drake.logs.metrics import figures_of
from stewart_drake.logs.outcomes import find_warnings, judge
from stewart_drake.logs.rows import RunRows
from stewart_drake.logs.versions import collect_versions
from stewart_drake.planning.feasibility import refuse_turns
from stewart_drake.runs.engine import Engine, quiet
from stewart_drake.runs.motion_fit import motion_report
from stewart_drake.safety import SafetyOptions, refuse_motion, refuse_start, sample_times
from stewart_drake.sampling import steps_per, times_of
from stewart_drake.scenario import Scenario, require_scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

CHUNK = 0.05
"""[s] simulated time between two calls of `progress`."""


def engine_of(scenario: Scenario, meshcat: Meshcat | None) -> Engine:
    """The engine that a scenario asks for, see `PlantOptions.engine`."""
    # The closed form needs no Drake, which takes seconds to import.
    if scenario.plant.engine == "reduced":
        from stewart_drake.runs.fast_run import FastRun

        return FastRun(scenario, meshcat)
    from stewart_drake.runs.drake_run import DrakeRun

    return DrakeRun(scenario, meshcat)


def run(
    scenario: Scenario,
    progress: Callable[[float], None] | None = None,
    meshcat: Meshcat | None = None,
    check: bool = True,
    engine: Engine | None = None,
) -> SimulationLog:
    """Simulates a scenario.

    A run that breaks midway does not raise: its log so far comes back, with how it ended, see `outcomes.Status`.

    Args:
        scenario: What to run.
        progress: Called with the simulated time [s] now and then; what it raises passes, but for KeyboardInterrupt,
            which ends the run as Ctrl-C does.
        meshcat: Shows the run while it happens.
        check: Check the reference against `scenario.limits` first.
        engine: What `engine_of` has made of the scenario, with its own `meshcat`; it is closed afterwards. None makes
            one.

    Raises:
        ConfigurationError: Found before the run: see `check_scenario`; options that the plant cannot have; weights file
            that cannot be used; code that is not trusted; a user's controller that cannot; too many rows for memory.
        UnreachablePoseError: The start pose is out of reach, with `check` off.
        TypeError: Something else than a Scenario.
    """
    require_scenario(scenario)
    refuse_unrunnable(scenario)
    if check:
        check_scenario(scenario)
    # What lies on the disk now is what the run is made of.
    files = file_digests(scenario.to_dict())
    engine = engine_of(scenario, meshcat) if engine is None else engine
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
    """Runs an engine from its start; see `run`."""
    guard, time_step = user_code(scenario), scenario.plant.time_step
    with drake_guard("preparing the simulator"), guard:
        engine.prepare()
    total = int(scenario.duration / time_step + 1e-6)
    chunk = max(1, int(CHUNK / time_step))
    ended_by: RunFailure | KeyboardInterrupt | None = None
    start = time.perf_counter()
    try:
        with drake_guard("simulation"), guard, quiet():
            engine.start()
        for done in sorted({*range(chunk, total, chunk), total, *engine.stops}):
            # What `progress` raises is not ours, so it stays outside of the guard.
            with drake_guard("simulation"), guard, quiet():
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
    if trip is None:
        trip = engine.first_trip()
    when = ended_by.time if isinstance(ended_by, RunFailure) else None
    end_time = _nominal(engine.time if when is None else when, time_step)
    with quiet():
        # Metrics and outcome are those of every step of the plant, whatever rows the log keeps.
        rows = RunRows(scenario, engine.signals())
        outcome = judge(rows, trip, end_time, ended_by)
        warnings = tuple(plain_json(each) for each in find_warnings(outcome.status, rows, trip))
    stride = steps_per("log_period", scenario.effective_log_period, time_step)
    return SimulationLog(
        scenario=scenario,
        signals={name: values[::stride].copy() for name, values in rows.signals.items()},
        state_names=engine.state_names,
        status=outcome.status,
        reason=outcome.reason,
        message=outcome.message,
        outcome_time=None if outcome.time is None else _nominal(outcome.time, time_step),
        end_time=end_time,
        leg=outcome.leg,
        warnings=warnings,
        safety=trip,
        wall_time=wall,
        versions=dict(_versions()),
        files=files,
        figures=figures_of(rows),
    )


@cache
def _versions() -> dict[str, str | None]:
    """Of what runs in this process: it goes on with the code that it has loaded."""
    return collect_versions()


def refuse_unrunnable(scenario: Scenario) -> None:
    """Refuses code that is not trusted, and a run whose rows, one a step of the plant, are too many for memory."""
    for part in user_parts(scenario):
        part.code.check(part.code_key)
    step = scenario.plant.time_step
    if scenario.duration > MAX_ROWS * step * (1.0 + 1e-9):
        allowed = f"at most {MAX_ROWS * step:g} s at a plant.time_step of {step:g} s"
        raise ConfigurationError("duration", scenario.duration, f"{allowed}: a row for each step is kept in memory")


def check_scenario(scenario: Scenario) -> None:
    """Checks that the reference keeps to the limits over the whole run, and that the robot can stand at its start.

    Raises:
        InfeasibleReferenceError: Names limit, time, leg and margin.
        ConfigurationError: The start pose is out of reach or singular; the reference grows beyond all numbers, or a
            pose is beyond half a turn; a recording cannot be read; the motion or its start would trip the safety layer.
    """
    _check_motion(scenario)
    with quiet():
        start = scenario.start()[0]
        refuse_turns("initial_offset", start[None], np.zeros(1))
        try:
            checked_legs(scenario.robot, scenario.controller.near_singularity, start)
        except RunFailure as failure:
            key, value = "reference", start.tolist()
            if any(scenario.initial_offset):
                key, value = "initial_offset", list(scenario.initial_offset)
            raise ConfigurationError(key, value, f"a start where the robot can stand ({failure})") from None


_PASSED: set[Any] = set()
"""Motions that have passed: a search runs the same one a thousand times."""


def _check_motion(scenario: Scenario) -> None:
    """Checks the reference over the whole run, but for one that has passed before; a user's code is asked again."""
    told = (scenario.robot, scenario.model_robot, scenario.limits, scenario.safety, scenario.gravity)
    moves = (scenario.reference, scenario.duration, scenario.initial_offset, scenario.controller.period)
    subject = (*told, *moves, tuple(file_digests({"reference": to_plain(scenario.reference)}).items()))
    known = not user_parts(scenario)
    if known and subject in _PASSED:
        return
    motion_report(scenario).raise_if_infeasible()
    if scenario.safety is not None:
        try:
            with user_code(scenario), quiet():
                _check_safety(scenario, scenario.safety)
        except ControllerError as error:
            names = ", ".join(scenario.safety.monitor_names)
            raise ConfigurationError("safety.monitors", names, f"monitors that do not raise ({error})") from None
    if known:
        _PASSED.add(subject)


def _check_safety(scenario: Scenario, safety: SafetyOptions) -> None:
    """Refuses what the safety layer would stop, if everything goes well."""
    time = sample_times(scenario.duration, scenario.controller.period)
    motion = scenario.reference.evaluate(time)
    start, start_rate = scenario.start()
    robot, gravity = scenario.believed_robot, scenario.gravity
    try:
        refuse_motion(robot, safety, gravity, time, motion)
        refuse_start(robot, safety, gravity, start, start_rate, motion[0][0])
    except (UnreachablePoseError, np.linalg.LinAlgError) as failure:
        key = "reference" if scenario.model_robot is None else "model_robot"
        raise ConfigurationError(key, "this motion", f"one that the robot can do ({failure})") from None


def _nominal(time_on_grid: float, time_step: float) -> float:
    """Simulated time without the rounding of `sampling.on_grid`."""
    return float(times_of(np.round(time_on_grid / time_step), time_step))
