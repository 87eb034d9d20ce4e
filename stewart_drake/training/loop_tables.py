"""What a batch of loops is made of: numbers of each loop, and what along its run does not depend on its state."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.estimator import EncoderOptions
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.hardware.seeded import tick_normal
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.sampling import on_grid, steps_per
from stewart_drake.scenario import Scenario

ROWS = 250
"""Ticks that a table has at a time."""
KEPT = 2**30
"""[bytes] of tables that are kept for another run of the same loops."""
_NOISE = 1
"""Stream of random numbers of encoders, see `EncoderOptions.read`."""

_ALIKE = ("robot", "model_robot", "gravity", "controller", "motors", "link", "safety")
"""Keys of a scenario in which the loops of a batch do not differ."""


def refuse(scenarios: Sequence[Scenario]) -> None:
    """Says what a batch cannot have.

    Raises:
        ConfigurationError: Something that only an engine for single runs has, or loops of different robots, ticks or
            kinds.
    """
    if not scenarios:
        raise ConfigurationError("scenarios", "none", "at least one")
    first = scenarios[0]
    for each in scenarios:
        for key in _ALIKE:
            if getattr(each, key) != getattr(first, key):
                raise ConfigurationError(key, getattr(each, key), "the same in all loops of a batch")
        for key, kind in (("estimator", each.estimator.kind), ("plant.time_step", each.plant.time_step)):
            allowed = first.estimator.kind if key == "estimator" else first.plant.time_step
            if kind != allowed:
                raise ConfigurationError(key, kind, f"{allowed}, as another loop of the batch")
        _refuse_parts(each)
    _refuse_controller(first.lqi)


def _refuse_controller(options: LqiOptions) -> None:
    for key, allowed in (
        ("model", "exact"),
        ("feedforward", "full"),
        ("feedforward_at", "reference"),
        ("solver", "split"),
        ("discretization", "exact"),
        ("bumpless", False),
    ):
        if getattr(options, key) != allowed:
            raise ConfigurationError(f"controller.{key}", getattr(options, key), f"{allowed}, in a batch of loops")


def _refuse_parts(scenario: Scenario) -> None:
    plain = "in a batch of loops"
    if scenario.estimator.kind not in ("observer", "difference"):
        raise ConfigurationError("estimator.kind", scenario.estimator.kind, f"observer or difference, {plain}")
    if scenario.sensors.kind not in ("encoders", "ideal"):
        raise ConfigurationError("sensors.kind", scenario.sensors.kind, f"encoders or ideal, {plain}")
    if scenario.estimator.kind == "difference" and scenario.sensors.kind != "ideal":
        raise ConfigurationError("sensors.kind", scenario.sensors.kind, f"ideal, {plain} without an observer")
    if scenario.sensors.faults:
        raise ConfigurationError("sensors.faults", "some", f"none, {plain}")
    for key, fine in (("motors", scenario.motors.perfect), ("link", scenario.link.perfect)):
        if not fine:
            raise ConfigurationError(key, "imperfect", f"perfect ones, {plain}")
    if scenario.safety is not None:
        raise ConfigurationError("safety", "a safety layer", f"null, {plain}")
    if len(scenario.tuner.weights) != 4:
        raise ConfigurationError("tuner.kind", scenario.tuner.kind, f"one of block weights, {plain}")


class Row(NamedTuple):
    """What a tick finds, components first.

    Attributes:
        wanted: (18, B) reference now.
        ahead: (18, B) reference when the command acts.
        feedforward: (6, B) [N m] by the exact model for that.
        friction: (6, B) [N m] against friction, likewise.
        noise: (6, B) [rad] of the readings; None where there is none.
        wrench: (steps, 6, B) [N m, N] at the steps of the plant; None where there is none.
    """

    wanted: Tensor
    ahead: Tensor
    feedforward: Tensor
    friction: Tensor
    noise: Tensor | None
    wrench: Tensor | None


class _Part:
    """A table of the different ones among many functions of time.

    Args:
        keys: What says whether two loops share one.
        make: Values (C, rows) of the loop with a number, from a first row on.
        device: Of the tensors.
    """

    def __init__(self, keys: Sequence[Any], make: Callable[[int, int, int], np.ndarray], device: Any) -> None:
        texts = [json.dumps(key, sort_keys=True, default=str) for key in keys]
        found = {text: number for number, text in reversed(list(enumerate(texts)))}
        order = {text: place for place, text in enumerate(found)}
        self.loops, self._make, self._device = list(found.values()), make, device
        self.index = torch.tensor([order[text] for text in texts], device=device)

    def rows(self, first: int, count: int) -> Tensor:
        """(C, count, different ones)."""
        values = np.stack([self._make(loop, first, count) for loop in self.loops], axis=-1)
        return torch.from_numpy(values).to(self._device)


class LoopTables:
    """References, feedforward, wrenches and noise of loops, in chunks of ticks; equal ones are made once.

    Args:
        scenarios: Of one batch.
        ahead: (B,) ticks by which each loop looks ahead.
        device: Of the tensors.
    """

    def __init__(self, scenarios: Sequence[Scenario], ahead: Sequence[int], device: Any = None) -> None:
        self._scenarios, first = scenarios, scenarios[0]
        self._step, period = on_grid(first.plant.time_step), first.controller.period
        self._per_tick = steps_per("controller.period", period, first.plant.time_step)
        said = [scenario.to_dict() for scenario in scenarios]
        paths = [(each["reference"], each["friction_compensation"]) for each in said]
        self._paths = _Part(paths, self._path, device)
        self._wrenches = None
        if any(scenario.disturbances for scenario in scenarios):
            self._wrenches = _Part([each["disturbances"] for each in said], self._wrench, device)
        noises = [(each["sensors"].get("noise", 0.0), each["sensors"].get("noise_seed", 0)) for each in said]
        self._noises = _Part(noises, self._noise, device) if any(size for size, _ in noises) else None
        self._most = max(ahead)
        self._ahead = torch.tensor(list(ahead), device=device)
        self._kept: dict[int, tuple[Tensor | None, ...]] = {}

    def row(self, tick: int) -> Row:
        """What a tick finds."""
        chunk, place = divmod(tick, ROWS)
        paths, noises, wrenches = self._chunk(chunk)
        assert paths is not None
        index = self._paths.index
        ahead = paths[:, place + self._ahead, index] if self._most else paths[:, place, index]
        wanted = paths[:18, place, index] if self._most else ahead[:18]
        noise = None if noises is None or self._noises is None else noises[:, place, self._noises.index]
        wrench = None
        if wrenches is not None and self._wrenches is not None:
            steps = slice(place * self._per_tick, (place + 1) * self._per_tick)
            wrench = wrenches[:, steps, self._wrenches.index].movedim(1, 0)
        return Row(wanted, ahead[:18], ahead[18:24], ahead[24:], noise, wrench)

    def _chunk(self, chunk: int) -> tuple[Tensor | None, ...]:
        if chunk not in self._kept:
            first, per_tick = chunk * ROWS, self._per_tick
            paths = self._paths.rows(first, ROWS + self._most)
            noises = None if self._noises is None else self._noises.rows(first, ROWS)
            wrenches = None if self._wrenches is None else self._wrenches.rows(first * per_tick, ROWS * per_tick)
            made = paths, noises, wrenches
            size = sum(8 * each.numel() for each in made if each is not None)
            if size * (1 + len(self._kept)) > KEPT:
                self._kept.clear()
            self._kept[chunk] = made
        return self._kept[chunk]

    def _path(self, loop: int, first: int, count: int) -> np.ndarray:
        scenario = self._scenarios[loop]
        times = np.arange(first, first + count) * self._per_tick * self._step
        pose, rate, acceleration = scenario.reference.evaluate(times)
        robot, known = scenario.believed_robot, scenario.friction_compensation
        torque = inverse_dynamics(robot, pose, rate, acceleration, scenario.gravity)
        friction = np.zeros_like(torque)
        if known is not None:
            friction = known.torque(crank_rates(robot, leg_geometry(robot, pose), pose, rate))
        return np.concatenate([pose, rate, acceleration, torque, friction], axis=-1).T

    def _wrench(self, loop: int, first: int, count: int) -> np.ndarray:
        return total_wrench(self._scenarios[loop].disturbances, np.arange(first, first + count) * self._step).T

    def _noise(self, loop: int, first: int, count: int) -> np.ndarray:
        sensors = self._scenarios[loop].sensors
        if not isinstance(sensors, EncoderOptions) or sensors.noise == 0.0:
            return np.zeros((6, count))
        drawn = [tick_normal(sensors.noise_seed, _NOISE, tick, 6) for tick in range(first, first + count)]
        return sensors.noise * np.stack(drawn, axis=-1)


def looked_ahead(scenario: Scenario) -> int:
    """[ticks] by which the observer of a scenario looks ahead; 0 without one."""
    options = scenario.estimator
    if not isinstance(options, ObserverOptions):
        return 0
    return options.ahead(scenario.command_delay)
