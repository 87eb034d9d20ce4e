"""The regression by which a robot learns its motors, its head and its ball joints while it moves, compiled.

A motor's command is itself the sensor of its torque: that of a motor which takes torques, and of a servo its stiffness
times (command - angle). With Y the exact inverse dynamics of the motion that was read, of head and of all else,

    command_i(t - delay) = exp(drive + own_i) (exp(head) Y_head_i + moment Y_moment_i + Y_rest_i) + damping_i rate_i
                           + coulomb_i tanh(rate_i / width) + viscous Y_viscous_i + dry Y_dry_i + push J^-1_i

in torques that the motors are believed to give for it. `moment` is there where the centre of mass is learnt: by how
much mass times centre of mass of the head is another. The last two are there where ball joints are learnt: what the
motors give for a unit of friction in all of these, see `ball_joints`. `push` is the wrench that motors give against
somebody who pushes sideways; it would be taken for friction, and no other part uses it. A push from above is taken for
a load. Servos give way to a push, so there it is left out. All terms pass one Gaussian kernel, and what changes at a
reversal passes it too: the sign of the rate, and the ball joints' torques.
`arrow_factor` brings samples into one estimate, and `learnt_laws` makes constants of other parts of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import fields, njit, record
from stewart_drake.control.arrow_factor import (
    COMMON,
    JOINT,
    OWN,
    PLACE,
    PUSH,
    SIDEWAYS,
    add_row,
    forget,
    hold_between,
    solve_arrow,
    spread_along,
)
from stewart_drake.control.ball_joints import JOINTS, ball_joint_parts, ball_joint_torques
from stewart_drake.control.estimator import ITERATIONS, TOLERANCE
from stewart_drake.control.learnt_laws import MOST_COULOMB, MOST_DAMPING, ROBOT_SIZE, show, stand_in
from stewart_drake.mechanics.dynamics_laws import inverse_dynamics, platform_load, twists_of_motion
from stewart_drake.mechanics.friction import FRICTION
from stewart_drake.mechanics.kinematics_laws import forward_kinematics, legs_at
from stewart_drake.mechanics.linear_algebra import all_finite, solve

HALF = 6  # [blocks] to each side of the kernel's middle, at least two of its standard deviations.
LATE = 16  # [blocks] that a command and a reading may be late together.
ROWS = 3 * HALF + LATE + 1  # [blocks] that are remembered.
NEWEST, MIDDLE, SHARP = ROWS - 1, ROWS - 1 - 2 * HALF, 2 * HALF + 1
SHOWN = 20
"""Numbers that are shown, see `Learnt`."""
MOST, MOST_DELAY = np.log(3.0), 0.05
"""Bounds of the logarithms, and [s]."""
SATURATED = 0.9
"""[-] of the torque limit from which on a motor counts as saturated."""
OUTLIER, REFUSED = 3.0, 0.1
"""[-] standard deviations from which on a sample is refused as somebody's push; share of refused samples above which
that limit widens."""


def params_of(common: int) -> np.dtype:
    """Type of the parameters, with so many common numbers.

    stride: ticks of a block. kernel: weights of smoothed value, rate and acceleration. late: those of commands, and of
    their first two derivatives. gain: torque for a command as believed. by_gain: whether a motor's gain is what its
    drive changes, else all bodies are. by_angle: whether commands are angles. damping, coulomb: believed at first, the
    servo's damping included. alike: samples that count as one. first: blocks that a sample needs. seldom: blocks from
    one forgetting to the next, and of what is shown. keep, keep_push: shares of what was known that it leaves. adapt: a
    block over the time in which the limit for refused samples widens. own, common: standard deviations at first.
    most_moment: of the head, beyond what is believed [kg m].
    """
    return fields(
        gravity=(), stride=(), kernel=(3, 2 * HALF + 1), late=(3, ROWS), gain=6, limit=6, by_gain=(), by_angle=(),
        damping=6, coulomb=6, servo_damping=(), noise=(), alike=(), slowest=(), width=(), seldom=(), keep=(),
        keep_push=(), adapt=(), blend=(), first=(), own=OWN, common=common, most_moment=(), cautious=(), frozen=(),
    )  # fmt: skip


def state_of(common: int, joint: int) -> np.dtype:
    """Type of the state, with so many common numbers, of which these of ball joints.

    friction, robot, doubt, gain, lead, joints: stand in for constants; doubt of the Coulomb friction, 1 for that at
    first. learnt: the estimate, see `Learnt`, and half the width of its 95 % intervals; learnt_center_of_mass: of the
    head [m], and the half widths; learnt_joints: those of ball joints, viscous, dry and the half widths;
    friction_unknown: how far Coulomb and viscous friction of the motors may be from `friction`. information: rows of
    the factor of each motor, own columns, common ones, right-hand side; shared: those below. own, common: estimate;
    held: the same, with friction of ball joints within its bounds; used: what that has gone over into. Blocks, newest
    last: pose, angles, commands, whether they are good (1), refused (0) or missing (-1); and of half a kernel before,
    rates of the cranks, and torques of ball joints, which are sharp at a reversal. Sums of the block under way, its
    ticks, whether it is bad; blocks so far. noise_scale: factor of the limit for refused samples, and of the intervals
    up to what the first uncertainty gives.
    """
    return fields(
        friction=FRICTION, robot=ROBOT_SIZE, joints=JOINTS.itemsize // 8, learnt=SHOWN, learnt_half_width=SHOWN,
        learnt_center_of_mass=2 * PLACE, learnt_joints=2 * JOINT, friction_unknown=FRICTION, doubt=6, gain=6, lead=(1,),
        information=(6, OWN, OWN + common + 1), shared=(common, common + 1), own=(6, OWN), common=common,
        held_own=(6, OWN), held_common=common, used_own=(6, OWN), used_common=common,
        pose=(ROWS, 6), angles=(ROWS, 6), commands=(ROWS, 6), good=ROWS, sharp=(SHARP, 1 + joint, 6),
        sum_angles=6, sum_command=6, ticks=(), bad=(), blocks=(), noise_scale=(),
    )  # fmt: skip


@njit
def regression_tick(
    robot: Any, rest: Any, heads: Any, joints: Any, bodies: Any, friction: Any, params: Any, reading: Any,
    command: Any, legs: Any, state: Any,
) -> None:  # fmt: skip
    """A tick: the block under way grows; at its end all that is known of the motion in its middle is a sample."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    if params.frozen == 1.0:
        return
    _gather(robot, params, reading, command, legs, state)
    if state.ticks < params.stride:
        return
    _close_block(robot, record(joints), params, legs, state)
    if state.blocks < params.first:
        return
    rows = np.zeros((6, OWN + len(state.common) + 1))
    moving = _rows(robot, record(rest), heads, record(joints), params, legs, state, rows)
    if moving:
        if state.blocks % params.seldom == 0.0:
            forget(state.information, state.shared, params.keep, params.keep_push, params.own[:], params.common[:])
        _take(params, state, rows)
    for i in range(6):
        for k in range(OWN):
            state.used_own[i, k] += params.blend * (state.held_own[i, k] - state.used_own[i, k])
    for k in range(len(state.common)):
        state.used_common[k] += params.blend * (state.held_common[k] - state.used_common[k])
    stand_in(params, bodies, friction, state)
    if state.blocks % params.seldom == 0.0:
        show(params, bodies, state)


@njit
def _gather(robot: Any, params: Any, reading: Any, command: Any, legs: Any, state: Any) -> None:
    """Adds a tick's reading and command to the sums of its block."""
    angles = reading[:6].copy()
    if reading.size == 12 and legs_at(robot, reading[:6], legs) < 0:
        for i in range(6):
            angles[i] = np.arctan2(legs.sine[i], legs.cosine[i])
    if not (all_finite(angles) and all_finite(command)):
        state.bad = 1.0
    elif state.bad == 0.0:
        for i in range(6):
            # Within half a turn of the last block's.
            near = state.angles[NEWEST, i]
            angle = near + _within_turn(angles[i] - near)
            state.sum_angles[i] += angle
            state.sum_command[i] += angle + _within_turn(command[i] - angle) if params.by_angle == 1.0 else command[i]
    state.ticks += 1.0


@njit
def _within_turn(angle: float) -> float:
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))


@njit
def _close_block(robot: Any, joints: Any, params: Any, legs: Any, state: Any) -> None:
    """The means of a block become the newest rows, but where it is bad, or no pose has its angles, those of the last.

    A block is bad too where a crank jumps, until it is back; but not after readings that were missing.
    """
    for row in range(ROWS - 1):
        state.good[row] = state.good[row + 1]
        for i in range(6):
            state.pose[row, i] = state.pose[row + 1, i]
            state.angles[row, i] = state.angles[row + 1, i]
            state.commands[row, i] = state.commands[row + 1, i]
    good = state.bad == 0.0
    if good:
        pose = state.pose[NEWEST - 1].copy()
        angles = state.sum_angles / params.stride
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
    state.good[NEWEST] = 1.0 if good else -1.0 if missing else 0.0
    sharp = len(state.sharp[0])
    for row in range(SHARP - 1):
        for n in range(sharp):
            for i in range(6):
                state.sharp[row, n, i] = state.sharp[row + 1, n, i]
    for i in range(6):
        rate = 0.0
        for k in range(2 * HALF + 1):
            rate += params.kernel[1, k] * state.angles[NEWEST - 2 * HALF + k, i]
        state.sharp[SHARP - 1, 0, i] = rate
        state.sum_angles[i] = state.sum_command[i] = 0.0
    if sharp > 1:
        both, acceleration, parts = np.zeros(12), np.zeros(6), np.zeros((3, 6))
        _smoothed(params, state, NEWEST - 2 * HALF, both, acceleration)
        if legs_at(robot, both[:6], legs) < 0:
            ball_joint_parts(robot, joints, both, acceleration, legs, parts)
        for n in range(1, sharp):
            for i in range(6):
                state.sharp[SHARP - 1, n, i] = parts[n - 1, i]
    state.ticks = state.bad = 0.0
    state.blocks += 1.0


@njit
def _smoothed(params: Any, state: Any, first: int, motion: Any, acceleration: Any) -> None:
    """Adds to zeros pose and rate (12,), acceleration (6,) in the middle of a kernel that begins at a row."""
    for k in range(2 * HALF + 1):
        for i in range(6):
            motion[i] += params.kernel[0, k] * state.pose[first + k, i]
            motion[6 + i] += params.kernel[1, k] * state.pose[first + k, i]
            acceleration[i] += params.kernel[2, k] * state.pose[first + k, i]


@njit
def _rows(robot: Any, rest: Any, heads: Any, joints: Any, params: Any, legs: Any, state: Any, rows: Any) -> bool:
    """Fills the rows (6, n) of a sample, those left out with zeros; whether any crank moves."""
    for row in range(ROWS):
        if state.good[row] <= 0.0:
            return False
    both, acceleration, angles, rates = np.zeros(12), np.zeros(6), np.zeros(6), np.zeros(6)
    given, faster, sharp, rests = np.zeros(6), np.zeros(6), np.zeros((state.sharp.shape[1], 6)), np.zeros(6)
    delay, joint_count = state.common[4], state.sharp.shape[1] - 1
    places = len(state.common) - COMMON - joint_count
    _smoothed(params, state, MIDDLE - HALF, both, acceleration)
    for k in range(2 * HALF + 1):
        at = MIDDLE - HALF + k
        for i in range(6):
            angles[i] += params.kernel[0, k] * state.angles[at, i]
            rates[i] += params.kernel[1, k] * state.angles[at, i]
            rate = state.sharp[k, 0, i]
            rests[i] += params.kernel[0, k] if abs(rate) < params.slowest else 0.0
            sharp[0, i] += params.kernel[0, k] * np.tanh(rate / params.width)
            for n in range(1, 1 + joint_count):
                sharp[n, i] += params.kernel[0, k] * state.sharp[k, n, i]
    for row in range(ROWS):
        # Those of the delay that is known by now.
        rate = params.late[1, row] - delay * params.late[2, row]
        value = params.late[0, row] - delay * (params.late[1, row] - 0.5 * delay * params.late[2, row])
        for i in range(6):
            given[i] += value * state.commands[row, i]
            faster[i] += rate * state.commands[row, i]
    if legs_at(robot, both[:6], legs) >= 0:
        return False
    twist, twist_rate, other, moving = np.empty(6), np.empty(6), np.empty(6), False
    twists_of_motion(both[:6], both[6:], acceleration, twist, twist_rate)
    if not inverse_dynamics(rest, legs, twist, twist_rate, params.gravity, other):
        return False
    # What motors give for wrenches at the head: of its weight and inertia, of unit first moments, of unit pushes.
    first_push, wrench = 1 + places, np.empty(6)
    of_head = np.zeros((6, first_push + COMMON - PUSH))
    for n in range(first_push):
        head = record(heads[n : n + 1])
        platform_load(head, legs.rotation[:], twist, twist_rate, params.gravity, wrench)
        of_head[:, n] = wrench
    if params.by_angle == 0.0:
        for k, axis in enumerate(SIDEWAYS):
            of_head[axis, first_push + k] = 1.0
    # Not singular, or there were no inverse dynamics.
    solve(legs.line.T.copy(), of_head)
    for i in range(6):
        of_head[i] *= legs.lever[i]
    if joints.viscous > 0.0 or joints.coulomb > 0.0 or joints.inertia > 0.0:
        joint = np.zeros(6)
        if joint_count > 0:
            # What is learnt of them has passed the kernel.
            parts = np.zeros((3, 6))
            ball_joint_parts(robot, joints, both, acceleration, legs, parts)
            for i in range(6):
                joint[i] = joints.inertia * parts[2, i]
        else:
            ball_joint_torques(robot, joints, both, acceleration, legs, joint)
        other += joint
    for i in range(6):
        if not abs(rates[i]) > params.slowest:
            continue
        moving = True
        torque = params.gain[i] * (given[i] - (angles[i] if params.by_angle == 1.0 else 0.0))
        if abs(torque) > SATURATED * params.limit[i]:
            continue
        own, common = state.own[i], state.common
        drive = np.exp(common[1] + own[0])
        of_weight = drive * np.exp(common[0]) * of_head[i, 0]
        load = of_weight + drive * other[i]
        for n in range(places):
            rows[i, OWN + COMMON + n] = drive * of_head[i, 1 + n]
            load += drive * common[COMMON + n] * of_head[i, 1 + n]
        damping, coulomb = params.damping[i] + common[2] + own[1], common[3] + own[2]
        rows[i, 0] = load if params.by_gain == 1.0 else 0.0
        rows[i, 1], rows[i, 2] = rates[i], sharp[0, i]
        rows[i, 3], rows[i, 4], rows[i, 5], rows[i, 6] = of_weight, load, rates[i], sharp[0, i]
        rows[i, 7] = params.gain[i] * faster[i] if params.by_angle == 1.0 else 0.0
        left = torque - load - damping * rates[i] - coulomb * sharp[0, i]
        for k in range(COMMON - PUSH):
            rows[i, OWN + PUSH + k] = of_head[i, first_push + k]
            left -= of_head[i, first_push + k] * common[PUSH + k]
        for n in range(joint_count):
            rows[i, OWN + COMMON + places + n] = sharp[1 + n, i]
            left -= common[COMMON + places + n] * sharp[1 + n, i]
        rows[i, OWN + len(common)] = left
        # While a crank rests, its dry friction may be anything up to its level.
        level = np.sqrt(coulomb**2 + state.doubt[i] ** 2 * (params.common[3] ** 2 + params.own[2] ** 2))
        rows[i] /= np.hypot(params.noise * params.limit[i], rests[i] * level)
    return moving


@njit
def _take(params: Any, state: Any, rows: Any) -> None:
    """Brings the rows of a sample into the estimate, but those that nothing known explains."""
    taken, seen = np.zeros(6), 0.0
    for i in range(6):
        if rows[i, 2] != 0.0:
            expected = state.noise_scale * np.sqrt(1.0 + spread_along(state.information[i], state.shared, rows[i]))
            taken[i] = 1.0 if abs(rows[i, OWN + len(state.common)]) <= OUTLIER * expected else 0.0
            seen += 1.0
    if seen > 0.0:
        # Stochastic approximation of a quantile. Else an estimate that is wrong and sure of itself stays.
        more = (1.0 - taken.sum() / seen - REFUSED) / (1.0 - REFUSED)
        state.noise_scale = max(1.0, state.noise_scale * np.exp(params.adapt * more))
    for i in range(6):
        if taken[i] == 1.0:
            rows[i] /= np.sqrt(params.alike)
            add_row(state.information[i], state.shared, rows[i])
    solve_arrow(state.information, state.shared, state.own, state.common)
    first = len(state.common) - state.sharp.shape[1] + 1
    _bound(params, state.common[:first])
    state.held_own[:], state.held_common[:] = state.own, state.common
    if first < len(state.common):
        # Were the estimate itself held there, each sample would bend what is known of the motors.
        most = params.limit.max() * np.array([MOST_DAMPING, MOST_COULOMB])
        hold_between(state.information, state.shared, state.held_own, state.held_common, most)
        _bound(params, state.held_common[:first])


@njit
def _bound(params: Any, common: Any) -> None:
    """Keeps logarithms, delay and first moment of the head within their bounds."""
    for k in range(2):
        common[k] = min(max(common[k], -MOST), MOST)
    common[4] = min(max(common[4], -MOST_DELAY), MOST_DELAY)
    most = params.most_moment * np.exp(common[0])
    for k in range(COMMON, len(common)):
        common[k] = min(max(common[k], -most), most)
