"""Statics and exact dynamics of the closed chain for arrays of any namespace; goes on from `kinematics_core`.

`masked` leaves singular systems out before solving and dead centres out before dividing: the result is finite there and
means nothing. Where it is False they end as the namespace ends them.
"""

from __future__ import annotations

from typing import Any

from stewart_drake.mechanics.arrays import Array, Robot, cross, dot, first, fitted, last, namespace, stack
from stewart_drake.mechanics.kinematics_core import (
    Legs,
    angular_drift,
    angular_velocity,
    divisor,
    euler_rates,
    levers,
    linear,
    rod_lines,
    solve,
    twist,
    twist_jacobian,
)


def inverse_dynamics(
    robot: Robot, legs: Legs, pose: Array, rate: Array, acceleration: Array, gravity: float, masked: bool = True
) -> Array:
    """Motor torques (..., 6) [N m] of a motion, all bodies included.

    Args:
        robot: Geometry and masses.
        legs: `legs_at` of the poses.
        pose: (..., 6) [rad, m].
        rate: (..., 6) [rad/s, m/s] Euler rates and velocity.
        acceleration: (..., 6) [rad/s^2, m/s^2] their time derivatives.
        gravity: [m/s^2] along -z of B.
        masked: See above.
    """
    xp = namespace(pose, rate, acceleration)
    angular = angular_velocity(pose, acceleration) + angular_drift(pose, rate)
    twist_rate = xp.concat([angular, linear(xp, acceleration)])
    wrench, own = loads(robot, legs, twist(pose, rate), twist_rate, gravity, masked)
    return _through_rods(robot, legs, wrench, own, masked)


def static_torque(robot: Robot, legs: Legs, gravity: float, masked: bool = True) -> Array:
    """Motor torques (..., 6) [N m] that hold platform, rods and cranks at rest against gravity."""
    return _through_rods(robot, legs, *weight(robot, legs, gravity), masked)


def task_bias(robot: Robot, legs: Legs, motion: Array, gravity: float, masked: bool = True) -> Array:
    """Coriolis, centrifugal, gyroscopic and gravity terms (..., 6) [N m, N] of twists (..., 6)."""
    xp = namespace(motion)
    moving = stack(xp, (motion[..., k] for k in range(6)))
    wrench, own = loads(robot, legs, moving, None, gravity, masked)
    return last(xp, wrench + xp.sum(twist_jacobian(robot, legs, masked) * own, axis=1), 1)


def task_inertia(robot: Robot, legs: Legs, masked: bool = True) -> Array:
    """M: inertia of the closed chain as the platform feels it; (..., 6, 6) [kg m^2, kg m, kg], symmetric.

    A rod is three things to its two ends: m/4 of their sum, and I/l^2 of their difference, which has no part along it.
    With the joint's Jacobian [-[arm] 1] and the tip's a e_N J_i all terms but the joints' own are dyads of J_i.
    """
    xp = namespace(legs.e_l)
    robot = fitted(robot, legs.transmission.ndim - 1)
    across = robot.rod_inertia / (robot.rods * robot.rods)
    both, apart = 0.25 * robot.rod_mass + across, 0.25 * robot.rod_mass - across
    jacobian = twist_jacobian(robot, legs, masked)
    swept = xp.concat([cross(xp, legs.arm, legs.e_n), legs.e_n])
    half = 0.5 * (both * robot.cranks * robot.cranks + robot.axis_inertias)
    other = half * jacobian + (apart * robot.cranks) * swept
    if jacobian.ndim == 2:
        dyads = xp.matmul(jacobian, xp.matrix_transpose(other))
    else:
        dyads = xp.sum(jacobian[:, None, ...] * other, axis=2)
    dyads = dyads + xp.permute_dims(dyads, (1, 0, *range(2, dyads.ndim)))

    x, y, z = (legs.arm[k, ...] for k in range(3))
    platform = _in_base(xp, legs.rotation, robot.platform_inertia)
    moment = _platform_moment(legs, robot) + xp.sum(both * legs.arm, axis=1)
    squares = [xp.sum(both * value * value, axis=0) for value in (x, y, z)]
    products = [-xp.sum(both * a * b, axis=0) for a, b in ((x, y), (x, z), (y, z))]
    xx, yy, zz = (platform[k, k, ...] + squares[k - 2] + squares[k - 1] for k in range(3))
    xy, xz, yz = (platform[i, j, ...] + value for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), products, strict=True))
    mass = robot.platform_mass + xp.sum(both + 0.0 * x, axis=0)
    p, q, r = (moment[k, ...] for k in range(3))
    o = 0.0 * p
    entries = [
        xx, xy, xz, o, -r, q,
        xy, yy, yz, r, o, -p,
        xz, yz, zz, -q, p, o,
        o, r, -q, mass, o, o,
        -r, o, p, o, mass, o,
        q, -p, o, o, o, mass,
    ]  # fmt: skip
    return last(xp, xp.reshape(stack(xp, entries), (6, 6, *p.shape)) + dyads, 2)


def forward_dynamics(
    robot: Robot, legs: Legs, pose: Array, rate: Array, torque: Array, gravity: float, masked: bool = True
) -> Array:
    """Second derivative of the pose (..., 6) [rad/s^2, m/s^2] under motor torques (..., 6) [N m]."""
    xp = namespace(pose, rate, torque)
    pushed = xp.sum(twist_jacobian(robot, legs, masked) * first(xp, torque, 1), axis=1)
    load = last(xp, pushed, 1) - task_bias(robot, legs, last(xp, twist(pose, rate), 1), gravity, masked)
    solved = first(xp, xp.linalg.solve(task_inertia(robot, legs, masked), load[..., None])[..., 0], 1)
    angular = euler_rates(pose, solved[:3, ...] - angular_drift(pose, rate))
    return last(xp, xp.concat([angular, solved[3:, ...]]), 1)


def weight(robot: Robot, legs: Legs, gravity: float) -> tuple[Array, Array]:
    """What gravity takes to hold: wrench on the platform and torque at each crank, (6, ...).

    Each platform joint carries half a rod, with the moment (R p_i) x z; each crank half a rod and its own weight.
    """
    xp = namespace(legs.e_l)
    robot = fitted(robot, legs.transmission.ndim - 1)
    half_rod = (0.5 * gravity) * robot.rod_mass
    x, y = (
        half_rod * xp.sum(legs.arm[k, ...], axis=0) + gravity * _platform_moment(legs, robot)[k, ...] for k in (0, 1)
    )
    nothing = 0.0 * x
    wrench = stack(xp, (y, -x, nothing, nothing, nothing, nothing + (gravity * robot.platform_mass + 6.0 * half_rod)))
    return wrench, (half_rod + (0.5 * gravity) * robot.crank_mass) * robot.cranks * legs.e_n[2, ...]


def loads(
    robot: Robot, legs: Legs, moving: Array, changing: Array | None, gravity: float, masked: bool
) -> tuple[Array, Array]:
    """What twists and their rates (6, ...) take, and gravity: wrench on the platform, torque at cranks; (6, ...).

    Rates of None are zero.
    """
    xp = namespace(moving)
    weights = weight(robot, legs, gravity)
    robot = fitted(robot, moving.ndim - 1)
    a, length, e_l, e_n = robot.cranks, robot.rods, legs.e_l, legs.e_n
    lever = divisor(robot, legs, masked)
    omega, moment, to_body = moving[:3, ...], _platform_moment(legs, robot), _transposed(xp, legs.rotation)
    inside = _times(to_body, omega)
    spun = cross(xp, inside, _times(robot.platform_inertia, inside))
    pushing = cross(xp, omega, cross(xp, omega, moment))
    spin = cross(xp, omega[:, None, ...], legs.arm)
    a_joint = cross(xp, omega[:, None, ...], spin)
    if changing is not None:
        alpha, linear = changing[:3, ...], changing[3:, ...]
        spun = spun + _times(robot.platform_inertia, _times(to_body, alpha))
        pushing = pushing + robot.platform_mass * linear + cross(xp, alpha, moment)
        a_joint = a_joint + linear[:, None, ...] + cross(xp, alpha[:, None, ...], legs.arm)
    turning = _times(legs.rotation, spun)
    if changing is not None:
        turning = turning + cross(xp, moment, changing[3:, ...])

    v_joint = moving[3:, None, ...] + spin
    theta_rate = dot(e_l, v_joint) / lever
    v_relative = v_joint - (a * theta_rate) * e_n
    centripetal = a * theta_rate * theta_rate
    theta_acceleration = (
        dot(e_l, a_joint) + centripetal * dot(e_l, legs.crank) + dot(v_relative, v_relative) / length
    ) / lever
    a_tip = (a * theta_acceleration) * e_n - centripetal * legs.crank

    # Rod without spin: angular acceleration e_l x (a_joint - a_tip) / length, its moment as a couple of end forces.
    half = (0.25 * robot.rod_mass) * (a_joint + a_tip)
    a_relative = a_joint - a_tip
    couple = (robot.rod_inertia / (length * length)) * (a_relative - dot(a_relative, e_l) * e_l)
    at_joint, at_tip = half + couple, half - couple
    own = robot.axis_inertias * theta_acceleration + a * dot(e_n, at_tip) + weights[1]
    turning = turning + xp.sum(cross(xp, legs.arm, at_joint), axis=1)
    return weights[0] + xp.concat([turning, pushing + xp.sum(at_joint, axis=1)]), own


def _through_rods(robot: Robot, legs: Legs, wrench: Array, own: Array, masked: bool) -> Array:
    """Torques (..., 6) that carry a wrench through the rods, and the cranks' own loads."""
    xp = namespace(wrench)
    lines = xp.matrix_transpose(last(xp, rod_lines(legs), 2))
    force = solve(xp, lines, last(xp, wrench, 1), masked)
    return last(xp, levers(robot, legs), 1) * force + last(xp, own, 1)


def _times(matrix: Array, vector: Array) -> Array:
    return matrix[:, 0, ...] * vector[0, ...] + matrix[:, 1, ...] * vector[1, ...] + matrix[:, 2, ...] * vector[2, ...]


def _transposed(xp: Any, matrix: Array) -> Array:
    """Of matrices (3, 3, ...)."""
    return xp.permute_dims(matrix, (1, 0, *range(2, matrix.ndim)))


def _platform_moment(legs: Legs, robot: Robot) -> Array:
    """Mass times centre of mass of the platform in B; (3, ...) [kg m]."""
    return _times(legs.rotation, robot.platform_moment)


def _in_base(xp: Any, rotation: Array, inertia: Array) -> Array:
    """R I R'; (3, 3, ...)."""
    left = [_times(rotation, inertia[:, k, ...]) for k in range(3)]
    columns = [sum(left[k] * rotation[i, k, ...] for k in range(3))[:, None, ...] for i in range(3)]
    return xp.concat(columns, axis=1)
