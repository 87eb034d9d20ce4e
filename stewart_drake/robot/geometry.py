"""Checks of a robot's geometry: the order of its joints, and its home pose.

Messages name the leg, the number and the likely mistake: millimetres, a mirrored axis, swapped joints.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.robot.leg import DIRECTION_TOLERANCE, LARGEST_SIZE, LEG_COUNT, crank_angles, crank_equation
from stewart_drake.robot.symmetry import doubts, regular

if TYPE_CHECKING:
    from stewart_drake.robot.robot_parameters import RobotParameters

_SLACK = 1e-6  # [rad] Tolerance of the order of joints, for joints that coincide.


def check_geometry(robot: RobotParameters) -> None:
    """Refuses directions that are not perpendicular, joints out of order, and a home pose that is not reachable."""
    for leg, parameters in enumerate(robot.legs or ()):
        quarter = parameters.crank_quarter_direction or (0.0, 0.0, 1.0)
        if abs(np.dot(robot.crank_zero_directions[leg], quarter)) > DIRECTION_TOLERANCE:
            allowed = "a direction perpendicular to crank_zero_direction"
            raise ConfigurationError(f"robot.legs.{leg}.crank_quarter_direction", quarter, allowed)
    check_order(robot.shaft_positions, robot.joints_in_platform)
    _check_home(robot)


def check_order(shafts: np.ndarray, joints: np.ndarray) -> None:
    """Refuses platform joints (6, 3) that are not in the order of the shafts (6, 3) around z."""
    x, y = np.moveaxis(np.stack([shafts, joints]) - np.stack([shafts, joints]).mean(axis=1, keepdims=True), -1, 0)[:2]
    around = np.arctan2(y, x)
    order = np.argsort(around[0], kind="stable")
    following = np.roll(order, -1)
    steps = wrapped(around[:, following] - around[:, order])
    wrong = (steps[0] > _SLACK) & (steps[1] < -_SLACK)
    if wrong.sum() >= LEG_COUNT - 1:
        allowed = "joints in the same order around z as the shafts; the order is reversed: is an axis of P mirrored?"
        raise ConfigurationError("robot.legs.0.platform_joint", joints[0].tolist(), allowed)
    if wrong.any():
        one, other = sorted((int(order[wrong][0]), int(following[wrong][0])))
        allowed, swapped = f"a joint [m] that is not beyond leg {other}'s", [(one, other)]
        if doubts(shafts, joints):  # Legs have a pattern: joints are swapped if an exchange restores it.
            swapped = [pair for pair in combinations(range(LEG_COUNT), 2) if _restored(shafts, joints, pair)]
        allowed += "; are the joints of legs {} and {} swapped?".format(*swapped[0]) if swapped else ""
        raise ConfigurationError(f"robot.legs.{one}.platform_joint", joints[one].tolist(), allowed)


def _restored(shafts: np.ndarray, joints: np.ndarray, pair: tuple[int, int]) -> bool:
    """Whether all legs have one pattern once the joints of a pair of them are exchanged."""
    exchanged = joints.copy()
    exchanged[list(pair)] = joints[list(pair[::-1])]
    return regular(shafts, exchanged)


def _check_home(robot: RobotParameters) -> None:
    """Refuses a robot whose legs do not close at home, or only beyond their stops: it has no SDF."""
    span = robot.joints_in_platform + [0.0, 0.0, robot.home_height] - robot.shaft_positions
    directions = robot.crank_zero_directions, robot.crank_quarter_directions
    along, up, constant = crank_equation(span, *directions, robot.crank_lengths, robot.rod_lengths)
    size = np.hypot(along, up)
    margin = 1.0 - np.divide(np.abs(constant), size, out=np.full(LEG_COUNT, np.inf), where=size > 0.0)
    if not margin.min() > 0.0:
        leg = int(margin.argmin())
        allowed = (
            f"a height at which leg {leg} can be assembled: its joint is {np.linalg.norm(span[leg]):.4g} m from its "
            f"shaft, its crank {robot.crank_lengths[leg]:g} m and its rod {robot.rod_lengths[leg]:g} m long "
            f"(margin {margin[leg]:.3g}); are all lengths in metres?"
        )
        raise ConfigurationError("robot.home_height", robot.home_height, allowed)
    theta = crank_angles(along, up, constant, robot.branches)
    low, high = np.clip(robot.crank_angle_ranges, -LARGEST_SIZE, LARGEST_SIZE).T
    beyond = np.abs(wrapped(theta - 0.5 * (low + high))) > 0.5 * (high - low)
    if beyond.any():
        leg = int(beyond.argmax())
        allowed = f"a range that contains the angle at home, {theta[leg]:.4g} rad"
        raise ConfigurationError(f"robot.legs.{leg}.crank_angle_range", (float(low[leg]), float(high[leg])), allowed)


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles within half a turn of zero."""
    return np.asarray(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi)
