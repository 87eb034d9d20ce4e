"""One robot as data: six legs, masses, limits; robots by name or file, and what scales with a robot."""

from stewart_drake.robot.gravity import Gravity, base_reading
from stewart_drake.robot.robot_parameters import RobotParameters

__all__ = ["Gravity", "RobotParameters", "base_reading"]
