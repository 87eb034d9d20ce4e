"""Inverse and forward kinematics of the 6-RSS platform, (1)-(6), and their Jacobians.

Poses are [roll, pitch, yaw, X, Y, Z] of P in B; R_BP = Rz(yaw) Ry(pitch) Rx(roll), the inverse of the paper's (3). A
twist is [w, v]: angular velocity of P and velocity of its origin, both in B. All is vectorised over leading axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.errors import ConfigurationError, ForwardKinematicsError, UnreachablePoseError
from stewart_drake.robot import RobotParameters


def rotation_matrix(rpy: ArrayLike) -> np.ndarray:
    """R_BP of roll, pitch, yaw; the inverse of (3).

    Deviation: entry (3,1) of the print is a misprint; this is the matrix that it means.

    Args:
        rpy: (..., 3) [rad].

    Returns:
        (..., 3, 3) [-].
    """
    rpy = np.asarray(rpy, dtype=float)
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(rpy), -1, 0), np.moveaxis(np.cos(rpy), -1, 0)
    matrix = np.empty((*rpy.shape[:-1], 3, 3))
    matrix[..., 0, 0] = cy * cp
    matrix[..., 0, 1] = cy * sp * sr - sy * cr
    matrix[..., 0, 2] = cy * sp * cr + sy * sr
    matrix[..., 1, 0] = sy * cp
    matrix[..., 1, 1] = sy * sp * sr + cy * cr
    matrix[..., 1, 2] = sy * sp * cr - cy * sr
    matrix[..., 2, 0] = -sp
    matrix[..., 2, 1] = cp * sr
    matrix[..., 2, 2] = cp * cr
    return matrix


def rotation_angle(rotation: np.ndarray) -> np.ndarray:
    """Angle (...) [rad] of rotations (..., 3, 3)."""
    return np.arccos(np.clip(0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0), -1.0, 1.0))


def roll_pitch_yaw(matrix: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw of a rotation matrix; pitch in [-pi/2, pi/2].

    Args:
        matrix: (..., 3, 3) [-].

    Returns:
        (..., 3) [rad].
    """
    matrix = np.asarray(matrix, dtype=float)
    return np.stack(
        [
            np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2]),
            np.arcsin(np.clip(-matrix[..., 2, 0], -1.0, 1.0)),
            np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]),
        ],
        axis=-1,
    )


def euler_rate_matrix(rpy: ArrayLike) -> np.ndarray:
    """E with w_B = E(rpy) d(rpy)/dt.

    Args:
        rpy: (..., 3) [rad].

    Returns:
        (..., 3, 3) [-]; singular at pitch = +-pi/2.
    """
    rpy = np.asarray(rpy, dtype=float)
    sp, cp = np.sin(rpy[..., 1]), np.cos(rpy[..., 1])
    sy, cy = np.sin(rpy[..., 2]), np.cos(rpy[..., 2])
    matrix = np.zeros((*rpy.shape[:-1], 3, 3))
    matrix[..., 0, 0] = cy * cp
    matrix[..., 0, 1] = -sy
    matrix[..., 1, 0] = sy * cp
    matrix[..., 1, 1] = cy
    matrix[..., 2, 0] = -sp
    matrix[..., 2, 2] = 1.0
    return matrix


def euler_rate_matrix_dot(rpy: np.ndarray, rpy_rate: np.ndarray) -> np.ndarray:
    """Time derivative of `euler_rate_matrix` along `rpy_rate`.

    Args:
        rpy: (..., 3) [rad].
        rpy_rate: (..., 3) [rad/s].

    Returns:
        (..., 3, 3) [1/s].
    """
    rpy, rpy_rate = np.asarray(rpy, dtype=float), np.asarray(rpy_rate, dtype=float)
    sp, cp = np.sin(rpy[..., 1]), np.cos(rpy[..., 1])
    sy, cy = np.sin(rpy[..., 2]), np.cos(rpy[..., 2])
    pd, yd = rpy_rate[..., 1], rpy_rate[..., 2]
    matrix = np.zeros((*rpy.shape[:-1], 3, 3))
    matrix[..., 0, 0] = -sy * cp * yd - cy * sp * pd
    matrix[..., 0, 1] = -cy * yd
    matrix[..., 1, 0] = cy * cp * yd - sy * sp * pd
    matrix[..., 1, 1] = -sy * yd
    matrix[..., 2, 0] = -cp * pd
    return matrix


def pose_rate_to_twist(pose: ArrayLike, pose_rate: ArrayLike) -> np.ndarray:
    """Twist [w, v] of P in B from the pose's rate.

    Args:
        pose: (..., 6) [rad, m].
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity.

    Returns:
        (..., 6) [rad/s, m/s].
    """
    pose, pose_rate = np.asarray(pose, dtype=float), np.asarray(pose_rate, dtype=float)
    omega = np.einsum("...ij,...j->...i", euler_rate_matrix(pose[..., :3]), pose_rate[..., :3])
    return np.concatenate([omega, pose_rate[..., 3:]], axis=-1)


def twist_to_pose_rate(pose: ArrayLike, twist: ArrayLike) -> np.ndarray:
    """Inverse of `pose_rate_to_twist`.

    Args:
        pose: (..., 6) [rad, m]; pitch away from +-pi/2.
        twist: (..., 6) [rad/s, m/s].

    Returns:
        (..., 6) [rad/s, m/s].
    """
    pose, twist = np.asarray(pose, dtype=float), np.asarray(twist, dtype=float)
    rates = np.linalg.solve(euler_rate_matrix(pose[..., :3]), twist[..., :3, None])[..., 0]
    return np.concatenate([rates, twist[..., 3:]], axis=-1)


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


def _spans(robot: RobotParameters, pose: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R (..., 3, 3), R p_i and d_i = R p_i + G - P_i, both (..., 6, 3) [m]; (2)."""
    pose = np.asarray(pose, dtype=float)
    rotation = rotation_matrix(pose[..., :3])
    arm = robot.platform_joints @ np.swapaxes(rotation, -1, -2)
    return rotation, arm, arm + pose[..., None, 3:] - robot.shaft_positions


def reach_margin(robot: RobotParameters, pose: ArrayLike) -> np.ndarray:
    """1 - |C| / sqrt(A^2 + B^2) of each leg; negative where a rod cannot span, zero at a crank's dead centre.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6) [-].
    """
    return robot.reach_margin(_spans(robot, pose)[2])


def inverse_kinematics(robot: RobotParameters, pose: ArrayLike, branch: int | None = None) -> np.ndarray:
    """Crank angles that put the platform at `pose`; closed form of (1)-(6).

    Deviation: (5) rotates G as well, a misplaced bracket; (6) gives one branch in degrees without A, B, C. Here
    theta_i = atan2(B, A) + branch * acos(C / sqrt(A^2 + B^2)).

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, rad, rad, m, m, m] roll, pitch, yaw, X, Y, Z of P in B.
        branch: -1 or +1; None takes the robot's own.

    Returns:
        (..., 6) [rad] crank angles, wrapped to (-pi, pi].

    Raises:
        UnreachablePoseError: A rod cannot span; `.leg`, `.pose` and `.margin` say which, where and by how much.
        ConfigurationError: A branch other than -1 and +1, or a pose that is not finite or not (..., 6).
    """
    return _solve_cranks(robot, pose, branch)[0]


def leg_geometry(robot: RobotParameters, pose: ArrayLike, branch: int | None = None) -> LegGeometry:
    """Directions of cranks and rods at `pose`, Fig. 1.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].
        branch: As in `inverse_kinematics`.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    theta, rotation, arm, span = _solve_cranks(robot, pose, branch)
    cosine, sine = np.cos(theta)[..., None], np.sin(theta)[..., None]
    h, quarter = robot.crank_zero_directions, robot.crank_quarter_directions
    crank, e_n = cosine * h + sine * quarter, cosine * quarter - sine * h
    e_l = (span - robot.crank_lengths[:, None] * crank) / robot.rod_lengths[:, None]
    return LegGeometry(rotation, theta, arm, crank, e_n, e_l, np.sum(e_l * e_n, axis=-1))


def _solve_cranks(
    robot: RobotParameters, pose: ArrayLike, branch: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    pose = np.asarray(pose, dtype=float)
    if pose.ndim < 1 or pose.shape[-1] != 6 or not np.isfinite(pose).all():
        raise ConfigurationError("pose", pose, "finite numbers of shape (..., 6)")
    if branch not in (None, -1, 1):
        raise ConfigurationError("branch", branch, "-1 or 1, or None")
    signs = robot.branches if branch is None else branch
    rotation, arm, span = _spans(robot, pose)
    along, up, ratio = robot.crank_equation(span)
    size = np.abs(ratio)
    if not size.max(initial=0.0) <= 1.0:
        worst = np.unravel_index(int(size.argmax()), size.shape)
        raise UnreachablePoseError(np.array(pose[worst[:-1]]), int(worst[-1]), float(1.0 - size[worst]))
    theta = np.arctan2(up, along) + signs * np.arccos(ratio)
    return np.arctan2(np.sin(theta), np.cos(theta)), rotation, arm, span


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product over the last axis; several times faster than numpy's on small arrays."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def rod_lines(legs: LegGeometry) -> np.ndarray:
    """Rows [e_M, e_l] = [(R p_i) x e_l, e_l]: the rods as unit lines in Pluecker coordinates, (14) transposed.

    Returns:
        (..., 6, 6) [m, -], one row per leg.
    """
    return np.concatenate([cross(legs.arm, legs.e_l), legs.e_l], axis=-1)


def twist_jacobian(robot: RobotParameters, pose: ArrayLike) -> np.ndarray:
    """d(theta)/d(twist): crank rates from the twist of P.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6, 6) [-, rad/m]; infinite where a crank is at its dead centre.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    legs = leg_geometry(robot, pose)
    return rod_lines(legs) / (robot.crank_lengths * legs.transmission)[..., None]


def pose_jacobian(robot: RobotParameters, pose: ArrayLike) -> np.ndarray:
    """d(theta)/d(pose): crank rates from the pose's rate (Euler rates).

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].

    Returns:
        (..., 6, 6) [-, rad/m].

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    pose = np.asarray(pose, dtype=float)
    jacobian = twist_jacobian(robot, pose)
    jacobian[..., :3] = jacobian[..., :3] @ euler_rate_matrix(pose[..., :3])
    return jacobian


def crank_rates(robot: RobotParameters, legs: LegGeometry, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates at a pose whose leg vectors are at hand; infinite or NaN at a crank's dead centre.

    Args:
        robot: Geometry.
        legs: `leg_geometry` of `pose`.
        pose: (..., 6) [rad, m].
        pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity of P.

    Returns:
        (..., 6) [rad/s].
    """
    along_rods = np.einsum("...ij,...j->...i", rod_lines(legs), pose_rate_to_twist(pose, pose_rate))
    return along_rods / (robot.crank_lengths * legs.transmission)


def forward_kinematics(
    robot: RobotParameters,
    crank_angles: ArrayLike,
    guess: ArrayLike | None = None,
    tolerance: float = 1e-13,
    max_iterations: int = 30,
) -> np.ndarray:
    """Pose of the platform from the crank angles, by Newton's method on the six rod lengths.

    The assembly mode found is the one nearest to the guess in Newton's sense.

    Args:
        robot: Geometry.
        crank_angles: (..., 6) [rad].
        guess: (..., 6) [rad, m] where to start; None starts at home.
        tolerance: [m] largest rod-length error accepted.
        max_iterations: Newton steps at most.

    Returns:
        (..., 6) [rad, m].

    Raises:
        ForwardKinematicsError: No convergence, or a singular Jacobian on the way.
        ConfigurationError: Wrong shape, or not finite.
    """
    theta = np.asarray(crank_angles, dtype=float)
    if theta.ndim < 1 or theta.shape[-1] != 6 or not np.isfinite(theta).all():
        raise ConfigurationError("crank_angles", theta, "finite numbers of shape (..., 6)")
    start = robot.home_pose if guess is None else np.asarray(guess, dtype=float)
    if start.shape[-1:] != (6,) or not np.isfinite(start).all():
        raise ConfigurationError("guess", start, "finite numbers of shape (..., 6)")
    try:
        pose = np.array(np.broadcast_to(start, theta.shape))
    except ValueError:
        allowed = f"finite numbers whose shape fits that of crank_angles, {theta.shape}"
        raise ConfigurationError("guess", start, allowed) from None
    cosine, sine = robot.crank_lengths * np.cos(theta), robot.crank_lengths * np.sin(theta)
    tips = robot.shaft_positions + cosine[..., None] * robot.crank_zero_directions
    tips += sine[..., None] * robot.crank_quarter_directions
    error = np.inf
    for iteration in range(max_iterations + 1):
        arm = robot.platform_joints @ np.swapaxes(rotation_matrix(pose[..., :3]), -1, -2)
        rod = arm + pose[..., None, 3:] - tips
        length = np.linalg.norm(rod, axis=-1)
        residual = length - robot.rod_lengths
        error = float(np.abs(residual).max(initial=0.0))
        if error <= tolerance:
            return pose
        if iteration == max_iterations or not np.isfinite(error):
            break
        rows = np.concatenate([cross(arm, rod), rod], axis=-1) / length[..., None]
        rows[..., :3] = rows[..., :3] @ euler_rate_matrix(pose[..., :3])
        try:
            step = np.linalg.solve(rows, residual[..., None])[..., 0]
        except np.linalg.LinAlgError:
            break
        # A full Newton step from a poor guess can tumble the platform; half a radian and 0.2 m keep it in one piece.
        scale = np.max(np.abs(step) / np.array([0.5, 0.5, 0.5, 0.2, 0.2, 0.2]), axis=-1, keepdims=True)
        pose -= step / np.maximum(scale, 1.0)
    raise ForwardKinematicsError(error, iteration)


def conditioning(robot: RobotParameters, pose: ArrayLike) -> np.ndarray:
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
    rows = rod_lines(legs)
    rows[..., :3] /= robot.characteristic_length
    sigma = np.linalg.svd(rows, compute_uv=False)
    return sigma[..., -1] / sigma[..., 0]
