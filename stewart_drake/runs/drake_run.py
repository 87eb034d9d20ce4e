"""A run on Drake's plant: one Diagram, one Simulator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus
from pydrake.systems.primitives import VectorLog

from stewart_drake.errors import RunFailure, StewartDrakeError, drake_guard
from stewart_drake.runs.engine import Engine, quiet, signals_of
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


class DrakeRun(Engine):
    """The loop of a scenario on its way; see `engine.Engine`."""

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None) -> None:
        # Peaks and bounds are looked at in every step of the plant, whatever the log keeps.
        self.scenario, self._loop = scenario, ClosedLoop(scenario, meshcat, scenario.plant.time_step)
        self._step = on_grid(scenario.plant.time_step)
        self.state_names = self._loop.plant.state_names
        self._breaks = _breaks(scenario, int(scenario.duration / scenario.plant.time_step + 1e-6))
        self.stops = tuple(self._breaks)

    def prepare(self) -> None:
        """See `Engine`."""
        _compile(self._loop)
        simulator = Simulator(self._loop, self._loop.create_start_context())
        integrate_in_substeps(simulator, self.scenario.plant.time_step)
        self._simulator, self._context = simulator, simulator.get_mutable_context()
        self._logs = {name: sink.FindMutableLog(self._context) for name, sink in self._loop.sinks.items()}

    def start(self) -> None:
        """See `Engine`."""
        self._simulator.Initialize()

    def advance(self, step: int) -> None:
        """See `Engine`."""
        refuse_early_end(self._simulator.AdvanceTo(step * self._step))
        if step in self._breaks:
            self._loop.plant.break_rod(self._context, self._breaks[step])

    @property
    def time(self) -> float:
        """See `Engine`."""
        time: float = self._context.get_time()
        return time

    def signals(self) -> dict[str, np.ndarray]:
        """See `Engine`; a row is complete once the slowest sink has it: a failure can stop a publish halfway."""
        rows = min(log.num_samples() for log in self._logs.values())
        return _signals(self._loop, self._logs, rows)

    def safety_state(self) -> Any:
        """See `Engine`."""
        return self._loop.systems["safety"].state(self._context)

    def graph(self) -> str | None:
        """See `Engine`."""
        return self._loop.graph()

    def close(self) -> None:
        """See `Engine`."""
        release(self._loop)


def _compile(loop: ClosedLoop) -> None:
    """Takes the first tick of a compiled loop on a Context of its own: numba compiles in the first call of a function.

    It takes half a minute on a new machine, and is no part of what the run costs.
    """
    if loop.scenario.controller.code is not None:
        return
    # What is wrong with the first tick shows in the run itself, with a log.
    with suppress(StewartDrakeError), drake_guard("compiling"), quiet():
        simulator = Simulator(loop, loop.create_start_context())
        simulator.Initialize()
        simulator.AdvancePendingEvents()


def _breaks(scenario: Scenario, total: int) -> dict[int, int]:
    """Step of the plant before which a rod breaks -> its leg; from the first step that begins at the time or later."""
    rod = scenario.plant.broken_rod
    if rod is None or rod.time > scenario.duration:
        return {}
    step = math.ceil(rod.time / scenario.plant.time_step - 1e-6)
    return {step: rod.leg} if step < total else {}


def _signals(loop: ClosedLoop, logs: Mapping[str, VectorLog], rows: int) -> dict[str, np.ndarray]:
    plant = loop.plant
    values = {name: np.array(log.data().T[:rows]) for name, log in logs.items()}
    state = values["plant_state"]
    pose, pose_rate = plant.pose_and_rate(state)
    true = {
        "pose": pose,
        "pose_rate": pose_rate,
        "crank_angle": plant.crank_angles(state),
        "loop_gap": plant.loop_gap(state),
    }
    steps = np.round(logs["plant_state"].sample_times()[:rows] / loop.scenario.plant.time_step)
    return signals_of(loop.scenario, steps, values | true)


SUBSTEPS = 10
"""Parts of the plant's step in which continuous state of a user's controller is integrated."""
_PEERS = "_pydrake_internal_ref_cycle_peers"


def release(system: Any) -> None:
    """Lets go of a system that nobody will use again, which Python's garbage collector would keep for ever.

    pydrake ties systems, ports and diagrams together in cycles. Where a system is written in Python, CPython visits the
    dictionary of its attributes twice, once for each base, and takes the cycle for one that is held from outside: each
    run would leave its diagram, some megabytes, behind.
    """
    waiting: list[Any] = [system]
    while waiting:
        peers: set[Any] = getattr(waiting.pop(), _PEERS, set())
        waiting.extend(peers)
        peers.clear()


def integrate_in_substeps(simulator: Simulator, time_step: float) -> None:
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


def refuse_early_end(status: SimulatorStatus) -> None:
    """A run that a user's system ended did not complete."""
    if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
        raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")
