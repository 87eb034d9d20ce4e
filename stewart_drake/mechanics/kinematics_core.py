"""Mechanics of the closed chain for arrays of any namespace of the Array API: numpy, torch, CPU or GPU, with gradients.

The one array implementation of (1)-(18) and of the exact dynamics. Nothing here raises for a pose: where a rod cannot
span, a crank is at its dead centre or the rods' lines lose rank, the result is finite and means nothing, and margins
say so: `Cranks.reach`, `Legs.transmission` and `determinant`. Gradients stay finite there too. The functions of
`kinematics`, `force_map` and `dynamics` are shells around these that raise by name.

Poses, rates and torques have six entries on the last axis and any axes before it. Inside, components come first, then
legs, then those other axes: a vector of each leg is (3, 6, ...). So every operation runs over long contiguous rows, and
no angle is formed but where one is asked for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from array_api_compat import device

from stewart_drake.mechanics.arrays import Array, Robot, cross, dot, first, fitted, last, namespace, stack, turned
from stewart_drake.robot.leg import crank_equation


class Cranks(NamedTuple):
    """What the crank equation gives at poses, components first.

    Attributes:
        rotation: (3, 3, ...) [-] R_BP.
        arm: (3, 6, ...) [m] platform joints relative to P, in B.
        span: (3, 6, ...) [m] from motor shaft to platform joint in B, (2).
        cosine: (6, ...) [-] of theta.
        sine: (6, ...) [-] of theta.
        transmission: (6, ...) [-] e_l . e_N; zero where a crank is at its dead centre.
        reach: (6, ...) [-] 1 - |C| / sqrt(A^2 + B^2); negative where the rod cannot span.
    """

    rotation: Array
    arm: Array
    span: Array
    cosine: Array
    sine: Array
    transmission: Array
    reach: Array


class Legs(NamedTuple):
    """Vectors of the legs at poses, all in B, components first.

    Attributes:
        rotation: (3, 3, ...) [-] R_BP.
        arm: (3, 6, ...) [m] platform joints relative to P.
        crank: (3, 6, ...) [-] along the cranks.
        e_n: (3, 6, ...) [-] along which the crank tips move for growing theta.
        e_l: (3, 6, ...) [-] along the rods, from crank tip to platform joint.
        transmission: (6, ...) [-] e_l . e_N; zero where a crank is at its dead centre.
        cranks: The `Cranks` that they come from; None where those are not at hand.
    """

    rotation: Array
    arm: Array
    crank: Array
    e_n: Array
    e_l: Array
    transmission: Array
    cranks: Any = None


def legs_at(robot: Robot, pose: Array) -> Legs:
    """Directions of cranks and rods at poses (..., 6) [rad, m]; where a rod cannot span, as near as it can."""
    cranks = cranks_at(robot, pose)
    robot = fitted(robot, pose.ndim - 1)
    c, s = cranks.cosine[None, ...], cranks.sine[None, ...]
    crank = c * robot.zeros + s * robot.quarters
    e_n = c * robot.quarters - s * robot.zeros
    e_l = (cranks.span - robot.cranks * crank) / robot.rods
    return Legs(cranks.rotation, cranks.arm, crank, e_n, e_l, cranks.transmission, cranks)


def cranks_at(robot: Robot, pose: Array) -> Cranks:
    """Closed form of (1)-(6) at poses (..., 6) [rad, m].

    Deviation: (5) rotates G as well, a misplaced bracket; (6) gives one branch in degrees without A, B, C. Here
    theta_i = atan2(B, A) + branch * acos(C / sqrt(A^2 + B^2)), whose cosine and sine need no angle.
    """
    xp = namespace(pose)
    robot = fitted(robot, pose.ndim - 1)
    turn, arm, span = spans(robot, pose)
    along, up, constant, square, size, reach = _crank_circle(xp, robot, span)
    constant = xp.minimum(xp.maximum(constant, -size), size)
    inside = (size - constant) * (size + constant)
    turning = inside > 0.0
    root = xp.where(turning, robot.branches * xp.sqrt(xp.where(turning, inside, 1.0)), 0.0)
    cosine = (along * constant - up * root) / square
    sine = (up * constant + along * root) / square
    return Cranks(turn, arm, span, cosine, sine, root * (-0.5 / (robot.cranks * robot.rods)), reach)


def spans(robot: Robot, pose: Array) -> tuple[Array, Array, Array]:
    """R (3, 3, ...), R p_i and d_i = R p_i + G - P_i, both (3, 6, ...) [m]; (2), of a robot that is `fitted`."""
    xp = namespace(pose)
    turn = rotation(pose)
    arm = turned(turn, robot.joints)
    # Beyond 1e100 m squares would leave floating point; nothing reaches either.
    place = xp.clip(linear(xp, pose), -1e100, 1e100)
    return turn, arm, arm + (place[:, None, ...] - robot.shafts)


def reach_margin(robot: Robot, pose: Array) -> Array:
    """`Cranks.reach` alone, at less cost."""
    robot = fitted(robot, pose.ndim - 1)
    return _crank_circle(namespace(pose), robot, spans(robot, pose)[2])[-1]


def _crank_circle(xp: Any, robot: Robot, span: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """A, B, C of the crank equation, A^2 + B^2 and its root, 1 where zero, and the reach; all (6, ...)."""
    along, up, constant = crank_equation(span, robot.zeros, robot.quarters, robot.cranks, robot.rods)
    square = along * along + up * up
    known = square > 0.0
    square = xp.where(known, square, 1.0)
    size = xp.sqrt(square)
    ratio = xp.where(known, xp.abs(constant) / size, xp.inf)
    return along, up, constant, square, size, 1.0 - ratio


def rotation(pose: Array) -> Array:
    """R_BP (3, 3, ...) of poses or angles (..., 3 or 6), the inverse of (3).

    Deviation: entry (3,1) of the print is a misprint; this is the matrix that it means.
    """
    xp = namespace(pose)
    roll, pitch, yaw = (pose[..., k] for k in range(3))
    sr, sp, sy, cr, cp, cy = xp.sin(roll), xp.sin(pitch), xp.sin(yaw), xp.cos(roll), xp.cos(pitch), xp.cos(yaw)
    entries = (
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp, cp * sr, cp * cr,
    )  # fmt: skip
    return xp.reshape(stack(xp, entries), (3, 3, *roll.shape))


def rod_lines(legs: Legs) -> Array:
    """Columns [(R p_i) x e_l; e_l]: the rods as unit lines in Pluecker coordinates, (14); (6, 6, ...) [m, -]."""
    xp = namespace(legs.e_l)
    return xp.concat([cross(xp, legs.arm, legs.e_l), legs.e_l])


def determinant(legs: Legs) -> Array:
    """Of the rods' lines (...); zero at a parallel singularity, where `inverse_dynamics` means nothing."""
    xp = namespace(legs.e_l)
    return xp.linalg.det(last(xp, rod_lines(legs), 2))


def angular_velocity(pose: Array, rate: Array) -> Array:
    """W (3, ...) [rad/s] in B of Euler rates at poses (..., 6)."""
    xp = namespace(pose, rate)
    sp, cp, sy, cy = xp.sin(pose[..., 1]), xp.cos(pose[..., 1]), xp.sin(pose[..., 2]), xp.cos(pose[..., 2])
    roll, pitch, yaw = (rate[..., k] for k in range(3))
    level = cp * roll
    return stack(xp, (cy * level - sy * pitch, sy * level + cy * pitch, yaw - sp * roll))


def twist(pose: Array, rate: Array) -> Array:
    """[w, v] (6, ...) in B of the pose's rates (..., 6)."""
    xp = namespace(pose, rate)
    return xp.concat([angular_velocity(pose, rate), linear(xp, rate)])


def angular_drift(pose: Array, rate: Array) -> Array:
    """What Euler rates that do not change add to dw/dt; (3, ...) [rad/s^2]."""
    xp = namespace(pose, rate)
    sp, cp, sy, cy = xp.sin(pose[..., 1]), xp.cos(pose[..., 1]), xp.sin(pose[..., 2]), xp.cos(pose[..., 2])
    roll, pitch, yaw = (rate[..., k] for k in range(3))
    sink, swing = sp * pitch * roll, yaw * (cp * roll)
    return stack(
        xp, (-cy * sink - sy * swing - cy * yaw * pitch, -sy * sink + cy * swing - sy * yaw * pitch, -cp * pitch * roll)
    )


def euler_rates(pose: Array, omega: Array) -> Array:
    """Euler rates (3, ...) of angular velocities (3, ...), or of what else turns like them; pitch off +-pi/2."""
    xp = namespace(pose, omega)
    sp, cp, sy, cy = xp.sin(pose[..., 1]), xp.cos(pose[..., 1]), xp.sin(pose[..., 2]), xp.cos(pose[..., 2])
    roll = (cy * omega[0, ...] + sy * omega[1, ...]) / cp
    return stack(xp, (roll, cy * omega[1, ...] - sy * omega[0, ...], omega[2, ...] + sp * roll))


def crank_angles(cranks: Cranks) -> Array:
    """Crank angles (..., 6) [rad] in (-pi, pi]."""
    xp = namespace(cranks.sine)
    return last(xp, xp.atan2(cranks.sine, cranks.cosine), 1)


def newton_step(rows: Array, error: Array, pose: Array, masked: bool = True) -> Array:
    """Pose (..., 6) after a step of Newton's method on the rod lengths, with `rod_errors` at the pose before it.

    A full step from a poor guess can tumble the platform; half a radian and 0.2 m keep it in one piece.
    """
    xp = namespace(error, pose)
    step = solve(xp, rows, error, masked)
    scale = xp.maximum(
        xp.max(xp.abs(step[..., :3]), axis=-1, keepdims=True) / 0.5,
        xp.max(xp.abs(step[..., 3:]), axis=-1, keepdims=True) / 0.2,
    )
    return pose - step / xp.where(scale > 1.0, scale, 1.0)


def rod_errors(robot: Robot, theta: Array, pose: Array) -> tuple[Array, Array]:
    """Derivative by the pose (..., 6, 6) and error (..., 6) [m] of the rods' lengths at crank angles (..., 6)."""
    xp = namespace(theta, pose)
    robot = fitted(robot, pose.ndim - 1)
    _, arm, span = spans(robot, pose)
    angle = first(xp, theta, 1)
    rod = span - (robot.cranks * xp.cos(angle)) * robot.zeros - (robot.cranks * xp.sin(angle)) * robot.quarters
    length = xp.sqrt(dot(rod, rod))
    along = rod / length
    turning = _by_euler_rates(xp, cross(xp, arm, along), pose)
    return last(xp, xp.concat([turning, along]), 2), last(xp, length - robot.rods, 1)


def twist_jacobian(robot: Robot, legs: Legs, masked: bool = True) -> Array:
    """d(theta)/d(twist), components first: (6, 6 legs, ...) [-, rad/m]."""
    return rod_lines(legs) / divisor(robot, legs, masked)


def pose_jacobian(robot: Robot, legs: Legs, pose: Array, masked: bool = True) -> Array:
    """d(theta)/d(pose) in Euler angles, components first: (6, 6 legs, ...) [-, rad/m]."""
    xp = namespace(pose)
    jacobian = twist_jacobian(robot, legs, masked)
    return xp.concat([_by_euler_rates(xp, jacobian[:3, ...], pose), jacobian[3:, ...]])


def solve(xp: Any, matrix: Array, right: Array, masked: bool) -> Array:
    """Solution (..., 6) of systems (..., 6, 6) with right sides (..., 6); of no meaning where `masked` and singular."""
    if masked:
        determinants = xp.linalg.det(matrix)
        singular = (determinants == 0.0) | ~xp.isfinite(determinants)
        matrix = xp.where(singular[..., None, None], xp.eye(6, dtype=matrix.dtype, device=device(matrix)), matrix)
    return xp.linalg.solve(matrix, right[..., None])[..., 0]


def levers(robot: Robot, legs: Legs) -> Array:
    """|a| e_l . e_N (6, ...) [m]: torque of a motor over force in its rod."""
    return fitted(robot, legs.transmission.ndim - 1).cranks * legs.transmission


def divisor(robot: Robot, legs: Legs, masked: bool) -> Array:
    """`levers` to divide by."""
    lever = levers(robot, legs)
    if not masked:
        return lever
    xp = namespace(lever)
    return xp.where(lever == 0.0, 1.0, lever)


def linear(xp: Any, pose: Array) -> Array:
    """X, Y, Z of what has six entries on the last axis; (3, ...)."""
    return stack(xp, (pose[..., 3], pose[..., 4], pose[..., 5]))


def _by_euler_rates(xp: Any, moments: Array, pose: Array) -> Array:
    """Moments (3, 6, ...), which act on angular velocity, as what acts on Euler rates."""
    sp, cp, sy, cy = xp.sin(pose[..., 1]), xp.cos(pose[..., 1]), xp.sin(pose[..., 2]), xp.cos(pose[..., 2])
    x, y, z = (moments[k, ...] for k in range(3))
    return stack(xp, (cp * (cy * x + sy * y) - sp * z, cy * y - sy * x, z))
