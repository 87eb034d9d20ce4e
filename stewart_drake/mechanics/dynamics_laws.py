"""Exact rigid-body dynamics of the closed chain in six task coordinates, compiled, for one robot at one pose.

Model: platform of Table I, cranks turning about their motors, rods as rigid bodies without spin about their own axes.
Coordinates: twist [w, v] of P in B. M(pose) d(twist)/dt + h(pose, twist) = J' T with J = d(theta)/d(twist).
`dynamics` has the same for arrays of poses, with checks. `base` (9,) is what an inertial unit at the origin of B reads,
see `robot.gravity.base_reading`: it has gravity and the motion of the base. Poses are in [rad, m], twists in
[rad/s, m/s], wrenches in [N m, N].
"""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Mat6, Mat6x1, Vec3, Vec6, Vec9, Vec12
from stewart_drake.mechanics.kinematics_laws import (
    Legs,
    Robot,
    angular_velocity,
    cross,
    dot,
    euler_drift,
    euler_rates,
    euler_rates_of_columns,
    turned,
    twist_of,
)
from stewart_drake.mechanics.linear_algebra import any_nonzero, multiply, solve


@njit
def task_inertia(robot: Robot, legs: Legs, out: Mat6) -> None:
    """M [kg m^2, kg m, kg]: inertia of the closed chain in task coordinates."""
    turn = legs.rotation[:]
    rows, mass = np.empty((5, 6)), robot.platform_mass
    moment, column, pull, row, tip_row = rows[0, :3], rows[1, :3], rows[2, :3], rows[3], rows[4]
    for i in range(6):
        for k in range(6):
            out[i, k] = 0.0
    for k in range(3):
        turned(robot.platform_tensor[:], turn[k], column)
        turned(turn, column, out[k, :3])
    turned(turn, robot.platform_moment[:], moment)
    # Kinetic energy of a rod from the velocities of its ends: m/4 of their sum squared, and I/l^2 of their difference,
    # which is across the rod because its length is constant. The Jacobian of the end at the platform is [-[arm] I],
    # that of the end at the crank a e_N J_i.
    for i in range(6):
        a, arm = robot.crank_length[i], legs.arm[i]
        across = robot.rod_inertia / (robot.rod_length[i] * robot.rod_length[i])
        both, apart = 0.25 * robot.rod_mass + across, 0.25 * robot.rod_mass - across
        mass += both
        square = both * dot(arm, arm)
        for j in range(3):
            moment[j] += both * arm[j]
            out[j, j] += square
            for k in range(j, 3):
                out[j, k] -= both * arm[j] * arm[k]
        cross(arm, legs.e_n[i], pull)
        crank_term = robot.crank_inertia[i] + both * a * a
        for j in range(6):
            row[j] = legs.line[i, j] / legs.lever[i]
            tip_row[j] = apart * a * (pull[j] if j < 3 else legs.e_n[i, j - 3])
        for j in range(6):
            for k in range(j, 6):
                out[j, k] += row[j] * (crank_term * row[k] + tip_row[k]) + tip_row[j] * row[k]
    x, y, z = moment[0], moment[1], moment[2]
    out[0, 4] -= z
    out[0, 5] += y
    out[1, 3] += z
    out[1, 5] -= x
    out[2, 3] -= y
    out[2, 4] += x
    for j in range(6):
        if j >= 3:
            out[j, j] += mass
        for k in range(j):
            out[j, k] = out[k, j]


@njit
def loads(robot: Robot, legs: Legs, twist: Vec6, twist_rate: Vec6, base: Vec9, wrench: Vec6, torque: Vec6) -> None:
    """Inertial and gravity loads of a motion: a wrench about P in B, and torques at the cranks.

    Args:
        robot: Geometry and masses.
        legs: At the pose.
        twist: [rad/s, m/s].
        twist_rate: [rad/s^2, m/s^2].
        base: Specific force [m/s^2], angular velocity and acceleration of the base.
        wrench: [N m, N], out.
        torque: [N m] at the cranks, out.
    """
    turn, w, alpha = legs.rotation[:], twist[:3], twist_rate[:3]
    moving = any_nonzero(base[3:])
    if moving:
        _platform_on_moving_base(robot, legs, twist, twist_rate, base, wrench)
    else:
        platform_load(robot, turn, twist, twist_rate, base, wrench)
    rows = np.empty((9, 3))  # One array: to allocate nine would take longer than the computation.
    arm_w, joint, speed, tip, arm_alpha, swing = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    load, other, moment = rows[6], rows[7], rows[8]
    for i in range(6):
        a, length, lever = robot.crank_length[i], robot.rod_length[i], legs.lever[i]
        across = robot.rod_inertia / (length * length)
        cross(w, legs.arm[i], arm_w)
        cross(alpha, legs.arm[i], arm_alpha)
        cross(w, arm_w, swing)
        for k in range(3):
            speed[k] = twist[3 + k] + arm_w[k]
            joint[k] = twist_rate[3 + k] + arm_alpha[k] + swing[k]
        rate = dot(legs.e_l[i], speed) / lever
        centripetal = a * rate * rate
        acceleration = 0.0
        for k in range(3):
            relative = speed[k] - a * legs.e_n[i, k] * rate
            acceleration += legs.e_l[i, k] * (joint[k] + centripetal * legs.crank[i, k]) + relative * relative / length
        acceleration /= lever
        crank_torque, along = robot.crank_inertia[i] * acceleration, 0.0
        for k in range(3):
            tip[k] = a * legs.e_n[i, k] * acceleration - centripetal * legs.crank[i, k]
            crank_torque += 0.5 * a * robot.crank_mass * base[k] * legs.e_n[i, k]
        if moving:
            crank_torque += _leg_on_moving_base(robot, legs, i, rate, speed, base, joint, tip)
        for k in range(3):
            along += legs.e_l[i, k] * (joint[k] - tip[k])
        for k in range(3):
            half = 0.25 * robot.rod_mass * (joint[k] + tip[k]) + 0.5 * robot.rod_mass * base[k]
            couple = across * (joint[k] - tip[k] - along * legs.e_l[i, k])
            load[k], other[k] = half + couple, half - couple
            crank_torque += a * legs.e_n[i, k] * other[k]
            wrench[3 + k] += load[k]
        cross(legs.arm[i], load, moment)
        for k in range(3):
            wrench[k] += moment[k]
        torque[i] = crank_torque


@njit
def add_base_acceleration(base: Vec9, place: Vec3, velocity: Vec3, out: Vec3) -> None:
    """Adds the acceleration that turning of the base gives a point (3,) [m] of B that moves in B (3,) [m/s].

    alpha x p + w x (w x p) + 2 w x v; that of the base's origin is in the specific force.
    """
    rows, w, alpha = np.empty((2, 3)), base[3:6], base[6:]
    cross(w, place, rows[0])
    for k in range(3):
        rows[0, k] += 2.0 * velocity[k]
    cross(w, rows[0], rows[1])
    cross(alpha, place, rows[0])
    for k in range(3):
        out[k] += rows[0, k] + rows[1, k]


@njit
def _leg_on_moving_base(
    robot: Robot, legs: Legs, leg: int, rate: float, speed: Vec3, base: Vec9, joint: Vec3, tip: Vec3
) -> float:
    """Adds the accelerations of a turning base to those of a rod's ends; returns the torque that the crank needs.

    `rate` [rad/s] of the crank, `speed` (3,) [m/s] of the rod's end at the platform, both in B. A rotor is seen as
    one that turns fast and light: its share of the crank's inertia follows the crank alone, as in Drake.
    """
    rows = np.zeros((6, 3))
    place, end, velocity, centre, added, axis = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    a, c, n, e_n = robot.crank_length[leg], legs.crank[leg], robot.crank_tensor, legs.e_n[leg]
    for k in range(3):
        centre[k] = robot.shaft[leg, k] + 0.5 * a * c[k]
        place[k] = robot.shaft[leg, k] + a * c[k]
        end[k] = place[k] + robot.rod_length[leg] * legs.e_l[leg, k]
        velocity[k] = a * rate * e_n[k]
    add_base_acceleration(base, end, speed, joint)
    add_base_acceleration(base, place, velocity, tip)
    for k in range(3):
        velocity[k] *= 0.5
    add_base_acceleration(base, centre, velocity, added)
    cross(c, e_n, axis)
    turning = n[1] * dot(axis, base[6:]) + (n[2] - n[0]) * dot(c, base[3:6]) * dot(e_n, base[3:6])
    return 0.5 * a * robot.crank_mass * dot(e_n, added) + turning


@njit
def _platform_on_moving_base(robot: Robot, legs: Legs, twist: Vec6, twist_rate: Vec6, base: Vec9, wrench: Vec6) -> None:
    """`platform_load` of the platform's motion in the world, in components of B."""
    rows, place = np.empty((2, 6)), np.empty(3)
    moved, moved_rate = rows[0], rows[1]
    cross(base[3:6], twist[:3], moved_rate[:3])
    for k in range(3):
        place[k] = robot.shaft[0, k] + robot.crank_length[0] * legs.crank[0, k]
        place[k] += robot.rod_length[0] * legs.e_l[0, k] - legs.arm[0, k]
        moved[k], moved[3 + k] = twist[k] + base[3 + k], twist[3 + k]
        moved_rate[k] += twist_rate[k] + base[6 + k]
        moved_rate[3 + k] = twist_rate[3 + k]
    add_base_acceleration(base, place, twist[3:], moved_rate[3:])
    platform_load(robot, legs.rotation[:], moved, moved_rate, base, wrench)


@njit
def platform_load(robot: Robot, turn: Mat3, twist: Vec6, twist_rate: Vec6, base: Vec9, wrench: Vec6) -> None:
    """Load of the platform about P, in B: I alpha + w x I w, from components in P, and terms of its centre of mass."""
    rows = np.zeros((9, 3))
    body_w, body_alpha, spin, load, gyro = rows[0], rows[1], rows[2], rows[3], rows[4]
    for k in range(3):
        for m in range(3):
            body_w[k] += turn[m, k] * twist[m]
            body_alpha[k] += turn[m, k] * twist_rate[m]
    turned(robot.platform_tensor[:], body_w, spin)
    turned(robot.platform_tensor[:], body_alpha, load)
    cross(body_w, spin, gyro)
    for k in range(3):
        load[k] += gyro[k]
    turned(turn, load, wrench[:3])
    centre, lifted, moment, swing = rows[5], rows[6], rows[7], rows[8]
    turned(turn, robot.platform_moment[:], centre)
    for k in range(3):
        lifted[k] = twist_rate[3 + k] + base[k]
    cross(centre, lifted, moment)
    cross(twist[:3], centre, gyro)
    cross(twist[:3], gyro, swing)
    cross(twist_rate[:3], centre, gyro)
    for k in range(3):
        wrench[k] += moment[k]
        wrench[3 + k] = robot.platform_mass * lifted[k] + gyro[k] + swing[k]


@njit
def inverse_dynamics(robot: Robot, legs: Legs, twist: Vec6, twist_rate: Vec6, base: Vec9, torque: Vec6) -> bool:
    """Motor torques [N m] of a motion, all bodies included; False at a parallel singularity."""
    wrench, rod_force, matrix = np.empty(6), np.empty((6, 1)), np.empty((6, 6))
    loads(robot, legs, twist, twist_rate, base, wrench, torque)
    for i in range(6):
        rod_force[i, 0] = wrench[i]
        for k in range(6):
            matrix[k, i] = legs.line[i, k]
    if solve(matrix, rod_force) == 0.0:
        return False
    for i in range(6):
        torque[i] += legs.lever[i] * rod_force[i, 0]
    return True


@njit
def twists_of_motion(pose: Vec6, rate: Vec6, acceleration: Vec6, twist: Vec6, twist_rate: Vec6) -> None:
    """Twist and its rate from a pose, its rate and its acceleration in Euler angles."""
    drift = np.empty(3)
    angular_velocity(pose[:3], rate[:3], twist[:3])
    angular_velocity(pose[:3], acceleration[:3], twist_rate[:3])
    euler_drift(pose[:3], rate[:3], drift)
    for k in range(3):
        twist[3 + k], twist_rate[3 + k] = rate[3 + k], acceleration[3 + k]
        twist_rate[k] += drift[k]


@njit
def motion_torque(robot: Robot, legs: Legs, motion: Vec12, acceleration: Vec6, base: Vec9, torque: Vec6) -> bool:
    """`inverse_dynamics` of a motion in Euler angles: pose and rate (12,), acceleration (6,)."""
    twist, twist_rate = np.empty(6), np.empty(6)
    twists_of_motion(motion[:6], motion[6:], acceleration, twist, twist_rate)
    return inverse_dynamics(robot, legs, twist, twist_rate, base, torque)


@njit
def static_torque(robot: Robot, legs: Legs, base: Vec9, torque: Vec6) -> bool:
    """Motor torques [N m] that hold all bodies at rest; False at a parallel singularity."""
    still = np.zeros(6)
    return inverse_dynamics(robot, legs, still, still, base, torque)


@njit
def task_bias(robot: Robot, legs: Legs, twist: Vec6, base: Vec9, out: Vec6) -> None:
    """Bias h [N m, N] in task coordinates: Coriolis, centrifugal, gyroscopic and gravity terms."""
    crank_torque = np.empty(6)
    loads(robot, legs, twist, np.zeros(6), base, out, crank_torque)
    for i in range(6):
        for k in range(6):
            out[k] += legs.line[i, k] / legs.lever[i] * crank_torque[i]


@njit
def forward_dynamics(
    robot: Robot, legs: Legs, pose: Vec6, rate: Vec6, torque: Vec6, crank_acceleration: Vec6, base: Vec9, out: Vec6
) -> bool:
    """Acceleration of the pose [rad/s^2, m/s^2] under motor torques, the inverse of `motion_torque`.

    An observer adds a `crank_acceleration` [rad/s^2] to the one that the torques cause. False at a singularity.
    """
    twist, bias, inertia, solution = np.empty(6), np.empty(6), np.empty((6, 6)), np.empty((6, 1))
    twist_of(pose, rate, twist)
    task_bias(robot, legs, twist, base, bias)
    task_inertia(robot, legs, inertia)
    for k in range(6):
        solution[k, 0] = -bias[k]
        for i in range(6):
            solution[k, 0] += legs.line[i, k] / legs.lever[i] * torque[i]
    if solve(inertia, solution) == 0.0:
        return False
    lines, added, drift = legs.line.copy(), np.empty((6, 1)), np.empty(3)
    for i in range(6):
        added[i, 0] = legs.lever[i] * crank_acceleration[i]
    if solve(lines, added) == 0.0:
        return False
    euler_drift(pose[:3], rate[:3], drift)
    for k in range(6):
        out[k] = solution[k, 0] + added[k, 0] - (drift[k] if k < 3 else 0.0)
    euler_rates(pose[:3], out[:3], out[:3])
    return True


@njit
def pose_acceleration_map(robot: Robot, legs: Legs, pose: Vec6, out: Mat6) -> bool:
    """E^-1 M^-1 J': second derivative of the pose per unit of motor torque; False at a singularity.

    The exact counterpart of M^-1 tau in (10); [rad/s^2/(N m), m/s^2/(N m)].
    """
    inertia = np.empty((6, 6))
    task_inertia(robot, legs, inertia)
    for i in range(6):
        for k in range(6):
            out[k, i] = legs.line[i, k] / legs.lever[i]
    if solve(inertia, out) == 0.0:
        return False
    euler_rates_of_columns(pose[:3], out)
    return True


@njit
def multiply_by_crank_inertia(robot: Robot, legs: Legs, column: Mat6x1) -> bool:
    """Multiplies by the inertia at the cranks, J'^-1 M J^-1 [kg m^2], in place; False at a parallel singularity."""
    lines, transposed = legs.line.copy(), np.empty((6, 6))
    inertia, wrench = np.empty((6, 6)), np.empty((6, 1))
    for i in range(6):
        column[i, 0] *= legs.lever[i]
        for k in range(6):
            transposed[k, i] = legs.line[i, k]
    task_inertia(robot, legs, inertia)
    if solve(lines, column) == 0.0:
        return False
    multiply(inertia, column, wrench)
    if solve(transposed, wrench) == 0.0:
        return False
    for i in range(6):
        column[i, 0] = legs.lever[i] * wrench[i, 0]
    return True
