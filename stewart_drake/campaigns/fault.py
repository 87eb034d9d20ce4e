"""Faults of the table: each a change of the scenario, and what is expected of it; they stand in `faults.yaml`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from stewart_drake.campaigns.sized import sized
from stewart_drake.files.yaml_files import parse_yaml
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.safety import SafetyOptions
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.section import Flag, NotNegative, Section, Text, Vector6

Reaction = Literal["refused", "ridden through", "held", "ramped", "ended", "unnoticed"]
"""refused: before the start. ridden through: no monitor tripped, and none had to. unnoticed: none tripped, but the true
pose went farther from the reference than `safety.following_error` allows. held: the last good command
bridged it. ramped: a safe hold, then the end. ended: without one, since the robot could not be held; brakes are all
that is left."""

_FILE: Mapping[str, Any] = parse_yaml(Path(__file__).with_name("faults.yaml").read_text("utf-8"), "faults.yaml")
ONSET: float = _FILE["onset"]
"""[s] when every fault begins."""
DURATION: float = _FILE["duration"]
"""[s] of each run."""
MOTIONS: Mapping[str, Mapping[str, Any]] = _FILE["motions"]

_TICK = 0.001
"""[s] of `exact_fig7`."""
_WITHIN = {
    "at_once": 0.0,
    "deadline": 2 * _TICK,
    "estimator": EncoderOptions.hold_ticks * _TICK,
    "torque_limit": SafetyOptions.torque_limit_time,
    "torque_rate": SafetyOptions.torque_rate_time,
}
"""[s] at_once: in the tick of the fault. deadline: of the safety layer. estimator: it bridges readings that it cannot
believe for so long. Others: time in which that monitor trips."""


class Fault(Section):
    """A row of the table."""

    name: Text
    """Stable name."""
    text: Text
    """One line."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Scenario keys; `reference` is the motion's, whatever they say."""
    expected: tuple[Reaction, ...] = ("ridden through",)
    """Reactions allowed."""
    monitors: tuple[Text, ...] = ()
    """Monitors allowed to trip first; empty where none may."""
    drift: Vector6 | None = None
    """[rad, m] by which the reference wanders off; null for not at all."""
    drift_time: NotNegative = 0.8
    """[s] in which it does."""
    checked: Flag = True
    """Whether the run is checked beforehand, as a user's is."""
    since: NotNegative = ONSET
    """[s] from which it acts; 0 for what is wrong from the start."""
    encoders: dict[str, Any] | None = None
    """Keys of `sensors`, for a loop with encoders and commands a tick late; null for ideal sensors."""
    within: NotNegative | None = None
    """[s] within which a monitor trips, from the limits of the layer alone; null where it takes as long as the motion
    and the robot take to show it."""

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        """The file has a name for the time `within`."""
        return {**data, "within": _WITHIN.get(str(data.get("within")), data.get("within"))}

    def in_motion(self, motion: str, base: Scenario) -> dict[str, Any]:
        """Scenario key -> value for this fault during a motion of `MOTIONS`, in the size of the robot of `base`."""
        reference: Mapping[str, Any] = sized({"reference": MOTIONS[motion]}, base)["reference"]
        if self.drift is not None:
            home = base.robot.home_pose.tolist()
            away = [a + b for a, b in zip(home, LENGTH.value(self.drift, base.robot), strict=True)]
            path = {"kind": "minimum_jerk", "poses": [home, away], "durations": [self.drift_time], "dwell": [ONSET]}
            reference = {"kind": "sum", "parts": [reference, path]}
        changes: dict[str, Any] = {"reference": dict(reference), **sized(self.changes, base)}
        if self.encoders is not None:
            # Commands of a real drive are a tick old; with encoders it has to be shown that the loop bears both.
            changes |= {"sensors": {"kind": "encoders", **self.encoders}, "command_delay": 1}
        return changes


def base(robot: str | None = None, overrides: Sequence[str] = ()) -> Scenario:
    """The exact-model LQI of `exact_fig7` behind the safety layer, as it stands by default.

    Args:
        robot: Name or YAML file; None for the paper's.
        overrides: `key=value` texts, see `load_scenario`.
    """
    named = () if robot is None else (f"robot={robot}",)
    return load_scenario("exact_fig7", (*named, *overrides)).replace({"duration": DURATION, "safety": {}})


FAULTS = tuple(Fault.from_dict({"name": name, **keys}, f"faults.{name}") for name, keys in _FILE["faults"].items())
"""In the order of the table."""
BY_NAME = {fault.name: fault for fault in FAULTS}
