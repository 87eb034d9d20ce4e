"""Numbers of a robot, and the kinematics of the closed chain."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import singular_vectors, solve
from stewart_drake.robot import RobotParameters

OK, UNREACHABLE, SERIAL, PARALLEL, NOT_FINITE, NO_CONVERGENCE, NO_GAIN = range(7)
"""How a compiled function ended."""
AT_REFERENCE = 16
"""Added where it concerns the reference's pose, not the measured one."""

SHAFT, JOINT, ZERO, QUARTER = 0, 3, 6, 9
"""Where vectors begin in the row of a leg, and then its scalars:"""
CRANK_LENGTH, ROD_LENGTH, BRANCH, CRANK_AXIS_INERTIA = 12, 13, 14, 15
(
    ROD_MASS,
    ROD_INERTIA,
    CRANK_MASS,
    PLATFORM_MASS,
    PLATFORM_INERTIA,
    PLATFORM_TENSOR,
    PLATFORM_MOMENT,
    LENGTH,
    EFFORT,
) = (*range(4), 4, 7, 16, 19, 20)
"""Of the scalars of the whole robot. PLATFORM_INERTIA begins the moments about the centre of mass, PLATFORM_TENSOR
the nine entries of the tensor about P, PLATFORM_MOMENT mass times centre of mass, EFFORT the six motors' limits."""


def pack(robot: RobotParameters, platform: tuple[float, np.ndarray, np.ndarray] | None = None) -> np.ndarray:
    """The numbers of a robot in one contiguous array (8, 16): a row for each leg, then two of scalars of the whole.

    Args:
        robot: Geometry and masses.
        platform: In place of its own: mass [kg], mass times centre of mass (3,) [kg m], inertia about the origin of P
            (3, 3) [kg m^2]. PLATFORM_INERTIA, which the paper's model alone asks for, stays.
    """
    if platform is None:
        platform = robot.platform_mass, robot.platform_moment, robot.platform_inertia_about_origin
    mass, moment, inertia = platform
    legs = [
        robot.shaft_positions,
        robot.platform_joints,
        robot.crank_zero_directions,
        robot.crank_quarter_directions,
        np.stack([robot.crank_lengths, robot.rod_lengths, robot.branches, robot.crank_axis_inertias], axis=-1),
    ]
    scalars = [
        robot.rod_mass,
        robot.rod_inertia[0],
        robot.crank_mass,
        mass,
        *robot.platform_inertia,
        *inertia.ravel(),
        *moment,
        robot.characteristic_length,
        *robot.effort_limits,
    ]
    rows = np.zeros(32)
    rows[: len(scalars)] = scalars
    return np.concatenate([np.concatenate(legs, axis=-1), rows.reshape(2, 16)])


@njit(cache=True, error_model="numpy", inline="always")
def scalar(robot: np.ndarray, index: int) -> float:
    """A scalar of the whole robot in `pack`."""
    return robot[6 + index // 16, index % 16]


@njit(cache=True, error_model="numpy")
def rotation(rpy: np.ndarray, out: np.ndarray) -> None:
    """Reference `kinematics.rotation_matrix`; rpy (3,) [rad], out (3, 3)."""
    sr, sp, sy = np.sin(rpy[0]), np.sin(rpy[1]), np.sin(rpy[2])
    cr, cp, cy = np.cos(rpy[0]), np.cos(rpy[1]), np.cos(rpy[2])
    out[0, 0], out[0, 1], out[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[1, 0], out[1, 1], out[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr


@njit(cache=True, error_model="numpy")
def euler_rates(rpy: np.ndarray, omega: np.ndarray) -> None:
    """Turns angular velocity in B (3,) into Euler rates, in place; inverse of `kinematics.euler_rate_matrix`."""
    sp, cp = np.sin(rpy[1]), np.cos(rpy[1])
    sy, cy = np.sin(rpy[2]), np.cos(rpy[2])
    along = (cy * omega[0] + sy * omega[1]) / cp
    pitch = -sy * omega[0] + cy * omega[1]
    omega[2] += sp * along
    omega[0], omega[1] = along, pitch


@njit(cache=True, error_model="numpy")
def angular_velocity(rpy: np.ndarray, rate: np.ndarray, out: np.ndarray) -> None:
    """Reference `kinematics.euler_rate_matrix`: out (3,) = E(rpy) rate."""
    sp, cp = np.sin(rpy[1]), np.cos(rpy[1])
    sy, cy = np.sin(rpy[2]), np.cos(rpy[2])
    out[0] = cy * cp * rate[0] - sy * rate[1]
    out[1] = sy * cp * rate[0] + cy * rate[1]
    out[2] = -sp * rate[0] + rate[2]


@njit(cache=True, error_model="numpy")
def euler_drift(rpy: np.ndarray, rate: np.ndarray, out: np.ndarray) -> None:
    """Reference `kinematics.euler_rate_matrix_dot`: out (3,) = dE/dt rate."""
    sp, cp = np.sin(rpy[1]), np.cos(rpy[1])
    sy, cy = np.sin(rpy[2]), np.cos(rpy[2])
    rd, pd, yd = rate[0], rate[1], rate[2]
    out[0] = (-sy * cp * yd - cy * sp * pd) * rd - cy * yd * pd
    out[1] = (cy * cp * yd - sy * sp * pd) * rd - sy * yd * pd
    out[2] = -cp * pd * rd


@njit(cache=True, error_model="numpy")
def leg_vectors(robot: np.ndarray, pose: np.ndarray, legs: np.ndarray) -> int:
    """Reference `kinematics.leg_geometry`.

    Args:
        robot: From `pack`.
        pose: (6,) [rad, m].
        legs: (6, 14) out: arm (3), crank (3), e_N (3), e_l (3), transmission, reach margin; on return below zero the
            margins alone.

    Returns:
        -1, or the leg with the worst margin where it is negative or not a number.
    """
    turn = np.empty((3, 3))
    rotation(pose[:3], turn)
    worst, bad = 0.0, -1
    for i in range(6):
        a, length, branch = robot[i, CRANK_LENGTH], robot[i, ROD_LENGTH], robot[i, BRANCH]
        p0, p1, p2 = robot[i, JOINT], robot[i, JOINT + 1], robot[i, JOINT + 2]
        for k in range(3):
            legs[i, k] = turn[k, 0] * p0 + turn[k, 1] * p1 + turn[k, 2] * p2
        s0 = legs[i, 0] + pose[3] - robot[i, SHAFT]
        s1 = legs[i, 1] + pose[4] - robot[i, SHAFT + 1]
        s2 = legs[i, 2] + pose[5] - robot[i, SHAFT + 2]
        h0, h1, h2 = robot[i, ZERO], robot[i, ZERO + 1], robot[i, ZERO + 2]
        q0, q1, q2 = robot[i, QUARTER], robot[i, QUARTER + 1], robot[i, QUARTER + 2]
        along = 2.0 * a * (s0 * h0 + s1 * h1 + s2 * h2)
        up = 2.0 * a * (s0 * q0 + s1 * q1 + s2 * q2)
        constant = s0 * s0 + s1 * s1 + s2 * s2 + a * a - length * length
        size = np.sqrt(along * along + up * up)
        ratio = constant / size if size > 0.0 else np.inf
        margin = 1.0 - abs(ratio)
        legs[i, 13] = margin
        if not margin >= worst:
            worst, bad = margin, i
        # cos and sin of theta = atan2(up, along) + branch acos(ratio)
        height = branch * np.sqrt(max(0.0, (1.0 - ratio) * (1.0 + ratio)))
        cosine = (along * ratio - up * height) / size
        sine = (up * ratio + along * height) / size
        c0, c1, c2 = cosine * h0 + sine * q0, cosine * h1 + sine * q1, cosine * h2 + sine * q2
        n0, n1, n2 = cosine * q0 - sine * h0, cosine * q1 - sine * h1, cosine * q2 - sine * h2
        legs[i, 3], legs[i, 4], legs[i, 5] = c0, c1, c2
        legs[i, 6], legs[i, 7], legs[i, 8] = n0, n1, n2
        l0, l1, l2 = (s0 - a * c0) / length, (s1 - a * c1) / length, (s2 - a * c2) / length
        legs[i, 9], legs[i, 10], legs[i, 11] = l0, l1, l2
        legs[i, 12] = l0 * n0 + l1 * n1 + l2 * n2
    return bad


@njit(cache=True, error_model="numpy")
def rod_lines(legs: np.ndarray, out: np.ndarray) -> None:
    """Reference `kinematics.rod_lines`; out (6, 6)."""
    for i in range(6):
        a0, a1, a2 = legs[i, 0], legs[i, 1], legs[i, 2]
        l0, l1, l2 = legs[i, 9], legs[i, 10], legs[i, 11]
        out[i, 0], out[i, 1], out[i, 2] = a1 * l2 - a2 * l1, a2 * l0 - a0 * l2, a0 * l1 - a1 * l0
        out[i, 3], out[i, 4], out[i, 5] = l0, l1, l2


@njit(cache=True, error_model="numpy", inline="always")
def speed_along(lines: np.ndarray, leg: int, omega: np.ndarray, velocity: np.ndarray) -> float:
    """Speed [m/s] of a platform joint along its rod, of `rod_lines`, omega (3,) [rad/s] and velocity (3,) [m/s]."""
    along = 0.0
    for k in range(3):
        along += lines[leg, k] * omega[k] + lines[leg, 3 + k] * velocity[k]
    return along


@njit(cache=True, error_model="numpy")
def line_conditioning(robot: np.ndarray, lines: np.ndarray) -> float:
    """Reference `kinematics.line_conditioning`."""
    scaled, s, v = np.empty((6, 6)), np.empty(6), np.empty((6, 6))
    inverse = 1.0 / scalar(robot, LENGTH)
    for i in range(6):
        for k in range(3):
            scaled[i, k] = lines[i, k] * inverse
            scaled[i, 3 + k] = lines[i, 3 + k]
    singular_vectors(scaled, s, v, 1e-7)
    return s.min() / s.max()


@njit(cache=True, error_model="numpy")
def forward_kinematics(
    robot: np.ndarray, theta: np.ndarray, pose: np.ndarray, tolerance: float, iterations: int
) -> float:
    """Reference `kinematics.forward_kinematics`, from a near guess.

    Args:
        robot: From `pack`.
        theta: (6,) [rad].
        pose: (6,) [rad, m] guess; becomes the pose.
        tolerance: [m] largest rod-length error accepted.
        iterations: Newton steps at most.

    Returns:
        [m] the largest rod-length error left; not below `tolerance` (or NaN) means no convergence.
    """
    turn, tips = np.empty((3, 3)), np.empty((6, 3))
    for i in range(6):
        cosine, sine = robot[i, CRANK_LENGTH] * np.cos(theta[i]), robot[i, CRANK_LENGTH] * np.sin(theta[i])
        for k in range(3):
            tips[i, k] = robot[i, SHAFT + k] + cosine * robot[i, ZERO + k] + sine * robot[i, QUARTER + k]
    rows, residual = np.empty((6, 6)), np.empty((6, 1))
    error = np.inf
    for iteration in range(iterations + 1):
        rotation(pose[:3], turn)
        sp, cp = np.sin(pose[1]), np.cos(pose[1])
        sy, cy = np.sin(pose[2]), np.cos(pose[2])
        error = 0.0
        for i in range(6):
            p0, p1, p2 = robot[i, JOINT], robot[i, JOINT + 1], robot[i, JOINT + 2]
            a0 = turn[0, 0] * p0 + turn[0, 1] * p1 + turn[0, 2] * p2
            a1 = turn[1, 0] * p0 + turn[1, 1] * p1 + turn[1, 2] * p2
            a2 = turn[2, 0] * p0 + turn[2, 1] * p1 + turn[2, 2] * p2
            r0, r1, r2 = a0 + pose[3] - tips[i, 0], a1 + pose[4] - tips[i, 1], a2 + pose[5] - tips[i, 2]
            size = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
            residual[i, 0] = size - robot[i, ROD_LENGTH]
            if not abs(residual[i, 0]) <= error:
                error = abs(residual[i, 0])
            r0, r1, r2 = r0 / size, r1 / size, r2 / size
            m0, m1, m2 = a1 * r2 - a2 * r1, a2 * r0 - a0 * r2, a0 * r1 - a1 * r0
            # Moments act on angular velocity; the columns are for Euler rates.
            rows[i, 0] = cp * (cy * m0 + sy * m1) - sp * m2
            rows[i, 1] = -sy * m0 + cy * m1
            rows[i, 2] = m2
            rows[i, 3], rows[i, 4], rows[i, 5] = r0, r1, r2
        if error <= tolerance or iteration == iterations or not error < np.inf:
            break
        if solve(rows, residual) == 0.0:
            return np.inf
        scale = 1.0
        for k in range(6):
            scale = max(scale, abs(residual[k, 0]) / (0.5 if k < 3 else 0.2))
        for k in range(6):
            pose[k] -= residual[k, 0] / scale
    return error
