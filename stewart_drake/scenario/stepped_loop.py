"""The parts of a scenario on a plant, called in order, step by step, without a Diagram."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.sampling import InBlocks, on_grid
from stewart_drake.loop.part import LoopRunner
from stewart_drake.plant.plant_options import ANGLES, CRANK_RATES, POSE, RATE, Plant
from stewart_drake.scenario.assembly import Loop, loop_of
from stewart_drake.scenario.scenario import Scenario


class SteppedLoop:
    """The parts of a scenario on a plant.

    Args:
        scenario: The scenario.
        plant: The plant; None makes that of the scenario.
        sources: Signals of time in place of those of the scenario: name -> value (n,) at a step of the plant.
        parts: Those that run, `machine_side` for one; None for `loop_of` the scenario.

    Attributes:
        parts: The parts that run.
        runner: The parts with their states.
        plant: The plant.
        now: Steps of the plant that are done.
        measured: (24,) output of the plant, see `plant_options.POSE`.
        torque: (6,) [N m] of the motors.
    """

    def __init__(
        self,
        scenario: Scenario,
        plant: Plant | None = None,
        sources: Mapping[str, Callable[[int], np.ndarray]] | None = None,
        parts: Loop | None = None,
    ) -> None:
        self.scenario, self.parts = scenario, loop_of(scenario, split=True) if parts is None else parts
        if any(part.system is not None for part in self.parts.parts):
            allowed = "drake, with a controller that is a LeafSystem"
            raise ConfigurationError("plant.kind", scenario.plant.kind, allowed)
        time_step, self.now = scenario.plant.time_step, 0
        self._step = on_grid(time_step)
        self.plant = scenario.plant.make(scenario.robot, scenario.gravity) if plant is None else plant
        evaluated = {source.signal: InBlocks(source.evaluate, time_step).at for source in self.parts.sources}
        evaluated |= sources or {}
        outside = {"measured": 24, "wrench": 6, **{source.signal: source.size for source in self.parts.sources}}
        outside |= {name: len(first) for name, first in self.parts.inputs.items()}
        inside = {"plant_pose": slice(POSE.start, RATE.stop), "crank_state": slice(ANGLES.start, CRANK_RATES.stop)}
        self.runner = LoopRunner(self.parts.parts, outside, inside, scenario.controller.period, time_step)
        self.measured, self._wrench = self.runner.signal("measured"), self.runner.signal("wrench")
        self.torque = self.runner.signal(self.parts.torque)
        self._sources = [(self.runner.signal(name), evaluate) for name, evaluate in evaluated.items()]

    @property
    def time(self) -> float:
        """[s] since the beginning."""
        return self.now * self._step

    @property
    def pose(self) -> np.ndarray:
        """(6,) [rad, m] of the platform; a view."""
        return self.measured[POSE]

    def begin(self) -> None:
        """Puts the plant where the scenario starts, and the parts before their first tick."""
        self.now = 0
        self.runner.reset()
        for name, first in self.parts.inputs.items():
            self.runner.signal(name)[:] = first
        self.measured[:] = self.plant.initial(*self.scenario.start())

    def run_parts(self) -> None:
        """The parts that are due now, with the signals of time."""
        for signal, evaluate in self._sources:
            signal[:] = evaluate(self.now)
        self.runner.time[0] = self.time
        self.runner.run(self.now)

    def move(self) -> None:
        """A step of the plant, after the parts that act from the next tick on."""
        self.runner.end(self.now)
        try:
            self.measured[:] = self.plant.step(self.torque, self._wrench)
        except RunFailure as failure:
            failure.time = (self.now + 1) * self._step
            raise
        self.now += 1

    def take_over(self, other: SteppedLoop) -> None:
        """Continues from the state of another loop: plant, and the parts that both have."""
        self.now = other.now
        self.runner.take_over(other.runner)
        if self.plant is not other.plant:
            self.measured[:] = self.plant.restore(other.plant.save())
