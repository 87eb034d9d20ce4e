"""Friction and inertia of the rods' ball joints, as torques of the motors, for robots that have them.

Each rod hangs in a ball joint at its crank and in another at the platform. What a joint turns is the difference of the
angular velocities of the bodies that it joins. A rod may turn about itself, and does so that the moments of its two
joints about it are in balance, as if all friction were viscous.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.config import NotNegative, Positive, Real, Section, SixNumbers
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics_laws import twists_of_motion
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.mechanics.kinematics_laws import LEGS, cross, dot, legs_at
from stewart_drake.mechanics.linear_algebra import solve

_AHEAD = 1e-4  # [s] between two instants whose joint rates tell the joints' accelerations.
_Turn = tuple[Real, Real, Real]
SixTurns = tuple[_Turn, _Turn, _Turn, _Turn, _Turn, _Turn]
NO_TURNS: SixTurns = ((0.0, 0.0, 0.0),) * 6


class BallJoints(Section, key="model.friction.joints"):
    """Ball joints of the rods that rub, or carry an inertia of their own; by default both of a rod are alike."""

    viscous: NotNegative = 0.0
    """[N m s/rad] viscous friction of a joint."""
    coulomb: NotNegative = 0.0
    """[N m] dry friction of a joint, about each of three axes: the motor's across the rod, across both, and the rod."""
    width: Positive = 0.01
    """[rad/s] speed about an axis from which on all of the dry friction acts; below, in proportion."""
    inertia: NotNegative = 0.0
    """[kg m^2] that a joint's turning moves, such as MuJoCo's armature."""
    crank: SixNumbers = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Share of these that the joint at each crank has."""
    platform: SixNumbers = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Share of these that the joint at the platform has, of each leg."""
    crank_axes: SixTurns = NO_TURNS
    """[rad] roll, pitch, yaw by which the axes of the dry friction are turned from these in the joint at each crank."""
    platform_axes: SixTurns | None = None
    """[rad] those of the axes in the joint at the platform, of each leg, from the platform's; null for the rod's."""


JOINTS = fields(
    viscous=(), coulomb=(), width=(), inertia=(), crank=6, platform=6, turns=(2, 6, 3, 3), on_platform=()
)  # fmt: skip
"""`BallJoints` as numbers. turns: rotations of the axes at cranks and at the platform; on_platform: whether the latter
are from the platform's axes."""


def joints_record(joints: BallJoints | None) -> np.ndarray:
    """A `JOINTS` record; zeros for none."""
    if joints is None:
        return new_record(JOINTS, width=1.0)
    turns = np.array([joints.crank_axes, joints.platform_axes or NO_TURNS])
    return new_record(
        JOINTS, joints, turns=rotation_matrix(turns), on_platform=joints.platform_axes is not None
    )  # fmt: skip


@njit
def joint_rates(robot: Any, joints: Any, legs: Any, twist: Any, at_crank: Any, at_platform: Any) -> None:
    """Angular velocities (6, 3) [rad/s] of the rods against their cranks, and of the platform against its rods."""
    axis, arm, rod, tip = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(6):
        e, e_n = legs.e_l[i], legs.e_n[i]
        rate = (dot(legs.line[i, :3], twist[:3]) + dot(legs.line[i, 3:], twist[3:])) / legs.lever[i]
        cross(legs.crank[i], e_n, axis)
        cross(twist[:3], legs.arm[i], arm)
        for k in range(3):
            tip[k] = twist[3 + k] + arm[k] - robot.crank_length[i] * rate * e_n[k]
        cross(e, tip, rod)
        crank, platform = joints.crank[i], joints.platform[i]
        spin = (crank * rate * dot(axis, e) + platform * dot(twist[:3], e)) / max(crank + platform, 1e-9)
        for k in range(3):
            turning = rod[k] / robot.rod_length[i] + spin * e[k]
            at_crank[i, k] = turning - rate * axis[k]
            at_platform[i, k] = twist[k] - turning


@njit
def joint_axes(joints: Any, legs: Any, leg: int, side: int, out: Any) -> None:
    """Axes (3, 3) in B of the dry friction in a leg's joint, at its crank or on the other side."""
    e, axis, base = legs.e_l[leg], np.empty(3), np.empty((3, 3))
    cross(legs.crank[leg], legs.e_n[leg], axis)
    along = dot(axis, e)
    for k in range(3):
        axis[k] -= along * e[k]
    size = np.sqrt(dot(axis, axis))
    for k in range(3):
        base[0, k], base[2, k] = axis[k] / size, e[k]
    cross(e, base[0], base[1])
    if side == 1 and joints.on_platform == 1.0:
        for j in range(3):
            for k in range(3):
                base[j, k] = legs.rotation[k, j]
    for j in range(3):
        for k in range(3):
            out[j, k] = 0.0
            for n in range(3):
                out[j, k] += joints.turns[side, leg, n, j] * base[n, k]


@njit
def ball_joint_torques(robot: Any, joints: Any, motion: Any, acceleration: Any, legs: Any, out: Any) -> None:
    """Adds to torques (6,) [N m] what the joints ask for along a motion (12,) pose and rate, acceleration (6,).

    Nothing is added where the pose is out of reach or singular.
    """
    parts = np.zeros((3, 6))
    ball_joint_parts(robot, joints, motion, acceleration, legs, parts)
    for i in range(6):
        out[i] += joints.viscous * parts[0, i] + joints.coulomb * parts[1, i] + joints.inertia * parts[2, i]


@njit
def _rates_at(robot: Any, joints: Any, motion: Any, scratch: Any, out: Any) -> bool:
    """`joint_rates` (2, 6, 3) at a pose and twist (12,); False where it is out of reach."""
    legs = record(scratch)
    if legs_at(robot, motion[:6], legs) >= 0:
        return False
    joint_rates(robot, joints, legs, motion[6:], out[0], out[1])
    return True


@njit
def ball_joint_parts(robot: Any, joints: Any, motion: Any, acceleration: Any, legs: Any, out: Any) -> None:
    """Torques (3, 6) of unit viscous friction, unit dry friction and unit inertia of the joints along a motion.

    By virtual work: torques T with T . rates = sum of the joints' moments . their rates, for every twist. What the
    joints ask for is linear in the three. `out` stays where the pose is out of reach or singular.
    """
    twist, change, later, soon = np.empty(6), np.empty(6), np.empty(12), np.empty(1, LEGS)
    twists_of_motion(motion[:6], motion[6:], acceleration, twist, change)
    basis = np.empty((3, 3))
    now, then, moments = np.empty((2, 6, 3)), np.empty((2, 6, 3)), np.zeros((3, 2, 6, 3))
    joint_rates(robot, joints, legs, twist, now[0], now[1])
    for k in range(6):
        later[k] = motion[k] + _AHEAD * (motion[6 + k] + 0.5 * _AHEAD * acceleration[k])
        later[6 + k] = twist[k] + _AHEAD * change[k]
    if not _rates_at(robot, joints, later, soon, then):
        return
    for i in range(6):
        for side in range(2):
            joint_axes(joints, legs, i, side, basis)
            share = joints.crank[i] if side == 0 else joints.platform[i]
            for k in range(3):
                moments[0, side, i, k] = share * now[side, i, k]
                moments[2, side, i, k] = share * (then[side, i, k] - now[side, i, k]) / _AHEAD
            for j in range(3):
                turning = dot(now[side, i], basis[j]) / joints.width
                dry = share * min(max(turning, -1.0), 1.0)
                for k in range(3):
                    moments[1, side, i, k] += dry * basis[j, k]
    matrix, work = np.empty((6, 6)), np.zeros((6, 3))
    unit, rates = np.zeros(6), np.empty((2, 6, 3))
    for m in range(6):
        unit[:] = 0.0
        unit[m] = 1.0
        joint_rates(robot, joints, legs, unit, rates[0], rates[1])
        for i in range(6):
            for part in range(3):
                work[m, part] += dot(moments[part, 0, i], rates[0, i]) + dot(moments[part, 1, i], rates[1, i])
            # J' T = work, J' the transposed Jacobian.
            matrix[m, i] = legs.line[i, m] / legs.lever[i]
    if solve(matrix, work) == 0.0:
        return
    for part in range(3):
        for i in range(6):
            out[part, i] = work[i, part]
