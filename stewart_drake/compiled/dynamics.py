"""Exact dynamics of the closed chain."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import solve
from stewart_drake.compiled.mechanism import (
    CRANK_AXIS_INERTIA,
    CRANK_LENGTH,
    CRANK_MASS,
    PLATFORM_MASS,
    PLATFORM_MOMENT,
    PLATFORM_TENSOR,
    ROD_INERTIA,
    ROD_LENGTH,
    ROD_MASS,
    angular_velocity,
    euler_drift,
    scalar,
)


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
def loads(
    robot: np.ndarray,
    legs: np.ndarray,
    turn: np.ndarray,
    twist: np.ndarray,
    twist_rate: np.ndarray,
    gravity: float,
    wrench: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Reference `dynamics_core.loads`, for twist and twist rate (6,) [rad, m].

    Args:
        robot: From `pack`.
        legs: From `leg_vectors`.
        turn: (3, 3) R_BP.
        twist: (6,) [rad/s, m/s].
        twist_rate: (6,) [rad/s^2, m/s^2].
        gravity: [m/s^2].
        wrench: (6, 1) [N m, N] out, on the platform.
        torque: (6,) [N m] out, at each crank.
    """
    rod_mass, rod_inertia, crank_mass = scalar(robot, ROD_MASS), scalar(robot, ROD_INERTIA), scalar(robot, CRANK_MASS)
    mass = scalar(robot, PLATFORM_MASS)
    w0, w1, w2 = twist[0], twist[1], twist[2]
    d0, d1, d2 = twist_rate[0], twist_rate[1], twist_rate[2]
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
    wrench, matrix = np.empty((6, 1)), np.empty((6, 6))
    loads(robot, legs, turn, twist, twist_rate, gravity, wrench, torque)
    for i in range(6):
        for k in range(6):
            matrix[k, i] = lines[i, k]
    if solve(matrix, wrench) == 0.0:
        return False
    for i in range(6):
        torque[i] += robot[i, CRANK_LENGTH] * legs[i, 12] * wrench[i, 0]
    return True


@njit(cache=True, error_model="numpy")
def motion_torque(
    robot: np.ndarray,
    legs: np.ndarray,
    lines: np.ndarray,
    turn: np.ndarray,
    motion: np.ndarray,
    acceleration: np.ndarray,
    gravity: float,
    torque: np.ndarray,
) -> bool:
    """`inverse_dynamics` for pose and rate (12,) and acceleration (6,) in Euler angles; torque (6,) out [N m].

    Returns:
        False at a parallel singularity.
    """
    twist, twist_rate, drift = np.empty(6), np.empty(6), np.empty(3)
    angular_velocity(motion[:3], motion[6:9], twist[:3])
    angular_velocity(motion[:3], acceleration[:3], twist_rate[:3])
    euler_drift(motion[:3], motion[6:9], drift)
    for k in range(3):
        twist[3 + k], twist_rate[3 + k] = motion[9 + k], acceleration[3 + k]
        twist_rate[k] += drift[k]
    return inverse_dynamics(robot, legs, lines, turn, twist, twist_rate, gravity, torque)
