"""Running a scenario: one Diagram, one Simulator, one log."""

from __future__ import annotations

import math
import signal
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus
from pydrake.systems.framework import Context
from pydrake.systems.primitives import VectorLog

from stewart_drake.control.inputs import checked_legs
from stewart_drake.control.user_controller import user_code
from stewart_drake.errors import (
    ConfigurationError,
    RunFailure,
    SafetyStop,
    StewartDrakeError,
    UnreachablePoseError,
    drake_guard,
    raised_at,
)
from stewart_drake.files.named_files import file_digests
from stewart_drake.files.user_errors import ControllerError
from stewart_drake.files.whole import plain_json
from stewart_drake.logs.log import SIGNALS, SimulationLog
from stewart_drake.logs.log_rows import LogRows
from stewart_drake.logs.outcomes import find_warnings, judge
from stewart_drake.logs.tally import Tally
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.motion_fit import motion_report
from stewart_drake.safety import SafetyOptions, refuse_motion, refuse_start, sample_times
from stewart_drake.sampling import on_grid, steps_per, times_of
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop, require_scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

SUBSTEPS = 10
"""Parts of the plant's step in which continuous state of a user's controller is integrated."""
CHUNK = 0.05
"""[s] simulated time between two calls of `progress`."""
ROWS_AT_ONCE = 1000
"""Rows, one for each step of the plant, that gather before they are taken from the Diagram."""


def run(
    scenario: Scenario,
    progress: Callable[[float], None] | None = None,
    meshcat: Meshcat | None = None,
    check: bool = True,
    rows: LogRows | None = None,
) -> SimulationLog:
    """Simulates a scenario.

    A run that breaks midway does not raise: its log so far comes back, with how it ended, see `outcomes.Status`.

    Args:
        scenario: What to run.
        progress: Called with the simulated time [s] now and then; what it raises passes, but for KeyboardInterrupt,
            which ends the run as Ctrl-C does.
        meshcat: Shows the run while it happens.
        check: Check the reference against `scenario.limits` first.
        rows: Where the rows of the log go; None keeps them in memory.

    Raises:
        ConfigurationError: Found before the run: see `check_scenario`; options that the plant cannot have; weights file
            that cannot be used; a user's controller that cannot; not enough memory for the rows.
        RunFailure: The start pose cannot be assembled, only with `check` off; `rows` could not be written any more
            (`disk_full`), what came before is where they go.
        TypeError: Something else than a Scenario.
    """
    require_scenario(scenario)
    rows = LogRows() if rows is None else rows
    rows.check(scenario)
    if check:
        check_scenario(scenario)
    # What lies on the disk now is what the run is made of.
    files = file_digests(scenario.to_dict())
    # Peaks and bounds are looked at in every step of the plant, whatever the log keeps.
    loop = ClosedLoop(scenario, meshcat, scenario.plant.time_step)
    try:
        return _run_loop(loop, rows, files, progress)
    except BaseException as error:
        # A notebook keeps the traceback. Its frames hold views of Contexts that are gone, and pydrake would hand one of
        # those out for the next Context at the same address: a crash.
        traceback.clear_frames(error.__traceback__)
        raise
    finally:
        _release(loop)


def _run_loop(
    loop: ClosedLoop, rows: LogRows, files: Mapping[str, str | None], progress: Callable[[float], None] | None
) -> SimulationLog:
    """Runs a loop from its start; see `run`."""
    scenario = loop.scenario
    _compile(loop)
    with drake_guard("preparing the simulator"), user_code(scenario):
        simulator = Simulator(loop, loop.create_start_context())
        _integrate_in_substeps(simulator, scenario.plant.time_step)
    context = simulator.get_mutable_context()
    header = SimulationLog(
        scenario=scenario,
        signals={},
        state_names=loop.plant.state_names,
        status="interrupted",
        reason="killed",
        message="the process ended in the midst of the run",
        versions=collect_versions(),
        files=files,
    )
    rows.begin(header)
    recorder = _Recorder(loop, context, rows)

    step = on_grid(scenario.plant.time_step)
    total = int(scenario.duration / scenario.plant.time_step + 1e-6)
    stride = max(1, int(CHUNK / scenario.plant.time_step))
    breaks = _breaks(scenario, total)
    ended_by: RunFailure | KeyboardInterrupt | None = None
    start = time.perf_counter()
    try:
        with drake_guard("simulation"), user_code(scenario), _quiet():
            simulator.Initialize()
        for done in sorted({*range(stride, total, stride), total, *breaks}):
            # What `progress` raises is not ours, so it stays outside of the guard.
            with drake_guard("simulation"), user_code(scenario), _quiet():
                _refuse_early_end(simulator.AdvanceTo(done * step))
            if done in breaks:
                loop.plant.break_rod(context, breaks[done])
            recorder.drain(ROWS_AT_ONCE)
            if progress is not None:
                progress(_nominal(context.get_time(), scenario.plant.time_step))
    except (RunFailure, KeyboardInterrupt) as end:
        ended_by = end
    except MemoryError:
        ended_by = RunFailure("no memory is left to continue", reason="out_of_memory")
    except np.linalg.LinAlgError as error:
        ended_by = RunFailure(f"{error}{raised_at(error)}", reason="singular_matrix")
    wall = time.perf_counter() - start
    recorder.drain()
    figures = recorder.tally.figures()
    trip = ended_by.trip if isinstance(ended_by, SafetyStop) else None
    if trip is None and loop.safety is not None:
        trip = loop.safety.first_trip(context)
    when = ended_by.time if isinstance(ended_by, RunFailure) else None
    end_time = _nominal(context.get_time() if when is None else when, scenario.plant.time_step)
    outcome = judge(scenario.bounds, figures, trip, end_time, ended_by)
    log = replace(
        header,
        status=outcome.status,
        reason=outcome.reason,
        message=outcome.message,
        outcome_time=None if outcome.time is None else _nominal(outcome.time, scenario.plant.time_step),
        end_time=end_time,
        leg=outcome.leg,
        warnings=tuple(plain_json(each) for each in find_warnings(figures, trip)),
        safety=trip,
        wall_time=wall,
        figures=plain_json(figures),
    )
    return rows.end(log)


_PEERS = "_pydrake_internal_ref_cycle_peers"


def _release(loop: ClosedLoop) -> None:
    """Lets go of a loop that nobody will use again, which Python's garbage collector would keep for ever.

    pydrake ties systems, ports and diagrams together in cycles. Where a system is written in Python, CPython visits the
    dictionary of its attributes twice, once for each base, and takes the cycle for one that is held from outside: each
    run would leave its diagram, some megabytes, behind.
    """
    waiting: list[Any] = [loop]
    while waiting:
        peers: set[Any] = getattr(waiting.pop(), _PEERS, set())
        waiting.extend(peers)
        peers.clear()


class _Recorder:
    """Empties a loop's sinks: every row into the tally, those of the log period into the log.

    Attributes:
        tally: Figures so far.
    """

    def __init__(self, loop: ClosedLoop, context: Context, rows: LogRows) -> None:
        self.tally = Tally(loop.scenario)
        self._loop, self._rows = loop, rows
        self._logs = {name: sink.FindMutableLog(context) for name, sink in loop.sinks.items()}
        scenario = loop.scenario
        self._stride = steps_per("log_period", scenario.effective_log_period, scenario.plant.time_step)

    def drain(self, at_least: int = 0) -> None:
        """Takes what the sinks hold, if that are so many rows. A Ctrl-C meanwhile comes after it."""
        if min(log.num_samples() for log in self._logs.values()) < at_least:
            return
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        try:
            with _quiet():
                signals = _signals(self._loop, self._logs)
                for log in self._logs.values():
                    log.Clear()
                self.tally.add(signals)
                steps = np.rint(signals["time"] / self._loop.scenario.plant.time_step).astype(np.int64)
                kept = steps % self._stride == 0
                self._rows.add({name: values[kept] for name, values in signals.items()})
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _integrate_in_substeps(simulator: Simulator, time_step: float) -> None:
    """Fixed steps for continuous state, which only a controller of the user's has.

    Steps as error control wants them would end nowhere once a derivative is not a number.
    """
    if simulator.get_system().num_continuous_states() == 0:
        return
    integrator = simulator.get_mutable_integrator()
    integrator.set_fixed_step_mode(True)
    # The step wanted at first comes before the largest one: Drake refuses it where it is larger.
    integrator.request_initial_step_size_target(time_step / SUBSTEPS)
    integrator.set_maximum_step_size(time_step / SUBSTEPS)


def _quiet() -> np.errstate:
    """Numbers near the largest overflow on the way to an end with a name; numpy need not say so as well."""
    return np.errstate(all="ignore")


def _compile(loop: ClosedLoop) -> None:
    """Takes the first tick of a compiled loop on a Context of its own: numba compiles in the first call of a function.

    It takes half a minute on a new machine, and is no part of what the run costs.
    """
    if not loop.scenario.compiled or loop.scenario.controller.code is not None:
        return
    # What is wrong with the first tick shows in the run itself, with a log.
    with suppress(StewartDrakeError), drake_guard("compiling"), _quiet():
        simulator = Simulator(loop, loop.create_start_context())
        simulator.Initialize()
        simulator.AdvancePendingEvents()


def check_scenario(scenario: Scenario) -> None:
    """Checks that the reference keeps to the limits over the whole run, and that the robot can stand at its start.

    Raises:
        InfeasibleReferenceError: Names limit, time, leg and margin.
        ConfigurationError: The start pose is out of reach or singular; the reference grows beyond all numbers; a
            recording cannot be read; the motion or its start would trip the safety layer.
    """
    motion_report(scenario).raise_if_infeasible()
    if scenario.safety is not None:
        try:
            with user_code(scenario), _quiet():
                _check_safety(scenario, scenario.safety)
        except ControllerError as error:
            names = ", ".join(scenario.safety.monitor_names)
            raise ConfigurationError("safety.monitors", names, f"monitors that do not raise ({error})") from None
    with _quiet():
        try:
            checked_legs(scenario.robot, scenario.controller.near_singularity, scenario.start()[0])
        except RunFailure as failure:
            key, value = "reference", scenario.start()[0].tolist()
            if any(scenario.initial_offset):
                key, value = "initial_offset", list(scenario.initial_offset)
            raise ConfigurationError(key, value, f"a start where the robot can stand ({failure})") from None


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


def _refuse_early_end(status: SimulatorStatus) -> None:
    """A run that a user's system ended did not complete."""
    if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
        raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")


def _nominal(time_on_grid: float, time_step: float) -> float:
    """Simulated time without the rounding of `sampling.on_grid`."""
    return float(times_of(np.round(time_on_grid / time_step), time_step))


def _breaks(scenario: Scenario, total: int) -> dict[int, int]:
    """Step of the plant before which a rod breaks -> its leg; from the first step that begins at the time or later."""
    rod = scenario.plant.broken_rod
    if rod is None or rod.time > scenario.duration:
        return {}
    step = math.ceil(rod.time / scenario.plant.time_step - 1e-6)
    return {step: rod.leg} if step < total else {}


def _signals(loop: ClosedLoop, logs: Mapping[str, VectorLog]) -> dict[str, np.ndarray]:
    scenario, plant = loop.scenario, loop.plant
    # A row is complete once the slowest sink has it: a failure can stop a publish halfway.
    rows = min(log.num_samples() for log in logs.values())
    values = {name: np.array(log.data().T[:rows]) for name, log in logs.items()}
    time_on_grid = logs["plant_state"].sample_times()[:rows]
    multiple = np.round(time_on_grid / scenario.plant.time_step)
    limit = scenario.robot.effort_limits
    pose, pose_rate = plant.pose_and_rate(values["plant_state"])
    signals = {
        "time": times_of(multiple, scenario.plant.time_step),
        "pose": pose,
        "pose_rate": pose_rate,
        "reference": values["reference"][:, :6],
        "reference_rate": values["reference"][:, 6:12],
        "reference_acceleration": values["reference"][:, 12:],
        "torque_applied": np.clip(values.get("torque_applied", values["torque"]), -limit, limit),
        "crank_angle": plant.crank_angles(values["plant_state"]),
        "loop_gap": plant.loop_gap(values["plant_state"]),
    }
    weights = values.pop("weights", None)
    if weights is not None:
        signals["weights" if weights.shape[1] == 2 else "block_weights"] = weights
    if not (scenario.sensors.exact and scenario.estimator.exact):
        signals["measured_pose"] = values["measurement"][:, :6]
        signals["measured_pose_rate"] = values["measurement"][:, 6:]
    signals = values | signals
    return {name: signals[name] for name in SIGNALS if name in signals}
