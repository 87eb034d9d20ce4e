"""Friction and inertia of the rods' ball joints, as motor torques.

A rod has one ball joint at its crank and one at the platform. The rate of a joint is the difference of the angular
velocities of the two bodies. A rod is free to spin about its axis; its spin is that at which the moments of its two
joints about the axis are in balance, with all friction taken as viscous.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from stewart_drake.base.config import NotNegative, Positive, Real, Section, SixNumbers
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Mat6x3, Record, Vec6, Vec12, record
from stewart_drake.mechanics.dynamics_laws import twists_of_motion
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.mechanics.kinematics_laws import LEGS, Legs, Robot, cross, dot, legs_at
from stewart_drake.mechanics.linear_algebra import solve

_AHEAD = 1e-4  # [s] between the two instants whose joint rates give the joints' accelerations.
Mat3x6 = Annotated[np.ndarray, (3, 6)]
JointRates = Annotated[np.ndarray, (2, 6, 3)]
"""Angular velocities [rad/s] of the joints at the cranks, then of those at the platform."""
_Turn = tuple[Real, Real, Real]
SixTurns = tuple[_Turn, _Turn, _Turn, _Turn, _Turn, _Turn]
NO_TURNS: SixTurns = ((0.0, 0.0, 0.0),) * 6


class BallJoints(Section, key="model.friction.joints"):
    """Friction and inertia of the rods' ball joints; by default the same in both joints of a rod."""

    viscous: NotNegative = 0.0
    """[N m s/rad] viscous friction of a joint."""
    coulomb: NotNegative = 0.0
    """[N m] dry friction about three axes: x the motor's axis projected across the rod, y across both, z the rod."""
    width: Positive = 0.01
    """[rad/s] speed about an axis above which dry friction is constant; below, it is proportional to the speed."""
    inertia: NotNegative = 0.0
    """[kg m^2] inertia of a joint, such as MuJoCo's armature."""
    crank: SixNumbers = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Factors of viscous, coulomb and inertia in the joints at the cranks."""
    platform: SixNumbers = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Factors of viscous, coulomb and inertia in the joints at the platform."""
    crank_axes: SixTurns = NO_TURNS
    """[rad] roll, pitch, yaw that turn the three axes of dry friction in the joints at the cranks."""
    platform_axes: SixTurns | None = None
    """[rad] the same in the joints at the platform, relative to the platform's axes; null for the rod's axes."""


class Joints(Record):
    """`BallJoints` as numbers."""

    viscous: float  # [N m s/rad]
    coulomb: float  # [N m]
    width: float  # [rad/s]
    inertia: float  # [kg m^2]
    crank: Vec6  # Factors of viscous, coulomb and inertia in the joints at the cranks.
    platform: Vec6  # The same for the joints at the platform.
    turns: Annotated[np.ndarray, (2, 6, 3, 3)]  # Rotations of the axes of dry friction, at cranks and platform.
    on_platform: float  # 1 if `turns` at the platform start from the platform's axes, 0 from the rod's.


def joints_record(joints: BallJoints | None) -> Joints:
    """The record of ball joints; zeros for joints without friction and inertia."""
    if joints is None:
        return Joints.new(width=1.0)
    turns = rotation_matrix(np.array([joints.crank_axes, joints.platform_axes or NO_TURNS]))
    return Joints.new(joints, turns=turns, on_platform=joints.platform_axes is not None)


@njit
def joint_rates(robot: Robot, joints: Joints, legs: Legs, twist: Vec6, at_crank: Mat6x3, at_platform: Mat6x3) -> None:
    """Angular velocities [rad/s] of the rods relative to the cranks, and of the platform relative to the rods."""
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
def joint_axes(joints: Joints, legs: Legs, leg: int, side: int, out: Mat3) -> None:
    """Axes (3, 3) in B of the dry friction in the joint of a leg: side 0 at the crank, 1 at the platform."""
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
def ball_joint_torques(robot: Robot, joints: Joints, motion: Vec12, acceleration: Vec6, legs: Legs, out: Vec6) -> None:
    """Adds the torques (6,) [N m] that the joints need along a motion: pose and rate (12,), acceleration (6,).

    Adds nothing where the pose is out of reach or singular.
    """
    parts = np.zeros((3, 6))
    ball_joint_parts(robot, joints, motion, acceleration, legs, parts)
    for i in range(6):
        out[i] += joints.viscous * parts[0, i] + joints.coulomb * parts[1, i] + joints.inertia * parts[2, i]


@njit
def _rates_at(robot: Robot, joints: Joints, motion: Vec12, legs: Legs, out: JointRates) -> bool:
    """`joint_rates` at a pose and twist (12,); False where the pose is out of reach."""
    legs = record(legs)
    if legs_at(robot, motion[:6], legs) >= 0:
        return False
    joint_rates(robot, joints, legs, motion[6:], out[0], out[1])
    return True


@njit
def ball_joint_parts(robot: Robot, joints: Joints, motion: Vec12, acceleration: Vec6, legs: Legs, out: Mat3x6) -> None:
    """Torques (3, 6) of unit viscous friction, unit dry friction and unit inertia of the joints along a motion.

    By virtual work: motor torques T with T . crank rates = sum of joint moments . joint rates, for every twist. The
    torque is linear in the three. `out` is unchanged where the pose is out of reach or singular.
    """
    twist, change, later = np.empty(6), np.empty(6), np.empty(12)
    later_legs: Any = np.empty(1, LEGS)
    twists_of_motion(motion[:6], motion[6:], acceleration, twist, change)
    basis = np.empty((3, 3))
    now, then, moments = np.empty((2, 6, 3)), np.empty((2, 6, 3)), np.zeros((3, 2, 6, 3))
    joint_rates(robot, joints, legs, twist, now[0], now[1])
    for k in range(6):
        later[k] = motion[k] + _AHEAD * (motion[6 + k] + 0.5 * _AHEAD * acceleration[k])
        later[6 + k] = twist[k] + _AHEAD * change[k]
    if not _rates_at(robot, joints, later, later_legs, then):
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
        for k in range(6):
            unit[k] = 1.0 if k == m else 0.0
        joint_rates(robot, joints, legs, unit, rates[0], rates[1])
        for i in range(6):
            for part in range(3):
                work[m, part] += dot(moments[part, 0, i], rates[0, i]) + dot(moments[part, 1, i], rates[1, i])
            # J' T = work, with J the Jacobian of the cranks.
            matrix[m, i] = legs.line[i, m] / legs.lever[i]
    if solve(matrix, work) == 0.0:
        return
    for part in range(3):
        for i in range(6):
            out[part, i] = work[i, part]
