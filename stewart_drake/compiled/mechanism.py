"""Kinematics and exact dynamics of the closed chain."""

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


def pack(robot: RobotParameters) -> np.ndarray:
    """The numbers of a robot in one contiguous array (8, 16): a row for each leg, then two of scalars of the whole."""
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
        robot.platform_mass,
        *robot.platform_inertia,
        *robot.platform_inertia_about_origin.ravel(),
        *robot.platform_moment,
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


@njit(cache=True, error_model="numpy")
def task_inertia(robot: np.ndarray, legs: np.ndarray, lines: np.ndarray, turn: np.ndarray, out: np.ndarray) -> None:
    """Reference `dynamics.task_inertia`; lines (6, 6) from `rod_lines`, turn (3, 3) R_BP, out (6, 6)."""
    rod_mass, rod_inertia = scalar(robot, ROD_MASS), scalar(robot, ROD_INERTIA)
    for j in range(6):
        for k in range(6):
            out[j, k] = 0.0
    for j in range(3):
        for k in range(3):
            for m in range(3):
                for n in range(3):
                    out[j, k] += turn[j, m] * scalar(robot, PLATFORM_TENSOR + 3 * m + n) * turn[k, n]
        out[3 + j, 3 + j] = scalar(robot, PLATFORM_MASS)
    x, y, z = platform_moment(robot, turn)
    out[0, 4], out[0, 5], out[1, 3], out[1, 5], out[2, 3], out[2, 4] = -z, y, z, -x, -y, x
    # A rod is three things to its two ends: m/4 of their sum, and I/l^2 of their difference across the rod. Written out
    # with the joint's Jacobian [-[arm] I] and the tip's a e_N J_i, all terms are dyads of few vectors.
    joint, tip, row = np.empty((3, 6)), np.empty((3, 6)), np.empty(6)
    for i in range(6):
        a, length, crank_inertia = robot[i, CRANK_LENGTH], robot[i, ROD_LENGTH], robot[i, CRANK_AXIS_INERTIA]
        across = rod_inertia / (length * length)
        both, apart = 0.25 * rod_mass + across, 0.25 * rod_mass - across
        inverse = 1.0 / (a * legs[i, 12])
        x, y, z = legs[i, 0], legs[i, 1], legs[i, 2]
        joint[0, 0], joint[0, 1], joint[0, 2] = 0.0, z, -y
        joint[1, 0], joint[1, 1], joint[1, 2] = -z, 0.0, x
        joint[2, 0], joint[2, 1], joint[2, 2] = y, -x, 0.0
        for k in range(3):
            for j in range(3):
                joint[k, 3 + j] = 1.0 if j == k else 0.0
        for j in range(6):
            row[j] = lines[i, j] * inverse
            for k in range(3):
                tip[k, j] = a * legs[i, 6 + k] * row[j]
        # e_l . (joint - tip) J = 0: the rod keeps its length, so the difference has no part along it.
        for j in range(6):
            for k in range(j, 6):
                value = crank_inertia * row[j] * row[k]
                for m in range(3):
                    value += both * (joint[m, j] * joint[m, k] + tip[m, j] * tip[m, k])
                    value += apart * (joint[m, j] * tip[m, k] + tip[m, j] * joint[m, k])
                out[j, k] += value
    for j in range(6):
        for k in range(j):
            out[j, k] = out[k, j]


@njit(cache=True, error_model="numpy", inline="always")
def platform_moment(robot: np.ndarray, turn: np.ndarray) -> tuple[float, float, float]:
    """Mass times centre of mass of the platform in B [kg m]."""
    m0, m1, m2 = scalar(robot, PLATFORM_MOMENT), scalar(robot, PLATFORM_MOMENT + 1), scalar(robot, PLATFORM_MOMENT + 2)
    return (
        turn[0, 0] * m0 + turn[0, 1] * m1 + turn[0, 2] * m2,
        turn[1, 0] * m0 + turn[1, 1] * m1 + turn[1, 2] * m2,
        turn[2, 0] * m0 + turn[2, 1] * m1 + turn[2, 2] * m2,
    )


@njit(cache=True, error_model="numpy")
def inverse_dynamics(
    robot: np.ndarray,
    legs: np.ndarray,
    lines: np.ndarray,
    turn: np.ndarray,
    twist: np.ndarray,
    twist_rate: np.ndarray,
    gravity: float,
    torque: np.ndarray,
) -> bool:
    """Reference `dynamics.inverse_dynamics`, for twist and twist rate (6,) [rad, m]; torque (6,) out [N m].

    Returns:
        False at a parallel singularity.
    """
    rod_mass, rod_inertia, crank_mass = scalar(robot, ROD_MASS), scalar(robot, ROD_INERTIA), scalar(robot, CRANK_MASS)
    mass = scalar(robot, PLATFORM_MASS)
    w0, w1, w2 = twist[0], twist[1], twist[2]
    d0, d1, d2 = twist_rate[0], twist_rate[1], twist_rate[2]
    wrench, matrix = np.zeros((6, 1)), np.empty((6, 6))
    # Platform: I alpha + w x I w about P, in its own frame; then what its centre of mass adds, in B.
    body_w, body_d, spin, load = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        body_w[k] = turn[0, k] * w0 + turn[1, k] * w1 + turn[2, k] * w2
        body_d[k] = turn[0, k] * d0 + turn[1, k] * d1 + turn[2, k] * d2
    for k in range(3):
        spin[k], load[k] = 0.0, 0.0
        for m in range(3):
            entry = scalar(robot, PLATFORM_TENSOR + 3 * k + m)
            spin[k] += entry * body_w[m]
            load[k] += entry * body_d[m]
    m0 = load[0] + body_w[1] * spin[2] - body_w[2] * spin[1]
    m1 = load[1] + body_w[2] * spin[0] - body_w[0] * spin[2]
    m2 = load[2] + body_w[0] * spin[1] - body_w[1] * spin[0]
    c0, c1, c2 = platform_moment(robot, turn)
    v0, v1, v2 = w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0
    a0, a1, a2 = twist_rate[3], twist_rate[4], twist_rate[5] + gravity
    for k in range(3):
        wrench[k, 0] = turn[k, 0] * m0 + turn[k, 1] * m1 + turn[k, 2] * m2
    wrench[0, 0] += c1 * a2 - c2 * a1
    wrench[1, 0] += c2 * a0 - c0 * a2
    wrench[2, 0] += c0 * a1 - c1 * a0
    wrench[3, 0] = mass * a0 + d1 * c2 - d2 * c1 + w1 * v2 - w2 * v1
    wrench[4, 0] = mass * a1 + d2 * c0 - d0 * c2 + w2 * v0 - w0 * v2
    wrench[5, 0] = mass * a2 + d0 * c1 - d1 * c0 + w0 * v1 - w1 * v0
    joint, speed, tip, other = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(6):
        a, length, crank_inertia = robot[i, CRANK_LENGTH], robot[i, ROD_LENGTH], robot[i, CRANK_AXIS_INERTIA]
        across = rod_inertia / (length * length)
        x, y, z = legs[i, 0], legs[i, 1], legs[i, 2]
        t = a * legs[i, 12]
        s0, s1, s2 = w1 * z - w2 * y, w2 * x - w0 * z, w0 * y - w1 * x
        speed[0], speed[1], speed[2] = twist[3] + s0, twist[4] + s1, twist[5] + s2
        joint[0] = twist_rate[3] + d1 * z - d2 * y + w1 * s2 - w2 * s1
        joint[1] = twist_rate[4] + d2 * x - d0 * z + w2 * s0 - w0 * s2
        joint[2] = twist_rate[5] + d0 * y - d1 * x + w0 * s1 - w1 * s0
        rate = (legs[i, 9] * speed[0] + legs[i, 10] * speed[1] + legs[i, 11] * speed[2]) / t
        centripetal = a * rate * rate
        acceleration = 0.0
        for k in range(3):
            relative = speed[k] - a * legs[i, 6 + k] * rate
            acceleration += legs[i, 9 + k] * (joint[k] + centripetal * legs[i, 3 + k]) + relative * relative / length
        acceleration /= t
        along = 0.0
        for k in range(3):
            tip[k] = a * legs[i, 6 + k] * acceleration - centripetal * legs[i, 3 + k]
            along += legs[i, 9 + k] * (joint[k] - tip[k])
        own = crank_inertia * acceleration + 0.5 * a * crank_mass * gravity * legs[i, 8]
        for k in range(3):
            half = 0.25 * rod_mass * (joint[k] + tip[k])
            if k == 2:
                half += 0.5 * rod_mass * gravity
            couple = across * (joint[k] - tip[k] - along * legs[i, 9 + k])
            load[k], other[k] = half + couple, half - couple
            own += a * legs[i, 6 + k] * other[k]
            wrench[3 + k, 0] += load[k]
        wrench[0, 0] += y * load[2] - z * load[1]
        wrench[1, 0] += z * load[0] - x * load[2]
        wrench[2, 0] += x * load[1] - y * load[0]
        torque[i] = own
        for k in range(6):
            matrix[k, i] = lines[i, k]
    if solve(matrix, wrench) == 0.0:
        return False
    for i in range(6):
        torque[i] += robot[i, CRANK_LENGTH] * legs[i, 12] * wrench[i, 0]
    return True
