"""Exact rigid-body dynamics of the closed chain in six task coordinates, in closed form over the legs.

Model: platform of Table I, cranks turning about their motors, rods as rigid bodies without spin about their own axes.
Coordinates: twist [w, v] of P in B. M(pose) d(twist)/dt + h(pose, twist) = J' T with J = d(theta)/d(twist).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import (
    LegGeometry,
    cross,
    euler_rate_matrix,
    euler_rate_matrix_dot,
    leg_geometry,
    pose_rate_to_twist,
    rod_lines,
    twist_jacobian,
)
from stewart_drake.robot import RobotParameters

STANDARD_GRAVITY = 9.81
"""[m/s^2] the value of the reference computations and of Drake's default field."""


def static_torque(robot: RobotParameters, pose: ArrayLike, gravity: float = STANDARD_GRAVITY) -> np.ndarray:
    """Motor torques that hold platform, rods and cranks at rest against gravity.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m].
        gravity: [m/s^2] along -z of B.

    Returns:
        (..., 6) [N m].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
        numpy.linalg.LinAlgError: Exactly at a parallel singularity.
    """
    return static_torque_of_legs(robot, leg_geometry(robot, pose), gravity)


def static_torque_of_legs(robot: RobotParameters, legs: LegGeometry, gravity: float) -> np.ndarray:
    """`static_torque` from leg vectors that are already at hand; (..., 6) [N m]."""
    half_rods = 0.5 * robot.rod_mass * gravity
    force_z = robot.platform_mass * gravity + 6.0 * half_rods
    wrench = np.zeros((*legs.arm.shape[:-2], 6))
    # Each platform joint carries half a rod, with the moment (R p_i) x z.
    moment = half_rods * legs.arm.sum(axis=-2) + gravity * (legs.rotation @ robot.platform_moment)
    wrench[..., 0], wrench[..., 1] = moment[..., 1], -moment[..., 0]
    wrench[..., 5] = force_z
    rod_forces = np.linalg.solve(np.swapaxes(rod_lines(legs), -1, -2), wrench[..., None])[..., 0]
    lever = robot.crank_lengths * legs.e_n[..., 2]
    own = (half_rods + 0.5 * robot.crank_mass * gravity) * lever
    return robot.crank_lengths * legs.transmission * rod_forces + own


def inverse_dynamics(
    robot: RobotParameters,
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
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
        numpy.linalg.LinAlgError: Exactly at a parallel singularity.
    """
    pose, pose_rate = np.asarray(pose, dtype=float), np.asarray(pose_rate, dtype=float)
    pose_acceleration = np.asarray(pose_acceleration, dtype=float)
    twist = pose_rate_to_twist(pose, pose_rate)
    twist_rate = pose_rate_to_twist(pose, pose_acceleration)
    drift = euler_rate_matrix_dot(pose[..., :3], pose_rate[..., :3])
    twist_rate[..., :3] += np.einsum("...ij,...j->...i", drift, pose_rate[..., :3])
    legs = leg_geometry(robot, pose)
    wrench, own = _task_wrench(robot, legs, twist, twist_rate, gravity)
    rod_forces = np.linalg.solve(np.swapaxes(rod_lines(legs), -1, -2), wrench[..., None])[..., 0]
    return robot.crank_lengths * legs.transmission * rod_forces + own


def forward_dynamics(
    robot: RobotParameters,
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
        UnreachablePoseError: As in `inverse_kinematics`.
        ConfigurationError: Likewise; rate or torque of another shape.
    """
    pose, pose_rate, torque = (np.asarray(value, dtype=float) for value in (pose, pose_rate, torque))
    for name, value in (("pose_rate", pose_rate), ("torque", torque)):
        if value.shape[-1:] != (6,):
            raise ConfigurationError(name, value, "numbers of shape (..., 6)")
    wrench = np.einsum("...ji,...j->...i", twist_jacobian(robot, pose), torque)
    wrench -= task_bias(robot, pose, pose_rate_to_twist(pose, pose_rate), gravity)
    twist_rate = np.linalg.solve(task_inertia(robot, pose), wrench[..., None])[..., 0]
    return euler_acceleration(pose, pose_rate, twist_rate)


def task_bias(
    robot: RobotParameters, pose: ArrayLike, twist: np.ndarray, gravity: float = STANDARD_GRAVITY
) -> np.ndarray:
    """h(pose, twist): Coriolis, centrifugal, gyroscopic and gravity terms in task coordinates.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m].
        twist: (..., 6) [rad/s, m/s].
        gravity: [m/s^2] along -z of B.

    Returns:
        (..., 6) [N m, N].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose, twist = np.asarray(pose, dtype=float), np.asarray(twist, dtype=float)
    legs = leg_geometry(robot, pose)
    wrench, own = _task_wrench(robot, legs, twist, np.zeros_like(twist), gravity)
    jacobian = rod_lines(legs) / (robot.crank_lengths * legs.transmission)[..., None]
    return wrench + np.einsum("...ji,...j->...i", jacobian, own)


def task_inertia(robot: RobotParameters, pose: ArrayLike) -> np.ndarray:
    """M(pose): inertia of the closed chain as the platform feels it.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6, 6) [kg m^2, kg m, kg], symmetric positive definite.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = np.asarray(pose, dtype=float)
    legs = leg_geometry(robot, pose)
    jacobian = rod_lines(legs) / (robot.crank_lengths * legs.transmission)[..., None]
    joint = np.zeros((*legs.arm.shape[:-1], 3, 6))
    joint[..., 3:] = np.eye(3)
    joint[..., :3] = -_skew(legs.arm)
    tip = (robot.crank_lengths[:, None] * legs.e_n)[..., :, None] * jacobian[..., None, :]
    centre, swing = 0.5 * (joint + tip), (joint - tip) / robot.rod_lengths[:, None, None]
    swing -= legs.e_l[..., :, None] * np.einsum("...i,...ij->...j", legs.e_l, swing)[..., None, :]
    inertia = robot.rod_mass * np.einsum("...lij,...lik->...jk", centre, centre)
    inertia += robot.rod_inertia[0] * np.einsum("...lij,...lik->...jk", swing, swing)
    turning = robot.crank_axis_inertias[:, None] * jacobian
    inertia += np.einsum("...li,...lj->...ij", turning, jacobian)
    inertia[..., :3, :3] += legs.rotation @ robot.platform_inertia_about_origin @ np.swapaxes(legs.rotation, -1, -2)
    inertia[..., 3:, 3:] += robot.platform_mass * np.eye(3)
    moment = _skew(legs.rotation @ robot.platform_moment)
    inertia[..., :3, 3:] += moment
    inertia[..., 3:, :3] -= moment
    return inertia


def pose_acceleration_map(robot: RobotParameters, pose: ArrayLike) -> np.ndarray:
    """Second derivative of the pose per unit of motor torque, E^-1 M^-1 J'; the exact counterpart of M^-1 tau in (10).

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.

    Returns:
        (..., 6, 6) [rad/s^2/(N m), m/s^2/(N m)].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = np.asarray(pose, dtype=float)
    result = np.linalg.solve(task_inertia(robot, pose), np.swapaxes(twist_jacobian(robot, pose), -1, -2))
    result[..., :3, :] = np.linalg.solve(euler_rate_matrix(pose[..., :3]), result[..., :3, :])
    return result


def _task_wrench(
    robot: RobotParameters,
    legs: LegGeometry,
    twist: np.ndarray,
    twist_rate: np.ndarray,
    gravity: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Inertial and gravity loads: the wrench through the platform (..., 6) and the torque at each crank (..., 6)."""
    a, length = robot.crank_lengths, robot.rod_lengths
    omega, alpha = twist[..., None, :3], twist_rate[..., None, :3]
    spin = cross(omega, legs.arm)
    v_joint = twist[..., None, 3:] + spin
    a_joint = twist_rate[..., None, 3:] + cross(alpha, legs.arm) + cross(omega, spin)
    theta_rate = np.sum(legs.e_l * v_joint, axis=-1) / (a * legs.transmission)
    v_tip = legs.e_n * (a * theta_rate)[..., None]
    v_relative = v_joint - v_tip
    centripetal = a * theta_rate**2
    theta_acceleration = (
        np.sum(legs.e_l * a_joint, axis=-1)
        + centripetal * np.sum(legs.e_l * legs.crank, axis=-1)
        + np.sum(v_relative * v_relative, axis=-1) / length
    ) / (a * legs.transmission)
    a_tip = legs.e_n * (a * theta_acceleration)[..., None] - centripetal[..., None] * legs.crank

    half = 0.25 * robot.rod_mass * (a_joint + a_tip)
    half[..., 2] += 0.5 * robot.rod_mass * gravity
    # Rod without spin: angular acceleration e_l x (a_joint - a_tip) / length, its moment as a couple of end forces.
    a_relative = a_joint - a_tip
    across = a_relative - np.sum(a_relative * legs.e_l, axis=-1, keepdims=True) * legs.e_l
    couple = (robot.rod_inertia[0] / length**2)[:, None] * across
    at_joint, at_tip = half + couple, half - couple

    own = (
        robot.crank_axis_inertias * theta_acceleration
        + 0.5 * a * robot.crank_mass * gravity * legs.e_n[..., 2]
        + a * np.sum(legs.e_n * at_tip, axis=-1)
    )
    omega, alpha = twist[..., :3], twist_rate[..., :3]
    inertia = legs.rotation @ robot.platform_inertia_about_origin @ np.swapaxes(legs.rotation, -1, -2)
    momentum = np.einsum("...ij,...j->...i", inertia, omega)
    moment = np.einsum("...ij,...j->...i", inertia, alpha) + cross(omega, momentum)
    first = legs.rotation @ robot.platform_moment
    lifted = twist_rate[..., 3:] + np.array([0.0, 0.0, gravity])
    force = robot.platform_mass * lifted + cross(alpha, first) + cross(omega, cross(omega, first))
    wrench = np.concatenate([moment + cross(first, lifted), force], axis=-1)
    wrench[..., :3] += cross(legs.arm, at_joint).sum(axis=-2)
    wrench[..., 3:] += at_joint.sum(axis=-2)
    return wrench, own


def _skew(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrix whose product with b is the cross product of vectors (..., 3) with b."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)


def euler_acceleration(pose: ArrayLike, pose_rate: ArrayLike, twist_rate: np.ndarray) -> np.ndarray:
    """Second derivative of the pose from d(twist)/dt; undoes the first step of `inverse_dynamics`.

    Args:
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.
        pose_rate: (..., 6) [rad/s, m/s].
        twist_rate: (..., 6) [rad/s^2, m/s^2].

    Returns:
        (..., 6) [rad/s^2, m/s^2].
    """
    pose, pose_rate = np.asarray(pose, dtype=float), np.asarray(pose_rate, dtype=float)
    drift = np.einsum("...ij,...j->...i", euler_rate_matrix_dot(pose[..., :3], pose_rate[..., :3]), pose_rate[..., :3])
    angular = np.linalg.solve(euler_rate_matrix(pose[..., :3]), (twist_rate[..., :3] - drift)[..., None])[..., 0]
    return np.concatenate([angular, twist_rate[..., 3:]], axis=-1)
