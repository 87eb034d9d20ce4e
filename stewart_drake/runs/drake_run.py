"""A run on Drake's plant: one Diagram, one Simulator."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus

from stewart_drake.errors import RunFailure, StewartDrakeError, drake_guard
from stewart_drake.runs.engine import signals_of
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop

SUBSTEPS = 10  # Parts of the plant's step in which continuous state of a user's controller is integrated.
_PEERS = "_pydrake_internal_ref_cycle_peers"


class DrakeRun:
    """The loop of a scenario as a Diagram; peaks and bounds need every step of the plant, whatever the log keeps."""

    closed = False

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._loop = scenario, ClosedLoop(scenario, log_period=scenario.plant.time_step)
        self._step, self._now = on_grid(scenario.plant.time_step), -1
        self.state_names = self._loop.plant.state_names
        rod = scenario.plant.broken_rod
        self._breaks: dict[int, int] = {}
        if rod is not None and rod.time <= scenario.duration:
            # It breaks at the first step that begins at its time or later.
            self._breaks[math.ceil(rod.time / scenario.plant.time_step - 1e-6)] = rod.leg

    def prepare(self) -> None:
        loop = self._loop
        if self.scenario.controller.code is None:
            # numba compiles in the first call of a function: half a minute on a new machine, so a Context of its own
            # takes the first tick. What is wrong with that shows in the run itself, with a log.
            with suppress(StewartDrakeError), drake_guard("compiling"), np.errstate(all="ignore"):
                first = Simulator(loop, loop.create_start_context())
                first.Initialize()
                first.AdvancePendingEvents()
        self._simulator = Simulator(loop, loop.create_start_context())
        if loop.num_continuous_states() > 0:
            # Only a user's controller has them. Steps as error control wants them would end nowhere once a derivative
            # is not a number.
            integrator, step = self._simulator.get_mutable_integrator(), self.scenario.plant.time_step / SUBSTEPS
            integrator.set_fixed_step_mode(True)
            # The step wanted at first comes before the largest one: Drake refuses it where it is larger.
            integrator.request_initial_step_size_target(step)
            integrator.set_maximum_step_size(step)
        self._context = self._simulator.get_mutable_context()
        self._logs = {name: sink.FindMutableLog(self._context) for name, sink in loop.sinks.items()}

    def advance(self, step: int) -> None:
        for stop in (*(each for each in self._breaks if self._now < each < step), step):
            status = self._simulator.AdvanceTo(stop * self._step)
            if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
                # A user's system has ended the run.
                raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")
            if stop in self._breaks:
                self._loop.plant.break_rod(self._context, self._breaks[stop])
        self._now = step

    @property
    def time(self) -> float:
        time: float = self._context.get_time()
        return time

    def signals(self) -> dict[str, np.ndarray]:
        # A row is complete once the slowest sink has it: a failure can stop a publish halfway.
        rows = min(log.num_samples() for log in self._logs.values())
        values = {name: np.array(log.data().T[:rows]) for name, log in self._logs.items()}
        plant, state = self._loop.plant, values["plant_state"]
        values["pose"], values["pose_rate"] = plant.pose_and_rate(state)
        values["crank_angle"], values["loop_gap"] = plant.crank_angles(state), plant.loop_gap(state)
        steps = np.round(self._logs["plant_state"].sample_times()[:rows] / self.scenario.plant.time_step)
        return signals_of(self.scenario, steps, values)

    def safety_state(self) -> Any:
        return self._loop.systems["safety"].state(self._context)

    def graph(self) -> str:
        return self._loop.graph()

    def close(self) -> None:
        """Lets go of the Diagram, which Python's garbage collector would keep for ever.

        pydrake ties systems, ports and diagrams together in cycles, which CPython takes for held from outside: it
        visits the attributes of a system that is written in Python twice, once for each base.
        """
        self.closed = True
        waiting: list[Any] = [self._loop]
        while waiting:
            peers: set[Any] = getattr(waiting.pop(), _PEERS, set())
            waiting.extend(peers)
            peers.clear()
