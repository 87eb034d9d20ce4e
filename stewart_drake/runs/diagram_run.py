"""A run on Drake's plant: one Diagram, one Simulator."""

from __future__ import annotations

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus

from stewart_drake.base.errors import RunFailure
from stewart_drake.runs.engine import Run
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop

SUBSTEPS = 10  # Integration steps per step of the plant, for the continuous state of a user's controller.


class DiagramRun(Run):
    """A run of the scenario's Diagram."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._loop = ClosedLoop(scenario, sparse=True)
        self.state_names = self._loop.plant.state_names

    def begin(self) -> None:
        loop = self._loop
        self._simulator = Simulator(loop)
        if loop.num_continuous_states() > 0:
            # Integrator of a user's controller. With error control it would not end once a derivative is NaN.
            integrator, step = self._simulator.get_mutable_integrator(), self.scenario.plant.time_step / SUBSTEPS
            integrator.set_fixed_step_mode(True)
            # In this order: Drake refuses an initial step above the maximum.
            integrator.request_initial_step_size_target(step)
            integrator.set_maximum_step_size(step)
        self._context = self._simulator.get_mutable_context()

    def advance(self, step: int) -> None:
        status = self._simulator.AdvanceTo(step * self._step)
        if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
            # A user's system ended the run.
            raise RunFailure(" ".join(status.FormatMessage().split()), reason="controller_stopped")

    @property
    def time(self) -> float:
        time: float = self._context.get_time()
        return time

    def rows(self) -> tuple[int, dict[str, np.ndarray]]:
        count, values = self._loop.rows(self._context)
        return count, {**values, "loop_gap": self._loop.plant.loop_gap(values["plant_state"])}

    def safety_state(self) -> np.ndarray:
        return self._loop.systems["safety"].state(self._context)

    def graph(self) -> str:
        return self._loop.graph()

    def close(self) -> None:
        """Frees the Diagram.

        pydrake connects systems, ports and diagrams in reference cycles by attributes of these objects. CPython visits
        the attributes of a system written in Python twice, once per base class, and so takes the cycles for referenced
        from outside and never collects them.
        """
        super().close()
        for system in (*self._loop.GetSystems(), self._loop):
            vars(system).clear()
