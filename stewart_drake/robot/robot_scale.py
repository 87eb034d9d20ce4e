"""Defaults that depend on the robot: lengths, torques and gains, scaled from the paper's robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.config import Section
from stewart_drake.robot.robot_parameters import RobotParameters

PAPER = RobotParameters()
LATENCY = 0.005
"""[s] Largest sum of control period and command delay for the default gains; at their natural frequency of about
66 rad/s this is a third of a radian of phase. With a longer latency, gains are reduced in proportion."""
_OF_MODEL = ("controller", "tuner", "estimator", "safety")  # Sections scaled by the controller's model of the robot.


class OfRobot(NamedTuple):
    """In `Annotated`: how the default of a field, which is for the paper's robot, is scaled to another robot."""

    value: Callable[[Any, RobotParameters], Any]  # Of the default and the robot.
    null: bool = False  # Whether a null in the file means the default, rather than a missing key.
    slower: float = 0.0  # Power of `LATENCY` / latency, a factor for latencies above `LATENCY`.

    def at(self, default: object, robot: RobotParameters, latency: float) -> Any:
        """The default for a robot whose commands act within a latency [s]."""
        value = self.value(default, robot)
        return value * (LATENCY / latency) ** self.slower if self.slower and latency > LATENCY else value


def defaults_of(
    robot: RobotParameters,
    model: RobotParameters,
    latency: float,
    others: Mapping[str, Mapping[str, object]] | None = None,
) -> Callable[[type[Section], Document], Document | None]:
    """A function that adds the defaults of a robot and a latency [s] to the keys of a section, see `Reading`.

    `model` is the controller's model of the robot. `others`: section -> further defaults, unless one of its keys is
    given.
    """

    def with_defaults(section: type[Section], given: Document) -> Document | None:
        if section is RobotParameters:
            return None
        scaled_to = model if section.section_key in _OF_MODEL else robot
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
    """A default in proportion to a power of a measure of the robot; for `slower` see `OfRobot`.

    Of a tuple, such as an angle and a length, or a pose, only the second half is scaled.
    """

    def value(default: object, robot: RobotParameters) -> Any:
        if robot == PAPER:
            # The scale is 1; this way a scenario is read without compiling a law.
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
