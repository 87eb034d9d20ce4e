"""Runs on which tuners are searched, trained and assessed: kinds of situations, drawn by kind, robot and seed.

What matters in a run happens in its second half, which its cost is made of: pushes come there, and motions that change
do so at 60 to 75 % of it.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.planning.pose_box import NEAR
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import PAPER
from stewart_drake.runs.checks import check_scenario
from stewart_drake.scenario import Scenario, load_scenario

TRAINING, VALIDATION, HELD_OUT = (range(first, first + 10**6) for first in (0, 10**6, 3 * 10**6))
"""Seeds: of what is searched and trained on, of what is chosen by, and of what is assessed by. Earlier policies
were assessed on those from 2e6 on."""
_TRIES = 50
"""Draws of a situation until the robot can do its motion; nearly all can at once."""

Changes = dict[str, Any]
"""Scenario key -> value."""


@dataclass(frozen=True)
class Setup:
    """A robot with its sensors, motors and bus, before anything is drawn."""

    scenario: str
    """Name of a shipped one."""
    changes: Changes
    """What of it is otherwise."""
    duration: float
    """[s] of a run."""
    viscous: float
    """[N m s/rad] friction of its motors."""
    beyond: tuple[float, float]
    """[N m] lowest and highest dry friction that nobody believes."""
    push: float
    """[-] size of pushes beside those of the paper's robot, once torques and lengths are counted."""

    @cached_property
    def base(self) -> Scenario:
        """The scenario before anything is drawn, with the default setting of the loop."""
        # How large an error is beside its motion, the cost of a run says here.
        common = {"duration": self.duration, "tuner": {"kind": "block"}, "safety": None, "bounds.error_ratio": None}
        return load_scenario(self.scenario).replace({**common, **self.changes})


ROBOTS = {
    "paper": Setup("exact_breathing", {}, 1.8, 0.0, (0.04, 0.1), 1.0),
    # Its counts alone would not change at rest.
    "reachy_mini": Setup("reachy_nod", {"sensors.noise": 3e-4}, 3.0, 0.095, (0.062, 0.08), 0.7),
}


class Draw:
    """Numbers of one situation, in the size of its robot; all from one generator."""

    def __init__(self, rng: np.random.Generator, setup: Setup, robot: RobotParameters) -> None:
        self.rng, self.setup, self.robot = rng, setup, robot
        self.length = robot.characteristic_length / PAPER.characteristic_length
        self._torque = setup.push * robot.effort_limit / PAPER.effort_limit

    def between(self, low: float, high: float) -> float:
        """Uniform in the logarithm."""
        return float(low * (high / low) ** self.rng.random())

    def time(self, low: float, high: float) -> float:
        """[s] by shares of the run, on a millisecond."""
        return round(self.setup.duration * float(self.rng.uniform(low, high)), 3)

    def any_of(self, choices: Sequence[Callable[[Draw], Changes]]) -> Changes:
        """What one of them draws."""
        return choices[int(self.rng.integers(len(choices)))](self)

    def place(self, share: float) -> np.ndarray:
        """A pose (6,) within a share of the near box."""
        half_width = np.array(NEAR.around(self.robot).half_width)
        return self.robot.home_pose + share * half_width * self.rng.uniform(-1.0, 1.0, 6)

    def size(self, rotation: tuple[float, float], shift: tuple[float, float]) -> np.ndarray:
        """(6,) [rad, m] a rotation and a shift, each of a length between the two, for the paper's robot, any way."""
        parts = (self.between(*rotation), self.length * self.between(*shift))
        return np.concatenate([self._direction() * part for part in parts])

    def wrench(self, moment: tuple[float, float], force: tuple[float, float]) -> list[float]:
        """(6,) [N m, N] or these times s, as `size`."""
        moments = self._torque * self._direction() * self.between(*moment)
        forces = self._torque / self.length * self._direction() * self.between(*force)
        return [*moments.tolist(), *forces.tolist()]

    def _direction(self) -> np.ndarray:
        way = self.rng.standard_normal(3)
        return way / np.linalg.norm(way)


def _wave(amplitude: np.ndarray, frequency: float, center: np.ndarray, phase: Sequence[float]) -> Changes:
    numbers = {"center": center, "amplitude": amplitude, "angular_frequency": np.full(6, 2.0 * math.pi * frequency)}
    return {"kind": "sine", **{key: value.tolist() for key, value in numbers.items()}, "phase": list(phase)}


def _hold(draw: Draw) -> Changes:
    return {"reference": {"kind": "hold", "pose": draw.place(0.5).tolist()}}


def _breathing(draw: Draw) -> Changes:
    phase = [float(draw.rng.uniform(0.0, 2.0 * math.pi))] * 6
    amplitude = draw.size((0.02, 0.06), (0.004, 0.012))
    return {"reference": _wave(amplitude, draw.between(0.2, 0.6), draw.place(0.2), phase)}


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


def _fast(draw: Draw) -> Changes:
    phase = draw.rng.uniform(0.0, 2.0 * math.pi, 6).tolist()
    amplitude = draw.size((0.008, 0.03), (0.001, 0.004))
    return {"reference": _wave(amplitude, draw.between(2.5, 5.0), draw.place(0.2), phase)}


def _nod(draw: Draw) -> Changes:
    phase = [float(draw.rng.uniform(0.0, 2.0 * math.pi))] * 6
    return {"reference": _wave(draw.size((0.06, 0.2), (0.002, 0.012)), draw.between(0.4, 1.2), draw.place(0.15), phase)}


def _tool_path(draw: Draw) -> Changes:
    reference = {
        "kind": "minimum_jerk",
        "poses": [draw.place(0.35).tolist() for _ in range(4)],
        "durations": [draw.time(0.2, 0.28) for _ in range(3)],
        "dwell": [draw.time(0.02, 0.08) for _ in range(3)],
    }
    return {"reference": reference}


def _moves(draw: Draw) -> Changes:
    """A motion of the robot's own."""
    return draw.any_of([_breathing, _heart, _fast] if draw.robot == PAPER else [_nod, _breathing])


def _moves_or_rests(draw: Draw) -> Changes:
    return draw.any_of([_hold, _moves])


def _push(draw: Draw) -> Changes:
    wrench = draw.wrench((0.03, 0.2), (1.5, 7.0))
    return {"kind": "step", "wrench": wrench, "time": draw.time(0.52, 0.7), "until": draw.time(0.75, 0.95)}


def _blow(draw: Draw) -> Changes:
    impulse = draw.wrench((0.001, 0.006), (0.04, 0.16))
    return {"kind": "impulse", "impulse": impulse, "time": draw.time(0.52, 0.85), "duration": 0.005}


def _pushed(draw: Draw) -> Changes:
    return {"disturbances": [draw.any_of([_push, _blow])]}


def _loaded(draw: Draw) -> Changes:
    position = draw.length * draw.rng.uniform(-0.04, 0.04, 3)
    mass = draw.robot.platform_mass * draw.between(0.15, 0.45)
    return {"plant.payload_mass": mass, "plant.payload_position": position.tolist()}


def _sticking(draw: Draw) -> Changes:
    coulomb = draw.between(*draw.setup.beyond)
    more = {"break_away": coulomb * float(draw.rng.uniform(1.0, 1.4)), "viscous": draw.setup.viscous}
    return {"plant.motor_friction": 0.0, "plant.motor_damping": 0.0, "plant.friction": {"coulomb": coulomb, **more}}


def _coarse(draw: Draw) -> Changes:
    return {"sensors.resolution_bits": int(draw.rng.integers(12, 15))}


def _bursts(draw: Draw, before: bool, after: bool) -> Changes:
    """A motion that begins or ends midway; between bursts the platform rests."""
    size = draw.size((0.01, 0.06), (0.002, 0.01)) if draw.robot == PAPER else draw.size((0.04, 0.15), (0.002, 0.01))
    frequency = draw.between(1.0, 3.0) if draw.robot == PAPER else draw.between(0.5, 1.5)
    reference = {
        "kind": "sine_bursts",
        "frequency": [frequency, frequency],
        "amplitude": [(size * moves).tolist() for moves in (before, after)],
        "center": draw.place(0.2).tolist(),
        "burst_duration": draw.time(0.6, 0.75),
        "fade": 0.1 * draw.setup.duration,
    }
    return {"reference": reference}


def _load_comes(draw: Draw) -> Changes:
    """From some time on the platform carries more."""
    weight = draw.wrench((0.02, 0.1), (1.0, 4.0))
    step = {"kind": "step", "wrench": [*weight[:3], 0.0, 0.0, -float(np.linalg.norm(weight[3:]))]}
    return {**_moves_or_rests(draw), "disturbances": [{**step, "time": draw.time(0.6, 0.75)}]}


def _mixture(draw: Draw) -> Changes:
    begins, ends = (lambda d: _bursts(d, False, True)), (lambda d: _bursts(d, True, False))
    return draw.any_of([begins, ends, lambda d: {**_moves(d), **_pushed(d)}, _load_comes])


def _noisy(draw: Draw) -> Changes:
    return {**_moves_or_rests(draw), "sensors.noise": draw.between(8e-5, 4e-4)}


def _delayed(draw: Draw) -> Changes:
    return {**_moves(draw), "command_delay": int(draw.rng.integers(2, 5))}


@dataclass(frozen=True)
class Kind:
    """A kind of situations: a draw of one, as changes of a `Setup.base`, and the robots that it is for.

    Tuners are made on those that are `trained`; of the others they see nothing before they are assessed.
    """

    draw: Callable[[Draw], Changes]
    robots: tuple[str, ...] = ("paper",)
    trained: bool = True


_BOTH = tuple(ROBOTS)
KINDS = {
    "hold": Kind(_hold, _BOTH),
    "breathing": Kind(_breathing),
    "heart": Kind(_heart),
    "fast": Kind(_fast),
    "nod": Kind(_nod, ("reachy_mini",)),
    "payload": Kind(lambda d: {**_moves(d), **_loaded(d)}, _BOTH),
    "pushes": Kind(lambda d: {**_moves_or_rests(d), **_pushed(d)}, _BOTH),
    "noise": Kind(_noisy),
    "coarse encoders": Kind(lambda d: {**_moves(d), **_coarse(d)}),
    "stiction": Kind(lambda d: {**_moves(d), **_sticking(d)}, _BOTH),
    "delay": Kind(_delayed),
    "mixture": Kind(_mixture, _BOTH),
    "tool path": Kind(_tool_path, _BOTH, trained=False),
    "coarse encoders with stiction": Kind(lambda d: {**_moves(d), **_coarse(d), **_sticking(d)}, trained=False),
    "payload with pushes": Kind(lambda d: {**_moves_or_rests(d), **_loaded(d), **_pushed(d)}, _BOTH, trained=False),
}


def kinds_of(robot: str, trained: bool | None = None) -> list[str]:
    """Names of the kinds for a robot; of those that are trained on, of the others, or, with None, of all."""
    return [name for name, kind in KINDS.items() if robot in kind.robots and trained in (None, kind.trained)]


def situation(kind: str, robot: str, seed: int) -> Scenario:
    """A run that the robot can do, the same for the same arguments; with the default setting, on Drake's plant."""
    if kind not in KINDS:
        raise ConfigurationError("kind", kind, f"one of {', '.join(KINDS)}")
    if robot not in KINDS[kind].robots:
        raise ConfigurationError("robot", robot, f"one of {', '.join(KINDS[kind].robots)}, for {kind}")
    if seed < 0:
        raise ConfigurationError("seed", seed, "a whole number from 0 on")
    setup = ROBOTS[robot]
    base = setup.base
    rng = np.random.default_rng([zlib.crc32(kind.encode()), zlib.crc32(robot.encode()), seed])
    draw = Draw(rng, setup, base.robot)
    for left in reversed(range(_TRIES)):
        changes = {"sensors.noise_seed": int(rng.integers(2**31)), **KINDS[kind].draw(draw)}
        scenario = base.replace({"name": f"{kind} {robot} {seed}", **changes})
        try:
            check_scenario(scenario)
            break
        except ConfigurationError:
            if not left:
                raise
    return scenario
