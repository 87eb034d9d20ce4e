"""Recursive least squares for parameters of motors, head and ball joints while the robot moves, compiled.

No torque is measured. A motor's torque follows from its command: it is the command itself, or for a servo the stiffness
times (command - angle). With torques Y from the inverse dynamics of the measured motion, separately for the head and
for all other bodies, motor i obeys

    torque_i(t - delay) = exp(drive + drive_i) (exp(head) Y_head_i + moment Y_moment_i + Y_other_i)
                          + (damping + damping_i) rate_i + (coulomb + coulomb_i) tanh(rate_i / width)
                          + viscous Y_viscous_i + dry Y_dry_i + push J^-1_i

exp(head) is a factor of the head's mass, exp(drive + drive_i) of all torques of the bodies. `moment` is the change of
the head's first moment, estimated only if the centre of mass is learnt. `viscous` and `dry` are the friction of the
ball joints, estimated only if this friction is learnt. `push` is the wrench that the motors apply against a person who
pushes sideways. Without it, the push would be estimated as friction; no other part uses it. A vertical push cannot be
told from a heavier head. Servos yield to a push, so it is left out for them.

Both sides are smoothed by the same Gaussian kernel. The sign of the rate and the torques of the ball joints jump when a
crank reverses: they are computed from smoothed motion, and then smoothed too. `square_root_filter` updates the
estimate, `learnt_parameters` writes parameters of other parts.
"""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Vec6, Vec12, Vector, record
from stewart_drake.control.ball_joints import Joints, ball_joint_parts, ball_joint_torques
from stewart_drake.control.estimator import ITERATIONS, TOLERANCE
from stewart_drake.control.learnt_parameters import MOST_COULOMB, MOST_DAMPING, update_intervals, write_parameters
from stewart_drake.control.regression_records import (
    HALF,
    KERNEL,
    MIDDLE,
    MOMENT,
    N_WRENCH,
    NEWEST,
    ROWS,
    SIDE_PUSH,
    WEIGHT,
    RegressionParams,
    RegressionState,
    Sample,
    joint_unknowns,
    moment_unknowns,
)
from stewart_drake.control.square_root_filter import (
    COULOMB,
    DAMPING,
    DELAY,
    DRIVE,
    HEAD,
    MOTOR_COULOMB,
    MOTOR_DAMPING,
    MOTOR_DRIVE,
    N_JOINT,
    N_MOMENT,
    N_MOTOR,
    N_SHARED,
    PUSH,
    SIDEWAYS,
    add_row,
    apply_correction,
    constrain_last_two,
    forget,
    variance_along,
)
from stewart_drake.mechanics.dynamics_laws import inverse_dynamics, platform_load, twists_of_motion
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, forward_kinematics, legs_at
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, largest_size, solve

MAX_LOG_RATIO = np.log(3.0)  # [-] bound on the logarithms `head` and `drive`.
MAX_DELAY = 0.05  # [s] bound on the delay.
SATURATED = 0.9  # Share of the torque limit above which a motor counts as saturated.
OUTLIER = 3.0  # [standard deviations] residual above which a row is rejected as an outlier, such as a person's push.
REJECTED = 0.1  # Share of rejected rows above which the limit for outliers widens.


@njit
def regression_tick(
    robot: Robot,
    rest: Robot,
    joints: Joints,
    friction: Friction,
    params: RegressionParams,
    reading: Vector,
    command: Vec6,
    legs: Legs,
    sample: Sample,
    state: RegressionState,
) -> None:
    """One tick: adds reading and command to the present block. Every complete block gives one sample.

    The sample is the smoothed motion in the middle of the kernel, several blocks ago. `robot`, `joints` and `friction`
    are those of the model; `rest` is the rest of the robot, without the head. A reading has the angles (6,) [rad] of
    the cranks, or pose and rate (12,).
    """
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    if params.frozen == 1.0:
        return
    _gather(robot, params, reading, command, legs, state)
    if state.ticks < params.stride:
        return
    _close_block(robot, record(joints), params, legs, state)
    if state.blocks < params.first:
        return
    rows = np.zeros((6, N_MOTOR + len(state.shared) + 1))
    if sample_rows(robot, record(rest), record(joints), params, legs, record(sample), state, rows):
        if state.blocks % params.report_period == 0.0:
            forget(
                state.motor_rows,
                state.shared_rows,
                params.keep,
                params.keep_push,
                params.motor_sigma[:],
                params.shared_sigma[:],
            )
        _update(params, state, rows)
    for i in range(6):
        for k in range(N_MOTOR):
            state.applied_per_motor[i, k] += params.blend * (
                state.bounded_per_motor[i, k] - state.applied_per_motor[i, k]
            )
    for k in range(len(state.shared)):
        state.applied_shared[k] += params.blend * (state.bounded_shared[k] - state.applied_shared[k])
    write_parameters(params, robot, friction, state)
    if state.blocks % params.report_period == 0.0:
        update_intervals(params, robot, state)


@njit
def _gather(
    robot: Robot, params: RegressionParams, reading: Vector, command: Vec6, legs: Legs, state: RegressionState
) -> None:
    """Adds a tick's reading and command to the sums of its block."""
    angles = reading[:6].copy()
    if reading.size == 12 and legs_at(robot, reading[:6], legs) < 0:
        for i in range(6):
            angles[i] = np.arctan2(legs.sine[i], legs.cosine[i])
    if not (all_finite(angles) and all_finite(command)):
        state.bad = 1.0
    elif state.bad == 0.0:
        for i in range(6):
            # Whole turns are removed: the angle is within half a turn of its mean over the last block.
            near = state.angles[NEWEST, i]
            angle = near + _within_turn(angles[i] - near)
            state.sum_angles[i] += angle
            state.sum_command[i] += angle + _within_turn(command[i] - angle) if params.by_angle == 1.0 else command[i]
    state.ticks += 1.0


@njit
def _within_turn(angle: float) -> float:
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))


@njit
def _close_block(robot: Robot, joints: Joints, params: RegressionParams, legs: Legs, state: RegressionState) -> None:
    """Appends the means of the complete block; a bad block repeats the means of the block before.

    A block is bad if a reading or command was not finite, if no pose has its angles, or if a crank jumped by 0.5 rad
    from the block before. After missing readings a jump is accepted.
    """
    for row in range(ROWS - 1):
        state.good[row] = state.good[row + 1]
        for i in range(6):
            state.pose[row, i] = state.pose[row + 1, i]
            state.angles[row, i] = state.angles[row + 1, i]
            state.commands[row, i] = state.commands[row + 1, i]
    good = state.bad == 0.0
    if good:
        pose, angles = state.pose[NEWEST - 1].copy(), np.empty(6)
        for i in range(6):
            angles[i] = state.sum_angles[i] / params.stride
        error, _ = forward_kinematics(robot, angles, pose, TOLERANCE, ITERATIONS)
        good = error <= TOLERANCE
        if state.good[NEWEST - 1] >= 0.0:
            for i in range(6):
                good = good and abs(angles[i] - state.angles[NEWEST - 1, i]) < 0.5
        if good:
            for i in range(6):
                state.pose[NEWEST, i] = pose[i]
                state.angles[NEWEST, i] = angles[i]
                state.commands[NEWEST, i] = state.sum_command[i] / params.stride
    missing = state.bad == 1.0 or state.good[NEWEST - 1] < 0.0
    # See `RegressionState.good` for these three values.
    state.good[NEWEST] = 1.0 if good else -1.0 if missing else 0.0
    _append_unsmoothed(robot, joints, params, legs, state)
    for i in range(6):
        state.sum_angles[i] = state.sum_command[i] = 0.0
    state.ticks = state.bad = 0.0
    state.blocks += 1.0


@njit
def _append_unsmoothed(
    robot: Robot, joints: Joints, params: RegressionParams, legs: Legs, state: RegressionState
) -> None:
    """Appends the cranks' rates and the ball joints' torques at the middle time of the newest kernel."""
    signals = 1 + joint_unknowns(state)
    for row in range(KERNEL - 1):
        for n in range(signals):
            for i in range(6):
                state.unsmoothed[row, n, i] = state.unsmoothed[row + 1, n, i]
    for i in range(6):
        rate = 0.0
        for k in range(KERNEL):
            rate += params.kernel[1, k] * state.angles[NEWEST - 2 * HALF + k, i]
        state.unsmoothed[KERNEL - 1, 0, i] = rate
    if signals > 1:
        motion, acceleration, parts = np.zeros(12), np.zeros(6), np.zeros((3, 6))
        _add_smoothed(params, state, NEWEST - 2 * HALF, motion, acceleration)
        if legs_at(robot, motion[:6], legs) < 0:
            ball_joint_parts(robot, joints, motion, acceleration, legs, parts)
        for n in range(1, signals):
            for i in range(6):
                state.unsmoothed[KERNEL - 1, n, i] = parts[n - 1, i]


@njit
def _add_smoothed(
    params: RegressionParams, state: RegressionState, first: int, motion: Vec12, acceleration: Vec6
) -> None:
    """Adds pose and rate (12,) and acceleration (6,) in the middle of a kernel that begins at a row."""
    for k in range(KERNEL):
        for i in range(6):
            motion[i] += params.kernel[0, k] * state.pose[first + k, i]
            motion[6 + i] += params.kernel[1, k] * state.pose[first + k, i]
            acceleration[i] += params.kernel[2, k] * state.pose[first + k, i]


@njit
def sample_rows(
    robot: Robot,
    rest: Robot,
    joints: Joints,
    params: RegressionParams,
    legs: Legs,
    sample: Sample,
    state: RegressionState,
    rows: Matrix,
) -> bool:
    """Fills the equations (6, n) of a sample, zeros for motors that give none; True if any crank moves."""
    for row in range(ROWS):
        if state.good[row] <= 0.0:
            return False
    _smooth(params, state, sample)
    if legs_at(robot, sample.motion[:6], legs) >= 0:
        return False
    if not _needed_torques(robot, rest, joints, params, legs, sample, joint_unknowns(state) > 0):
        return False
    moving = False
    for i in range(6):
        if abs(sample.rates[i]) > params.slowest:
            moving = True
            angle = sample.angles[i] if params.by_angle == 1.0 else 0.0
            torque = params.gain[i] * (sample.command[i] - angle)
            if not abs(torque) > SATURATED * params.limit[i]:
                _fill_row(params, sample, state, i, torque, rows[i])
    return moving


@njit
def _smooth(params: RegressionParams, state: RegressionState, sample: Sample) -> None:
    """Smooths motion, commands, signs of the rates and torques of the ball joints, in the middle of the kernel."""
    for i in range(6):
        sample.motion[i] = sample.motion[6 + i] = sample.acceleration[i] = sample.angles[i] = sample.rates[i] = 0.0
        sample.command[i] = sample.command_rate[i] = sample.sign[i] = sample.at_rest[i] = 0.0
        for n in range(N_JOINT):
            sample.joint_torque[n, i] = 0.0
    _add_smoothed(params, state, MIDDLE - HALF, sample.motion[:], sample.acceleration[:])
    for k in range(KERNEL):
        weight, at = params.kernel[0, k], MIDDLE - HALF + k
        for i in range(6):
            sample.angles[i] += weight * state.angles[at, i]
            sample.rates[i] += params.kernel[1, k] * state.angles[at, i]
            rate = state.unsmoothed[k, 0, i]
            sample.at_rest[i] += weight if abs(rate) < params.slowest else 0.0
            sample.sign[i] += weight * np.tanh(rate / params.width)
            for n in range(joint_unknowns(state)):
                sample.joint_torque[n, i] += weight * state.unsmoothed[k, 1 + n, i]
    delay = state.shared[DELAY]
    for row in range(ROWS):
        # Weights of the commands for the present estimate of the delay: Taylor series in the delay.
        rate = params.late[1, row] - delay * params.late[2, row]
        value = params.late[0, row] - delay * (params.late[1, row] - 0.5 * delay * params.late[2, row])
        for i in range(6):
            sample.command[i] += value * state.commands[row, i]
            sample.command_rate[i] += rate * state.commands[row, i]


@njit
def _needed_torques(
    robot: Robot,
    rest: Robot,
    joints: Joints,
    params: RegressionParams,
    legs: Legs,
    sample: Sample,
    joints_learnt: bool,
) -> bool:
    """Motor torques for the head, unit moments and pushes of it, and all other bodies; False at a singularity."""
    motion, other, torques = sample.motion, sample.other_torque[:], sample.wrench_torque[:]
    twist, twist_rate, wrench, lines = np.empty(6), np.empty(6), np.empty(6), np.empty((6, 6))
    twists_of_motion(motion[:6], motion[6:], sample.acceleration[:], twist, twist_rate)
    if not inverse_dynamics(rest, legs, twist, twist_rate, params.base[:], other):
        return False
    platform_load(robot, legs.rotation[:], twist, twist_rate, params.base[:], wrench)
    for k in range(6):
        torques[k, WEIGHT] = wrench[k]
    for n in range(N_MOMENT):
        _unit_moment(sample.unit_head, n)
        platform_load(sample.unit_head, legs.rotation[:], twist, twist_rate, params.base[:], wrench)
        for k in range(6):
            torques[k, MOMENT + n] = wrench[k]
    for n in range(SIDE_PUSH, N_WRENCH):
        for k in range(6):
            torques[k, n] = 1.0 if params.by_angle == 0.0 and k == SIDEWAYS[n - SIDE_PUSH] else 0.0
    for i in range(6):
        for k in range(6):
            lines[k, i] = legs.line[i, k]
    # The lines are independent: otherwise the inverse dynamics would have failed above.
    solve(lines, torques)
    for i in range(6):
        for n in range(N_WRENCH):
            torques[i, n] *= legs.lever[i]
    if joints.viscous > 0.0 or joints.coulomb > 0.0 or joints.inertia > 0.0:
        joint = np.zeros(6)
        if joints_learnt:
            # Only their inertia: their friction is unknown, and its torques are in `sample.joint_torque`.
            parts = np.zeros((3, 6))
            ball_joint_parts(robot, joints, motion[:], sample.acceleration[:], legs, parts)
            for i in range(6):
                joint[i] = joints.inertia * parts[2, i]
        else:
            ball_joint_torques(robot, joints, motion[:], sample.acceleration[:], legs, joint)
        for i in range(6):
            other[i] += joint[i]
    return True


@njit
def _unit_moment(head: Robot, axis: int) -> None:
    """Sets a head with a unit first moment along one axis, and with no mass or inertia."""
    head.platform_mass = 0.0
    for k in range(3):
        head.platform_moment[k] = 1.0 if k == axis else 0.0
        for m in range(3):
            head.platform_tensor[k, m] = 0.0


@njit
def _fill_row(
    params: RegressionParams, sample: Sample, state: RegressionState, i: int, torque: float, row: Vector
) -> None:
    """The equation of a motor: derivatives of its torque by the unknowns, then the residual torque."""
    motor, shared, moments, rate, sign = (
        state.per_motor[i],
        state.shared,
        moment_unknowns(state),
        sample.rates[i],
        sample.sign[i],
    )
    drive = np.exp(shared[DRIVE] + motor[MOTOR_DRIVE])
    weight_torque = drive * np.exp(shared[HEAD]) * sample.wrench_torque[i, WEIGHT]
    load = weight_torque + drive * sample.other_torque[i]
    for n in range(moments):
        row[N_MOTOR + N_SHARED + n] = drive * sample.wrench_torque[i, MOMENT + n]
        load += drive * shared[N_SHARED + n] * sample.wrench_torque[i, MOMENT + n]
    damping, coulomb = (
        params.damping[i] + shared[DAMPING] + motor[MOTOR_DAMPING],
        shared[COULOMB] + motor[MOTOR_COULOMB],
    )
    row[MOTOR_DRIVE] = load if params.by_gain == 1.0 else 0.0
    row[MOTOR_DAMPING], row[MOTOR_COULOMB] = rate, sign
    row[N_MOTOR + HEAD], row[N_MOTOR + DRIVE] = weight_torque, load
    row[N_MOTOR + DAMPING], row[N_MOTOR + COULOMB] = rate, sign
    row[N_MOTOR + DELAY] = params.gain[i] * sample.command_rate[i] if params.by_angle == 1.0 else 0.0
    residual = torque - load - damping * rate - coulomb * sign
    for k in range(N_SHARED - PUSH):
        row[N_MOTOR + PUSH + k] = sample.wrench_torque[i, SIDE_PUSH + k]
        residual -= sample.wrench_torque[i, SIDE_PUSH + k] * shared[PUSH + k]
    for n in range(joint_unknowns(state)):
        at = N_SHARED + moments + n
        row[N_MOTOR + at] = sample.joint_torque[n, i]
        residual -= shared[at] * sample.joint_torque[n, i]
    row[N_MOTOR + len(shared)] = residual
    # The dry friction of a resting crank can have any value up to its Coulomb friction, so it counts as noise.
    variance = params.shared_sigma[COULOMB] ** 2 + params.motor_sigma[MOTOR_COULOMB] ** 2
    level = np.sqrt(coulomb**2 + state.coulomb_uncertainty[i] ** 2 * variance)
    deviation = np.hypot(params.noise * params.limit[i], sample.at_rest[i] * level)
    for k in range(len(row)):
        row[k] /= deviation


@njit
def _update(params: RegressionParams, state: RegressionState, rows: Matrix) -> None:
    """Updates the estimate with a sample; rows with a residual above three standard deviations are rejected."""
    accepted, count, total = np.zeros(6), 0.0, 0.0
    for i in range(6):
        if rows[i, MOTOR_COULOMB] != 0.0:
            variance = 1.0 + variance_along(state.motor_rows[i], state.shared_rows, rows[i])
            expected = state.noise_scale * np.sqrt(variance)
            accepted[i] = 1.0 if abs(rows[i, N_MOTOR + len(state.shared)]) <= OUTLIER * expected else 0.0
            count += accepted[i]
            total += 1.0
    if total > 0.0:
        # Stochastic approximation of a quantile. Without it, a wrong estimate with small intervals would reject all
        # the rows that could correct it.
        excess = (1.0 - count / total - REJECTED) / (1.0 - REJECTED)
        state.noise_scale = max(1.0, state.noise_scale * np.exp(params.widening * excess))
    for i in range(6):
        if accepted[i] == 1.0:
            for k in range(rows.shape[1]):
                rows[i, k] /= np.sqrt(params.correlated)
            add_row(state.motor_rows[i], state.shared_rows, rows[i])
    apply_correction(state.motor_rows, state.shared_rows, state.per_motor, state.shared)
    first = len(state.shared) - joint_unknowns(state)
    _bound(params, state.shared[:first])
    for i in range(6):
        copy_to(state.bounded_per_motor[i], state.per_motor[i])
    copy_to(state.bounded_shared[:], state.shared)
    if joint_unknowns(state) == N_JOINT:
        # Bounds on the ball joints' friction apply to a copy: on the estimate itself, they would bias the motors'
        # parameters at every sample.
        most, limit = np.empty(2), largest_size(params.limit[:])
        most[0], most[1] = limit * MOST_DAMPING, limit * MOST_COULOMB
        constrain_last_two(state.motor_rows, state.shared_rows, state.bounded_per_motor, state.bounded_shared, most)
        _bound(params, state.bounded_shared[:first])


@njit
def _bound(params: RegressionParams, shared: Vector) -> None:
    """Keeps logarithms, delay and first moment of the head within their bounds."""
    for k in range(HEAD, DRIVE + 1):
        shared[k] = min(max(shared[k], -MAX_LOG_RATIO), MAX_LOG_RATIO)
    shared[DELAY] = min(max(shared[DELAY], -MAX_DELAY), MAX_DELAY)
    most = params.most_moment * np.exp(shared[HEAD])
    for k in range(N_SHARED, len(shared)):
        shared[k] = min(max(shared[k], -most), most)
