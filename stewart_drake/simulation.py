"""Running a scenario: one Diagram, one Simulator, one log."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus
from pydrake.systems.framework import Context

from stewart_drake.control_inputs import checked_legs
from stewart_drake.diagram import ClosedLoop, require_scenario
from stewart_drake.errors import (
    ConfigurationError,
    RunFailure,
    SafetyStop,
    StewartDrakeError,
    UnreachablePoseError,
    drake_guard,
)
from stewart_drake.estimator import EncoderOptions
from stewart_drake.log import SimulationLog, Status
from stewart_drake.lqi_options import LqiOptions
from stewart_drake.motion_fit import motion_report
from stewart_drake.named_files import file_digests
from stewart_drake.safety import SafetyOptions, refuse_motion, refuse_start, sample_times
from stewart_drake.sampling import on_grid, times_of
from stewart_drake.scenario import Scenario
from stewart_drake.user_controller import ControllerStop, PythonOptions, user_code
from stewart_drake.versions import collect_versions

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

SUBSTEPS = 10
"""Parts of the plant's step in which continuous state of a user's controller is integrated."""
CHUNK = 0.05
"""[s] simulated time between two calls of `progress`."""


def run(
    scenario: Scenario,
    progress: Callable[[float], None] | None = None,
    meshcat: Meshcat | None = None,
    check: bool = True,
) -> SimulationLog:
    """Simulates a scenario.

    A run that breaks midway does not raise: its log so far comes back with status `failed`, reason, time and leg; after
    Ctrl-C with status `interrupted`.

    Args:
        scenario: What to run.
        progress: Called with the simulated time [s] now and then; what it raises passes, but for KeyboardInterrupt,
            which ends the run as Ctrl-C does.
        meshcat: Shows the run while it happens.
        check: Check the reference against `scenario.limits` first.

    Raises:
        ConfigurationError: Found before the run: see `check_scenario`; options that the plant cannot have; weights file
            that cannot be used; a user's controller that cannot.
        RunFailure: The start pose cannot be assembled; only with `check` off.
        TypeError: Something else than a Scenario.
    """
    require_scenario(scenario)
    if check:
        check_scenario(scenario)
    # What lies on the disk now is what the run is made of.
    files = file_digests(scenario.to_dict())
    loop = ClosedLoop(scenario, meshcat)
    _compile(loop)
    with drake_guard("preparing the simulator"):
        simulator = Simulator(loop, loop.create_start_context())
        _integrate_in_substeps(simulator, scenario.plant.time_step)
    context = simulator.get_context()

    step = on_grid(scenario.plant.time_step)
    total = int(scenario.duration / scenario.plant.time_step + 1e-6)
    stride = max(1, int(CHUNK / scenario.plant.time_step))
    breaks = _breaks(scenario, total)
    trip: dict[str, Any] | None = None
    status: Status = "completed"
    reason = message = None
    leg: int | None = None
    end: float | None = None
    # A mistake in a user's controller ends the run with its log; one in this package must show.
    users_own = user_code if isinstance(scenario.controller, PythonOptions) else nullcontext
    start = time.perf_counter()
    try:
        with drake_guard("simulation"), users_own(), _quiet():
            simulator.Initialize()
        for done in sorted({*range(stride, total, stride), total, *breaks}):
            # What `progress` raises is the caller's own affair, so it stays outside of the guard.
            with drake_guard("simulation"), users_own(), _quiet():
                _refuse_early_end(simulator.AdvanceTo(done * step))
            if done in breaks:
                loop.plant.break_rod(simulator.get_mutable_context(), breaks[done])
            if progress is not None:
                progress(_nominal(context.get_time(), scenario.plant.time_step))
    except RunFailure as failure:
        status, reason, message, leg, end = "failed", failure.reason, str(failure), failure.leg, failure.time
        trip = failure.trip if isinstance(failure, SafetyStop) else None
    except KeyboardInterrupt:
        status, reason, message = "interrupted", "interrupted", "stopped by the user"
    wall = time.perf_counter() - start
    return SimulationLog(
        scenario=scenario,
        signals=_signals(loop, context),
        state_names=loop.plant.state_names,
        status=status,
        reason=reason,
        message=message,
        end_time=_nominal(end if end is not None else context.get_time(), scenario.plant.time_step),
        leg=leg,
        safety=trip if trip is not None or loop.safety is None else loop.safety.first_trip(context),
        wall_time=wall,
        versions=collect_versions(),
        files=files,
    )


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
    options = loop.scenario.controller
    if not options.compiled or isinstance(options, PythonOptions):
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
        with _quiet():
            _check_safety(scenario, scenario.safety)
    with _quiet():
        try:
            near = LqiOptions() if isinstance(scenario.controller, PythonOptions) else scenario.controller
            checked_legs(scenario.robot, near, scenario.start()[0])
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
    """A run that a system of the user's ended is none that completed."""
    if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
        raise ControllerStop(" ".join(status.FormatMessage().split()))


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


def _signals(loop: ClosedLoop, context: Context) -> dict[str, np.ndarray]:
    scenario, plant = loop.scenario, loop.plant
    data = {name: sink.FindLog(context) for name, sink in loop.sinks.items()}
    # A row is complete once the slowest sink has it: a failure can stop a publish halfway.
    rows = min(log.num_samples() for log in data.values())
    values = {name: np.array(log.data().T[:rows]) for name, log in data.items()}
    time_on_grid = data["plant_state"].sample_times()[:rows]
    multiple = np.round(time_on_grid / scenario.plant.time_step)
    limit = scenario.robot.effort_limit
    pose, pose_rate = plant.pose_and_rate(values["plant_state"])
    signals = {
        "time": times_of(multiple, scenario.plant.time_step),
        "pose": pose,
        "pose_rate": pose_rate,
        "reference": values["reference"][:, :6],
        "reference_rate": values["reference"][:, 6:12],
        "reference_acceleration": values["reference"][:, 12:],
        "error": values["error"],
        "integral": values["integral"],
        "torque": values["torque"],
        "torque_applied": np.clip(values.get("torque_applied", values["torque"]), -limit, limit),
        "crank_angle": plant.crank_angles(values["plant_state"]),
        "loop_gap": plant.loop_gap(values["plant_state"]),
        "plant_state": values["plant_state"],
    }
    if "weights" in values:
        signals["weights" if values["weights"].shape[1] == 2 else "block_weights"] = values["weights"]
        signals["density"] = values["density"]
    if "disturbance" in values:
        signals["disturbance"] = values["disturbance"]
    if "safety" in values:
        signals["safety"] = values["safety"]
    if isinstance(scenario.sensors, EncoderOptions) or scenario.sensors.faults:
        signals["measured_pose"] = values["measurement"][:, :6]
        signals["measured_pose_rate"] = values["measurement"][:, 6:]
    return signals
