"""The fast engine, on the closed form of the robot, and what both engines have in common."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.errors import ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.logs.log import SIGNALS
from stewart_drake.part import Running
from stewart_drake.parts import loop_of
from stewart_drake.plant.closed_chain import CHAIN_STATE, ClosedChain
from stewart_drake.sampling import InBlocks, on_grid, steps_per, times_of
from stewart_drake.scenario import Scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


def quiet() -> np.errstate:
    """Numbers near the largest overflow on the way to an end with a name; numpy need not say so as well."""
    return np.errstate(all="ignore")


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keeps libraries' warnings about numbers off the terminal, which our checks find; Python's -W shows them."""
    with quiet(), warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
        yield


def signals_of(scenario: Scenario, steps: np.ndarray, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Signals by their names in a log, at steps (n,) of the plant, of values by their names in the loop."""
    limit = scenario.robot.effort_limits
    reference, measurement = values["reference"], values["measurement"]
    signals = {
        "time": times_of(steps, scenario.plant.time_step),
        "reference": reference[:, :6],
        "reference_rate": reference[:, 6:12],
        "reference_acceleration": reference[:, 12:],
        "torque_applied": np.clip(values.get("torque_applied", values["torque"]), -limit, limit),
    }
    weights = values.pop("weights", None)
    if weights is not None:
        signals["weights" if weights.shape[1] == 2 else "block_weights"] = weights
    if not (scenario.sensors.exact and scenario.estimator.exact):
        signals["measured_pose"], signals["measured_pose_rate"] = measurement[:, :6], measurement[:, 6:]
    signals = values | signals
    return {name: signals[name] for name in SIGNALS if name in signals}


POSE, CRANKS = (slice(at, at + 12) for at in (CHAIN_STATE.fields[name][1] // 8 for name in ("pose", "angles")))  # type: ignore[index]


class FastRun:
    """The parts of a scenario called in order, on the closed form of the robot; late ones before the plant steps."""

    state_names: tuple[str, ...] = ()

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
        if self.scenario.controller.code is None:
            # numba compiles in the first call of a function; what is wrong with that shows in the run itself.
            with suppress(StewartDrakeError), quiet():
                first = FastRun(self.scenario)
                first._begin()
                first.advance(1)
        self._begin()

    def _begin(self) -> None:
        self._state[:] = self._chain.initial(*self.scenario.start())

    def advance(self, step: int) -> None:
        running = self._running
        if self._count == 0:
            self._row()
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
        return self._now * self._step

    def signals(self) -> dict[str, np.ndarray]:
        rows = self._rows[: self._count]
        values = {"loop_gap": np.zeros((len(rows), 6)), "crank_angle": rows[:, CRANKS][:, :6].copy()}
        values["pose"], values["pose_rate"] = (each.copy() for each in np.hsplit(rows[:, POSE], 2))
        for name, signal in self._loop.logged.items():
            places = self._running.places
            values[name] = (
                rows[:, places[signal]].copy() if isinstance(signal, str) else np.tile(signal, (len(rows), 1))
            )
        return signals_of(self.scenario, np.arange(len(rows)), values)

    def safety_state(self) -> Any:
        return self._running.state("safety")

    def graph(self) -> None:
        """There is no Diagram."""

    def close(self) -> None:
        """There is nothing to let go of."""
