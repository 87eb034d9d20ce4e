"""The controller's side of a scenario as one object: readings in, torques out; no plant, no simulator, no Drake."""

from __future__ import annotations

import numpy as np

from stewart_drake.errors import ConfigurationError, NotFiniteError
from stewart_drake.part import LoopRunner
from stewart_drake.parts import controllers_side, loop_of
from stewart_drake.safety import LEVELS
from stewart_drake.sampling import InBlocks
from stewart_drake.scenario import Scenario


class Controller:
    """Estimator, controller, tuner and safety layer of a scenario, for a real machine or another simulator.

        controller = Controller(load_scenario("exact_fig7"))
        torque = np.empty(6)
        controller.step(angles, time, torque)  # every controller.period seconds

    The same parts run here as in a Diagram, without sensors, delay, link and motors: those are the machine's. Where the
    commands of the machine act later than after one period, `command_delay` of the scenario says so, and an observer
    allows for it. The Riccati equation of an LQI is solved by the compiled split solution.

    Args:
        scenario: Model of the robot, reference, controller, tuner, estimator and safety layer.

    Raises:
        ConfigurationError: A controller that is a LeafSystem, which needs a Diagram; as `loop_of`.

    Attributes:
        period: [s] between two steps.
        reading: Numbers in a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
    """

    def __init__(self, scenario: Scenario) -> None:
        loop = loop_of(scenario, split=True)
        self._age = np.zeros(1)
        own = controllers_side(loop)
        safety = [part for part in loop.parts if part.name == "safety"]
        if any(part.system is not None for part in own):
            raise ConfigurationError(
                "controller", scenario.controller.kind, "a controller that is no LeafSystem, to run without a plant"
            )
        self.period, self.reading = scenario.controller.period, scenario.sensors.reading_size
        outside = {loop.reading: self.reading, **{source.signal: source.size for source in loop.sources}}
        for layer in safety:
            own.append(layer.connected(command="torque", age=self._age))
        self._running = LoopRunner(own, outside, period=self.period)
        self._sources = [
            (self._running.signal(each.signal), InBlocks(each.evaluate, self.period), each.evaluate)
            for each in loop.sources
            if each.signal != "wrench"
        ]
        self._reading = self._running.signal(loop.reading)
        self._torque = self._running.signal("safe_torque" if safety else "torque")
        self._safe = bool(safety)
        self._limits = scenario.believed_robot.effort_limits
        self._last = -np.inf

    def step(self, readings: np.ndarray, time: float, out: np.ndarray, age: float = 0.0) -> None:
        """One tick.

        Args:
            readings: (6,) [rad] angles of the cranks, or (12,) pose [rad, m] and its rate, see `reading`.
            time: [s] of the motion, later than at the step before; fastest at multiples of the period.
            out: (6,) [N m] out, for the motors: float64, within the effort limits of the robot.
            age: [s] of the readings beyond what the scenario says; the safety layer's `deadline` refers to it.

        Raises:
            ConfigurationError: An argument that is not as said; nothing has changed then.
            RunFailure: A part has failed, or the safety layer gives the robot up; `reason` and `leg` say why.
        """
        if np.shape(readings) != self._reading.shape:
            raise ConfigurationError("readings", np.shape(readings), f"an array of shape ({self.reading},)")
        if not (isinstance(out, np.ndarray) and out.dtype == np.float64 and out.shape == (6,)):
            raise ConfigurationError("out", out, "an array of shape (6,), dtype float64, to write torques to")
        if not self._last < time < np.inf:
            raise ConfigurationError("time", time, f"a finite time later than that of the step before, {self._last} s")
        if not age >= 0.0:
            raise ConfigurationError("age", age, "a number that is not negative [s]")
        self._reading[:] = readings
        self._age[0] = age / self.period
        self._running.time[0] = self._last = time
        for signal, table, evaluate in self._sources:
            at, value = table.at(round(time / table.period))
            signal[:] = value if abs(at - time) < 1e-9 else evaluate(np.array([time]))[0]
        self._running.run()
        if not np.isfinite(self._torque).all():
            raise NotFiniteError("torque", self._torque.copy())
        np.clip(self._torque, -self._limits, self._limits, out=out)
        self._running.end()

    def reset(self) -> None:
        """Resets the state to that before the first step."""
        self._running.reset()
        self._last = -np.inf

    def signal(self, name: str) -> np.ndarray:
        """A signal of the last step by its name, such as `torque`, `error` or `measurement`; a view.

        The tuner's `weights` or `setting` apply from the next step on.
        """
        return self._running.signal(name)

    @property
    def status(self) -> str:
        """Level of the safety layer: `none` where all is well, then `hold`, `ramp`, `safe_hold`, `end`."""
        return LEVELS[int(self._running.signal("safety")[0])] if self._safe else LEVELS[0]
