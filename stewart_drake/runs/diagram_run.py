"""A run on Drake's plant: one Diagram, one Simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus

from stewart_drake.base.errors import RunFailure
from stewart_drake.runs.engine import Run
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop

SUBSTEPS = 10  # Parts of the plant's step in which continuous state of a user's controller is integrated.
_PEERS = "_pydrake_internal_ref_cycle_peers"


class DiagramRun(Run):
    """The loop of a scenario as a Diagram."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._loop = ClosedLoop(scenario, sparse=True)
        self.state_names, self._break_step = self._loop.plant.state_names, self._loop.plant.options.break_step

    def begin(self) -> None:
        loop = self._loop
        self._simulator, self._now = Simulator(loop, loop.create_start_context()), -1
        if loop.num_continuous_states() > 0:
            # Only a user's controller has them. Steps as error control wants them would end nowhere once a derivative
            # is not a number.
            integrator, step = self._simulator.get_mutable_integrator(), self.scenario.plant.time_step / SUBSTEPS
            integrator.set_fixed_step_mode(True)
            # The step wanted at first comes before the largest one: Drake refuses it where it is larger.
            integrator.request_initial_step_size_target(step)
            integrator.set_maximum_step_size(step)
        self._context = self._simulator.get_mutable_context()

    def advance(self, step: int) -> None:
        stops = {step} if self._break_step is None or not self._now < self._break_step else {step, self._break_step}
        for stop in sorted(each for each in stops if each <= step):
            status = self._simulator.AdvanceTo(stop * self._step)
            if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
                # A user's system has ended the run.
                raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")
            if stop == self._break_step:
                self._loop.plant.break_rod(self._context)
        self._now = step

    @property
    def time(self) -> float:
        time: float = self._context.get_time()
        return time

    def rows(self) -> tuple[int, dict[str, np.ndarray]]:
        count, values = self._loop.rows(self._context)
        return count, {**values, "loop_gap": self._loop.plant.loop_gap(values["plant_state"])}

    def safety_state(self) -> Any:
        return self._loop.systems["safety"].state(self._context)

    def graph(self) -> str:
        return self._loop.graph()

    def close(self) -> None:
        """Lets go of the Diagram, which Python's garbage collector would keep for ever.

        pydrake ties systems, ports and diagrams together in cycles, which CPython takes for held from outside: it
        visits the attributes of a system that is written in Python twice, once for each base.
        """
        super().close()
        waiting: list[Any] = [self._loop]
        while waiting:
            peers: set[Any] = getattr(waiting.pop(), _PEERS, set())
            waiting.extend(peers)
            peers.clear()
