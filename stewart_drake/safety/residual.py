"""The torque that was asked for beside what was measured: a residual, what it speaks of, and speeds without readings.

The residual of a wrong reading shows as an acceleration of its crank alone, that of a wrong motor as a torque of its
own alone, and a push moves several cranks. R. Isermann, Fault-Diagnosis Systems, 2006, on parity equations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import fields, njit
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import motion_torque, task_inertia
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, solve

LONGEST_HALF = 10
"""Ticks of half a window at most; the state has place for so many."""
ONE_LEG_SHARE = 0.2
"""Share of the bound on a residual that is enough where it is that of one leg; assumed."""
TWO_LEGS_SHARE = 0.5
"""What the residual of two legs counts, unless it fits motors that give each other's torque: a push along an axis of
symmetry can look so."""
UNSURE_SHARE = 0.25  # Of friction that is believed, by which it may be off; assumed.
DOMINANCE = 2.0  # [-] times all others, that one or two cranks have then.
SWAPPED_WITHIN = 0.3  # Share of a residual to which two motors must give each other's torque.
_SWEEPS = 4  # Over the cranks, for friction that ends their motion.
_TOLERANCE, _ITERATIONS = 1e-12, 12  # As an estimator of readings has it, see `estimator`.
READING_WRONG, MOTOR_WEAK, MOTOR_REVERSED, MOTOR_SWAPPED = range(1, 5)

_ROWS = 2 * LONGEST_HALF + 1
RESIDUAL = fields(
    encoders=(), rubs=(), unsure=(), angles=6, poses=(_ROWS, 6), sent=(_ROWS, 6), given=6, residual=6, push=6,
    lasting=6, missing=6, lost=6, still=6, mobility=(6, 6), speed=(2, 6), bias=(2, 6), rub=(2, 6), suspect=6,
)  # fmt: skip
"""encoders: whether there are any. rubs: friction that a motor may have, unsure: by how much that may be off [N m].
angles: read last [rad]. poses, sent: read and sent in the last ticks, newest first [rad, m] and [N m]. given: mean of
what was sent [N m]. residual: that less inverse dynamics [N m]. push: acceleration of the cranks that it would make,
lasting: change of it, less friction, that lasts [rad/s^2], missing: the torques of that [N m]. lost: ticks for which a
crank counts as not read. still, mobility: torque at rest, and d(acceleration) / d(torque), of the cranks [N m,
1/(kg m^2)]. Of two estimates, fast and slow, speed: of the cranks [rad/s], bias: acceleration that the model does not
explain [rad/s^2], rub: impulses of friction in a tick [N m s]. suspect: 0, or what is wrong with a leg."""


@njit
def update_residual(
    robot: Any, friction: Any, unknown: Any, params: Any, angles: Any, pose: Any, torque: Any, is_first: bool,
    state: Any, legs: Any,
) -> None:  # fmt: skip
    """One tick: readings, angles (6,) [rad] or else a pose (6,), beside the torques (6,) [N m] sent in the one before.

    `unknown` is how far `friction` may be off, of the same type: Coulomb and viscous count.

    Both count in the middle of a window: rates and accelerations are differences of poses, and torques have the weights
    that accelerations have in a second difference. The residual is zero while readings are missing.
    """
    half, h = int(params.half), params.period
    for row in range(2 * half, 0, -1):
        copy_to(state.poses[row], state.poses[row - 1])
        copy_to(state.sent[row], state.sent[row - 1])
    copy_to(state.sent[0], torque)
    now, centre, old = state.poses[0], state.poses[half], state.poses[2 * half]
    if np.isfinite(angles).any():
        state.encoders = 1.0
    copy_to(now, pose)
    if state.encoders > 0.0:
        if all_finite(state.poses[1]):
            copy_to(now, state.poses[1])
        error, _ = laws.forward_kinematics(robot, angles, now, _TOLERANCE, _ITERATIONS)
        if not error <= _TOLERANCE:
            now[:] = np.nan
    for i in range(6):
        state.given[i], state.push[i], state.residual[i] = 0.0, 0.0, 0.0
    whole = all_finite(now) and all_finite(centre) and all_finite(old)
    motion, acceleration, twist, speeds = np.zeros(12), np.zeros(6), np.empty(6), np.empty(6)
    still, need, mobility = np.empty(6), np.empty(6), np.zeros((6, 6))
    copy_to(motion[:6], centre if whole else pose)
    known = all_finite(motion) and laws.legs_at(robot, motion[:6], legs) < 0
    known = known and motion_torque(robot, legs, motion, acceleration, params.gravity, still)
    if not (known and _mobility(robot, legs, mobility)):
        copy_to(state.angles[:], angles)
        return
    if whole:
        for k in range(6):
            motion[6 + k] = (now[k] - old[k]) / (2.0 * half * h)
            acceleration[k] = (now[k] - 2.0 * centre[k] + old[k]) / (half * h) ** 2
        motion_torque(robot, legs, motion, acceleration, params.gravity, need)
        laws.twist_of(motion[:6], motion[6:], twist)
        laws.crank_rates(legs, twist, speeds)
        for i in range(6):
            for row in range(2 * half):
                share = (min(row, 2 * half - 1 - row) + 0.5) / (half * half)
                state.given[i] += share * state.sent[row + 1, i]
            state.residual[i] = state.given[i] - need[i] - friction.viscous[i] * speeds[i]
    state.rubs = state.unsure = 0.0
    for i in range(6):
        speed = abs(speeds[i]) if whole else 0.0
        beyond = friction.break_away[i] - friction.coulomb[i] + unknown.coulomb[i] + unknown.viscous[i] * speed
        state.unsure = max(state.unsure, beyond + UNSURE_SHARE * friction.coulomb[i])
        state.rubs = max(state.rubs, beyond + friction.coulomb[i])
    if state.encoders == 0.0:
        laws.twist_of(now, (now - state.poses[1]) / h, twist)
        laws.crank_rates(legs, twist, speeds)
    else:
        for i in range(6):
            speeds[i] = (angles[i] - state.angles[i]) / h
            # No crank can change so: it is not read at all, or its reading jumps.
            lost = not abs(speeds[i] - state.speed[0, i]) < params.impossible and not is_first
            state.lost[i] = params.remembered if lost else max(0.0, state.lost[i] - 1.0)
            speeds[i] = np.nan if lost else speeds[i]
    copy_to(state.angles[:], angles)
    sound = not state.lost.any()
    if sound:
        copy_to(state.still[:], still)
        for i in range(6):
            copy_to(state.mobility[i], mobility[i])
    _follow(params, friction, speeds, whole and sound, state)


@njit
def _mobility(robot: Any, legs: Any, out: Any) -> bool:
    """J M^-1 J' (6, 6) [1/(kg m^2)]: acceleration of the cranks per unit of torque; False at a singularity."""
    inertia, columns, jacobian = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    laws.crank_jacobian(legs, jacobian)
    task_inertia(robot, legs, inertia)
    for i in range(6):
        for k in range(6):
            columns[k, i] = jacobian[i, k]
    if solve(inertia, columns) == 0.0:
        return False
    for i in range(6):
        for k in range(6):
            for m in range(6):
                out[i, k] += jacobian[i, m] * columns[m, k]
    return True


@njit
def _dominant(values: Any) -> Any:
    """Places of the two largest of six values; by how much the first, and their difference, exceed the rest.

    The rest counts `DOMINANCE` times. What swaps two legs shows with opposite signs at both.
    """
    squares, first, second = values * values, 0, -1
    for i in range(6):
        if squares[i] > squares[first]:
            first = i
    for i in range(6):
        if i != first and (second < 0 or squares[i] > squares[second]):
            second = i
    but_one = squares.sum() - squares[first]
    alike = (values[first] + values[second]) ** 2 / 2.0
    but_swap = max(0.0, but_one - squares[second]) + alike
    swap = abs(values[first] - values[second]) / np.sqrt(2.0)
    return first, second, abs(values[first]) - DOMINANCE * np.sqrt(but_one), swap - DOMINANCE * np.sqrt(but_swap)


@njit
def _rub(most: Any, mobility: Any, speed: Any, rub: Any) -> None:
    """What dry friction makes of speeds (6,) [rad/s] in a tick, in place: impulses (6,) of at most `most` [N m s].

    None turns a crank back. `rub` has the impulses of the tick before, to begin with. Projected Gauss-Seidel; J. J.
    Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988.
    """
    for i in range(6):
        for k in range(6):
            speed[k] += mobility[k, i] * rub[i]
    for _ in range(_SWEEPS):
        for i in range(6):
            if not mobility[i, i] > 0.0:
                continue
            change = min(max(rub[i] - speed[i] / mobility[i, i], -most[i]), most[i]) - rub[i]
            rub[i] += change
            for k in range(6):
                speed[k] += mobility[k, i] * change


@njit
def _follow(params: Any, friction: Any, speeds: Any, sound: bool, state: Any) -> None:
    """Leads two estimates of the cranks' speeds on by torques and friction, and corrects by `speeds`: fast and slow.

    NaN is no reading. The slow one hardly sees a reading fail that has begun to; it follows none that is suspect.
    Where one leg is far off it alone is corrected by less. Else all six are, by one factor: so a push keeps its
    direction.
    """
    torque, off = np.empty((6, 1)), np.zeros((2, 6))
    for row in range(2):
        for i in range(6):
            trusted = np.isfinite(speeds[i]) and not (row == 1 and state.suspect[i] == READING_WRONG)
            off[row, i] = speeds[i] - state.speed[row, i] if trusted else 0.0
        _, _, one, _ = _dominant(off[row])
        largest = np.abs(off[row]).max()
        for i in range(6):
            size = abs(off[row, i]) if one > 0.0 else largest
            if size > params.most_correction[row]:
                off[row, i] *= params.most_correction[row] / size
    for i in range(6):
        turning, rubs = 0.0, 0.0
        for k in range(6):
            state.push[i] += state.mobility[i, k] * state.residual[k]
            turning += state.mobility[i, k] * (state.sent[0, k] - state.still[k])
            rubs += state.mobility[i, k] * state.rub[0, k] / params.period
        change = state.push[i] + rubs + state.bias[1, i] if sound else 0.0
        state.lasting[i] += params.lasting * (change - state.lasting[i])
        torque[i, 0] = state.lasting[i]
        for row in range(2):
            follow = params.follow[row]
            state.speed[row, i] += params.period * (turning + state.bias[row, i] + 2.0 * follow * off[row, i])
            state.bias[row, i] += params.period * follow**2 * off[row, i]
    for row in range(2):
        _rub(params.period * friction.coulomb[:], state.mobility, state.speed[row], state.rub[row])
        if not (all_finite(state.speed[row]) and all_finite(state.bias[row])):
            state.speed[row], state.bias[row], state.rub[row] = 0.0, 0.0, 0.0
    solvable = solve(state.mobility.copy(), torque) != 0.0
    for i in range(6):
        state.missing[i] = torque[i, 0] if solvable else 0.0


@njit
def _are_swapped(state: Any, motor: int, another: int) -> bool:
    """Whether the residual of two motors is what it is where each gives the other's torque."""
    apart, within = state.given[motor] - state.given[another], SWAPPED_WITHIN * abs(state.residual[motor])
    return max(abs(state.residual[motor] - apart), abs(state.residual[another] + apart)) < within


@njit
def is_unexplained(params: Any, state: Any) -> bool:
    """Whether the residual is more than load, push and friction may be, or a smaller one is that of a leg or two."""
    _, _, one, two = _dominant(state.lasting)
    motor, another, one_motor, two_motors = _dominant(state.missing)
    alike = 1.0 if _are_swapped(state, motor, another) else TWO_LEGS_SHARE
    alone = max(params.inertia * max(one, TWO_LEGS_SHARE * two), one_motor, alike * two_motors)
    # Of friction a single motor may have all.
    return (
        alone > params.unexplained_alone + state.rubs
        or (np.abs(state.residual) > params.unexplained + state.rubs).any()
    )


@njit
def mark_suspects(state: Any, failed: int, unexplained: bool) -> int:
    """Marks the one or two legs that are suspect: one whose sensor failed, or is lost, or of whom a residual speaks.

    Returns the first, or -1 for none: such as where a push moves all cranks.
    """
    first = -1
    for i in range(5, -1, -1):
        if i == failed or state.lost[i] > 0.0:
            state.suspect[i], first = READING_WRONG, i
    if first >= 0 or not unexplained:
        return first
    given, residual = state.given, state.residual
    reading, other, one, two = _dominant(state.lasting)
    motor, another, one_motor, two_motors = _dominant(state.missing)
    by_reading = max(one, two) / np.abs(state.lasting).max() if state.encoders > 0.0 else 0.0
    by_motor = max(one_motor, two_motors) / np.abs(state.missing).max()
    if not max(by_reading, by_motor) > 0.0:
        return -1
    if by_reading >= by_motor:
        state.suspect[reading] = READING_WRONG
        if one <= 0.0:
            state.suspect[other] = READING_WRONG
        return reading
    if one_motor <= 0.0 and _are_swapped(state, motor, another):
        state.suspect[motor], state.suspect[another] = MOTOR_SWAPPED, MOTOR_SWAPPED
    else:
        # Of a motor that gives the opposite twice its torque is missing, of a dead one its torque.
        is_reversed = residual[motor] * given[motor] > 1.5 * given[motor] ** 2
        state.suspect[motor] = MOTOR_REVERSED if is_reversed else MOTOR_WEAK
    return motor


@njit
def speeds_to_stop(params: Any, state: Any, out: Any) -> float:
    """Speeds (6,) [rad/s] of the cranks for a stop, and the fastest of those that can be trusted.

    Of one whose reading is wrong only what is beyond the slow estimate's error by friction counts.
    """
    # That of the slow estimate after a step of friction, which is an acceleration: over the bandwidth.
    fastest, slow_error = 0.0, state.unsure / (params.inertia * params.follow[1])
    for i in range(6):
        out[i] = state.speed[0, i]
        if state.suspect[i] == READING_WRONG:
            slow = state.speed[1, i]
            out[i] = np.sign(slow) * max(0.0, abs(slow) - slow_error)
        if state.suspect[i] == 0.0:
            fastest = max(fastest, abs(out[i]))
    return fastest


@njit
def motor_torques(state: Any, wanted: Any) -> None:
    """Makes of torques (6,) at the cranks what gives them with motors that are reversed or swapped, in place."""
    swapped = -1
    for i in range(6):
        if state.suspect[i] == MOTOR_REVERSED:
            wanted[i] = -wanted[i]
        elif state.suspect[i] == MOTOR_SWAPPED and swapped < 0:
            swapped = i
        elif state.suspect[i] == MOTOR_SWAPPED:
            wanted[i], wanted[swapped] = wanted[swapped], wanted[i]
