"""Exact rigid-body dynamics of the closed chain in six task coordinates, in closed form over the legs.

Model: platform of Table I, cranks turning about their motors, rods as rigid bodies without spin about their own axes.
Coordinates: twist [w, v] of P in B. M(pose) d(twist)/dt + h(pose, twist) = J' T with J = d(theta)/d(twist). Arrays of
numpy or of any other namespace of the Array API; `dynamics_core` has the same without a check.
"""

from __future__ import annotations

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics import dynamics_core as core
from stewart_drake.mechanics import kinematics_core
from stewart_drake.mechanics.arrays import AnyRobot, Array, arrays_of, as_array, first, in_blocks, last, namespace
from stewart_drake.mechanics.checks import legs_within_reach
from stewart_drake.mechanics.kinematics import LegGeometry

STANDARD_GRAVITY = 9.81
"""[m/s^2] the value of the reference computations and of Drake's default field."""


@in_blocks
def static_torque(robot: AnyRobot, pose: Array, gravity: float = STANDARD_GRAVITY) -> np.ndarray:
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
    pose = as_array(pose)
    return core.static_torque(*legs_within_reach(robot, pose), gravity, masked=False)


def static_torque_of_legs(robot: AnyRobot, legs: LegGeometry, gravity: float) -> np.ndarray:
    """`static_torque` from leg vectors that are already at hand; (..., 6) [N m]."""
    return core.static_torque(arrays_of(robot, legs.e_l), legs.components(), gravity, masked=False)


@in_blocks
def inverse_dynamics(
    robot: AnyRobot,
    pose: Array,
    pose_rate: Array,
    pose_acceleration: Array,
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
    pose, pose_rate, pose_acceleration = (as_array(value) for value in (pose, pose_rate, pose_acceleration))
    own, legs = legs_within_reach(robot, pose)
    return core.inverse_dynamics(own, legs, pose, pose_rate, pose_acceleration, gravity, masked=False)


@in_blocks
def forward_dynamics(
    robot: AnyRobot,
    pose: Array,
    pose_rate: Array,
    torque: Array,
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
    pose, pose_rate, torque = (as_array(value) for value in (pose, pose_rate, torque))
    for name, value in (("pose_rate", pose_rate), ("torque", torque)):
        if value.shape[-1:] != (6,):
            raise ConfigurationError(name, value, "numbers of shape (..., 6)")
    own, legs = legs_within_reach(robot, pose)
    return core.forward_dynamics(own, legs, pose, pose_rate, torque, gravity, masked=False)


@in_blocks
def task_bias(robot: AnyRobot, pose: Array, twist: np.ndarray, gravity: float = STANDARD_GRAVITY) -> np.ndarray:
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
    pose = as_array(pose)
    return core.task_bias(*legs_within_reach(robot, pose), as_array(twist), gravity, masked=False)


@in_blocks
def task_inertia(robot: AnyRobot, pose: Array) -> np.ndarray:
    """M(pose): inertia of the closed chain as the platform feels it.

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6, 6) [kg m^2, kg m, kg], symmetric positive definite.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = as_array(pose)
    return core.task_inertia(*legs_within_reach(robot, pose), masked=False)


@in_blocks
def pose_acceleration_map(robot: AnyRobot, pose: Array) -> np.ndarray:
    """Second derivative of the pose per unit of motor torque, E^-1 M^-1 J'; the exact counterpart of M^-1 tau in (10).

    Args:
        robot: Geometry and masses.
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.

    Returns:
        (..., 6, 6) [rad/s^2/(N m), m/s^2/(N m)].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = as_array(pose)
    xp, (own, legs) = namespace(pose), legs_within_reach(robot, pose)
    pushed = xp.matrix_transpose(last(xp, kinematics_core.twist_jacobian(own, legs, masked=False), 2))
    rates = xp.moveaxis(xp.linalg.solve(core.task_inertia(own, legs, masked=False), pushed), -2, 0)
    angular = kinematics_core.euler_rates(pose[..., None, :], rates[:3, ...])
    return xp.moveaxis(xp.concat([angular, rates[3:, ...]]), 0, -2)


def euler_acceleration(pose: Array, pose_rate: Array, twist_rate: np.ndarray) -> np.ndarray:
    """Second derivative of the pose from d(twist)/dt; undoes the first step of `inverse_dynamics`.

    Args:
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.
        pose_rate: (..., 6) [rad/s, m/s].
        twist_rate: (..., 6) [rad/s^2, m/s^2].

    Returns:
        (..., 6) [rad/s^2, m/s^2].
    """
    pose, pose_rate, twist_rate = (as_array(value) for value in (pose, pose_rate, twist_rate))
    xp = namespace(pose, pose_rate, twist_rate)
    changing = first(xp, twist_rate, 1)
    angular = kinematics_core.euler_rates(pose, changing[:3, ...] - kinematics_core.angular_drift(pose, pose_rate))
    return last(xp, xp.concat([angular, changing[3:, ...]]), 1)
