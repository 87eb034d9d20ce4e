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
What is common to the six motors and what is each one's own are estimated together, by a triangular factor of the
information in the form of arrows: own numbers do not meet those of other motors. Square-root information filter: G. J.
Bierman, Factorization Methods for Discrete Sequential Estimation (1977).
Forgetting goes towards the information that there was at first, and leaves the estimate: R. Kulhavy, Restricted
exponential forgetting in real-time identification (Automatica 23, 1987). So what nothing excites is kept. The push is
forgotten faster: J. E. Parkum, N. K. Poulsen, J. Holst, Recursive forgetting algorithms (Int. J. Control 55, 1992).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import fields, njit, record
from stewart_drake.control.ball_joints import JOINTS, ball_joint_parts, ball_joint_torques
from stewart_drake.control.estimator import ITERATIONS, TOLERANCE
from stewart_drake.mechanics.dynamics_laws import motion_torque
from stewart_drake.mechanics.kinematics_laws import ROBOT, crank_jacobian, forward_kinematics, legs_at
from stewart_drake.mechanics.linear_algebra import all_finite, solve

HALF = 6  # [blocks] to each side of the kernel's middle, at least two of its standard deviations.
LATE = 16  # [blocks] that a command and a reading may be late together.
ROWS = 3 * HALF + LATE + 1  # [blocks] that are remembered.
NEWEST, MIDDLE, SIGNS = ROWS - 1, ROWS - 1 - 2 * HALF, 2 * HALF + 1
OWN, COMMON, PUSH, PLACE, JOINT = 3, 8, 5, 3, 2
"""Numbers of each motor: log of its drive, damping, Coulomb; and of all: log of the head, these three, delay, and at
`PUSH` a push. After these come the head's first moment, where the centre of mass is learnt, and viscous and dry
friction of ball joints, where they are."""
SIDEWAYS = (3, 4, 2)
"""Axes of a push, in a wrench (moment, force): those that no weight has."""
SHOWN = 20
"""Numbers that are shown, see `Learnt`."""
MOST, LEAST_DAMPING, MOST_DAMPING, MOST_COULOMB, MOST_DELAY = np.log(3.0), -0.1, 0.6, 0.4, 0.05
"""Bounds: of the logarithms; as above of the torque limit; and [s]. A delay believed too long may be a damping < 0."""
SATURATED, OUTLIER = 0.9, 3.0
"""[-] of the torque limit from which on a motor counts as saturated; standard deviations from which on a sample is
somebody's push."""
ROBOT_SIZE = ROBOT.itemsize // 8
MASS, MOMENT = (int(ROBOT.fields[name][1]) // 8 for name in ("platform_mass", "platform_moment"))  # type: ignore[index]
"""Where mass and first moment of the head are in a robot's record."""


def params_of(common: int) -> np.dtype:
    """Type of the parameters, with so many common numbers.

    stride: ticks of a block. kernel: weights of smoothed value, rate and acceleration. late: those of commands, and of
    their first two derivatives. gain: torque for a command as believed. by_gain: whether a motor's gain is what its
    drive changes, else all bodies are. by_angle: whether commands are angles. damping: believed at first, servo
    included. alike: samples that count as one. first: blocks that a sample needs. keep, keep_push: shares that a
    block leaves of what was known. own, common: standard deviations at first. most_moment: of the head, beyond what is
    believed [kg m].
    """
    return fields(
        gravity=(), stride=(), kernel=(3, 2 * HALF + 1), late=(3, ROWS), gain=6, limit=6, by_gain=(), by_angle=(),
        damping=6, servo_damping=(), noise=(), alike=(), slowest=(), width=(), keep=(), keep_push=(), blend=(),
        first=(), own=OWN, common=common, most_moment=(), cautious=(), frozen=(),
    )  # fmt: skip


def state_of(common: int, joint: int) -> np.dtype:
    """Type of the state, with so many common numbers, of which these of ball joints.

    friction, robot, doubt, gain, lead, joints: stand in for constants; doubt of the Coulomb friction, 1 for that at
    first. learnt: the estimate, see `Learnt`, and half the width of its 95 % intervals; learnt_center_of_mass: of the
    head [m], and the half widths; learnt_joints: those of ball joints, viscous, dry and the half widths;
    friction_unknown: how far Coulomb and viscous friction of the motors may be from `friction`. information: rows of
    the factor of each motor, own columns, common ones, right-hand side; shared: those below. own, common: estimate;
    used: what it has gone over into. Blocks, newest last: pose, angles, commands, whether they are good; and of half a
    kernel before, what is sharp at a reversal: signs of the rates, torques of ball joints. Sums of the block under way,
    its ticks, whether it is bad; blocks so far.
    """
    return fields(
        friction=25, robot=ROBOT_SIZE, joints=JOINTS.itemsize // 8, learnt=SHOWN, learnt_half_width=SHOWN,
        learnt_center_of_mass=2 * PLACE, learnt_joints=2 * JOINT, friction_unknown=12, doubt=6, gain=6, lead=(1,),
        information=(6, OWN, OWN + common + 1), shared=(common, common + 1), own=(6, OWN), common=common,
        used_own=(6, OWN), used_common=common,
        pose=(ROWS, 6), angles=(ROWS, 6), commands=(ROWS, 6), good=ROWS, sharp=(SIGNS, 1 + joint, 6),
        sum_angles=6, sum_command=6, ticks=(), bad=(), blocks=(),
    )  # fmt: skip


@njit
def add_row(information: Any, shared: Any, row: Any) -> None:
    """Brings a row [own | common | right-hand side], which is destroyed, into a motor's factor, by rotations."""
    size = OWN + len(shared)
    for k in range(size):
        if row[k] == 0.0:
            continue
        pivot = information[k, k] if k < OWN else shared[k - OWN, k - OWN]
        length = np.hypot(pivot, row[k])
        c, s = pivot / length, row[k] / length
        for j in range(k, size + 1):
            above = information[k, j] if k < OWN else shared[k - OWN, j - OWN]
            turned = c * above + s * row[j]
            row[j] = c * row[j] - s * above
            if k < OWN:
                information[k, j] = turned
            else:
                shared[k - OWN, j - OWN] = turned


@njit
def spread_along(information: Any, shared: Any, row: Any) -> float:
    """Variance of a row [own | common] times a motor's numbers: |R^-T row|^2."""
    size, total = OWN + len(shared), 0.0
    solution = np.empty(OWN + len(shared))
    for k in range(size):
        value = row[k]
        for j in range(k):
            value -= solution[j] * (information[j, k] if j < OWN else shared[j - OWN, k - OWN])
        solution[k] = value / (information[k, k] if k < OWN else shared[k - OWN, k - OWN])
        total += solution[k] * solution[k]
    return total


@njit
def solve_arrow(information: Any, shared: Any, own: Any, common: Any) -> None:
    """Adds the least-squares solution to own (6, n) and common (m,) numbers; right-hand sides become zero."""
    size, change = len(shared), np.empty(len(shared))
    for k in range(size - 1, -1, -1):
        value = shared[k, size]
        for j in range(k + 1, size):
            value -= shared[k, j] * change[j]
        change[k] = value / shared[k, k]
        shared[k, size] = 0.0
    for k in range(size):
        common[k] += change[k]
    mine = np.empty(OWN)
    for i in range(6):
        for k in range(OWN - 1, -1, -1):
            value = information[i, k, OWN + size]
            for j in range(size):
                value -= information[i, k, OWN + j] * change[j]
            for j in range(k + 1, OWN):
                value -= information[i, k, j] * mine[j]
            mine[k] = value / information[i, k, k]
            information[i, k, OWN + size] = 0.0
        for k in range(OWN):
            own[i, k] += mine[k]


@njit
def forget(information: Any, shared: Any, keep: float, keep_push: float, sizes_own: Any, sizes_common: Any) -> None:
    """Leaves shares of the information, of the push and of all else; adds as much of that at first as is missing."""
    root, rest, row = np.sqrt(keep), np.sqrt(1.0 - keep), np.empty(OWN + len(shared) + 1)
    information *= root
    shared *= root
    for k in range(PUSH, COMMON):
        # Other variances and all correlations stay.
        information[:, :, OWN + k] *= np.sqrt(keep_push / keep)
        shared[:, k] *= np.sqrt(keep_push / keep)
    for i in range(6):
        for k in range(OWN):
            row[:] = 0.0
            row[k] = rest / sizes_own[k]
            add_row(information[i], shared, row)
    for k in range(len(shared)):
        row[:] = 0.0
        row[OWN + k] = (np.sqrt(1.0 - keep_push) if PUSH <= k < COMMON else rest) / sizes_common[k]
        add_row(information[0], shared, row)


@njit
def regression_tick(
    robot: Any, rest: Any, moments: Any, joints: Any, bodies: Any, friction: Any, params: Any, reading: Any,
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
    moving = _rows(robot, record(rest), moments, record(joints), params, legs, state, rows)
    if moving:
        forget(state.information, state.shared, params.keep, params.keep_push, params.own[:], params.common[:])
        _take(params, state, rows)
    for i in range(6):
        for k in range(OWN):
            state.used_own[i, k] += params.blend * (state.own[i, k] - state.used_own[i, k])
    for k in range(len(state.common)):
        state.used_common[k] += params.blend * (state.common[k] - state.used_common[k])
    _stand_in(params, bodies, friction, state)
    joint_count = state.sharp.shape[1] - 1
    if joint_count > 0:
        _stand_in_for_joints(params, state)
    if len(state.common) > COMMON + joint_count:
        _stand_in_for_moment(params, bodies, state)


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
    """The means of a block become the newest rows; where it is bad, or no pose has its angles, they repeat the last."""
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
        for i in range(6):
            good = good and abs(angles[i] - state.angles[NEWEST - 1, i]) < 0.5
    if good:
        for i in range(6):
            state.pose[NEWEST, i] = pose[i]
            state.angles[NEWEST, i] = angles[i]
            state.commands[NEWEST, i] = state.sum_command[i] / params.stride
    state.good[NEWEST] = 1.0 if good else 0.0
    sharp = len(state.sharp[0])
    for row in range(SIGNS - 1):
        for n in range(sharp):
            for i in range(6):
                state.sharp[row, n, i] = state.sharp[row + 1, n, i]
    for i in range(6):
        rate = 0.0
        for k in range(2 * HALF + 1):
            rate += params.kernel[1, k] * state.angles[NEWEST - 2 * HALF + k, i]
        state.sharp[SIGNS - 1, 0, i] = np.tanh(rate / params.width)
        state.sum_angles[i] = state.sum_command[i] = 0.0
    if sharp > 1:
        both, acceleration, parts = np.zeros(12), np.zeros(6), np.zeros((3, 6))
        _smoothed(params, state, NEWEST - 2 * HALF, both, acceleration)
        if legs_at(robot, both[:6], legs) < 0:
            ball_joint_parts(robot, joints, both, acceleration, legs, parts)
        for n in range(1, sharp):
            for i in range(6):
                state.sharp[SIGNS - 1, n, i] = parts[n - 1, i]
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
def _rows(robot: Any, rest: Any, moments: Any, joints: Any, params: Any, legs: Any, state: Any, rows: Any) -> bool:
    """Fills the rows (6, n) of a sample, those left out with zeros; whether any crank moves."""
    for row in range(ROWS):
        if state.good[row] == 0.0:
            return False
    both, acceleration, angles, rates = np.zeros(12), np.zeros(6), np.zeros(6), np.zeros(6)
    given, faster, sharp = np.zeros(6), np.zeros(6), np.zeros((state.sharp.shape[1], 6))
    delay, joint_count = state.common[4], state.sharp.shape[1] - 1
    places = len(state.common) - COMMON - joint_count
    of_moment = np.zeros((places, 6))
    _smoothed(params, state, MIDDLE - HALF, both, acceleration)
    for k in range(2 * HALF + 1):
        at = MIDDLE - HALF + k
        for i in range(6):
            angles[i] += params.kernel[0, k] * state.angles[at, i]
            rates[i] += params.kernel[1, k] * state.angles[at, i]
            for n in range(1 + joint_count):
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
    whole, other, moving = np.empty(6), np.empty(6), False
    jacobian, push = np.empty((6, 6)), np.zeros((6, COMMON - PUSH))
    if params.by_angle == 0.0:
        crank_jacobian(legs, jacobian)
        for k, axis in enumerate(SIDEWAYS):
            push[axis, k] = 1.0
        if solve(jacobian.T.copy(), push) == 0.0:
            return False
    if not motion_torque(robot, legs, both, acceleration, params.gravity, whole):
        return False
    motion_torque(rest, legs, both, acceleration, params.gravity, other)
    for n in range(places):
        motion_torque(record(moments[n : n + 1]), legs, both, acceleration, params.gravity, of_moment[n])
        of_moment[n] -= other
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
        whole += joint
        other += joint
    for i in range(6):
        if not abs(rates[i]) > params.slowest:
            continue
        moving = True
        torque = params.gain[i] * (given[i] - (angles[i] if params.by_angle == 1.0 else 0.0))
        if abs(torque) > SATURATED * params.limit[i]:
            continue
        own, common, unit = state.own[i], state.common, params.noise * params.limit[i]
        drive = np.exp(common[1] + own[0])
        head = drive * np.exp(common[0]) * (whole[i] - other[i])
        load = head + drive * other[i]
        for n in range(places):
            rows[i, OWN + COMMON + n] = drive * of_moment[n, i] / unit
            load += drive * common[COMMON + n] * of_moment[n, i]
        damping, coulomb = params.damping[i] + common[2] + own[1], common[3] + own[2]
        rows[i, 0] = load / unit if params.by_gain == 1.0 else 0.0
        rows[i, 1], rows[i, 2] = rates[i] / unit, sharp[0, i] / unit
        rows[i, 3], rows[i, 4], rows[i, 5], rows[i, 6] = head / unit, load / unit, rows[i, 1], rows[i, 2]
        rows[i, 7] = params.gain[i] * faster[i] / unit if params.by_angle == 1.0 else 0.0
        left = torque - load - damping * rates[i] - coulomb * sharp[0, i]
        for k in range(COMMON - PUSH):
            rows[i, OWN + PUSH + k] = push[i, k] / unit
            left -= push[i, k] * common[PUSH + k]
        for n in range(joint_count):
            rows[i, OWN + COMMON + places + n] = sharp[1 + n, i] / unit
            left -= common[COMMON + places + n] * sharp[1 + n, i]
        rows[i, OWN + len(common)] = left / unit
    return moving


@njit
def _take(params: Any, state: Any, rows: Any) -> None:
    """Brings the rows of a sample into the estimate, but those that nothing known explains."""
    taken = np.zeros(6)
    for i in range(6):
        expected = 1.0 + spread_along(state.information[i], state.shared, rows[i])
        if rows[i, 2] != 0.0 and abs(rows[i, OWN + len(state.common)]) <= OUTLIER * np.sqrt(expected):
            taken[i] = 1.0
    for i in range(6):
        if taken[i] == 1.0:
            rows[i] /= np.sqrt(params.alike)
            add_row(state.information[i], state.shared, rows[i])
    solve_arrow(state.information, state.shared, state.own, state.common)
    for k in range(2):
        state.common[k] = min(max(state.common[k], -MOST), MOST)
    state.common[4] = min(max(state.common[4], -MOST_DELAY), MOST_DELAY)
    first = len(state.common) - state.sharp.shape[1] + 1
    most = params.most_moment * np.exp(state.common[0])
    for k in range(COMMON, first):
        state.common[k] = min(max(state.common[k], -most), most)
    for k in range(first, len(state.common)):
        most = (MOST_DAMPING if k == first else MOST_COULOMB) * params.limit.max()
        state.common[k] = min(max(state.common[k], 0.0), most)


@njit
def _stand_in(params: Any, bodies: Any, friction: Any, state: Any) -> None:
    """Constants of other parts by what is used, and what is shown by the estimate."""
    common, own = state.used_common, state.used_own
    head, links = np.exp(common[0]), 1.0
    if params.by_gain == 0.0:
        links = np.exp(common[1])
        head *= links
    for k in range(ROBOT_SIZE):
        state.robot[k] = bodies[k, 0] + links * bodies[k, 1] + head * bodies[k, 2]
    for n in range(len(common) - COMMON - state.sharp.shape[1] + 1):
        state.robot[MOMENT + n] += links * common[COMMON + n]
    state.lead[0] = common[4]
    for i in range(6):
        damping, coulomb = _friction_of(params, own[i], common, i)
        if params.cautious == 1.0:
            damping *= 1.0 - _doubt(params, state, i, 1) ** 2 if damping > 0.0 else 1.0
            coulomb *= 1.0 - _doubt(params, state, i, 2) ** 2
        drive = np.exp(-(common[1] + own[i, 0])) if params.by_gain == 1.0 else 1.0
        state.gain[i] = drive * params.gain[i]
        state.friction[i] = drive * coulomb
        state.friction[6 + i] = drive * coulomb + friction[6 + i] - friction[i]
        state.friction[18 + i] = drive * damping - params.servo_damping
    common, own, row = state.common, state.own, np.zeros(OWN + len(state.common))
    mass = bodies[MASS, 2] * np.exp(common[0] + (common[1] if params.by_gain == 0.0 else 0.0))
    state.learnt[1], row[OWN + 4] = common[4], 1.0
    wide = 1.96 * np.sqrt(spread_along(state.information[0], state.shared, row))
    state.learnt_half_width[1] = wide if params.by_angle == 1.0 else 0.0
    row[:] = 0.0
    row[OWN] = 1.0
    row[OWN + 1] = 1.0 - params.by_gain
    state.learnt[0] = mass
    state.learnt_half_width[0] = 1.96 * mass * np.sqrt(spread_along(state.information[0], state.shared, row))
    for i in range(6):
        damping, coulomb = _friction_of(params, own[i], common, i)
        drive = np.exp(-(common[1] + own[i, 0]))
        size = drive if params.by_gain == 1.0 else 1.0
        of_drive = 0.0
        state.learnt[2 + i] = drive
        state.learnt[8 + i] = size * damping - params.servo_damping
        state.learnt[14 + i] = size * coulomb
        for k in range(OWN):
            row[:] = 0.0
            row[k] = row[OWN + 1 + k] = 1.0
            width = 1.96 * np.sqrt(spread_along(state.information[i], state.shared, row))
            if k == 0:
                of_drive = width if params.by_gain == 1.0 else 0.0
                state.learnt_half_width[2 + i] = width * drive
            else:
                # That of the drive is in it too.
                of_all = of_drive * (damping if k == 1 else coulomb)
                state.learnt_half_width[2 + 6 * k + i] = size * np.hypot(width, of_all)
        state.doubt[i] = _doubt(params, state, i, 2)
        state.friction_unknown[i] = state.learnt_half_width[14 + i] + abs(state.learnt[14 + i] - state.friction[i])
        of_used = state.learnt[8 + i] - state.friction[18 + i]
        state.friction_unknown[6 + i] = state.learnt_half_width[8 + i] + abs(of_used)


@njit
def _stand_in_for_joints(params: Any, state: Any) -> None:
    """Constants of the ball joints by what is used, and what is shown by the estimate."""
    row, first = np.zeros(OWN + len(state.common)), len(state.common) - JOINT
    for n in range(JOINT):
        row[:] = 0.0
        row[OWN + first + n] = 1.0
        spread, known = np.sqrt(spread_along(state.information[0], state.shared, row)), 1.0
        if params.cautious == 1.0:
            known -= min(1.0, spread / params.common[first + n]) ** 2
        used = shown = 1.0
        if params.by_gain == 1.0:
            used, shown = np.exp(-state.used_common[1]), np.exp(-state.common[1])
        state.joints[n] = known * used * state.used_common[first + n]
        state.learnt_joints[n] = shown * state.common[first + n]
        # That of the drive is in it too.
        row[OWN + 1] = -state.common[first + n] * params.by_gain
        spread = np.sqrt(spread_along(state.information[0], state.shared, row))
        state.learnt_joints[JOINT + n] = 1.96 * shown * spread


@njit
def _stand_in_for_moment(params: Any, bodies: Any, state: Any) -> None:
    """The head's centre of mass as it is shown."""
    row, links = np.zeros(OWN + len(state.common)), np.exp(state.common[1]) if params.by_gain == 0.0 else 1.0
    head = links * np.exp(state.common[0])
    for n in range(PLACE):
        moment = head * bodies[MOMENT + n, 2] + links * state.common[COMMON + n]
        row[:] = 0.0
        row[OWN + COMMON + n] = links
        # That of the mass is in it too.
        row[OWN] = -links * state.common[COMMON + n]
        state.learnt_center_of_mass[n] = moment / state.learnt[0]
        spread = np.sqrt(spread_along(state.information[0], state.shared, row))
        state.learnt_center_of_mass[PLACE + n] = 1.96 * spread / state.learnt[0]


@njit
def _doubt(params: Any, state: Any, leg: int, which: int) -> float:
    """Standard deviation of a number of a motor, over that at first."""
    row = np.zeros(OWN + len(state.common))
    row[which] = row[OWN + 1 + which] = 1.0
    first = np.hypot(params.common[1 + which], params.own[which])
    return min(1.0, np.sqrt(spread_along(state.information[leg], state.shared, row)) / first)


@njit
def _friction_of(params: Any, own: Any, common: Any, leg: int) -> Any:
    """Damping [N m s/rad] and Coulomb friction [N m] of a motor, within bounds, in units of its command's torque."""
    limit = params.limit[leg]
    damping, coulomb = params.damping[leg] + common[2] + own[1], common[3] + own[2]
    # What an earlier run has learnt, and is believed now, is not cut.
    most = max(MOST_DAMPING * limit, params.damping[leg])
    damping = min(max(damping, LEAST_DAMPING * limit), most)
    return damping, min(max(coulomb, 0.0), MOST_COULOMB * limit)
