"""What a robot's geometry must be for it to stand at home; messages name leg, number, and what was perhaps meant."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.robot.leg import LARGEST, LEGS, PARALLEL, crank_equation

if TYPE_CHECKING:
    from stewart_drake.robot.robot_parameters import RobotParameters

_HUGE = 30.0
"""[m] no leg is larger: such a number is in millimetres."""
_LENGTHS = ("rod_length", "crank_length", "shaft_position", "platform_joint")
_SLACK = 1e-6
"""[rad] by which directions of joints that meet in one point may seem out of order."""


def check_directions(robot: RobotParameters) -> None:
    """Refuses cranks' directions that are not perpendicular unit vectors."""
    for leg, own in enumerate(robot.legs or ()):
        for name in ("crank_zero_direction", "crank_quarter_direction"):
            given = getattr(own, name)
            if given is not None and abs(math.hypot(*given) - 1.0) > PARALLEL:
                allowed = f"a vector of length 1, not {math.hypot(*given):.4g}"
                raise ConfigurationError(f"robot.legs.{leg}.{name}", given, allowed)
        quarter = (0.0, 0.0, 1.0) if own.crank_quarter_direction is None else own.crank_quarter_direction
        if abs(np.dot(robot.crank_zero_directions[leg], quarter)) > PARALLEL:
            allowed = "a direction at a right angle to crank_zero_direction"
            raise ConfigurationError(f"robot.legs.{leg}.crank_quarter_direction", quarter, allowed)


def check_order(shafts: np.ndarray, joints: np.ndarray) -> None:
    """Refuses platform joints (6, 3) that do not follow each other around the platform as the shafts (6, 3) do."""
    around = []
    for points in (shafts, joints):
        x, y = (points[:, :2] - points[:, :2].mean(axis=0)).T
        around.append(np.arctan2(y, x))
    order = np.argsort(around[0], kind="stable")
    following = np.roll(order, -1)
    steps = [np.remainder(at[following] - at[order] + math.pi, 2.0 * math.pi) - math.pi for at in around]
    wrong = (steps[0] > _SLACK) & (steps[1] < -_SLACK)
    if wrong.sum() >= LEGS - 1:
        allowed = "joints that go round as the shafts do: these go round the other way; is an axis of P mirrored?"
        raise ConfigurationError("robot.legs.0.platform_joint", joints[0].tolist(), allowed)
    if wrong.any():
        one, other = sorted((int(order[wrong][0]), int(following[wrong][0])))
        allowed = f"a joint [m] on its own side of leg {other}'s: are the joints of legs {one} and {other} swapped?"
        raise ConfigurationError(f"robot.legs.{one}.platform_joint", joints[one].tolist(), allowed)


def check_sizes(robot: RobotParameters) -> None:
    """Refuses lengths of a leg that no leg has."""
    found = {
        "crank_length": robot.crank_lengths,
        "rod_length": robot.rod_lengths,
        "shaft_position": np.linalg.norm(robot.shaft_positions, axis=-1),
        "platform_joint": np.linalg.norm(robot.platform_joints, axis=-1),
    }
    for name, lengths in found.items():
        leg = int(lengths.argmax())
        own = robot.legs is not None and getattr(robot.legs[leg], name) is not None
        if lengths[leg] > _HUGE and (own or name.endswith("length")):
            allowed = f"at most {_HUGE:g} m; millimetres? {lengths[leg]:g} mm would be {lengths[leg] / 1e3:g} m"
            key = f"robot.legs.{leg}.{name}" if own else f"robot.{name}"
            raise ConfigurationError(key, getattr(robot.legs[leg] if own and robot.legs else robot, name), allowed)


def check_home(robot: RobotParameters) -> None:
    """Refuses a robot whose legs do not close at home, or only beyond their stops."""
    span = robot.platform_joints + robot.home_pose[3:] - robot.shaft_positions
    directions = robot.crank_zero_directions.T, robot.crank_quarter_directions.T
    along, up, constant = crank_equation(span.T, *directions, robot.crank_lengths, robot.rod_lengths)
    size = np.hypot(along, up)
    margin = 1.0 - np.divide(np.abs(constant), size, out=np.full(LEGS, np.inf), where=size > 0.0)
    if not margin.min() > 0.0:
        leg = int(margin.argmin())
        distance = float(np.linalg.norm(span[leg]))
        own = [name for name in _LENGTHS if robot.legs is not None and getattr(robot.legs[leg], name) is not None]
        # One number of its own is the likely cause; more of them say no more than the height.
        key, what = (f"legs.{leg}.{own[0]}", "a value") if len(own) == 1 else ("home_height", "a height")
        given = getattr(robot.legs[leg], own[0]) if len(own) == 1 and robot.legs else robot.home_height
        allowed = (
            f"{what} with which leg {leg} closes at home: its joint is {distance:.4g} m from its shaft, its crank "
            f"{robot.crank_lengths[leg]:g} m and its rod {robot.rod_lengths[leg]:g} m long (margin {margin[leg]:.3g})"
        )
        raise ConfigurationError(f"robot.{key}", given, allowed + _meant(robot, leg))
    theta = np.arctan2(up, along) + robot.branches * np.arccos(constant / size)
    low, high = np.clip(robot.crank_angle_ranges, -LARGEST, LARGEST).T
    off = np.remainder(theta - 0.5 * (low + high) + math.pi, 2.0 * math.pi) - math.pi
    if (beyond := np.abs(off) > 0.5 * (high - low)).any():
        leg = int(beyond.argmax())
        allowed = f"a range that holds the angle at home, {theta[leg]:.4g} rad"
        given = float(low[leg]), float(high[leg])
        raise ConfigurationError(f"robot.legs.{leg}.crank_angle_range", given, allowed)


def _meant(robot: RobotParameters, leg: int) -> str:
    """What was perhaps meant by a number of a leg that does not close."""
    sizes = {
        "crank_length": float(robot.crank_lengths[leg]),
        "rod_length": float(robot.rod_lengths[leg]),
        "shaft_position": float(np.linalg.norm(robot.shaft_positions[leg])),
        "platform_joint": float(np.linalg.norm(robot.platform_joints[leg])),
        "home_height": abs(robot.home_height),
    }
    # Of five lengths of one robot the middle one tells what is usual there.
    usual = float(np.median(list(sizes.values())))
    large = [name for name, size in sizes.items() if size > 100.0 * usual]
    small = [name for name, size in sizes.items() if 100.0 * size < usual]
    if large:
        return f"; is {' or '.join(large)} in millimetres?"
    return f"; are all but {' and '.join(small)} in millimetres?" if small else ""
