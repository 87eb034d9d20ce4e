"""What a robot's geometry must be for it to stand at home; messages name leg, number, and what was perhaps meant."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.robot.leg import LARGEST, LEGS, PARALLEL, crank_equation

if TYPE_CHECKING:
    from stewart_drake.robot.robot_parameters import RobotParameters

_HUGE = 30.0
"""[m] no leg is larger: such a number is in millimetres."""
_SLACK = 1e-6
"""[rad] by which directions of joints that meet in one point may seem out of order."""


def check_geometry(robot: RobotParameters) -> None:
    """Refuses directions that are not perpendicular unit vectors, lengths that no leg has, and a home that is none."""
    for leg, own in enumerate(robot.legs or ()):
        for name in ("crank_zero_direction", "crank_quarter_direction"):
            given = getattr(own, name)
            if given is not None and abs(math.hypot(*given) - 1.0) > PARALLEL:
                allowed = f"a vector of length 1, not {math.hypot(*given):.4g}"
                raise ConfigurationError(f"robot.legs.{leg}.{name}", given, allowed)
        quarter = own.crank_quarter_direction or (0.0, 0.0, 1.0)
        if abs(np.dot(robot.crank_zero_directions[leg], quarter)) > PARALLEL:
            allowed = "a direction at a right angle to crank_zero_direction"
            raise ConfigurationError(f"robot.legs.{leg}.crank_quarter_direction", quarter, allowed)
    for name, lengths in _sizes(robot).items():
        leg = int(lengths.argmax())
        given = getattr(robot.legs[leg], name) if robot.legs is not None else None
        if lengths[leg] > _HUGE and (given is not None or name.endswith("length")):
            allowed = f"at most {_HUGE:g} m; millimetres? {lengths[leg]:g} mm would be {lengths[leg] / 1e3:g} m"
            key = f"robot.{name}" if given is None else f"robot.legs.{leg}.{name}"
            raise ConfigurationError(key, getattr(robot, name) if given is None else given, allowed)
    check_order(robot.shaft_positions, robot.platform_joints)
    _check_home(robot)


def check_order(shafts: np.ndarray, joints: np.ndarray) -> None:
    """Refuses platform joints (6, 3) that do not follow each other around the platform as the shafts (6, 3) do."""
    x, y = np.moveaxis(np.stack([shafts, joints]) - np.stack([shafts, joints]).mean(axis=1, keepdims=True), -1, 0)[:2]
    around = np.arctan2(y, x)
    order = np.argsort(around[0], kind="stable")
    following = np.roll(order, -1)
    steps = wrapped(around[:, following] - around[:, order])
    wrong = (steps[0] > _SLACK) & (steps[1] < -_SLACK)
    if wrong.sum() >= LEGS - 1:
        allowed = "joints that go round as the shafts do: these go round the other way; is an axis of P mirrored?"
        raise ConfigurationError("robot.legs.0.platform_joint", joints[0].tolist(), allowed)
    if wrong.any():
        one, other = sorted((int(order[wrong][0]), int(following[wrong][0])))
        allowed = f"a joint [m] on its own side of leg {other}'s: are the joints of legs {one} and {other} swapped?"
        raise ConfigurationError(f"robot.legs.{one}.platform_joint", joints[one].tolist(), allowed)


def _check_home(robot: RobotParameters) -> None:
    """Refuses a robot whose legs do not close at home, or only beyond their stops: it has no SDF."""
    span = robot.platform_joints + robot.home_pose[3:] - robot.shaft_positions
    directions = robot.crank_zero_directions.T, robot.crank_quarter_directions.T
    along, up, constant = crank_equation(span.T, *directions, robot.crank_lengths, robot.rod_lengths)
    size = np.hypot(along, up)
    margin = 1.0 - np.divide(np.abs(constant), size, out=np.full(LEGS, np.inf), where=size > 0.0)
    if not margin.min() > 0.0:
        leg = int(margin.argmin())
        sizes = _sizes(robot)
        own = [name for name in sizes if robot.legs is not None and getattr(robot.legs[leg], name) is not None]
        # One number of its own is the likely cause; more of them say no more than the height.
        key, what, given = "home_height", "a height", robot.home_height
        if robot.legs is not None and len(own) == 1:
            key, what, given = f"legs.{leg}.{own[0]}", "a value", getattr(robot.legs[leg], own[0])
        allowed = (
            f"{what} with which leg {leg} closes at home: its joint is {np.linalg.norm(span[leg]):.4g} m from its "
            f"shaft, its crank {robot.crank_lengths[leg]:g} m and its rod {robot.rod_lengths[leg]:g} m long "
            f"(margin {margin[leg]:.3g})"
        )
        lengths = {name: float(each[leg]) for name, each in sizes.items()} | {"home_height": abs(robot.home_height)}
        raise ConfigurationError(f"robot.{key}", given, allowed + _meant(lengths))
    theta = np.arctan2(up, along) + robot.branches * np.arccos(constant / size)
    low, high = np.clip(robot.crank_angle_ranges, -LARGEST, LARGEST).T
    beyond = np.abs(wrapped(theta - 0.5 * (low + high))) > 0.5 * (high - low)
    if beyond.any():
        leg = int(beyond.argmax())
        allowed = f"a range that holds the angle at home, {theta[leg]:.4g} rad"
        raise ConfigurationError(f"robot.legs.{leg}.crank_angle_range", (float(low[leg]), float(high[leg])), allowed)


def _sizes(robot: RobotParameters) -> dict[str, np.ndarray]:
    """(6,) [m] of what each leg may have of its own."""
    return {
        "rod_length": robot.rod_lengths,
        "crank_length": robot.crank_lengths,
        "shaft_position": np.linalg.norm(robot.shaft_positions, axis=-1),
        "platform_joint": np.linalg.norm(robot.platform_joints, axis=-1),
    }


def _meant(lengths: dict[str, float]) -> str:
    """What was perhaps meant by lengths of a leg that does not close; the middle one of five tells what is usual."""
    usual = float(np.median(list(lengths.values())))
    large = [name for name, size in lengths.items() if size > 100.0 * usual]
    small = [name for name, size in lengths.items() if 100.0 * size < usual]
    if large:
        return f"; is {' or '.join(large)} in millimetres?"
    return f"; are all but {' and '.join(small)} in millimetres?" if small else ""


def wrapped(angle: Any) -> Any:
    """Angles within half a turn of zero."""
    return np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi
