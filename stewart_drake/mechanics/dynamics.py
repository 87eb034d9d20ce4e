"""Exact rigid-body dynamics of the closed chain in six task coordinates, for poses with any leading axes.

Model: platform of Table I, cranks turning about their motors, rods as rigid bodies without spin about their own axes.
Coordinates: twist [w, v] of P in B. M(pose) d(twist)/dt + h(pose, twist) = J' T with J = d(theta)/d(twist).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.jit import njit, record
from stewart_drake.mechanics import dynamics_laws as laws
from stewart_drake.mechanics.batch import Robot, at_poses
from stewart_drake.mechanics.kinematics_laws import LEGS, OK, PARALLEL, UNREACHABLE, legs_at

STANDARD_GRAVITY = 9.81
"""[m/s^2] the value of the reference computations and of Drake's default field."""


def static_torque(robot: Robot, pose: ArrayLike, gravity: float = STANDARD_GRAVITY) -> np.ndarray:
    """Motor torques (..., 6) [N m] that hold platform, rods and cranks at rest at poses (..., 6) [rad, m]."""
    still = np.zeros(6)
    return inverse_dynamics(robot, pose, still, still, gravity)


def inverse_dynamics(
    robot: Robot,
    pose: ArrayLike,
    pose_rate: ArrayLike,
    pose_acceleration: ArrayLike,
    gravity: float = STANDARD_GRAVITY,
) -> np.ndarray:
    """Motor torques of a motion, all bodies included.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m].
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity.
        pose_acceleration: (..., 6) [rad/s^2, m/s^2] their time derivatives.
        gravity: [m/s^2] along -z of B.

    Returns:
        (..., 6) [N m].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`; a rate or acceleration of another shape.
        numpy.linalg.LinAlgError: Exactly at a parallel singularity.
    """
    motion = {"pose": pose, "pose_rate": pose_rate, "pose_acceleration": pose_acceleration}
    return at_poses(_motion_torques, robot, motion, (6,), gravity)


def forward_dynamics(
    robot: Robot,
    pose: ArrayLike,
    pose_rate: ArrayLike,
    torque: ArrayLike,
    gravity: float = STANDARD_GRAVITY,
) -> np.ndarray:
    """Acceleration of the platform under motor torques, all bodies included; the inverse of `inverse_dynamics`.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity.
        torque: (..., 6) [N m] of the motors.
        gravity: [m/s^2] along -z of B.

    Returns:
        (..., 6) [rad/s^2, m/s^2] second derivative of the pose.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`; a rate or torque of another shape.
        numpy.linalg.LinAlgError: Exactly at a singularity.
    """
    motion = {"pose": pose, "pose_rate": pose_rate, "torque": torque}
    return at_poses(_forward_dynamics, robot, motion, (6,), gravity)


def task_bias(robot: Robot, pose: ArrayLike, twist: ArrayLike, gravity: float = STANDARD_GRAVITY) -> np.ndarray:
    """h(pose, twist) (..., 6) [N m, N]: Coriolis, centrifugal, gyroscopic and gravity terms in task coordinates."""
    return at_poses(_task_biases, robot, {"pose": pose, "twist": twist}, (6,), gravity)


def task_inertia(robot: Robot, pose: ArrayLike) -> np.ndarray:
    """M(pose) (..., 6, 6) [kg m^2, kg m, kg]: inertia of the closed chain as the platform feels it."""
    return at_poses(_task_inertias, robot, {"pose": pose}, (6, 6))


def pose_acceleration_map(robot: Robot, pose: ArrayLike) -> np.ndarray:
    """E^-1 M^-1 J' (..., 6, 6): second derivative of the pose per unit of motor torque; M^-1 tau of (10), exact."""
    return at_poses(_pose_acceleration_maps, robot, {"pose": pose}, (6, 6))


@njit
def _motion_torques(robots: Any, gravity: float, poses: Any, rates: Any, accelerations: Any, made: Any) -> int:
    robot, store, motion = record(robots), np.empty(1, LEGS), np.empty(12)
    for n in range(len(poses)):
        legs = record(store)
        if legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        motion[:6], motion[6:] = poses[n], rates[n]
        if not laws.motion_torque(robot, legs, motion, accelerations[n], gravity, made[n]):
            return PARALLEL
    return OK


@njit
def _forward_dynamics(robots: Any, gravity: float, poses: Any, rates: Any, torques: Any, made: Any) -> int:
    robot, store, nothing = record(robots), np.empty(1, LEGS), np.zeros(6)
    for n in range(len(poses)):
        legs = record(store)
        if legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        if not laws.forward_dynamics(robot, legs, poses[n], rates[n], torques[n], nothing, gravity, made[n]):
            return PARALLEL
    return OK


@njit
def _task_biases(robots: Any, gravity: float, poses: Any, twists: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        laws.task_bias(robot, legs, twists[n], gravity, made[n])
    return OK


@njit
def _task_inertias(robots: Any, poses: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        laws.task_inertia(robot, legs, made[n])
    return OK


@njit
def _pose_acceleration_maps(robots: Any, poses: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        if not laws.pose_acceleration_map(robot, legs, poses[n], made[n]):
            return PARALLEL
    return OK
