"""Gains of controllers in the size that a robot needs to answer as the paper's does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stewart_drake.mechanics.dynamics import pose_acceleration_map, task_inertia
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import times


@lru_cache(maxsize=64)
def _input_gain(robot: RobotParameters) -> float:
    """[m/s^2 per N m] geometric mean of the singular values of M^-1 tau at home, angles times characteristic length."""
    volume = abs(float(np.linalg.det(pose_acceleration_map(robot, robot.home_pose))))
    return float((volume * robot.characteristic_length**3) ** (1.0 / 6.0))


@lru_cache(maxsize=64)
def _crank_inertia(robot: RobotParameters) -> float:
    """[kg m^2] what heave at home moves, as felt at each crank: M / sum J^2 with J = d(theta)/dZ."""
    heave = task_inertia(robot, robot.home_pose)[5, 5]
    return float(heave / np.sum(twist_jacobian(robot, robot.home_pose)[:, 5] ** 2))


POSE_WEIGHT, RATE_WEIGHT, INTEGRAL_WEIGHT = (times(_input_gain, -2.0, slower) for slower in (4.0, 2.0, 6.0))
"""Of errors against torques, for poles at the same place; a natural frequency is the fourth root of the first."""
PROPORTIONAL, INTEGRAL, DERIVATIVE = (times(_crank_inertia, 1.0, slower) for slower in (2.0, 3.0, 1.0))
"""Of a crank's error, for the same natural frequency of heave."""
FREQUENCY = times(lambda _: 1.0, slower=1.0)
"""The same for every robot."""
