"""Levels and monitors by their numbers, and what a tick of the safety layer takes and leaves."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.compiled.constants import SAFETY_MEMORY
from stewart_drake.errors import FAILURES
from stewart_drake.registry import BUILT_IN_MONITORS

Level = Literal["none", "hold", "ramp", "safe_hold", "end"]
LEVELS: tuple[Level, ...] = ("none", "hold", "ramp", "safe_hold", "end")
NONE, HOLD, RAMP, SAFE_HOLD, END = range(5)

MONITORS = ("none", *BUILT_IN_MONITORS.names)
"""Stable names, by their number in the log."""
MEMORY_SIZE: int = SAFETY_MEMORY.size


class Trip(NamedTuple):
    """What a monitor says: its number, the level that it asks for, the leg or -1, and a cause in `FAILURES` or 0."""

    monitor: int
    level: int
    leg: int = -1
    cause: int = 0


class SafetyInputs(NamedTuple):
    """What a tick sees.

    Attributes:
        command: (6,) [N m].
        pose: (6,) [rad, m] measured.
        pose_rate: (6,) [rad/s, m/s] measured.
        reference: (6,) [rad, m] pose that is wanted.
        age: [ticks] of the command.
        sensor: What is wrong with the estimator, see `errors.FAILURES`, and its leg or -1.
        controller: What is wrong with the controller, likewise.
        surprise: [rad/s^2] acceleration of a crank that the largest innovation of an observer speaks of.
    """

    command: np.ndarray
    pose: np.ndarray
    pose_rate: np.ndarray
    reference: np.ndarray
    age: float = 0.0
    sensor: tuple[float, float] = (0.0, -1.0)
    controller: tuple[float, float] = (0.0, -1.0)
    surprise: float = 0.0


class SafetyMemory(NamedTuple):
    """What a tick says, and what the next one needs of it.

    Attributes:
        torque: (6,) [N m] for the motors.
        level: Number in `LEVELS`.
        monitor: Number in `MONITORS` of what is wrong.
        leg: 0 to 5, or -1.
        good: (6,) [N m] last good command: one that no limit touched.
        weight: (6,) [N m] last torque that carried the robot's weight.
        held: Ticks of holding, less what good ones gave back; while stopping, ticks without a measurement.
        at_limit: Ticks at the torque limit, less good ones.
        too_fast: Ticks whose command jumped, less good ones.
        since: Ticks in `ramp` and `safe_hold`.
        side: Sign of the rods' determinant at the start; 0 before the first tick.
        ticks: Done.
        first: (5,) monitor, level, leg, tick and cause (number in `FAILURES`) of the first trip; zeros before.
        worst: Highest level so far.
        command: (6,) [N m] that came in the last tick, if it was finite.
        surprised: Ticks with innovations that were too large, less good ones.
    """

    torque: np.ndarray
    level: float
    monitor: float
    leg: float
    good: np.ndarray
    weight: np.ndarray
    held: float
    at_limit: float
    too_fast: float
    since: float
    side: float
    ticks: float
    first: np.ndarray
    worst: float
    command: np.ndarray
    surprised: float

    def flat(self) -> np.ndarray:
        """All in one vector (40,), in the order of the attributes."""
        return np.concatenate([np.atleast_1d(value) for value in self])

    @classmethod
    def from_flat(cls, values: np.ndarray) -> SafetyMemory:
        """Inverse of `flat`."""
        parts = [values[start:end] for start, end in itertools.pairwise(SAFETY_MEMORY)]
        fields: Any = (part if part.size > 1 else float(part[0]) for part in parts)
        return cls(*fields)


def initial_memory(torque: np.ndarray) -> SafetyMemory:
    """Memory before the first tick; `torque` (6,) [N m] is what holds the robot at its start."""
    torque = np.asarray(torque, dtype=float)
    return SafetyMemory(torque, 0.0, 0.0, -1.0, torque, torque, *(0.0,) * 6, np.zeros(5), 0.0, torque, 0.0)


def first_trip(memory: SafetyMemory, period: float, names: Sequence[str] = MONITORS) -> dict[str, Any] | None:
    """What the layer has to tell of a run; None where no monitor tripped.

    Args:
        memory: Of the last tick.
        period: [s] of the ticks.
        names: Of the monitors, see `SafetyOptions.monitor_names`.

    Returns:
        monitor, level, time [s], leg (or None) and cause (or None) of the first trip; worst, the highest level; last,
        the level now; stopped, monitor, time and leg (or None) of the trip for which the robot was taken from its
        controller for good, or None.
    """
    monitor, level, leg, tick, cause = memory.first
    if monitor == 0.0:
        return None

    def told(monitor: float, tick: float, leg: float) -> dict[str, Any]:
        time = round(float(tick) * period, 9)
        return {"monitor": names[int(monitor)], "time": time, "leg": int(leg) if leg >= 0.0 else None}

    stopped = memory.level >= RAMP
    return {
        **told(monitor, tick, leg),
        "level": LEVELS[int(level)],
        "cause": FAILURES[int(cause) - 1] if cause > 0.0 else None,
        "worst": LEVELS[int(memory.worst)],
        "last": LEVELS[int(memory.level)],
        "stopped": told(memory.monitor, memory.ticks - memory.since, memory.leg) if stopped else None,
    }
