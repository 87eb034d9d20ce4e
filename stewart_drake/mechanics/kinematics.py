"""Inverse and forward kinematics of the 6-RSS platform, (1)-(6), and their Jacobians, for poses with any leading axes.

Poses are [roll, pitch, yaw, X, Y, Z] of P in B; R_BP = Rz(yaw) Ry(pitch) Rx(roll), the inverse of the paper's (3). A
twist is [w, v]: angular velocity of P and velocity of its origin, both in B. Many poses are computed on all cores.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.errors import ConfigurationError, ForwardKinematicsError
from stewart_drake.jit import njit, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.batch import Robot, at_poses, broadcast_rows, over_rows, reaches, robot_records
from stewart_drake.mechanics.kinematics_laws import LEGS, OK, UNREACHABLE
from stewart_drake.robot import RobotParameters


def rotation_matrix(rpy: ArrayLike) -> np.ndarray:
    """R_BP (..., 3, 3) of roll, pitch, yaw (..., 3) [rad]; the inverse of (3).

    Deviation: entry (3,1) of the print is a misprint; this is the matrix that it means.
    """
    return _by_rows(_rotations, (3, 3), rpy)


def rotation_angle(rotation: np.ndarray) -> np.ndarray:
    """Angle (...) [rad] of rotations (..., 3, 3)."""
    trace = np.trace(rotation, axis1=-2, axis2=-1)
    return np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))


def roll_pitch_yaw(matrix: ArrayLike) -> np.ndarray:
    """Roll, pitch, yaw (..., 3) [rad] of rotation matrices (..., 3, 3); pitch in [-pi/2, pi/2]."""
    m = np.asarray(matrix, dtype=float)
    roll, yaw = np.arctan2(m[..., 2, 1], m[..., 2, 2]), np.arctan2(m[..., 1, 0], m[..., 0, 0])
    return np.stack([roll, np.arcsin(np.clip(-m[..., 2, 0], -1.0, 1.0)), yaw], axis=-1)


def euler_rate_matrix(rpy: ArrayLike) -> np.ndarray:
    """E (..., 3, 3) with w_B = E(rpy) d(rpy)/dt, of rpy (..., 3) [rad]; singular at pitch = +-pi/2."""
    rpy = np.asarray(rpy, dtype=float)
    return _by_rows(_angular_velocities, (3,), rpy[..., None, :], np.eye(3)).swapaxes(-1, -2)


def euler_rate_matrix_dot(rpy: ArrayLike, rpy_rate: ArrayLike) -> np.ndarray:
    """Time derivative (..., 3, 3) [1/s] of `euler_rate_matrix` along rpy_rate (..., 3) [rad/s]."""
    rpy, rate = np.asarray(rpy, dtype=float), np.asarray(rpy_rate, dtype=float)
    sp, cp, sy, cy = np.sin(rpy[..., 1]), np.cos(rpy[..., 1]), np.sin(rpy[..., 2]), np.cos(rpy[..., 2])
    pitch, yaw = rate[..., 1], rate[..., 2]
    made = np.zeros((*np.broadcast_shapes(rpy.shape, rate.shape), 3))
    made[..., 0, 0], made[..., 0, 1] = -sy * cp * yaw - cy * sp * pitch, -cy * yaw
    made[..., 1, 0], made[..., 1, 1] = cy * cp * yaw - sy * sp * pitch, -sy * yaw
    made[..., 2, 0] = -cp * pitch
    return made


def pose_rate_to_twist(pose: ArrayLike, pose_rate: ArrayLike) -> np.ndarray:
    """Twist [w, v] (..., 6) [rad/s, m/s] of P in B, from poses (..., 6) and their rates (..., 6)."""
    return _by_rows(_twists, (6,), pose, pose_rate)


def twist_to_pose_rate(pose: ArrayLike, twist: ArrayLike) -> np.ndarray:
    """Inverse of `pose_rate_to_twist`; pitch away from +-pi/2."""
    return _by_rows(_rates, (6,), pose, twist)


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


def reach_margin(robot: Robot, pose: ArrayLike) -> np.ndarray:
    """1 - |C| / sqrt(A^2 + B^2) (..., 6) of each leg; negative where a rod cannot span, zero at a dead centre."""
    return at_poses(reaches, robot, {"pose": pose}, (6,))


def inverse_kinematics(robot: Robot, pose: ArrayLike, branch: int | None = None) -> np.ndarray:
    """Crank angles that put the platform at `pose`; closed form of (1)-(6).

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
    return at_poses(_crank_angles, _with_branch(robot, branch), {"pose": pose}, (6,))


def leg_geometry(robot: Robot, pose: ArrayLike, branch: int | None = None) -> LegGeometry:
    """Directions of cranks and rods at `pose`, Fig. 1.

    Args:
        robot: Geometry.
        pose: (..., 6) [rad, m].
        branch: As in `inverse_kinematics`.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    legs = at_poses(_legs, _with_branch(robot, branch), {"pose": pose}, (), kind=LEGS)
    names = ("rotation", "arm", "crank", "e_n", "e_l", "transmission")
    theta = np.arctan2(legs["sine"], legs["cosine"])
    return LegGeometry(crank_angles=theta, **{name: np.ascontiguousarray(legs[name]) for name in names})


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product over the last axis; several times faster than numpy's on small arrays."""
    a, b = np.broadcast_arrays(a, b)
    made = np.empty(a.shape)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        made[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return made


def rod_lines(legs: LegGeometry) -> np.ndarray:
    """Rows [e_M, e_l] = [(R p_i) x e_l, e_l] (..., 6, 6): the rods as unit lines, (14) transposed."""
    return np.concatenate([cross(legs.arm, legs.e_l), legs.e_l], axis=-1)


def twist_jacobian(robot: Robot, pose: ArrayLike) -> np.ndarray:
    """d(theta)/d(twist) (..., 6, 6): crank rates from the twist of P; infinite at a crank's dead centre."""
    return at_poses(_twist_jacobians, robot, {"pose": pose}, (6, 6))


def pose_jacobian(robot: Robot, pose: ArrayLike) -> np.ndarray:
    """d(theta)/d(pose) (..., 6, 6): crank rates from the pose's rate (Euler rates)."""
    return at_poses(_pose_jacobians, robot, {"pose": pose}, (6, 6))


def crank_rates(robot: RobotParameters, legs: LegGeometry, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates (..., 6) [rad/s] from `leg_geometry` of a pose and its rate; infinite or NaN at a dead centre."""
    twist = pose_rate_to_twist(pose, pose_rate)
    return np.einsum("...ij,...j->...i", rod_lines(legs), twist) / (robot.crank_lengths * legs.transmission)


def forward_kinematics(
    robot: Robot,
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
        guess: (..., 6) [rad, m] where to start; None starts at the home pose of a `RobotParameters`.
        tolerance: [m] largest rod-length error accepted.
        max_iterations: Newton steps at most.

    Returns:
        (..., 6) [rad, m].

    Raises:
        ForwardKinematicsError: No convergence, or a singular Jacobian on the way; with the largest error left.
        ConfigurationError: Wrong shape, or not finite; no guess for a robot that is a record.
    """
    theta = np.asarray(crank_angles, dtype=float)
    if theta.shape[-1:] != (6,) or not np.isfinite(theta).all():
        raise ConfigurationError("crank_angles", crank_angles, "finite numbers of shape (..., 6)")
    given = robot.home_pose if guess is None and isinstance(robot, RobotParameters) else guess
    start = np.asarray(given, dtype=float)
    if start.shape[-1:] != (6,) or not np.isfinite(start).all():
        raise ConfigurationError("guess", given, "finite numbers of shape (..., 6)")
    try:
        poses = np.broadcast_to(start, theta.shape).reshape(-1, 6)
    except ValueError:
        allowed = f"finite numbers whose shape fits that of crank_angles, {theta.shape}"
        raise ConfigurationError("guess", start, allowed) from None
    poses, error, steps = newton(robot, theta.reshape(-1, 6), poses, tolerance, max_iterations)
    if not (error <= tolerance).all():
        worst = np.nan_to_num(error, nan=np.inf).argmax()
        raise ForwardKinematicsError(float(error[worst]), int(steps[worst]))
    return poses.reshape(theta.shape)


def newton(
    robot: Robot, theta: np.ndarray, start: np.ndarray, tolerance: float, iterations: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`forward_kinematics` of angles and starts (n, 6), without raising: poses (n, 6), errors (n,) [m], steps (n,)."""
    poses, ends = np.array(start, order="C"), np.zeros((len(theta), 2))
    angles = np.array(theta, order="C")
    over_rows(_forward_kinematics, (robot_records(robot), float(tolerance), int(iterations)), (angles, poses, ends))
    return poses, ends[:, 0], ends[:, 1]


def conditioning(robot: Robot, pose: ArrayLike) -> np.ndarray:
    """sigma_min / sigma_max (...) of [e_M / length; e_l] of (14), rotations over the characteristic length.

    Zero at a parallel singularity; it says nothing about dead centres (see `LegGeometry.transmission`).
    """
    return at_poses(_conditioning, robot, {"pose": pose}, ())


def line_conditioning(robot: RobotParameters, legs: LegGeometry) -> np.ndarray:
    """`conditioning` from leg vectors that are already at hand; (...) [-]."""
    lines = rod_lines(legs)
    lines[..., :3] /= robot.characteristic_length
    sigma = np.linalg.svd(lines, compute_uv=False)
    return sigma[..., -1] / sigma[..., 0]


def _by_rows(loop: Any, tail: tuple[int, ...], *inputs: ArrayLike) -> np.ndarray:
    """Values of a loop that needs no robot."""
    leading, rows = broadcast_rows(*(np.asarray(each, dtype=float) for each in inputs))
    made = np.empty((len(rows[0]), *tail))
    over_rows(loop, (), (*rows, made))
    return made.reshape((*leading, *tail))


def _with_branch(robot: Robot, branch: int | None) -> Robot:
    if branch is None:
        return robot
    if branch not in (-1, 1):
        raise ConfigurationError("branch", branch, "-1 or 1, or None")
    made = robot_records(robot).copy()
    made["branch"] = branch
    return made


@njit
def _rotations(rpy: Any, made: Any) -> None:
    for n in range(len(rpy)):
        laws.rotation(rpy[n], made[n])


@njit
def _angular_velocities(rpy: Any, rates: Any, made: Any) -> None:
    for n in range(len(rpy)):
        laws.angular_velocity(rpy[n], rates[n], made[n])


@njit
def _twists(poses: Any, rates: Any, made: Any) -> None:
    for n in range(len(poses)):
        laws.twist_of(poses[n], rates[n], made[n])


@njit
def _rates(poses: Any, twists: Any, made: Any) -> None:
    for n in range(len(poses)):
        laws.rate_of(poses[n], twists[n], made[n])


@njit
def _crank_angles(robots: Any, poses: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if laws.legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        for i in range(6):
            made[n, i] = np.arctan2(legs.sine[i], legs.cosine[i])
    return OK


@njit
def _legs(robots: Any, poses: Any, made: Any) -> int:
    robot = record(robots)
    for n in range(len(poses)):
        if laws.legs_at(robot, poses[n], record(made[n : n + 1])) >= 0:
            return UNREACHABLE
    return OK


@njit
def _twist_jacobians(robots: Any, poses: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if laws.legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        laws.crank_jacobian(legs, made[n])
    return OK


@njit
def _pose_jacobians(robots: Any, poses: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if laws.legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        laws.crank_jacobian(legs, made[n])
        for i in range(6):
            laws.euler_moment(poses[n, :3], made[n, i, :3])
    return OK


@njit
def _conditioning(robots: Any, poses: Any, made: Any) -> int:
    robot, store = record(robots), np.empty(1, LEGS)
    for n in range(len(poses)):
        legs = record(store)
        if laws.legs_at(robot, poses[n], legs) >= 0:
            return UNREACHABLE
        made[n] = laws.conditioning(robot, legs, 1e-14)
    return OK


@njit
def _forward_kinematics(robots: Any, tolerance: float, iterations: int, angles: Any, poses: Any, ends: Any) -> None:
    robot = record(robots)
    for n in range(len(angles)):
        ends[n, 0], ends[n, 1] = laws.forward_kinematics(robot, angles[n], poses[n], tolerance, iterations)
