"""A loop that goes on for ever while a person changes it: target, pushes, payload, faults, controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stewart_drake.errors import RunFailure
from stewart_drake.live.steering import HandReference, Reached, nearest_allowed
from stewart_drake.plant.closed_chain import ClosedChain
from stewart_drake.runs.engine import FastLoop, Plant
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario


class LiveLoop:
    """The loop of a scenario on the plant that `plant.engine` names, changed while it runs.

    Every change but a new target and a push is a change of the scenario: its loop is built again, and each part that
    is still there keeps its state, as the robot does. `scenario` is as changed until now, `steps` of the plant are done
    since the beginning, `reference` is the pose set by hand with the motion about it, and `ended` says why the loop
    cannot go on; it is empty while it can.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._begun, self._plant, self._plant_keys = scenario, _plant_of(scenario), _plant_keys(scenario)
        self.reset()

    def reset(self) -> None:
        """As at first."""
        scenario = self._begun
        self.steps, self.ended, self._push, self._push_ends = 0, "", np.zeros(6), -1
        self._step = on_grid(scenario.plant.time_step)
        self.reference = HandReference(scenario.reference, self._step)
        self._build(scenario)
        self._loop.begin()

    def change(self, changes: Mapping[str, Any]) -> None:
        """Changes keys of the scenario, see `Scenario.replace`; a ConfigurationError leaves all as it was."""
        before = self._loop.running
        self._build(self.scenario.replace(changes))
        self._loop.running.take_over(before)

    def aim(self, pose: np.ndarray) -> Reached:
        """Sends the hand to a pose (6,) [rad, m], or as far towards it as the robot can go."""
        scenario, reference = self.scenario, self.reference
        around = reference.excursions(scenario.duration)
        here = reference.hand.state[0]
        reached = nearest_allowed(scenario.robot, scenario.limits, here, pose, scenario.gravity, around)
        reference.hand.target[:] = reached.pose
        return reached

    def move(self, on: bool) -> None:
        """Lets the motion of the scenario come or go."""
        self.reference.share.target[0] = float(on)

    def push(self, wrench: np.ndarray, duration: float) -> None:
        """Pushes the platform from now on, for a duration [s]: wrench (6,) [N m, N], moment about P and force, in B."""
        self._push[:], self._push_ends = wrench, self.steps + round(duration / self._step)

    def advance(self, steps: int) -> None:
        """Some steps of the plant; none once the loop has ended."""
        try:
            for _ in range(steps if not self.ended else 0):
                self._advance_one()
        except (RunFailure, np.linalg.LinAlgError) as failure:
            self.ended = " ".join(str(failure).split())

    def _advance_one(self) -> None:
        time = self.time
        self._reference[:] = self.reference.at(time)
        if self._reference_ahead is not None:
            self._reference_ahead[:] = self.reference.at(time, self._ahead)
        self._wrench[:] = self._push if self.pushed else 0.0
        if self._wrench_source is not None:
            self._wrench += self._wrench_source(np.array([time]))[0]
        self._loop.answer(self.steps)
        self._loop.move(self.steps)
        self.steps += 1
        self.reference.advance()

    @property
    def time(self) -> float:
        """[s] since the beginning."""
        return self.steps * self._step

    @property
    def pose(self) -> np.ndarray:
        """(6,) [rad, m] of the platform."""
        return self._loop.state["pose"][0].copy()

    @property
    def crank_angles(self) -> np.ndarray:
        """(6,) [rad] theta."""
        return self._loop.state["angles"][0].copy()

    @property
    def wanted(self) -> np.ndarray:
        """(6,) [rad, m] of the reference, at the instant of `pose`."""
        return self.reference.at(self.time)[:6]

    @property
    def torque(self) -> np.ndarray:
        """(6,) [N m] as the motors give it."""
        limit = self.scenario.robot.effort_limits
        return np.clip(self._loop.torque, -limit, limit)

    @property
    def pushed(self) -> bool:
        """Whether a push acts."""
        return self.steps < self._push_ends

    def logged(self, name: str) -> np.ndarray | None:
        """A signal by its name in a log, such as `setting`; None where the loop has none."""
        signal = self._loop.parts.logged.get(name)
        return self._loop.running.signal(signal).copy() if isinstance(signal, str) else signal

    def _build(self, scenario: Scenario) -> None:
        plant = self._plant if self._plant_keys == _plant_keys(scenario) else _plant_of(scenario)
        loop = FastLoop(scenario, plant)
        self._plant, self._plant_keys = plant, _plant_keys(scenario)
        self.scenario, self._loop = scenario, loop
        self._ahead = round(scenario.ahead * scenario.controller.period / scenario.plant.time_step)
        sources = {source.signal: source.evaluate for source in loop.parts.sources}
        self._wrench_source = sources.get("wrench")
        self._reference, self._wrench = loop.running.signal("reference"), loop.running.signal("wrench")
        self._reference_ahead = loop.running.signal("reference_ahead") if "reference_ahead" in sources else None


def _plant_keys(scenario: Scenario) -> tuple[Any, ...]:
    """What a plant is made of."""
    return scenario.robot, scenario.plant, scenario.gravity


def _plant_of(scenario: Scenario) -> Plant:
    if scenario.plant.engine == "reduced":
        return ClosedChain(*_plant_keys(scenario))
    # Drake takes seconds to import.
    from stewart_drake.plant.stepped_plant import SteppedPlant

    return SteppedPlant(*_plant_keys(scenario))
