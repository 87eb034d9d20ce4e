"""Random situations for search, training and tests of tuners, by kind, robot and seed.

The event is in a run's second half, which gives its cost.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np

from stewart_drake.analysis.feasibility import NEAR
from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.robot.robot_scale import PAPER
from stewart_drake.runs.checks import check_scenario, plant_report
from stewart_drake.scenario.scenario import Scenario, load_scenario

TRAINING, VALIDATION, HELD_OUT = (range(first, first + 10**6) for first in (0, 10**6, 3 * 10**6))
"""Seeds for search and training, for selection, and for the test. Those from 2e6 on tested earlier policies."""
_TRIES = 50  # Draws of a situation until its motion is feasible; nearly all first draws are.

Changes = Document  # Scenario key -> value.


class Case(NamedTuple):
    kind: str
    robot: str
    seed: int
    kappa: float = 0.0


@dataclass(frozen=True)
class Template:
    """A robot and its scenario before random changes."""

    scenario: str
    changes: Changes
    duration: float  # [s]
    viscous: float  # [N m s/rad] friction of the motors.
    beyond: tuple[float, float]  # [N m] lowest and highest dry friction that the model does not have.
    push: float  # [-] size of pushes relative to those on the paper's robot.

    @cached_property
    def base(self) -> Scenario:
        """The scenario before random changes, with the default setting of the loop."""
        # No limit on the error relative to the motion: the cost covers it.
        common = {"duration": self.duration, "tuner": "block", "safety": None, "bounds.error_ratio": None}
        return load_scenario(self.scenario).replace({**common, "adaptation": "regression", **self.changes})


# Without noise the counts would not change at rest.
_REACHY: Changes = {"sensors.noise": 3e-4}
ROBOTS = {
    "paper": Template("exact_breathing", {}, 1.8, 0.0, (0.04, 0.1), 1.0),
    "reachy_mini": Template("reachy_nod", _REACHY, 3.0, 0.095, (0.062, 0.08), 0.7),
    "reachy_200hz": Template("reachy_nod", {**_REACHY, "controller.period": 0.005}, 3.0, 0.095, (0.062, 0.08), 0.7),
}


class Draw:
    def __init__(self, rng: np.random.Generator, template: Template) -> None:
        self.rng, self.template, self.robot = rng, template, template.base.robot
        self.length = self.robot.characteristic_length / PAPER.characteristic_length
        self._torque = template.push * self.robot.effort_limit / PAPER.effort_limit

    def between(self, low: float, high: float) -> float:
        return float(low * (high / low) ** self.rng.random())

    def time(self, low: float, high: float) -> float:
        """[s] within shares of the run, in whole milliseconds."""
        return round(self.template.duration * float(self.rng.uniform(low, high)), 3)

    def place(self, share: float) -> np.ndarray:
        """A pose (6,) within a share of the near box."""
        half_width = np.array(NEAR.around(self.robot).half_width)
        return self.robot.home_pose + share * half_width * self.rng.uniform(-1.0, 1.0, 6)

    def size(self, rotation: tuple[float, float], shift: tuple[float, float]) -> np.ndarray:
        """(6,) [rad, m] a rotation and a shift in random directions, of sizes in ranges for the paper's robot."""
        parts = (self.between(*rotation), self.length * self.between(*shift))
        return np.concatenate([self._direction() * part for part in parts])

    def wrench(self, moment: tuple[float, float], force: tuple[float, float]) -> list[float]:
        """(6,) [N m, N], or an impulse, likewise."""
        moments = self._torque * self._direction() * self.between(*moment)
        forces = self._torque / self.length * self._direction() * self.between(*force)
        return [*moments.tolist(), *forces.tolist()]

    def _direction(self) -> np.ndarray:
        way = self.rng.standard_normal(3)
        return way / np.linalg.norm(way)


def _wave(
    rotation: tuple[float, float],
    shift: tuple[float, float],
    frequency: tuple[float, float],
    share: float = 0.2,
    phases: int = 1,
) -> Callable[[Draw], Changes]:
    """Sines around a pose on all axes, of one phase or six; sizes as in `Draw.size`, frequency [Hz]."""

    def reference(draw: Draw) -> Changes:
        phase = np.resize(draw.rng.uniform(0.0, 2.0 * math.pi, phases), 6).tolist()
        amplitude = draw.size(rotation, shift).tolist()
        omega = [2.0 * math.pi * draw.between(*frequency)] * 6
        sine = {"kind": "sine", "amplitude": amplitude, "angular_frequency": omega, "phase": phase}
        return {"reference": {**sine, "center": draw.place(share).tolist()}}

    return reference


_breathing = _wave((0.02, 0.06), (0.004, 0.012), (0.2, 0.6))
_fast = _wave((0.008, 0.03), (0.001, 0.004), (2.5, 5.0), phases=6)
_nod = _wave((0.06, 0.2), (0.002, 0.012), (0.4, 1.2), share=0.15)
_strong = _wave((0.03, 0.06), (0.006, 0.012), (8.0, 12.0), share=0.1, phases=6)


def _hold(draw: Draw) -> Changes:
    return {"reference": {"kind": "hold", "pose": draw.place(0.5).tolist()}}


def _heart(draw: Draw) -> Changes:
    place, phase = draw.place(0.2).tolist(), draw.rng.uniform(0.0, 2.0 * math.pi, 4)
    beat = {
        "kind": "heartbeat",
        "center": place,
        "excursion": draw.size((0.004, 0.02), (0.004, 0.009)).tolist(),
        "rate": draw.between(1.0, 1.8),
        "phase": [float(phase[0])] * 3 + phase[:3].tolist(),
    }
    breath = {
        "kind": "breathing",
        "center": place,
        "excursion": draw.size((0.01, 0.04), (0.008, 0.016)).tolist(),
        "frequency": draw.between(0.2, 0.35),
        "phase": float(phase[3]),
    }
    return {"reference": {"kind": "sum", "parts": [beat, breath]}}


def _tool_path(draw: Draw) -> Changes:
    reference = {
        "kind": "minimum_jerk",
        "poses": [draw.place(0.35).tolist() for _ in range(4)],
        "durations": [draw.time(0.2, 0.28) for _ in range(3)],
        "dwell": [draw.time(0.02, 0.08) for _ in range(3)],
    }
    return {"reference": reference}


def _any_of(*kinds: Callable[[Draw], Changes]) -> Callable[[Draw], Changes]:
    return lambda draw: kinds[int(draw.rng.integers(len(kinds)))](draw)


def _both(*kinds: Callable[[Draw], Changes]) -> Callable[[Draw], Changes]:
    return lambda draw: {key: value for kind in kinds for key, value in kind(draw).items()}


def _moves(draw: Draw) -> Changes:
    return _any_of(*((_breathing, _heart, _fast) if draw.robot == PAPER else (_nod, _breathing)))(draw)


_moves_or_rests = _any_of(_hold, _moves)


def _push(draw: Draw) -> Changes:
    wrench = draw.wrench((0.03, 0.2), (1.5, 7.0))
    return {"kind": "step", "wrench": wrench, "time": draw.time(0.52, 0.7), "until": draw.time(0.75, 0.95)}


def _blow(draw: Draw) -> Changes:
    impulse = draw.wrench((0.001, 0.006), (0.04, 0.16))
    return {"kind": "impulse", "impulse": impulse, "time": draw.time(0.52, 0.85), "duration": 0.005}


def _pushed(draw: Draw) -> Changes:
    return {"disturbances": [_push(draw)]}


def _struck(draw: Draw) -> Changes:
    return {"disturbances": [_blow(draw)]}


def _shaken(draw: Draw) -> Changes:
    shaking = {"kind": "sine", "wrench": draw.wrench((0.005, 0.05), (0.2, 1.5)), "frequency": draw.between(3.0, 30.0)}
    return {"disturbances": [{**shaking, "phase": float(draw.rng.uniform(0.0, 2.0 * math.pi))}]}


def _loaded(draw: Draw) -> Changes:
    position = draw.length * draw.rng.uniform(-0.04, 0.04, 3)
    mass = draw.robot.platform_mass * draw.between(0.15, 0.45)
    return {"plant.payload_mass": mass, "plant.payload_position": position.tolist()}


def _sticking(draw: Draw) -> Changes:
    coulomb = draw.between(*draw.template.beyond)
    more = {"break_away": coulomb * float(draw.rng.uniform(1.0, 1.4)), "viscous": draw.template.viscous}
    return {"plant.motor_friction": 0.0, "plant.motor_damping": 0.0, "plant.friction": {"coulomb": coulomb, **more}}


def _coarse(draw: Draw) -> Changes:
    return {"sensors.resolution_bits": int(draw.rng.integers(12, 15))}


def _bursts(draw: Draw, before: bool, after: bool) -> Changes:
    """A motion that begins or ends midway, with the platform at rest before or after."""
    size = draw.size((0.01, 0.06), (0.002, 0.01)) if draw.robot == PAPER else draw.size((0.04, 0.15), (0.002, 0.01))
    frequency = draw.between(1.0, 3.0) if draw.robot == PAPER else draw.between(0.5, 1.5)
    reference = {
        "kind": "sine_bursts",
        "frequency": [frequency, frequency],
        "amplitude": [(size * moves).tolist() for moves in (before, after)],
        "center": draw.place(0.2).tolist(),
        "burst_duration": draw.time(0.6, 0.75),
        "fade": 0.1 * draw.template.duration,
    }
    return {"reference": reference}


def _load_comes(draw: Draw) -> Changes:
    weight = draw.wrench((0.02, 0.1), (1.0, 4.0))
    step = {"kind": "step", "wrench": [*weight[:3], 0.0, 0.0, -float(np.linalg.norm(weight[3:]))]}
    return {"disturbances": [{**step, "time": draw.time(0.6, 0.75)}]}


def _saturating(draw: Draw) -> Changes:
    """Sines that need 80 to 105 % of the motors' torque, friction included."""
    changes, share = _strong(draw), draw.between(0.8, 1.05)
    amplitude = np.array(changes["reference"]["amplitude"])
    for _ in range(4):
        torque = plant_report(draw.template.base.replace(changes)).smallest.get("plant_torque")
        if torque is None:
            # Out of reach; the check of the scenario rejects it.
            break
        # Nearly proportional: mostly inertia and viscous friction.
        amplitude *= share / (1.0 - torque.margin / torque.bound)
        changes = {"reference": {**changes["reference"], "amplitude": amplitude.tolist()}}
    return changes


def _noisy(draw: Draw) -> Changes:
    return {"sensors.noise": draw.between(8e-5, 4e-4)}


def _delayed(draw: Draw) -> Changes:
    return {"command_delay": int(draw.rng.integers(2, 5))}


_mixture = _any_of(
    partial(_bursts, before=False, after=True),
    partial(_bursts, before=True, after=False),
    _both(_moves, _any_of(_pushed, _struck)),
)


@dataclass(frozen=True)
class Kind:
    """Random changes, robots, and whether tuners are trained on the kind or only tested."""

    draw: Callable[[Draw], Changes]
    robots: tuple[str, ...] = ("paper",)
    trained: bool = True


_ROBOTS = tuple(ROBOTS)
KINDS = {
    "hold": Kind(_hold, _ROBOTS),
    "breathing": Kind(_breathing),
    "heart": Kind(_heart),
    "fast": Kind(_fast),
    "nod": Kind(_nod, _ROBOTS[1:]),
    "payload": Kind(_both(_moves, _loaded), _ROBOTS[:2]),
    "load jump": Kind(_both(_moves_or_rests, _load_comes), _ROBOTS[:2]),
    "pushes": Kind(_both(_moves_or_rests, _pushed), _ROBOTS),
    "blows": Kind(_both(_moves_or_rests, _struck), _ROBOTS),
    "vibration": Kind(_both(_moves_or_rests, _shaken), _ROBOTS[:2]),
    "saturation": Kind(_saturating, _ROBOTS[:2]),
    "noise": Kind(_both(_moves_or_rests, _noisy)),
    "coarse encoders": Kind(_both(_moves, _coarse)),
    "stiction": Kind(_both(_moves, _sticking), _ROBOTS),
    "delay": Kind(_both(_moves, _delayed)),
    "mixture": Kind(_mixture, _ROBOTS[:2]),
    "tool path": Kind(_tool_path, _ROBOTS, trained=False),
    "coarse encoders with stiction": Kind(_both(_moves, _coarse, _sticking), trained=False),
    "payload with pushes": Kind(_both(_moves_or_rests, _loaded, _pushed), _ROBOTS[:2], trained=False),
    "delay with blows": Kind(_both(_moves_or_rests, _delayed, _struck), trained=False),
}


def kinds_of(robot: str, trained: bool | None = None) -> list[str]:
    """Names of the kinds for a robot: for training, for tests only, or, with None, all."""
    return [name for name, kind in KINDS.items() if robot in kind.robots and trained in (None, kind.trained)]


@lru_cache(maxsize=4096)
def situation(kind: str, robot: str, seed: int) -> Scenario:
    """A feasible run, the same for the same arguments; with the default setting, on Drake's plant."""
    if kind not in kinds_of(robot):
        raise ConfigurationError("kind", kind, f"one of {', '.join(kinds_of(robot))}, for {robot}")
    template = ROBOTS[robot]
    rng = np.random.default_rng([zlib.crc32(kind.encode()), zlib.crc32(robot.encode()), seed])
    draw = Draw(rng, template)
    for left in reversed(range(_TRIES)):
        changes = {"sensors.noise_seed": int(rng.integers(2**31)), **KINDS[kind].draw(draw)}
        scenario = template.base.replace({"name": f"{kind} {robot} {seed}", **changes})
        try:
            check_scenario(scenario)
            break
        except ConfigurationError:
            if not left:
                raise
    return scenario
