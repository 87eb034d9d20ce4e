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


class DiagramRun(Run):
    """The loop of a scenario as a Diagram."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._loop = ClosedLoop(scenario, sparse=True)
        self.state_names = self._loop.plant.state_names

    def begin(self) -> None:
        loop = self._loop
        self._simulator = Simulator(loop)
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
        status = self._simulator.AdvanceTo(step * self._step)
        if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
            # A user's system has ended the run.
            raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")

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

        pydrake ties systems, ports and diagrams together in cycles, by attributes of these objects, which CPython takes
        for held from outside: it visits the attributes of a system that is written in Python twice, once for each base.
        """
        super().close()
        for system in (*self._loop.GetSystems(), self._loop):
            vars(system).clear()
