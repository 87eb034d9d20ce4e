"""Records of the regression by which a robot learns while it moves, see `adaptation_laws`."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec3, Vec6, Vec9, Vec12
from stewart_drake.control.ball_joints import Joints
from stewart_drake.control.square_root_filter import N_JOINT, N_MOMENT, N_MOTOR, N_SHARED, PerMotor
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import Robot

HALF = 6  # [blocks] on each side of the kernel's middle, at least two of its standard deviations.
LATE = 16  # [blocks] that a command and a reading may be late together.
KERNEL, ROWS = 2 * HALF + 1, 3 * HALF + LATE + 1  # [blocks] in a kernel; stored.
NEWEST, MIDDLE = ROWS - 1, ROWS - 1 - 2 * HALF
WEIGHT, MOMENT, SIDE_PUSH, N_WRENCH = 0, 1, 1 + N_MOMENT, 4 + N_MOMENT
"""Indices and number of the columns of `Sample.wrench_torque`."""
BlockRows = Annotated[np.ndarray, (ROWS, 6)]
Shared = Annotated[np.ndarray, ("shared",)]


class Learnt(Record):
    """What was learnt, or half the widths of its 95 % intervals: the 20 numbers of the signal of that name."""

    mass: float  # [kg] of the head.
    delay: float  # [s] of the servos, beyond that of the model.
    drive: Vec6  # [-] torque of a motor for its command, over that of the model.
    viscous: Vec6  # [N m s/rad]
    coulomb: Vec6  # [N m]


class LearntCenter(Record):
    """Centre of mass of the head that was learnt."""

    value: Vec3  # [m] in P.
    half_width: Vec3  # [m] of the 95 % intervals.


class LearntJoints(Record):
    """Friction of the ball joints that was learnt."""

    viscous: float  # [N m s/rad]
    coulomb: float  # [N m]
    viscous_half_width: float  # [N m s/rad] of the 95 % interval.
    coulomb_half_width: float  # [N m]


class RegressionParams(Record):
    """Parameters of the regression; its size is that of the shared unknowns."""

    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    stride: float  # Ticks in a block.
    kernel: Annotated[np.ndarray, (3, KERNEL)]  # Weights of smoothed value, rate and acceleration.
    late: Annotated[np.ndarray, (3, ROWS)]  # The same for commands, which act later than readings.
    gain: Vec6  # Torque for a command, by the model.
    limit: Vec6  # [N m]
    by_gain: float  # 1 where the drive changes the gain of a motor; 0 where it changes the inertia of all bodies.
    by_angle: float  # 1 where commands are angles.
    damping: Vec6  # [N m s/rad] of the model, that of the servos included.
    coulomb: Vec6  # [N m] of the model.
    servo_damping: float  # [N m s/rad]
    noise: float  # [-] standard deviation of a sample, over the torque limit.
    correlated: float  # Samples in a row that count as one.
    slowest: float  # [rad/s] below which a crank counts as resting.
    width: float  # [rad/s] of a reversal.
    report_period: float  # Blocks from one update of the intervals, and one forgetting, to the next.
    keep: float  # Share of the information that forgetting leaves.
    keep_push: float  # The same for the push.
    widening: float  # A block over the time in which the limit for outliers widens by a factor of e.
    blend: float  # Share by which the applied numbers approach the estimate in a block.
    first: float  # Blocks before the first sample.
    motor_sigma: Annotated[np.ndarray, (N_MOTOR,)]  # Initial standard deviations of unknowns.
    shared_sigma: Shared
    most_moment: float  # [kg m] largest change of each first moment of the head.
    cautious: float  # 1 where friction is compensated only as far as it is known.
    frozen: float  # 1 where nothing is learnt.


class RegressionState(Record):
    """State of the regression; its sizes are those of shared unknowns, rows of the factor, and unsmoothed signals."""

    # Outputs: parameters of other parts, and what was learnt.
    friction: Friction
    robot: Robot
    joints: Joints
    learnt: Learnt
    learnt_half_width: Learnt
    learnt_center_of_mass: LearntCenter
    learnt_joints: LearntJoints
    friction_unknown: Friction  # Largest errors of Coulomb and viscous friction in `friction`.
    coulomb_uncertainty: Vec6  # [-] standard deviation of the Coulomb friction, over the initial one.
    gain: Vec6  # Torque of a motor for its command.
    command_lead: Annotated[np.ndarray, (1,)]  # [s] by which commands act later than the model says.
    # The filter.
    motor_rows: Annotated[np.ndarray, (6, N_MOTOR, "row")]  # Factor of the information: rows of each motor.
    shared_rows: Annotated[np.ndarray, ("shared", "shared_row")]  # Rows of the shared unknowns.
    per_motor: PerMotor  # Estimate.
    shared: Shared
    bounded_per_motor: PerMotor  # Estimate with the friction of ball joints within bounds.
    bounded_shared: Shared
    applied_per_motor: PerMotor  # What other parts get; it approaches the bounded estimate.
    applied_shared: Shared
    noise_scale: float  # [-] factor of the limit for outliers and of the intervals.
    # The last blocks, newest last.
    pose: BlockRows  # [rad, m]
    angles: BlockRows  # [rad]
    commands: BlockRows
    good: Annotated[np.ndarray, (ROWS,)]  # 1 for a good block, 0 for a rejected one, -1 for one without readings.
    # Half a kernel earlier: rates of the cranks [rad/s], then torques of ball joints of unit friction.
    unsmoothed: Annotated[np.ndarray, (KERNEL, "unsmoothed", 6)]
    # The present block.
    sum_angles: Vec6  # [rad]
    sum_command: Vec6
    ticks: float  # So far.
    bad: float  # 1 after a reading or command that is not finite.
    blocks: float  # Completed.


class Sample(Record):
    """The smoothed motion in the middle of the kernel, and the torques that it needs."""

    motion: Vec12  # [rad, m] pose and its rate.
    acceleration: Vec6
    angles: Vec6  # [rad]
    rates: Vec6  # [rad/s] of the cranks.
    command: Vec6
    command_rate: Vec6
    sign: Vec6  # tanh(rate / width), smoothed.
    at_rest: Vec6  # Share of the kernel in which a crank rests.
    joint_torque: Annotated[np.ndarray, (N_JOINT, 6)]  # [N m] for unit viscous and unit dry friction of ball joints.
    other_torque: Vec6  # [N m] for rods, cranks and inertia of ball joints.
    wrench_torque: Annotated[np.ndarray, (6, N_WRENCH)]  # For the head; per first moment [kg m]; per sideways push.
    unit_head: Robot  # A head of unit first moment; its other fields are not used.


@njit
def joint_unknowns(state: RegressionState) -> int:
    """How many unknowns the friction of ball joints has: 2 or 0."""
    return state.unsmoothed.shape[1] - 1


@njit
def moment_unknowns(state: RegressionState) -> int:
    """How many unknowns the first moment of the head has: 3 or 0."""
    return len(state.shared) - N_SHARED - joint_unknowns(state)


def state_type(shared: int, joints: int) -> type[RegressionState]:
    """The state for numbers of shared unknowns and of those of ball joints."""
    return RegressionState.sized(shared=shared, shared_row=shared + 1, row=N_MOTOR + shared + 1, unsmoothed=1 + joints)
