"""Defaults that come from the robot: lengths, torques and gains in the size that they have for the paper's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from stewart_drake.config import Section, to_plain
from stewart_drake.families import Family, given_again
from stewart_drake.robot.robot_parameters import RobotParameters

PAPER = RobotParameters()
LATENCY = 0.005
"""[s] of a control period and the delay of a command, up to which the defaults of gains hold; their natural frequency
of some 66 rad/s is then a third of a radian of phase. For a longer one they are as much slower."""


@dataclass(frozen=True)
class OfRobot:
    """In `Annotated`, beside a field whose default is for the paper's robot: what it is for another one.

    `Scenario` puts it in where the key is absent, so that files and messages have the number itself.
    """

    value: Callable[[Any, RobotParameters], Any]
    null: bool = False
    """Whether a null in the file asks for it, rather than the key's absence."""
    slower: float = 0.0
    """Power of `LATENCY` / latency with which it falls where commands act later than `LATENCY`."""

    def at(self, default: Any, robot: RobotParameters, latency: float) -> Any:
        """The default for a robot whose commands act within a latency [s]."""
        value = self.value(default, robot)
        return value * (LATENCY / latency) ** self.slower if self.slower and latency > LATENCY else value


def times(measure: Callable[[RobotParameters], float], power: float = 1.0, slower: float = 0.0) -> OfRobot:
    """A default that grows with a measure of the robot; for `slower` see `OfRobot`.

    Of two numbers, the first an angle, the second grows; of a pose its last three do.
    """

    def value(default: Any, robot: RobotParameters) -> Any:
        if robot == PAPER:
            # It would be 1 to the last bit; a scenario is read without compiling a law.
            return default
        scale = (measure(robot) / measure(PAPER)) ** power
        if not isinstance(default, tuple):
            return default * scale
        half = len(default) // 2
        return (*default[:half], *(each * scale for each in default[half:]))

    return OfRobot(value, slower=slower)


LENGTH = times(lambda robot: robot.characteristic_length)
TORQUE = times(lambda robot: robot.effort_limit)
HOME_POSE = OfRobot(lambda _, robot: tuple(robot.home_pose.tolist()))
CHARACTERISTIC_LENGTH = OfRobot(lambda _, robot: robot.characteristic_length, null=True)


def fill(
    section: Any,
    data: Any,
    robot: RobotParameters,
    families: Mapping[str, Family] | None = None,
    latency: float = 0.0,
) -> Any:
    """The keys of a section with those defaults that this robot has otherwise than the paper's; or `data` itself.

    In a section made in Python a value that is the class's default counts as absent. `families` are keys at which
    sections of a family stand in it, alone or in a list; commands act within `latency` [s].
    """
    if section is None or not isinstance(data, (Mapping, Section)):
        return data
    found: dict[str, Any] = {}
    for name, field in section.__pydantic_fields__.items():
        given = data.get(name, ...) if isinstance(data, Mapping) else getattr(data, name)
        if (marker := _marker(field)) is not None:
            unsaid = given is ... or (isinstance(data, Section) and given == field.default)
            value = marker.at(field.default, robot, latency)
            if (given is None if marker.null else unsaid) and (marker.null or value != field.default):
                found[name] = to_plain(value)
        elif families and name in families:
            parts = given if (many := isinstance(given, (list, tuple))) else [given]
            written = [families[name].spelled(each) for each in parts]
            made = [fill(families[name].section_of(each), each, robot, families) for each in written]
            if any(new is not old for new, old in zip(made, parts, strict=True)):
                found[name] = made if many else made[0]
    return {**(given_again(data) if isinstance(data, Section) else data), **found} if found else data


def without_own(
    section: Section, data: Mapping[str, Any], robot: RobotParameters, latency: float = 0.0
) -> dict[str, Any]:
    """The plain keys and values `data` of a section, without those that are but defaults of this robot and latency."""
    kept = dict(data)
    for name, field in section.__pydantic_fields__.items():
        marker = _marker(field)
        if marker is not None and getattr(section, name) == marker.at(field.default, robot, latency):
            del kept[name]
            if marker.null:
                kept[name] = None
    return kept


def _marker(field: Any) -> OfRobot | None:
    return next((each for each in field.metadata if isinstance(each, OfRobot)), None)
