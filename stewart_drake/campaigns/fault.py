"""A fault of the table: a change of the scenario, and what is expected of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from stewart_drake.scenario import Scenario, load_scenario

Reaction = Literal["refused", "ridden through", "held", "ramped", "ended", "unnoticed"]
"""refused: before the start. ridden through: no monitor tripped, and none had to. unnoticed: none tripped, but the true
pose went farther from the reference than `safety.following_error` allows. held: the last good command
bridged it. ramped: a safe hold, then the end. ended: without one, since the robot could not be held; brakes are all
that is left."""

ONSET = 0.5
"""[s] when every fault begins."""
DURATION = 2.0
"""[s] of each run; assumed long enough for what a fault does to show."""

HOME = [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
MOTIONS: Mapping[str, Mapping[str, Any]] = {
    "hold": {"kind": "hold", "pose": HOME},
    "breathing": {"kind": "breathing", "phase": 0.0},
    "paper": {"kind": "sine"},
}
"""Breathing begins at end-inhale, so that it moves when the fault comes."""


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Attributes:
        name: Stable name.
        text: One line.
        changes: Scenario keys; `reference` is the motion's, whatever they say.
        drift: (6,) [rad, m] by which the reference wanders off; None for not at all.
        drift_time: [s] in which it does.
        checked: Whether the run is checked beforehand, as a user's is.
        expected: Reactions allowed.
        monitors: Monitors allowed to trip first; empty where none may.
        since: [s] from which it acts; 0 for what is wrong from the start.
        encoders: Keys of `sensors`, for a loop with encoders and commands a tick late; None for ideal sensors.
        within: [s] within which a monitor trips, from the limits of the layer alone; None where it takes as long as
            the motion and the robot take to show it.
    """

    name: str
    text: str
    changes: Mapping[str, Any]
    expected: tuple[Reaction, ...]
    monitors: tuple[str, ...] = ()
    drift: tuple[float, ...] | None = None
    drift_time: float = 0.8
    checked: bool = True
    since: float = ONSET
    encoders: Mapping[str, Any] | None = None
    within: float | None = None

    def scenario(self, motion: str) -> Scenario:
        """The run of this fault during a motion of `MOTIONS`."""
        reference: Mapping[str, Any] = MOTIONS[motion]
        if self.drift is not None:
            away = [a + b for a, b in zip(HOME, self.drift, strict=True)]
            path = {"kind": "minimum_jerk", "poses": [HOME, away], "durations": [self.drift_time], "dwell": [ONSET]}
            reference = {"kind": "sum", "parts": [reference, path]}
        changes: dict[str, Any] = {"name": f"{self.name} {motion}", "reference": dict(reference), **self.changes}
        if self.encoders is not None:
            # Commands of a real drive are a tick old; with encoders it has to be shown that the loop bears both.
            changes |= {"sensors": {"kind": "encoders", **self.encoders}, "command_delay": 1}
        return base().replace(changes)


def base() -> Scenario:
    """The exact-model LQI of `exact_fig7` behind the safety layer, as it stands by default."""
    return load_scenario("exact_fig7").replace({"duration": DURATION, "safety": {}})


THROUGH: tuple[Reaction, ...] = ("ridden through",)
STOPPED: tuple[Reaction, ...] = ("ramped", "ended")
MOVING = ("following_error", "crank_speed", "torque_limit")
"""Monitors that see what a loop does that has lost its hold on the robot."""

TICK = 0.001
"""[s] of `exact_fig7`."""
AT_ONCE = 0.0
"""[s] in the tick of the fault."""
