"""Learns the motors and the head that a robot has while it moves, from commands and readings of the cranks alone.

A motor's command is itself the sensor of its torque: that of a motor which takes torques, and of a servo its stiffness
times (command - angle). With Y the exact inverse dynamics of the motion that was read, of head and of all else,

    command_i(t - delay) = exp(drive + own_i) (exp(head) Y_head_i + Y_rest_i) + damping_i rate_i
                           + coulomb_i tanh(rate_i / width)

in torques that the motors are believed to give for it. All terms pass one Gaussian kernel, the sign of the rate too.
What is common to the six motors and what is each one's own are estimated together, by a triangular factor of the
information in the form of arrows: own numbers do not meet those of other motors. Square-root information filter: G. J.
Bierman, Factorization Methods for Discrete Sequential Estimation (1977).
Forgetting goes towards the information that there was at first, and leaves the estimate: R. Kulhavy, Restricted
exponential forgetting in real-time identification (Automatica 23, 1987). So what nothing excites is kept.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.base.config import Flag, NotNegative, Positive
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.control.ball_joints import ball_joint_torques, joints_record
from stewart_drake.control.base import AdaptationOptions
from stewart_drake.control.estimator import ITERATIONS, TOLERANCE
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    ROBOT,
    forward_kinematics,
    legs_at,
    robot_record,
)
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to
from stewart_drake.robot import RobotParameters

HALF = 6  # [blocks] to each side of the kernel's middle, at least two of its standard deviations.
WIDTH = 2.2  # [blocks] of its standard deviation, as near as whole ticks allow; the fewer, the later a sample.
LATE = 16  # [blocks] that a command and a reading may be late together.
ROWS = 3 * HALF + LATE + 1  # [blocks] that are remembered.
NEWEST, MIDDLE, SIGNS = ROWS - 1, ROWS - 1 - 2 * HALF, 2 * HALF + 1
OWN, COMMON = 3, 5
"""Numbers of each motor: log of its drive, damping, Coulomb; and of all: log of the head, these three, delay."""
SHOWN = 20
"""Numbers that are shown, see `Learnt`."""
SIZE_HEAD, SIZE_DRIVE, SIZE_TORQUE, SIZE_OWN_DRIVE = 0.25, 0.35, 0.03, 0.06
"""[-] standard deviations of logarithms, before anything is learnt; torque: of motors that take one; own: how far apart
motors of a robot are."""
SIZE_DAMPING, SIZE_SERVO_DAMPING, SIZE_COULOMB, SHARE_OWN, SIZE_DELAY = 0.25, 0.03, 0.1, 0.2, 0.012
"""Likewise, [s/rad] and [-] of the torque limit; how far apart motors are, of that; [s] of a servo's delay."""
ALIKE = 0.6
"""[s] for which samples err alike, by what the model does not have: together they count as one."""
FINEST = 0.008
"""[s] smallest standard deviation of the kernel: finer, noise of the readings makes much of the acceleration."""
MOST, LEAST_DAMPING, MOST_DAMPING, MOST_COULOMB, MOST_DELAY = np.log(3.0), -0.1, 0.6, 0.4, 0.05
"""Bounds: of the logarithms; as above of the torque limit; and [s]. A delay believed too long may be a damping < 0."""
SATURATED, BLEND, BLEND_TORQUE, OUTLIER = 0.9, 0.5, 0.1, 3.0
"""[-] of the torque limit from which on a motor counts as saturated; [s] in which numbers go over into new ones, and
where a motor's torque depends on them at once; standard deviations from which on a sample is somebody's push."""


class RegressionOptions(AdaptationOptions):
    """Regression of commands on the motion that was read: head, stiffness or torque constants, damping, dry friction.

    It begins with what `model` believes. What a robot that rests, sticks, is pushed or is at its limits says does not
    count. For motors that take torques, head, rods and cranks are those in units of the torque that is commanded.
    """

    kind: Literal["regression"] = "regression"
    forgetting: Positive = 8.0
    """[s] of motion after which a sample counts 37 %."""
    reading_age: NotNegative = 0.0
    """[s] of the readings, as believed: commands and angles alone cannot tell it from the motors' delay."""
    smoothing: Positive | None = None
    """[s] standard deviation of the kernel; null for 1.5 periods, or more where the noise of the readings needs it."""
    drive: Positive | None = None
    """[-] how far stiffness or torque constants may be off, as a standard deviation; null for 0.35, and for motors that
    take torques 0.03."""
    slowest: Positive = 0.03
    """[rad/s] of a crank below which its samples are left out."""
    noise: Positive = 0.003
    """[-] standard deviation of a sample, of the motors' torque limit."""
    cautious: Flag = False
    """Whether friction is compensated only as far as it is known by now: too much of it would lose a slow loop."""
    frozen: Flag = False
    """Whether nothing is learnt: the numbers stay as they are in `model`."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        return (regression_part(self, context),)


_PARAMS = fields(
    gravity=(), stride=(), kernel=(3, 2 * HALF + 1), late=(3, ROWS), gain=6, limit=6, by_gain=(), by_angle=(),
    damping=6, servo_damping=(), noise=(), alike=(), slowest=(), width=(), keep=(), blend=(), first=(), own=OWN,
    common=COMMON, cautious=(), frozen=(),
)  # fmt: skip
"""stride: ticks of a block. kernel: weights of smoothed value, rate and acceleration. late: those of commands, and of
their first two derivatives. gain: torque for a command as believed. by_gain: whether a motor's gain is what its drive
changes, else all bodies are. by_angle: whether commands are angles. damping: believed at first, servo included. alike:
samples that count as one. first: blocks that a sample needs. keep: share that a block leaves of what was known. own,
common: standard deviations at first."""
_FRICTION = {"coulomb": slice(0, 6), "break_away": slice(6, 12), "viscous": slice(18, 24)}
_PLACES = {name: int(ROBOT.fields[name][1]) // 8 for name in ROBOT.names or ()}  # type: ignore[index]
_ROBOT = ROBOT.itemsize // 8
_LINKS = ("rod_mass", "rod_inertia", "crank_mass", "crank_inertia")
_HEAD = ("platform_mass", "platform_moment", "platform_tensor", "platform_inertia")
_MASS = _PLACES["platform_mass"]
_STATE = fields(
    friction=25, robot=_ROBOT, learnt=SHOWN, learnt_half_width=SHOWN, doubt=6, gain=6, lead=(1,),
    information=(6, OWN, OWN + COMMON + 1), shared=(COMMON, COMMON + 1), own=(6, OWN), common=COMMON,
    friction_unknown=12, used_own=(6, OWN), used_common=COMMON, pose=(ROWS, 6), angles=(ROWS, 6),
    commands=(ROWS, 6), good=ROWS, signs=(SIGNS, 6), sum_angles=6, sum_command=6, ticks=(), bad=(), blocks=(),
)  # fmt: skip
"""friction, robot, doubt, gain, lead: stand in for constants; doubt of the Coulomb friction, 1 for that at first.
learnt: the estimate, see `Learnt`, and half the width of its 95 % intervals; friction_unknown:
how far Coulomb and viscous friction may be from `friction`. information: rows of the factor of each
motor, own columns, common ones, right-hand side; shared: those below. own, common: estimate; used: what it has gone
over into. Blocks, newest last: pose, angles, commands, whether they are good, signs of the rates. Sums of the block
under way, its ticks, whether it is bad; blocks so far."""


class Learnt(NamedTuple):
    """What was learnt, or half the widths of its intervals, as a row (20,) of the signal of that name has it."""

    mass: float  # [kg] of the head.
    delay: float  # [s] by which a servo is later than was believed.
    drive: np.ndarray  # (6,) [-] torque of a motor for its command, over what was believed.
    viscous: np.ndarray  # (6,) [N m s/rad].
    coulomb: np.ndarray  # (6,) [N m].

    @classmethod
    def of(cls, row: np.ndarray) -> Learnt:
        return cls(float(row[0]), float(row[1]), row[2:8], row[8:14], row[14:20])


def rows_of(learnt: np.ndarray, half_width: np.ndarray) -> list[tuple[str, str]]:
    """What was learnt, with 95 % intervals, in lines to be read: of six motors the lowest and the highest."""
    value, width = Learnt.of(learnt), Learnt.of(half_width)
    lines = [("learnt: head", f"{value.mass:.4g} ± {width.mass:.2g} kg")]
    if width.delay > 0.0:
        lines.append(("learnt: delay, more than believed", f"{1e3 * value.delay:.3g} ± {1e3 * width.delay:.2g} ms"))
    units = {"drive": ("torque over what was believed", "1"), "viscous": ("viscous friction", "N m s/rad")}
    for name, (words, unit) in (units | {"coulomb": ("Coulomb friction", "N m")}).items():
        of, wide = getattr(value, name), getattr(width, name)
        shown = f"{of.min():.4g} to {of.max():.4g} ± {wide.max():.2g}"
        lines.append((f"learnt: {words}", shown if unit == "1" else f"{shown} {unit}"))
    return lines


def model_of(learnt: np.ndarray, robot: RobotParameters, motors: Any, friction: Any) -> dict[str, Any]:
    """Robot, motors and friction as keys of `model`: those that were believed, with what was learnt (20,)."""
    value, weaker = Learnt.of(learnt), 1.0
    keys: dict[str, Any] = {}
    viscous = value.viscous
    if motors.takes == "torque":
        weaker = 1.0 / float(value.drive.mean())
    else:
        gain = motors.gains * value.drive
        keys["motors"] = motors.with_gains(gain)
    if motors.takes == "angle":
        least = min(0.0, float(viscous.min()))
        damping = max(0.0, motors.damping + least)
        viscous = viscous + motors.damping - damping
        keys["motors"] |= {"damping": damping, "delay": max(0.0, motors.delay + value.delay)}
    more = np.subtract(friction.levels[1], friction.levels[0])
    rubs = {"coulomb": value.coulomb.tolist(), "viscous": np.maximum(viscous, 0.0).tolist()}
    keys["friction"] = {**friction.to_dict(), **rubs, "break_away": (value.coulomb + more).tolist()}
    if not more.any():
        keys["friction"]["break_away"] = None
    return keys | {"robot": {**robot.given(), **robot.heavier(value.mass / robot.platform_mass, weaker)}}


@njit
def add_row(information: Any, shared: Any, row: Any) -> None:
    """Brings a row [own | common | right-hand side] (9,), which is destroyed, into a motor's factor, by rotations."""
    size = OWN + COMMON
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
    """Variance of row (8,) times a motor's numbers: |R^-T row|^2."""
    size, total = OWN + COMMON, 0.0
    solution = np.empty(size)
    for k in range(size):
        value = row[k]
        for j in range(k):
            value -= solution[j] * (information[j, k] if j < OWN else shared[j - OWN, k - OWN])
        solution[k] = value / (information[k, k] if k < OWN else shared[k - OWN, k - OWN])
        total += solution[k] * solution[k]
    return total


@njit
def solve_arrow(information: Any, shared: Any, own: Any, common: Any) -> None:
    """Adds the least-squares solution to own (6, 3) and common (5,) numbers; right-hand sides become zero."""
    change = np.empty(COMMON)
    for k in range(COMMON - 1, -1, -1):
        value = shared[k, COMMON]
        for j in range(k + 1, COMMON):
            value -= shared[k, j] * change[j]
        change[k] = value / shared[k, k]
        shared[k, COMMON] = 0.0
    for k in range(COMMON):
        common[k] += change[k]
    mine = np.empty(OWN)
    for i in range(6):
        for k in range(OWN - 1, -1, -1):
            value = information[i, k, OWN + COMMON]
            for j in range(COMMON):
                value -= information[i, k, OWN + j] * change[j]
            for j in range(k + 1, OWN):
                value -= information[i, k, j] * mine[j]
            mine[k] = value / information[i, k, k]
            information[i, k, OWN + COMMON] = 0.0
        for k in range(OWN):
            own[i, k] += mine[k]


@njit
def forget(information: Any, shared: Any, keep: float, sizes_own: Any, sizes_common: Any) -> None:
    """Leaves a share of the information, and adds as much of that of the beginning as is missing then."""
    root, rest, row = np.sqrt(keep), np.sqrt(1.0 - keep), np.empty(OWN + COMMON + 1)
    information *= root
    shared *= root
    for i in range(6):
        for k in range(OWN):
            row[:] = 0.0
            row[k] = rest / sizes_own[k]
            add_row(information[i], shared, row)
    for k in range(COMMON):
        row[:] = 0.0
        row[OWN + k] = rest / sizes_common[k]
        add_row(information[0], shared, row)


@njit
def regression_tick(
    robot: Any, rest: Any, joints: Any, bodies: Any, friction: Any, params: Any, reading: Any, command: Any, legs: Any,
    state: Any,
) -> None:  # fmt: skip
    """A tick: the block under way grows; at its end all that is known of the motion in its middle is a sample."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    if params.frozen == 1.0:
        return
    _gather(robot, params, reading, command, legs, state)
    if state.ticks < params.stride:
        return
    _close_block(robot, params, state)
    if state.blocks < params.first:
        return
    rows = np.zeros((6, OWN + COMMON + 1))
    moving = _rows(robot, record(rest), record(joints), params, legs, state, rows)
    if moving:
        forget(state.information, state.shared, params.keep, params.own[:], params.common[:])
        _take(params, state, rows)
    for i in range(6):
        for k in range(OWN):
            state.used_own[i, k] += params.blend * (state.own[i, k] - state.used_own[i, k])
    for k in range(COMMON):
        state.used_common[k] += params.blend * (state.common[k] - state.used_common[k])
    _stand_in(params, bodies, friction, state)


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
def _close_block(robot: Any, params: Any, state: Any) -> None:
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
    for row in range(SIGNS - 1):
        for i in range(6):
            state.signs[row, i] = state.signs[row + 1, i]
    for i in range(6):
        rate = 0.0
        for k in range(2 * HALF + 1):
            rate += params.kernel[1, k] * state.angles[NEWEST - 2 * HALF + k, i]
        state.signs[SIGNS - 1, i] = np.tanh(rate / params.width)
        state.sum_angles[i] = state.sum_command[i] = 0.0
    state.ticks = state.bad = 0.0
    state.blocks += 1.0


@njit
def _rows(robot: Any, rest: Any, joints: Any, params: Any, legs: Any, state: Any, rows: Any) -> bool:
    """Fills the rows (6, 9) of a sample, those left out with zeros; whether any crank moves."""
    for row in range(ROWS):
        if state.good[row] == 0.0:
            return False
    motion, angles, rates = np.zeros((3, 6)), np.zeros(6), np.zeros(6)
    given, faster, signs = np.zeros(6), np.zeros(6), np.zeros(6)
    delay = state.common[4]
    for k in range(2 * HALF + 1):
        at = MIDDLE - HALF + k
        for i in range(6):
            angles[i] += params.kernel[0, k] * state.angles[at, i]
            rates[i] += params.kernel[1, k] * state.angles[at, i]
            signs[i] += params.kernel[0, k] * state.signs[k, i]
            for order in range(3):
                motion[order, i] += params.kernel[order, k] * state.pose[at, i]
    for row in range(ROWS):
        # Those of the delay that is known by now.
        rate = params.late[1, row] - delay * params.late[2, row]
        value = params.late[0, row] - delay * (params.late[1, row] - 0.5 * delay * params.late[2, row])
        for i in range(6):
            given[i] += value * state.commands[row, i]
            faster[i] += rate * state.commands[row, i]
    if legs_at(robot, motion[0], legs) >= 0:
        return False
    both, other, moving = np.empty(12), np.empty(6), False
    copy_to(both[:6], motion[0])
    copy_to(both[6:], motion[1])
    whole = np.empty(6)
    if not motion_torque(robot, legs, both, motion[2], params.gravity, whole):
        return False
    motion_torque(rest, legs, both, motion[2], params.gravity, other)
    if joints.viscous > 0.0 or joints.coulomb > 0.0 or joints.inertia > 0.0:
        joint = np.zeros(6)
        ball_joint_torques(robot, joints, both, motion[2], legs, joint)
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
        damping, coulomb = params.damping[i] + common[2] + own[1], common[3] + own[2]
        rows[i, 0] = load / unit if params.by_gain == 1.0 else 0.0
        rows[i, 1], rows[i, 2] = rates[i] / unit, signs[i] / unit
        rows[i, 3], rows[i, 4], rows[i, 5], rows[i, 6] = head / unit, load / unit, rows[i, 1], rows[i, 2]
        rows[i, 7] = params.gain[i] * faster[i] / unit if params.by_angle == 1.0 else 0.0
        rows[i, 8] = (torque - load - damping * rates[i] - coulomb * signs[i]) / unit
    return moving


@njit
def _take(params: Any, state: Any, rows: Any) -> None:
    """Brings the rows of a sample into the estimate, but those that nothing known explains."""
    taken = np.zeros(6)
    for i in range(6):
        expected = 1.0 + spread_along(state.information[i], state.shared, rows[i])
        if rows[i, 2] != 0.0 and abs(rows[i, OWN + COMMON]) <= OUTLIER * np.sqrt(expected):
            taken[i] = 1.0
    for i in range(6):
        if taken[i] == 1.0:
            rows[i] /= np.sqrt(params.alike)
            add_row(state.information[i], state.shared, rows[i])
    solve_arrow(state.information, state.shared, state.own, state.common)
    for k in range(2):
        state.common[k] = min(max(state.common[k], -MOST), MOST)
    state.common[4] = min(max(state.common[4], -MOST_DELAY), MOST_DELAY)


@njit
def _stand_in(params: Any, bodies: Any, friction: Any, state: Any) -> None:
    """Constants of other parts by what is used, and what is shown by the estimate."""
    common, own = state.used_common, state.used_own
    head, links = np.exp(common[0]), 1.0
    if params.by_gain == 0.0:
        links = np.exp(common[1])
        head *= links
    for k in range(_ROBOT):
        state.robot[k] = bodies[k, 0] + links * bodies[k, 1] + head * bodies[k, 2]
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
    common, own, row = state.common, state.own, np.zeros(OWN + COMMON)
    mass = bodies[_MASS, 2] * np.exp(common[0] + (common[1] if params.by_gain == 0.0 else 0.0))
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
def _doubt(params: Any, state: Any, leg: int, which: int) -> float:
    """Standard deviation of a number of a motor, over that at first."""
    row = np.zeros(OWN + COMMON)
    row[which] = row[OWN + 1 + which] = 1.0
    first = np.hypot(params.common[1 + which], params.own[which])
    return min(1.0, np.sqrt(spread_along(state.information[leg], state.shared, row)) / first)


@njit
def _friction_of(params: Any, own: Any, common: Any, leg: int) -> Any:
    """Damping [N m s/rad] and Coulomb friction [N m] of a motor, within bounds, in units of its command's torque."""
    limit = params.limit[leg]
    damping, coulomb = params.damping[leg] + common[2] + own[1], common[3] + own[2]
    damping = min(max(damping, LEAST_DAMPING * limit), MOST_DAMPING * limit)
    return damping, min(max(coulomb, 0.0), MOST_COULOMB * limit)


def kernel_weights(width: float) -> np.ndarray:
    """Weights (3, n) of a Gaussian of a standard deviation [blocks], its first two derivatives: exact for parabolas."""
    at = np.arange(-HALF, HALF + 1.0)
    bell = np.exp(-0.5 * (at / width) ** 2)
    bell /= bell.sum()
    square = bell @ at**2
    bent = bell * (at**2 - square)
    return np.stack([bell, at * bell / square, 2.0 * bent / (bent @ at**2)])


def late_weights(width: float, late: float) -> np.ndarray:
    """Weights (3, n) of commands that act `late` [blocks] after the reading of their own block, and of derivatives."""
    at = np.arange(ROWS) - MIDDLE + late
    bell = np.where(np.abs(at) <= HALF + 0.5, np.exp(-0.5 * (at / width) ** 2), 0.0)
    bell /= bell.sum()
    # What the window cuts off must not make it later.
    bell *= 1.0 - at * (bell @ at) / (bell @ at**2)
    bell /= bell.sum()
    return np.stack([bell, at * bell / width**2, (at**2 - width**2) * bell / width**4])


def regression_part(options: RegressionOptions, context: LoopContext) -> Part:
    """`reading` (6,) or (12,), `command` (6,) -> numbers that stand in for constants of other parts."""
    motors, robot, believed = context.motors, context.robot, context.compensation
    smoothing = options.smoothing
    if smoothing is None:
        # At which noise of the readings leaves a rate that is known to the width of friction's reversal.
        coarse = context.noise**2 * context.period / (4.0 * np.sqrt(np.pi) * believed.width**2)
        smoothing = max(FINEST, 1.5 * context.period, float(np.cbrt(coarse)))
    stride = max(1, round(smoothing / (WIDTH * context.period)))
    block = stride * context.period
    width, late = smoothing / block, (context.latency - 0.5 * context.period + options.reading_age) / block
    if not 1.0 <= width <= HALF / 2.0:
        raise ConfigurationError("adaptation.smoothing", smoothing, f"at least {context.period:g} s, a period")
    if late > LATE - 0.5:
        most = (LATE - 0.5) * block
        got = context.latency - 0.5 * context.period + options.reading_age
        raise ConfigurationError("adaptation.reading_age", got, f"with the delay of commands at most {most:g} s")
    limit = np.asarray(motors.available(robot, np.zeros(6)), dtype=float)
    friction = np.frombuffer(believed.part(context).constants["friction"].tobytes())
    servo_damping = getattr(motors, "damping", 0.0)
    weights = kernel_weights(width)
    per = np.array([1.0, block, block**2])[:, None]
    by_gain, by_angle = motors.takes != "torque", motors.takes == "angle"
    damping = SIZE_SERVO_DAMPING if by_angle else SIZE_DAMPING
    drive = options.drive or (SIZE_DRIVE if by_gain else SIZE_TORQUE)
    params = new_record(
        _PARAMS, gravity=context.gravity, stride=stride, kernel=weights / per, late=late_weights(width, late) / per,
        gain=motors.gains, limit=limit, by_gain=by_gain, by_angle=by_angle,
        damping=friction[_FRICTION["viscous"]] + servo_damping, servo_damping=servo_damping, noise=options.noise,
        alike=max(1.0, ALIKE / block), slowest=options.slowest, width=believed.width,
        keep=np.exp(-block / options.forgetting),
        blend=min(1.0, block / (BLEND if by_angle else BLEND_TORQUE)), first=3 * HALF + 1 + np.ceil(late),
        cautious=options.cautious, frozen=options.frozen,
        own=[SIZE_OWN_DRIVE, *(SHARE_OWN * limit.mean() * np.array([damping, SIZE_COULOMB]))],
        common=[SIZE_HEAD, drive, damping * limit.mean(), SIZE_COULOMB * limit.mean(), SIZE_DELAY],
    )  # fmt: skip
    whole = robot_record(robot)
    rest, bodies = whole.copy(), np.zeros((_ROBOT, 3))
    bodies[:, 0] = whole.view(np.float64)
    for column, names in ((1, _LINKS), (2, _HEAD)):
        for name in names:
            place = slice(_PLACES[name], _PLACES[name] + whole[name].size)
            bodies[place, column], bodies[place, 0] = bodies[place, 0], 0.0
    for name in _HEAD:
        rest[name] = 0.0
    angles = inverse_kinematics(robot, context.pose)
    coulomb = friction[_FRICTION["coulomb"]]
    first = new_record(
        _STATE, friction=friction, gain=motors.gains, robot=whole.view(np.float64), pose=context.pose, angles=angles,
        commands=motors.initial_command(context), good=1.0, doubt=1.0,
    )  # fmt: skip
    if options.cautious:
        for place in _FRICTION.values():
            first["friction"][0, place] = 0.0
    first["common"][0, 3] = first["used_common"][0, 3] = coulomb.mean()
    first["own"][0, :, 2] = first["used_own"][0, :, 2] = coulomb - coulomb.mean()
    first["learnt"] = np.concatenate([[robot.platform_mass, 0.0], np.ones(6), friction[_FRICTION["viscous"]], coulomb])
    for k in range(OWN):
        first["information"][0, :, k, k] = 1.0 / params["own"][0, k]
    for k in range(COMMON):
        first["shared"][0, k, k] = 1.0 / params["common"][0, k]
    constants = {
        "robot": whole, "rest": rest, "joints": joints_record(believed.joints), "bodies": bodies, "friction": friction,
        "params": params,
    }  # fmt: skip
    if not options.frozen:
        for k, level in enumerate(("coulomb", "viscous")):
            size = 1.96 * np.hypot(params["common"][0, 3 - k], params["own"][0, 2 - k])
            off = np.abs(friction[_FRICTION[level]] - first["friction"][0, _FRICTION[level]])
            first["friction_unknown"][0, 6 * k : 6 * k + 6] = size + off
    outputs = ["friction", "robot", "learnt", "learnt_half_width", "friction_unknown", "doubt"]
    outputs += ["gain"] if by_gain else []
    outputs += ["lead"] if by_angle else []
    inputs = {"reading": context.reading, "command": 6}
    return Part("adaptation", regression_tick, constants, inputs, tuple(outputs), first, (LEGS,))
