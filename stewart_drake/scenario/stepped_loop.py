"""The closed loop of a scenario without a Diagram: calls its parts and its plant in order, step by step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.sampling import InBlocks, on_grid
from stewart_drake.loop.part import LoopRunner
from stewart_drake.plant.plant_options import ANGLES, BALL, CRANK_RATES, POSE, RATE, BallPlant, Plant
from stewart_drake.scenario.assembly import Loop, loop_of
from stewart_drake.scenario.scenario import Scenario


class SteppedLoop:
    """The closed loop of a scenario: its parts and a plant.

    Args:
        scenario: The scenario.
        plant: The plant; None for the plant of the scenario.
        sources: Functions that replace sources of the scenario, such as its reference: name of the signal -> function
            of the number of the plant's step that returns the value (n,).
        parts: The parts to run, such as those of `machine_side`; None for all parts, `loop_of(scenario)`.

    Attributes:
        parts: The parts.
        runner: Runs the parts and has their states.
        plant: The plant.
        now: Number of steps of the plant so far.
        measured: (24,) output of the plant, see `plant_options.POSE`; (29,) with a ball.
        torque: (6,) [N m] torques of the motors.
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
        ball = () if scenario.ball is None else (scenario.ball,)
        self.plant = scenario.plant.make(scenario.robot, scenario.gravity_in_base, *ball) if plant is None else plant
        evaluated: dict[str, Callable[[int], np.ndarray]] = {
            source.signal: InBlocks(source.evaluate, time_step).at for source in self.parts.sources
        }
        for name, replacing in (sources or {}).items():
            unturned = f"unturned_{name}"
            evaluated[unturned if unturned in evaluated else name] = replacing
        size = BALL.stop if ball else CRANK_RATES.stop
        outside = {"measured": size, "wrench": 6, **{source.signal: source.size for source in self.parts.sources}}
        outside |= {name: len(first) for name, first in self.parts.inputs.items()}
        inside = {"plant_pose": slice(POSE.start, RATE.stop), "crank_state": slice(ANGLES.start, CRANK_RATES.stop)}
        inside |= {"ball": BALL} if ball else {}
        self.runner = LoopRunner(self.parts.parts, outside, inside, scenario.controller.period, time_step)
        self.measured, self._wrench = self.runner.signal("measured"), self.runner.signal("wrench")
        self._base = self.runner.signal("base") if "base" in outside else None
        self._ball_push = self.runner.signal("ball_push") if ball else None
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
        """Resets the plant to the start of the scenario, and the parts to their initial states."""
        self.now = 0
        self.runner.reset()
        for name, first in self.parts.inputs.items():
            self.runner.signal(name)[:] = first
        self.measured[:] = self.plant.initial(*self.scenario.start())

    def run_parts(self) -> None:
        """Evaluates the sources at the present time, and runs the parts that have a tick now."""
        for signal, evaluate in self._sources:
            signal[:] = evaluate(self.now)
        self.runner.time[0] = self.time
        self.runner.run(self.now)

    def move(self) -> None:
        """Runs the parts that update at the end of a tick, then moves the plant by one step."""
        self.runner.end(self.now)
        if self._base is not None:
            self.plant.set_base(self._base)
        if self._ball_push is not None:
            cast(BallPlant, self.plant).push_ball(self._ball_push)
        try:
            self.measured[:] = self.plant.step(self.torque, self._wrench)
        except RunFailure as failure:
            failure.time = (self.now + 1) * self._step
            raise
        self.now += 1

    def take_over(self, other: SteppedLoop) -> None:
        """Continues from the state of another loop: copies the plant's state and those of parts that both have."""
        self.now = other.now
        self.runner.take_over(other.runner)
        if self.plant is not other.plant:
            self.measured[:] = self.plant.restore(other.plant.save())
