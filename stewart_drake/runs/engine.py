"""The fast engine, on the closed form of the robot, and what both engines have in common."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from stewart_drake.errors import ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.logs.log import SIGNALS
from stewart_drake.part import LoopRunner
from stewart_drake.parts import loop_of
from stewart_drake.plant.closed_chain import CHAIN_STATE, ClosedChain
from stewart_drake.sampling import InBlocks, on_grid, times_of
from stewart_drake.scenario import Scenario


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


_POSE, _CRANKS = (slice(at, at + 12) for at in (CHAIN_STATE.fields[name][1] // 8 for name in ("pose", "angles")))  # type: ignore[index]


class Plant(Protocol):
    """A robot that `FastLoop` can move: `ClosedChain`, `SteppedPlant`, or another simulator."""

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """`CHAIN_STATE` record at a pose (6,) [rad, m] and its rate (6,) [rad/s, m/s]."""

    def step(self, torque: np.ndarray, wrench: np.ndarray, state: np.ndarray) -> None:
        """Changes a record by one step under torques (6,) [N m] and a wrench (6,) [N m, N] about P."""


class FastLoop:
    """The parts of a scenario, called in order, on a plant, by default its closed form.

    Who has it writes the signals of time. `parts` is the loop, see `loop_of`, `running` the parts at work, `step` is
    that of the plant [s], `state` the robot's `CHAIN_STATE` record, and `torque` (6,) [N m] what the plant gets.
    """

    def __init__(self, scenario: Scenario, plant: Plant | None = None) -> None:
        self.scenario, self.parts = scenario, loop_of(scenario, split=True)
        if any(part.system is not None for part in self.parts.parts):
            raise ConfigurationError("plant.engine", "reduced", "drake, with a controller that is a LeafSystem")
        self.step = on_grid(scenario.plant.time_step)
        time_step, period = scenario.plant.time_step, scenario.controller.period
        self._plant = plant or ClosedChain(scenario.robot, scenario.plant, scenario.gravity)
        outside = {"plant": CHAIN_STATE.itemsize // 8, "wrench": 6}
        outside |= {source.signal: source.size for source in self.parts.sources}
        inside = {"plant_pose": _POSE, "crank_state": _CRANKS}
        self.running = LoopRunner(self.parts.parts, outside, inside, period, time_step)
        self.state = self.running.signal("plant").view(CHAIN_STATE)
        self.torque, self._wrench = self.running.signal(self.parts.torque), self.running.signal("wrench")
        self._tables = [
            (self.running.signal(each.signal), InBlocks(each.evaluate, time_step)) for each in self.parts.sources
        ]

    def fill(self, now: int) -> None:
        """Writes the signals of time alone, as the scenario has them, for a step of the plant."""
        for signal, table in self._tables:
            signal[:] = table.at(now)[1]

    def begin(self) -> None:
        """Puts the robot where the scenario starts."""
        self.state[:] = self._plant.initial(*self.scenario.start())

    def answer(self, now: int) -> None:
        """What the parts say at a step of the plant."""
        self.running.time[0] = now * self.step
        self.running.run(now)

    def move(self, now: int) -> None:
        """The step itself, after the parts that act from the next tick on."""
        self.running.end(now)
        try:
            self._plant.step(self.torque, self._wrench, self.state)
        except RunFailure as failure:
            failure.time = (now + 1) * self.step
            raise


class FastRun:
    """A run on a `FastLoop`, with a row for each step of the plant."""

    state_names: tuple[str, ...] = ()
    closed = False

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._loop = scenario, FastLoop(scenario)
        self._running, time_step = self._loop.running, scenario.plant.time_step
        self._rows = np.empty((int(scenario.duration / time_step + 1e-6) + 1, len(self._running.values)))
        self._now, self._count = 0, 0

    def prepare(self) -> None:
        if self.scenario.controller.code is None:
            # numba compiles in the first call of a function; what is wrong with that shows in the run itself.
            with suppress(StewartDrakeError), np.errstate(all="ignore"):
                first = FastRun(self.scenario)
                first._loop.begin()
                first.advance(1)
        self._loop.begin()

    def advance(self, step: int) -> None:
        if self._count == 0:
            self._row()
        while self._now < step:
            self._loop.move(self._now)
            self._now += 1
            self._row()

    def _row(self) -> None:
        self._loop.fill(self._now)
        self._loop.answer(self._now)
        self._rows[self._count] = self._running.values
        self._count += 1

    @property
    def time(self) -> float:
        return self._now * self._loop.step

    def signals(self) -> dict[str, np.ndarray]:
        rows = self._rows[: self._count]
        values = {"loop_gap": np.zeros((len(rows), 6)), "crank_angle": rows[:, _CRANKS][:, :6].copy()}
        values["pose"], values["pose_rate"] = (each.copy() for each in np.hsplit(rows[:, _POSE], 2))
        for name, signal in self._loop.parts.logged.items():
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
        """Its rows and states are those of one run."""
        self.closed = True
