"""The fast engine: the parts of a scenario called in order, on the closed form of the robot."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.errors import ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.parts import loop_of
from stewart_drake.plant.closed_chain import CHAIN_STATE, ClosedChain
from stewart_drake.running import Running
from stewart_drake.runs.engine import Engine, quiet, signals_of
from stewart_drake.sampling import InBlocks, on_grid, steps_per
from stewart_drake.scenario import Scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


def _place(field: str) -> slice:
    """Where twelve numbers begin in the plant's state, which comes first in all values."""
    start = CHAIN_STATE.fields[field][1] // 8  # type: ignore[index]
    return slice(start, start + 12)


POSE, CRANKS = _place("pose"), _place("angles")


class FastRun(Engine):
    """The loop of a scenario on its way, see `engine.Engine`.

    At a step of the plant sensors read the state of that instant; at a tick the parts answer within it, in order; the
    row is complete; late parts tick; the plant steps.
    """

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None) -> None:
        if meshcat is not None:
            raise ConfigurationError("plant.engine", "reduced", "drake, for a live view")
        self.scenario, self._loop = scenario, loop_of(scenario, split=True)
        if any(part.system is not None for part in self._loop.parts):
            raise ConfigurationError("plant.engine", "reduced", "drake, with a controller that is a LeafSystem")
        time_step = scenario.plant.time_step
        self._step = on_grid(time_step)
        self._per_tick = steps_per("controller.period", scenario.controller.period, time_step)
        self._chain = ClosedChain(scenario.robot, scenario.plant, scenario.gravity)
        outside = {"plant": CHAIN_STATE.itemsize // 8, "wrench": 6}
        outside |= {source.signal: source.size for source in self._loop.sources}
        self._running = Running(self._loop.parts, outside, {"plant_pose": POSE, "crank_state": CRANKS})
        self._sources = [
            (self._running.signal(each.signal), InBlocks(each.evaluate, time_step)) for each in self._loop.sources
        ]
        self._state = self._running.signal("plant").view(CHAIN_STATE)
        self._torque, self._wrench = self._running.signal(self._loop.torque), self._running.signal("wrench")
        self._rows = np.empty((int(scenario.duration / time_step + 1e-6) + 1, len(self._running.values)))
        self._now, self._count = 0, 0

    def prepare(self) -> None:
        """See `Engine`."""
        if self.scenario.controller.code is None:
            # numba compiles in the first call of a function; what is wrong with that shows in the run itself.
            with suppress(StewartDrakeError), quiet():
                first = FastRun(self.scenario)
                first._begin()
                first.start()
                first.advance(1)
        self._begin()

    def _begin(self) -> None:
        self._state[:] = self._chain.initial(*self.scenario.start())

    def start(self) -> None:
        """See `Engine`."""
        self._row()

    def advance(self, step: int) -> None:
        """See `Engine`."""
        running = self._running
        while self._now < step:
            if self._now % self._per_tick == 0:
                running.late()
            try:
                self._chain.step(self._torque, self._wrench, self._state)
            except RunFailure as failure:
                failure.time = (self._now + 1) * self._step
                raise
            self._now += 1
            self._row()

    def _row(self) -> None:
        """What happens at a step of the plant before the plant itself moves."""
        running, now = self._running, self._now
        running.time[0] = now * self._step
        for signal, table in self._sources:
            signal[:] = table.at(now)[1]
        if now % self._per_tick == 0:
            running.tick()
        else:
            running.between()
        self._rows[self._count] = running.values
        self._count += 1

    @property
    def time(self) -> float:
        """See `Engine`."""
        return self._now * self._step

    def signals(self) -> dict[str, np.ndarray]:
        """See `Engine`."""
        rows = self._rows[: self._count]
        values = {}
        for name, signal in self._loop.logged.items():
            if isinstance(signal, str):
                values[name] = rows[:, self._running.places[signal]].copy()
            else:
                values[name] = np.tile(signal, (len(rows), 1))
        for name, place in (("pose", POSE), ("crank_angle", CRANKS)):
            values[name] = rows[:, place][:, :6].copy()
        values["pose_rate"], values["loop_gap"] = rows[:, POSE][:, 6:].copy(), np.zeros((len(rows), 6))
        return signals_of(self.scenario, np.arange(len(rows)), values)

    def safety_state(self) -> Any:
        """See `Engine`."""
        return self._running.state("safety")
