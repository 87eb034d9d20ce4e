"""A run on the closed form of the robot: the same parts as in the Diagram, called one after the other."""

from __future__ import annotations

import itertools
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.compiled.constants import CHAIN_STATE
from stewart_drake.control.density import density_part
from stewart_drake.control.parts import Answer, ControllerSite, TickedControl
from stewart_drake.errors import ConfigurationError, NotFiniteError, RunFailure, StewartDrakeError
from stewart_drake.hardware.command_link import command_link
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.friction_feedforward import feedforward_part
from stewart_drake.hardware.sensing import Estimate, LoopSite
from stewart_drake.plant.closed_chain import ClosedChain, starting_state
from stewart_drake.references import in_blocks
from stewart_drake.registry import CONTROLLERS, ESTIMATORS, SENSORS, TUNERS
from stewart_drake.runs.engine import quiet, signals_of
from stewart_drake.safety import MEMORY_SIZE, SafetyMemory, first_trip, safety_part
from stewart_drake.sampling import InBlocks, Running, on_grid, steps_per
from stewart_drake.scenario import Scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

_S = CHAIN_STATE
_ROWS = 2048
"""Rows that there is place for at first."""


class ReducedRun:
    """The loop of a scenario on its way, see `engine.Engine`.

    Events have the order of the Diagram. At a step of the plant sensors read the state of that instant; at a tick the
    controller answers within it; delay, link, safety layer and motors follow; the row is complete; the plant steps.

    Raises:
        ConfigurationError: A kind of sensor or tuner that there is in a Diagram alone; a live view; as the controller.
    """

    state_names: tuple[str, ...] = ()
    stops: tuple[int, ...] = ()

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None) -> None:
        if meshcat is not None:
            raise ConfigurationError("plant.engine", "reduced", "drake, for a live view")
        self._scenario, options, believed = scenario, scenario.controller, scenario.believed_robot
        time_step, period, compiled = scenario.plant.time_step, options.period, scenario.compiled
        self._step, self._per_tick = on_grid(time_step), steps_per("controller.period", period, time_step)
        self._chain = ClosedChain(scenario.robot, scenario.plant, scenario.gravity)
        self._reference = in_blocks(scenario.reference, time_step)
        self._wrench = InBlocks(lambda times: total_wrench(scenario.disturbances, times), time_step)

        at = LoopSite.of(scenario)
        still = at.still
        self._sensing = _plain(scenario, "sensors", SENSORS)(scenario.sensors, at)
        estimating = _plain(scenario, "estimator", ESTIMATORS)
        self._estimating = estimating(scenario.estimator, at, scenario.sensors, self._sensing.size)
        self._live = self._sensing.live and self._estimating.live
        # A block of its own: one that both asked would be made again and again where one ends.
        self._ahead = in_blocks(scenario.reference, time_step) if self._estimating.ahead else self._reference
        friction = scenario.friction_compensation
        self._against = None if friction is None else Running(feedforward_part(believed, friction, compiled))
        self._limit = believed.effort_limits
        self._sent = still
        site = ControllerSite(believed, scenario.gravity, len(scenario.tuner.weights), at.guarded, compiled)
        self._control = _control(scenario, site)
        self._tuner, self._density = None, None
        self._weights = np.array(scenario.tuner.weights)
        self._level: np.ndarray | None = None
        if self._control.weighted:
            tuner = scenario.tuner
            self._density = Running(density_part(tuner.window, tuner.density, compiled))
            self._tuner = Running(_plain(scenario, "tuner", TUNERS)(tuner, scenario.tuner_site()))
            self._listens, self._said = tuner.listens, np.zeros(0)
            self._take(self._tuner.memory)
        self._delayed = deque([still] * scenario.command_delay)
        link, safety = scenario.link, scenario.safety
        self._link = None if link.perfect else Running(command_link(link, self._per_tick, still))
        self._safety = None
        if safety is not None:
            quantum = scenario.sensors.quantum
            part = safety_part(
                believed,
                safety,
                scenario.gravity,
                period,
                still,
                compiled,
                quantum,
                self._estimating.surprise_scale or (0.0, 1.0),
            )
            self._safety = Running(part)
        self._motors = None if scenario.motors.perfect else scenario.motors
        # The plant would clip an infinite torque to one that looks valid; our own controllers never give one.
        self._unchecked = safety is None and bool(options.code is not None or link.faults)

        self._applied = bool(self._delayed or self._link or self._safety or self._motors)
        self._places = _places(
            state=_S.size,
            reference=18,
            measurement=12,
            torque=6,
            error=6,
            integral=6,
            innovation=6 if self._estimating.surprise_scale else 0,
            weights=len(self._weights) if self._tuner else 0,
            density=12 if self._density else 0,
            setting=len(self._said) if self._tuner else 0,
            torque_applied=6 if self._applied else 0,
            disturbance=6 if scenario.disturbances else 0,
            safety=3 if self._safety else 0,
        )
        self._table = np.empty((_ROWS, self._places["safety"].stop))
        self._now, self._first, self._count = 0, 0, 0
        self._state, self._next = np.zeros(_S.size), np.empty(_S.size)
        self._estimate = Estimate(np.zeros(12), np.zeros(12))
        self._answer = Answer(np.zeros(6), np.zeros(6), np.zeros(6))
        self._command, self._reading = still, np.zeros(12)

    def prepare(self) -> None:
        """See `Engine`."""
        if self._scenario.controller.code is None:
            # numba compiles in the first call of a function; what is wrong with that shows in the run itself.
            with suppress(StewartDrakeError), quiet():
                first = ReducedRun(self._scenario)
                first._begin()
                first.start()
                first.advance(1)
        self._begin()

    def _begin(self) -> None:
        self._state[:] = np.concatenate(starting_state(self._scenario.robot, *self._scenario.start()))

    def start(self) -> None:
        """See `Engine`."""
        self._row()

    def advance(self, step: int) -> None:
        """See `Engine`."""
        while self._now < step:
            self._advance()
            self._now += 1
            self._row()

    @property
    def time(self) -> float:
        """See `Engine`."""
        return self._now * self._step

    @property
    def rows(self) -> int:
        """See `Engine`."""
        return self._count

    def take(self) -> dict[str, np.ndarray]:
        """See `Engine`."""
        rows, steps = self._table[: self._count].copy(), np.arange(self._first, self._first + self._count)
        values = {name: rows[:, place] for name, place in self._places.items() if place.stop > place.start}
        state = values.pop("state")
        for name, start in (("pose", _S.pose), ("pose_rate", _S.pose_rate), ("crank_angle", _S.angles)):
            values[name] = state[:, start : start + 6]
        values["loop_gap"] = np.zeros((len(rows), 6))
        self._first, self._count = self._first + self._count, 0
        return signals_of(self._scenario, steps, values)

    def first_trip(self) -> dict[str, Any] | None:
        """See `Engine`."""
        options = self._scenario.safety
        if self._safety is None or options is None:
            return None
        memory = SafetyMemory.from_flat(self._safety.memory[:MEMORY_SIZE])
        return first_trip(memory, self._scenario.controller.period, options.monitor_names)

    def graph(self) -> None:
        """See `Engine`."""

    def close(self) -> None:
        """See `Engine`."""
        self._control.close()

    def _row(self) -> None:
        """What happens at a step of the plant before the plant itself moves."""
        time, wanted = self._reference.at(self._now)
        tick, within = divmod(self._now, self._per_tick)
        ticks = within == 0
        if ticks or self._live:
            self._reading = self._sensing(time, tick, self._state)
            self._estimate = self._estimating(time, self._reading, self._sent, wanted, self._level)
        measured, seen = self._estimate.measurement, self._estimate.seen
        ahead = self._ahead.at(self._now + self._estimating.ahead * self._per_tick)[1]
        say = self._control.tick if ticks else self._control.between
        self._answer = self._compensated(time, ticks, ahead, say(time, seen, ahead, self._weights))
        if ticks and self._density is not None:
            self._density(time, self._answer.error, self._answer.torque)
        answer = self._answer
        command = self._delayed[0] if self._delayed else answer.torque
        age = 0.0
        if self._link is not None:
            arrived = self._link(time, command, time, self._now)
            command, age = arrived[:6], float(arrived[6])
        if self._safety is not None:
            if ticks:
                healths = self._estimating.health, self._control.health
                pose = self._reading[:6] if self._sensing.angles is None else None
                more = self._sensing.angles, self._estimate.innovation, pose
                self._safety(time, command, measured, wanted, age, *healths, *more)
            command = self._safety.memory[:6]
        if self._motors is not None:
            # Times of steps are stretched slightly, see `sampling.on_grid`.
            command = self._motors.torque(command, self._state[_S.angles : _S.anchor], time)
        self._command = command
        self._write(wanted, answer)

    def _compensated(self, time: float, ticks: bool, reference: np.ndarray, answer: Answer) -> Answer:
        """The answer with what is added to its torque: against friction, and what an observer cannot explain."""
        friction, surplus = self._against, self._estimate.compensation
        if friction is not None and ticks:
            friction(time, reference)
        torque = answer.torque if surplus is None else answer.torque + surplus
        torque = torque if friction is None else torque + friction.memory
        if torque is answer.torque:
            return answer
        return Answer(torque, answer.error, answer.integral)

    def _write(self, wanted: np.ndarray, answer: Answer) -> None:
        """Completes the row."""
        if self._count == len(self._table):
            self._table = np.concatenate([self._table, np.empty_like(self._table)])
        parts = [self._state, wanted, self._estimate.measurement, *answer]
        if self._estimate.innovation is not None:
            parts.append(self._estimate.innovation)
        if self._density is not None:
            parts += [self._weights, self._density.memory[:12], self._said]
        if self._applied:
            parts.append(self._command)
        if self._scenario.disturbances:
            parts.append(self._wrench.at(self._now)[1])
        if self._safety is not None:
            parts.append(self._safety.memory[6:9])
        np.concatenate(parts, out=self._table[self._count])
        self._count += 1

    def _take(self, told: np.ndarray) -> None:
        """What a tuner says acts from the next tick on."""
        self._weights = told
        if self._listens:
            self._weights, self._level, self._said = told[:4], told[4:5], told[5:10]

    def _advance(self) -> None:
        """One step of the plant, and what else remembers."""
        time, wrench = self._wrench.at(self._now)
        if self._unchecked and not np.isfinite(self._command).all():
            error = NotFiniteError("torque", self._command)
            error.time = time
            raise error
        self._control.advance((self._now + 1) * self._step)
        if self._tuner is not None and self._density is not None and self._now % self._per_tick == 0:
            answer, innovation = self._answer, self._estimate.innovation
            ahead = self._ahead.at(self._now + self._estimating.ahead * self._per_tick)[1]
            heard = answer.error, answer.torque, innovation, ahead
            self._take(self._tuner(time, self._density.memory[:12], *heard))
        if (self._now + 1) % self._per_tick == 0:
            torque = self._answer.torque
            given = np.minimum(np.maximum(torque, -self._limit), self._limit)
            self._sent = given if self._against is None else given - self._against.memory
            if self._delayed:
                self._delayed.append(torque)
                self._delayed.popleft()
        try:
            self._chain.advance(self._command, wrench, self._state, self._next)
        except RunFailure as failure:
            failure.time = time + self._step
            raise
        self._state, self._next = self._next, self._state


def _places(**sizes: int) -> dict[str, slice]:
    """Where the fields of a row are, by name."""
    ends = list(itertools.accumulate(sizes.values()))
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def _plain(scenario: Scenario, key: str, family: Any) -> Any:
    """What runs a kind outside of a Diagram.

    Raises:
        ConfigurationError: There is nothing.
    """
    kind = getattr(scenario, key).kind
    made = family.plain(kind)
    if made is None:
        raise ConfigurationError("plant.engine", "reduced", f"drake, with {key}.kind {kind}")
    return made


def _control(scenario: Scenario, site: ControllerSite) -> Any:
    """The controller: of the package as a function, of others as the LeafSystem that it is."""
    options = scenario.controller
    part = CONTROLLERS.plain(options.kind)
    if part is not None:
        return TickedControl(part(options, site), options, site)
    # Only such a controller needs Drake.
    from stewart_drake.systems.stepped import SteppedControl

    return SteppedControl(options, site._replace(guarded=False), scenario.plant.time_step)
