"""Defaults that come from the robot: lengths, torques and gains in the size that they have for the paper's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from stewart_drake.base.config import Section
from stewart_drake.robot.robot_parameters import RobotParameters

PAPER = RobotParameters()
LATENCY = 0.005
"""[s] of a control period and the delay of a command, up to which the defaults of gains hold; their natural frequency
of some 66 rad/s is then a third of a radian of phase. For a longer one they are as much slower."""
_BELIEVED = ("controller", "tuner", "estimator", "safety")
"""Sections scaled by the controller's model of the robot."""


class OfRobot(NamedTuple):
    """In `Annotated`: how the default of a field, which is for the paper's robot, is scaled to another robot."""

    value: Callable[[Any, RobotParameters], Any]
    null: bool = False
    """Whether a null in the file asks for it, rather than the key's absence."""
    slower: float = 0.0
    """Power of `LATENCY` / latency with which it falls where commands act later than `LATENCY`."""

    def at(self, default: Any, robot: RobotParameters, latency: float) -> Any:
        """The default for a robot whose commands act within a latency [s]."""
        value = self.value(default, robot)
        return value * (LATENCY / latency) ** self.slower if self.slower and latency > LATENCY else value


def defaults_of(
    robot: RobotParameters,
    believed: RobotParameters,
    latency: float,
    others: Mapping[str, Mapping[str, Any]] | None = None,
) -> Callable[[type[Section], dict[str, Any]], dict[str, Any] | None]:
    """How sections get the defaults of a robot whose commands act within a latency [s], see `Reading`.

    `others`: name of a section -> what it has unless one of these keys is given.
    """

    def with_defaults(section: type[Section], given: dict[str, Any]) -> dict[str, Any] | None:
        if section is RobotParameters:
            return None
        scaled_to = believed if section.section_key in _BELIEVED else robot
        more = (others or {}).get(section.section_key, {})
        if not given.keys() & more.keys() and more.keys() <= section.__pydantic_fields__.keys():
            given = {**given, **more}
        return given | {
            name: marker.at(field.default, scaled_to, latency)
            for name, field in section.__pydantic_fields__.items()
            for marker in field.metadata
            if isinstance(marker, OfRobot) and given.get(name, ...) is (None if marker.null else ...)
        }

    return with_defaults


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
        return (*default[:half], *(number * scale for number in default[half:]))

    return OfRobot(value, slower=slower)


LENGTH = times(lambda robot: robot.characteristic_length)
TORQUE = times(lambda robot: robot.effort_limit)
HOME_POSE = OfRobot(lambda _, robot: tuple(robot.home_pose.tolist()))
CHARACTERISTIC_LENGTH = OfRobot(lambda _, robot: robot.characteristic_length, null=True)
