"""Inverse and forward kinematics of the 6-RSS platform, (1)-(6), and their Jacobians.

Poses are [roll, pitch, yaw, X, Y, Z] of P in B; R_BP = Rz(yaw) Ry(pitch) Rx(roll), the inverse of the paper's (3). A
twist is [w, v]: angular velocity of P and velocity of its origin, both in B. All is vectorised over leading axes and
takes arrays of numpy or of any other namespace of the Array API; `kinematics_core` has the same without a check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError, ForwardKinematicsError
from stewart_drake.mechanics import kinematics_core as core
from stewart_drake.mechanics.arrays import (
    AnyRobot,
    Array,
    arrays_of,
    as_array,
    first,
    in_blocks,
    last,
    namespace,
    numbers_like,
    to_numpy,
)
from stewart_drake.mechanics.arrays import cross as cross_of_components
from stewart_drake.mechanics.checks import checked, legs_within_reach, within_reach
from stewart_drake.robot import RobotParameters


def rotation_matrix(rpy: Array) -> np.ndarray:
    """R_BP of roll, pitch, yaw; the inverse of (3).

    Deviation: entry (3,1) of the print is a misprint; this is the matrix that it means.

    Args:
        rpy: (..., 3) [rad].

    Returns:
        (..., 3, 3) [-].
    """
    rpy = as_array(rpy)
    xp = namespace(rpy)
    return xp.matrix_transpose(last(xp, core.rotation(rpy), 2))


def rotation_angle(rotation: Array) -> np.ndarray:
    """Angle (...) [rad] of rotations (..., 3, 3)."""
    xp = namespace(rotation)
    return xp.acos(xp.clip(0.5 * (xp.linalg.trace(rotation) - 1.0), -1.0, 1.0))


def roll_pitch_yaw(matrix: Array) -> np.ndarray:
    """Roll, pitch, yaw of a rotation matrix; pitch in [-pi/2, pi/2].

    Args:
        matrix: (..., 3, 3) [-].

    Returns:
        (..., 3) [rad].
    """
    matrix = as_array(matrix)
    xp = namespace(matrix)
    roll = xp.atan2(matrix[..., 2, 1], matrix[..., 2, 2])
    pitch = xp.asin(xp.clip(-matrix[..., 2, 0], -1.0, 1.0))
    return xp.stack([roll, pitch, xp.atan2(matrix[..., 1, 0], matrix[..., 0, 0])], axis=-1)


def euler_rate_matrix(rpy: Array) -> np.ndarray:
    """E with w_B = E(rpy) d(rpy)/dt.

    Args:
        rpy: (..., 3) [rad].

    Returns:
        (..., 3, 3) [-]; singular at pitch = +-pi/2.
    """
    rpy = as_array(rpy)
    xp = namespace(rpy)
    sp, cp, sy, cy = xp.sin(rpy[..., 1]), xp.cos(rpy[..., 1]), xp.sin(rpy[..., 2]), xp.cos(rpy[..., 2])
    o = xp.zeros_like(sp)
    return _of_entries(xp, (cy * cp, -sy, o, sy * cp, cy, o, -sp, o, o + 1.0))


def euler_rate_matrix_dot(rpy: Array, rpy_rate: Array) -> np.ndarray:
    """Time derivative of `euler_rate_matrix` along `rpy_rate`.

    Args:
        rpy: (..., 3) [rad].
        rpy_rate: (..., 3) [rad/s].

    Returns:
        (..., 3, 3) [1/s].
    """
    rpy, rpy_rate = as_array(rpy), as_array(rpy_rate)
    xp = namespace(rpy, rpy_rate)
    sp, cp, sy, cy = xp.sin(rpy[..., 1]), xp.cos(rpy[..., 1]), xp.sin(rpy[..., 2]), xp.cos(rpy[..., 2])
    pd, yd = rpy_rate[..., 1], rpy_rate[..., 2]
    sink = -cp * pd
    o = xp.zeros_like(sink)
    first_row = -sy * cp * yd - cy * sp * pd, -cy * yd, o
    return _of_entries(xp, (*first_row, cy * cp * yd - sy * sp * pd, -sy * yd, o, sink, o, o))


def _of_entries(xp: Any, entries: tuple[Array, ...]) -> np.ndarray:
    """Matrices (..., 3, 3) of nine entries (...), row by row."""
    matrix: np.ndarray = xp.reshape(xp.stack(entries, axis=-1), (*entries[0].shape, 3, 3))
    return matrix


def pose_rate_to_twist(pose: Array, pose_rate: Array) -> np.ndarray:
    """Twist [w, v] of P in B from the pose's rate.

    Args:
        pose: (..., 6) [rad, m].
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity.

    Returns:
        (..., 6) [rad/s, m/s].
    """
    pose, pose_rate = as_array(pose), as_array(pose_rate)
    xp = namespace(pose, pose_rate)
    return last(xp, core.twist(pose, pose_rate), 1)


def twist_to_pose_rate(pose: Array, twist: Array) -> np.ndarray:
    """Inverse of `pose_rate_to_twist`.

    Args:
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.
        twist: (..., 6) [rad/s, m/s].

    Returns:
        (..., 6) [rad/s, m/s].
    """
    pose, twist = as_array(pose), as_array(twist)
    xp = namespace(pose, twist)
    moving = first(xp, twist, 1)
    return last(xp, xp.concat([core.euler_rates(pose, moving[:3, ...]), moving[3:, ...]]), 1)


@dataclass(frozen=True)
class LegGeometry:
    """Vectors of the six legs at one pose (or many), all in B.

    Attributes:
        rotation: (..., 3, 3) [-] R_BP.
        crank_angles: (..., 6) [rad] theta_i.
        arm: (..., 6, 3) [m] platform joints relative to P: R p_i.
        crank: (..., 6, 3) [-] unit vectors along the cranks.
        e_n: (..., 6, 3) [-] unit vectors along which the crank tips move for growing theta.
        e_l: (..., 6, 3) [-] unit vectors along the rods, from crank tip to platform joint.
        transmission: (..., 6) [-] e_l . e_N; zero where a crank is at its dead centre.
    """

    rotation: np.ndarray
    crank_angles: np.ndarray
    arm: np.ndarray
    crank: np.ndarray
    e_n: np.ndarray
    e_l: np.ndarray
    transmission: np.ndarray

    def components(self) -> core.Legs:
        """The same with components first, as `kinematics_core` takes them; no copy."""
        xp = namespace(self.e_l)
        rotation = first(xp, xp.matrix_transpose(self.rotation), 2)
        arm, crank, e_n, e_l = (first(xp, vector, 2) for vector in (self.arm, self.crank, self.e_n, self.e_l))
        return core.Legs(rotation, arm, crank, e_n, e_l, first(xp, self.transmission, 1))


@in_blocks
def reach_margin(robot: AnyRobot, pose: Array) -> np.ndarray:
    """1 - |C| / sqrt(A^2 + B^2) of each leg; negative where a rod cannot span, zero at a crank's dead centre.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6) [-].
    """
    pose = as_array(pose)
    return last(namespace(pose), core.reach_margin(arrays_of(robot, pose), pose), 1)


@in_blocks
def inverse_kinematics(robot: AnyRobot, pose: Array, branch: int | None = None) -> np.ndarray:
    """Crank angles that put the platform at `pose`; closed form of (1)-(6), see `kinematics_core.cranks_at`.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, rad, rad, m, m, m] roll, pitch, yaw, X, Y, Z of P in B.
        branch: -1 or +1 for all legs; None takes the robot's own.

    Returns:
        (..., 6) [rad] crank angles, wrapped to (-pi, pi].

    Raises:
        UnreachablePoseError: A rod cannot span; `.leg`, `.pose` and `.margin` say which, where and by how much.
        ConfigurationError: A branch other than -1 and +1, or a pose that is not finite or not (..., 6).
    """
    pose = as_array(pose)
    return core.crank_angles(within_reach(core.cranks_at(*checked(robot, pose, branch)), pose))


def leg_geometry(robot: AnyRobot, pose: Array, branch: int | None = None) -> LegGeometry:
    """Directions of cranks and rods at `pose`, Fig. 1.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].
        branch: As in `inverse_kinematics`.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = as_array(pose)
    xp, (own, pose) = namespace(pose), checked(robot, pose, branch)
    legs = core.legs_at(own, pose)
    theta = core.crank_angles(within_reach(legs.cranks, pose))
    arm, crank, e_n, e_l = (last(xp, vector, 2) for vector in (legs.arm, legs.crank, legs.e_n, legs.e_l))
    rotation = xp.matrix_transpose(last(xp, legs.rotation, 2))
    return LegGeometry(rotation, theta, arm, crank, e_n, e_l, last(xp, legs.transmission, 1))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product over the last axis; several times faster than numpy's on small arrays."""
    xp = namespace(a, b)
    return last(xp, cross_of_components(xp, *(xp.moveaxis(each, -1, 0) for each in xp.broadcast_arrays(a, b))), 1)


def rod_lines(legs: LegGeometry) -> np.ndarray:
    """Rows [e_M, e_l] = [(R p_i) x e_l, e_l]: the rods as unit lines in Pluecker coordinates, (14) transposed.

    Returns:
        (..., 6, 6) [m, -], one row per leg.
    """
    return last(namespace(legs.e_l), core.rod_lines(legs.components()), 2)


@in_blocks
def twist_jacobian(robot: AnyRobot, pose: Array) -> np.ndarray:
    """d(theta)/d(twist): crank rates from the twist of P.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6, 6) [-, rad/m]; infinite where a crank is at its dead centre.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = as_array(pose)
    return last(namespace(pose), core.twist_jacobian(*legs_within_reach(robot, pose), masked=False), 2)


@in_blocks
def pose_jacobian(robot: AnyRobot, pose: Array) -> np.ndarray:
    """d(theta)/d(pose): crank rates from the pose's rate (Euler rates).

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6, 6) [-, rad/m].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = as_array(pose)
    return last(namespace(pose), core.pose_jacobian(*legs_within_reach(robot, pose), pose, masked=False), 2)


def crank_rates(robot: AnyRobot, legs: LegGeometry, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates at a pose whose leg vectors are at hand; infinite or NaN at a crank's dead centre.

    Args:
        robot: Geometry.
        legs: `leg_geometry` of `pose`.
        pose: (..., 6) [rad, m].
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity of P.

    Returns:
        (..., 6) [rad/s].
    """
    xp, parts = namespace(legs.e_l), legs.components()
    along_rods = xp.sum(core.rod_lines(parts) * core.twist(pose, pose_rate)[:, None, ...], axis=0)
    return last(xp, along_rods / core.levers(arrays_of(robot, legs.e_l), parts), 1)


def forward_kinematics(
    robot: AnyRobot,
    crank_angles: Array,
    guess: Array | None = None,
    tolerance: float = 1e-13,
    max_iterations: int = 30,
) -> np.ndarray:
    """Pose of the platform from the crank angles, by Newton's method on the six rod lengths.

    The assembly mode found is the one nearest to the guess in Newton's sense.

    Args:
        robot: Geometry.
        crank_angles: (..., 6) [rad].
        guess: (..., 6) [rad, m] where to start, in the namespace of the angles or numbers of numpy or of lists; None
            starts at the home pose of a `RobotParameters`.
        tolerance: [m] largest rod-length error accepted.
        max_iterations: Newton steps at most.

    Returns:
        (..., 6) [rad, m].

    Raises:
        ForwardKinematicsError: No convergence, or a singular Jacobian on the way.
        ConfigurationError: Wrong shape, or not finite; no guess for a robot that is arrays.
    """
    theta = as_array(crank_angles)
    xp, own = namespace(theta), arrays_of(robot, theta)
    if theta.ndim < 1 or theta.shape[-1] != 6 or not bool(xp.all(xp.isfinite(theta))):
        raise ConfigurationError("crank_angles", theta, "finite numbers of shape (..., 6)")
    start = as_array(robot.home_pose if guess is None and isinstance(robot, RobotParameters) else guess)
    if isinstance(start, np.ndarray):
        start = numbers_like(start, theta)
    if start.shape[-1:] != (6,) or not bool(xp.all(xp.isfinite(start))):
        raise ConfigurationError("guess", start, "finite numbers of shape (..., 6)")
    try:
        pose = xp.broadcast_to(start, theta.shape)
    except (ValueError, RuntimeError):
        allowed = f"finite numbers whose shape fits that of crank_angles, {tuple(theta.shape)}"
        raise ConfigurationError("guess", start, allowed) from None
    worst = np.inf
    for iteration in range(max_iterations + 1):
        rows, error = core.rod_errors(own, theta, pose)
        worst = float(to_numpy(xp.max(xp.abs(error)))) if 0 not in error.shape else 0.0
        if worst <= tolerance:
            return pose
        if iteration == max_iterations or not np.isfinite(worst):
            break
        try:
            pose = core.newton_step(rows, error, pose, masked=False)
        except (np.linalg.LinAlgError, RuntimeError):
            break
    raise ForwardKinematicsError(worst, iteration)


def conditioning(robot: RobotParameters, pose: Array) -> np.ndarray:
    """sigma_min / sigma_max of [e_M / length; e_l] of (14), rotations scaled by the characteristic length.

    Zero at a parallel singularity; it says nothing about dead centres (see `LegGeometry.transmission`).

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (...) [-].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    return line_conditioning(robot, leg_geometry(robot, pose))


def line_conditioning(robot: RobotParameters, legs: LegGeometry) -> np.ndarray:
    """`conditioning` from leg vectors that are already at hand; (...) [-]."""
    xp, parts = namespace(legs.e_l), legs.components()
    lines = xp.concat([cross_of_components(xp, parts.arm, parts.e_l) / robot.characteristic_length, parts.e_l])
    sigma = xp.linalg.svdvals(last(xp, lines, 2))
    return sigma[..., -1] / sigma[..., 0]
