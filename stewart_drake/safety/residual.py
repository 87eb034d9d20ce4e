"""Residual between the torques that were sent and those of the measured motion; speeds of cranks without readings.

A wrong reading shows as an acceleration of its crank alone, a wrong motor as a torque of that motor alone, and a push
moves several cranks. R. Isermann, Fault-Diagnosis Systems, 2006, on parity equations.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat6, Record, Vec2, Vec6, Vec9, Vec12
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import motion_torque, task_inertia
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import Legs, Robot
from stewart_drake.mechanics.linear_algebra import (
    all_finite,
    any_nonzero,
    copy_to,
    largest_size,
    multiply,
    set_to,
    solve,
)

LONGEST_HALF = 10
"""[ticks] largest half of a window; the state has room for no more."""
ONE_LEG_SHARE = 0.2
"""Share of the bound on a residual that applies if one leg dominates; assumed."""
TWO_LEGS_SHARE = 0.5
"""Factor of the residual of two legs, unless it fits motors that give each other's torque: a push along an axis of
symmetry can look so."""
FRICTION_ERROR = 0.25  # Share of the model's friction by which it may be wrong; assumed.
DOMINANCE = 2.0  # One or two cranks dominate if they exceed all others by this factor.
SWAPPED_WITHIN = 0.3  # Share of a residual to which two motors must give each other's torque.
_SWEEPS = 4  # Gauss-Seidel sweeps over the cranks, for dry friction.
_TOLERANCE, _ITERATIONS = 1e-12, 12  # The same as in `estimator`.
READING_WRONG, MOTOR_WEAK, MOTOR_REVERSED, MOTOR_SWAPPED = range(1, 5)
FAST, SLOW = range(2)
"""Rows of two observers of the cranks' speeds."""

_Ticks = Annotated[np.ndarray, (2 * LONGEST_HALF + 1, 6)]
_Observers = Annotated[np.ndarray, (2, 6)]


class ResidualParams(Record):
    """Parameters of residual and observers."""

    period: float  # [s]
    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    half: float  # [ticks] of half a window.
    first: float  # Row of the sent torques that is the newest one in a window.
    unexplained: Vec6  # [N m] bound on a residual, besides friction.
    unexplained_alone: float  # [N m] the same where one leg or two dominate.
    filter_share: float  # Weight of the newest tick in the low pass `filtered_acceleration`.
    inertia: float  # [kg m^2] least, of a crank.
    bandwidth: Vec2  # [rad/s] of the observers.
    most_correction: Vec2  # [rad/s] largest correction of a speed in a tick.
    impossible: float  # [rad/s] change of a crank's speed in a tick that only a wrong reading shows.
    unread_time: float  # [ticks] for which a crank counts as not read after such a change.


class ResidualState(Record):
    """State of residual and observers, of the six cranks."""

    encoders: float  # 1 where angles have been read.
    friction_bound: float  # [N m] largest friction of a motor.
    friction_margin: float  # [N m] by which it may be wrong.
    angles: Vec6  # [rad] read last.
    poses: _Ticks  # [rad, m] read in the last ticks, newest first.
    sent_torques: _Ticks  # [N m] in the last ticks, newest first.
    doubts: _Ticks  # [N m] by which these may be wrong.
    mean_torque: Vec6  # [N m] sent, weighted over the window.
    doubt: Vec6  # [N m] by which that may be wrong.
    residual: Vec6  # [N m] that less inverse dynamics.
    push_acceleration: Vec6  # [rad/s^2] that the residual would make.
    filtered_acceleration: Vec6  # [rad/s^2] unexplained, friction included, low-passed.
    missing_torque: Vec6  # [N m] that gives this acceleration.
    unread_ticks: Vec6  # Ticks for which a crank still counts as not read.
    holding_torque: Vec6  # [N m] at rest.
    mobility: Mat6  # [1/(kg m^2)] acceleration by torque.
    speed: _Observers  # [rad/s] estimates of the fast and the slow observer.
    bias: _Observers  # [rad/s^2] acceleration that the model does not explain.
    friction_impulse: _Observers  # [N m s] of friction in a tick.
    suspect: Vec6  # 0, or what is wrong with a leg: READING_WRONG ... MOTOR_SWAPPED.


@njit
def update_residual(
    robot: Robot,
    friction: Friction,
    unknown: Friction,
    params: ResidualParams,
    angles: Vec6,
    pose: Vec6,
    torque: Vec6,
    doubt: Vec6,
    is_first: bool,
    state: ResidualState,
    legs: Legs,
) -> None:
    """One tick: updates residual and observers with readings and with the torques of the tick before.

    These may be wrong by `doubt` [N m].

    Both are evaluated in the middle of a window: rates and accelerations are differences of poses, and torques have the
    weights that accelerations have in a second difference. The residual is zero while readings are missing. `unknown`
    has the largest errors of Coulomb and viscous friction in `friction`. Angles [rad] are NaN without encoders; the
    pose [rad, m] is used only then.
    """
    half, h = int(params.half), params.period
    _store(robot, half, angles, pose, torque, doubt, state)
    now, centre, old = state.poses[0], state.poses[half], state.poses[2 * half]
    whole = all_finite(now) and all_finite(centre) and all_finite(old)
    motion, acceleration, twist, speeds = np.zeros(12), np.zeros(6), np.empty(6), np.zeros(6)
    holding, mobility = np.empty(6), np.zeros((6, 6))
    copy_to(motion[:6], centre if whole else pose)
    known = all_finite(motion) and laws.legs_at(robot, motion[:6], legs) < 0
    known = known and motion_torque(robot, legs, motion, acceleration, params.base[:], holding)
    if not (known and _mobility(robot, legs, mobility)):
        copy_to(state.angles[:], angles)
        return
    if whole:
        for k in range(6):
            motion[6 + k] = (now[k] - old[k]) / (2.0 * half * h)
            acceleration[k] = (now[k] - 2.0 * centre[k] + old[k]) / (half * h) ** 2
        laws.twist_of(motion[:6], motion[6:], twist)
        laws.crank_rates(legs, twist, speeds)
        _compare(robot, friction, params, motion, acceleration, speeds, legs, state)
    _bound_friction(friction, unknown, speeds, state)
    if state.encoders == 0.0:
        for k in range(6):
            motion[6 + k] = (now[k] - state.poses[1, k]) / h
        laws.twist_of(now, motion[6:], twist)
        laws.crank_rates(legs, twist, speeds)
    else:
        for i in range(6):
            speeds[i] = (angles[i] - state.angles[i]) / h
            # No crank can accelerate so: its reading is missing, or jumps.
            unread = not abs(speeds[i] - state.speed[FAST, i]) < params.impossible and not is_first
            state.unread_ticks[i] = params.unread_time if unread else max(0.0, state.unread_ticks[i] - 1.0)
            speeds[i] = np.nan if unread else speeds[i]
    copy_to(state.angles[:], angles)
    sound = not any_nonzero(state.unread_ticks[:])
    if sound:
        copy_to(state.holding_torque[:], holding)
        for i in range(6):
            copy_to(state.mobility[i], mobility[i])
    _update_speed_estimates(params, friction, speeds, whole and sound, state)


@njit
def _store(robot: Robot, half: int, angles: Vec6, pose: Vec6, torque: Vec6, doubt: Vec6, state: ResidualState) -> None:
    """Stores the pose of the readings, NaN where there is none, and the torques that were sent."""
    for row in range(2 * half, 0, -1):
        copy_to(state.poses[row], state.poses[row - 1])
        copy_to(state.sent_torques[row], state.sent_torques[row - 1])
        copy_to(state.doubts[row], state.doubts[row - 1])
    copy_to(state.sent_torques[0], torque)
    copy_to(state.doubts[0], doubt)
    for i in range(6):
        if np.isfinite(angles[i]):
            state.encoders = 1.0
        state.mean_torque[i], state.push_acceleration[i], state.residual[i], state.doubt[i] = 0.0, 0.0, 0.0, 0.0
    now = state.poses[0]
    copy_to(now, pose)
    if state.encoders > 0.0:
        if all_finite(state.poses[1]):
            copy_to(now, state.poses[1])
        error, _ = laws.forward_kinematics(robot, angles, now, _TOLERANCE, _ITERATIONS)
        if not error <= _TOLERANCE:
            set_to(now, np.nan)


@njit
def _compare(
    robot: Robot,
    friction: Friction,
    params: ResidualParams,
    motion: Vec12,
    acceleration: Vec6,
    speeds: Vec6,
    legs: Legs,
    state: ResidualState,
) -> None:
    """Residual: torques sent, less inverse dynamics of a motion and viscous friction at the speeds of the cranks."""
    half, first, need = int(params.half), int(params.first), np.empty(6)
    motion_torque(robot, legs, motion, acceleration, params.base[:], need)
    for i in range(6):
        for row in range(2 * half):
            share = (min(row, 2 * half - 1 - row) + 0.5) / (half * half)
            state.mean_torque[i] += share * state.sent_torques[row + first, i]
            state.doubt[i] += share * state.doubts[row + first, i]
        state.residual[i] = state.mean_torque[i] - need[i] - friction.viscous[i] * speeds[i]


@njit
def _bound_friction(friction: Friction, unknown: Friction, speeds: Vec6, state: ResidualState) -> None:
    """Largest friction of a motor at the speeds of the cranks, and by how much it may be wrong."""
    state.friction_bound = state.friction_margin = 0.0
    for i in range(6):
        excess = friction.break_away[i] - friction.coulomb[i] + unknown.coulomb[i]
        beyond = excess + unknown.viscous[i] * abs(speeds[i])
        state.friction_margin = max(state.friction_margin, beyond + FRICTION_ERROR * friction.coulomb[i])
        state.friction_bound = max(state.friction_bound, beyond + friction.coulomb[i])


@njit
def _mobility(robot: Robot, legs: Legs, out: Mat6) -> bool:
    """J M^-1 J' (6, 6) [1/(kg m^2)]: acceleration of the cranks per unit of torque; False at a singularity."""
    inertia, columns, jacobian = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    laws.crank_jacobian(legs, jacobian)
    task_inertia(robot, legs, inertia)
    for i in range(6):
        for k in range(6):
            columns[k, i] = jacobian[i, k]
    if solve(inertia, columns) == 0.0:
        return False
    multiply(jacobian, columns, out)
    return True


@njit
def two_largest(values: Vec6) -> tuple[int, int, float, float]:
    """Places of the two largest of six values, and by how much one, and the two as a pair, dominate the rest.

    The rest counts `DOMINANCE` times. A pair is the difference of the two: what swaps two legs has opposite signs at
    both. Not positive where none dominates.
    """
    first, second, but_one = 0, -1, 0.0
    for i in range(6):
        if values[i] * values[i] > values[first] * values[first]:
            first = i
        but_one += values[i] * values[i]
    for i in range(6):
        if i != first and (second < 0 or values[i] * values[i] > values[second] * values[second]):
            second = i
    but_one -= values[first] * values[first]
    in_common = (values[first] + values[second]) ** 2 / 2.0
    but_pair = max(0.0, but_one - values[second] * values[second]) + in_common
    pair = abs(values[first] - values[second]) / np.sqrt(2.0)
    return first, second, abs(values[first]) - DOMINANCE * np.sqrt(but_one), pair - DOMINANCE * np.sqrt(but_pair)


@njit
def apply_dry_friction(coulomb: Vec6, period: float, mobility: Mat6, speed: Vec6, impulse: Vec6) -> None:
    """Slows speeds [rad/s] by dry friction [N m] over a tick, in place; friction turns no crank back.

    `impulse` [N m s] is that of friction, and first that of the tick before. Projected Gauss-Seidel; J. J. Moreau,
    Unilateral contact and dry friction in finite freedom dynamics, 1988.
    """
    for i in range(6):
        for k in range(6):
            speed[k] += mobility[k, i] * impulse[i]
    for _ in range(_SWEEPS):
        for i in range(6):
            if not mobility[i, i] > 0.0:
                continue
            most = period * coulomb[i]
            change = min(max(impulse[i] - speed[i] / mobility[i, i], -most), most) - impulse[i]
            impulse[i] += change
            for k in range(6):
                speed[k] += mobility[k, i] * change


@njit
def _update_speed_estimates(
    params: ResidualParams, friction: Friction, speeds: Vec6, sound: bool, state: ResidualState
) -> None:
    """Predicts and corrects two crank-speed observers, one fast, one slow; NaN is no reading.

    The slow one hardly follows a reading that begins to fail, and does not use suspect readings. A large error of one
    leg alone limits the correction of that leg; other errors limit all six by one factor, so that a push keeps its
    direction.
    """
    torque, error = np.empty((6, 1)), np.zeros((2, 6))
    for row in range(2):
        for i in range(6):
            trusted = np.isfinite(speeds[i]) and not (row == SLOW and state.suspect[i] == READING_WRONG)
            error[row, i] = speeds[i] - state.speed[row, i] if trusted else 0.0
        _, _, one, _ = two_largest(error[row])
        largest = largest_size(error[row])
        for i in range(6):
            size = abs(error[row, i]) if one > 0.0 else largest
            if size > params.most_correction[row]:
                error[row, i] *= params.most_correction[row] / size
    for i in range(6):
        acceleration, by_friction = 0.0, 0.0
        for k in range(6):
            state.push_acceleration[i] += state.mobility[i, k] * state.residual[k]
            acceleration += state.mobility[i, k] * (state.sent_torques[0, k] - state.holding_torque[k])
            by_friction += state.mobility[i, k] * state.friction_impulse[FAST, k] / params.period
        change = state.push_acceleration[i] + by_friction + state.bias[SLOW, i] if sound else 0.0
        state.filtered_acceleration[i] += params.filter_share * (change - state.filtered_acceleration[i])
        torque[i, 0] = state.filtered_acceleration[i]
        for row in range(2):
            bandwidth = params.bandwidth[row]
            correction = 2.0 * bandwidth * error[row, i]
            state.speed[row, i] += params.period * (acceleration + state.bias[row, i] + correction)
            state.bias[row, i] += params.period * bandwidth**2 * error[row, i]
    for row in range(2):
        apply_dry_friction(
            friction.coulomb[:], params.period, state.mobility[:], state.speed[row], state.friction_impulse[row]
        )
        if not (all_finite(state.speed[row]) and all_finite(state.bias[row])):
            for i in range(6):
                state.speed[row, i] = state.bias[row, i] = state.friction_impulse[row, i] = 0.0
    solvable = solve(state.mobility.copy(), torque) != 0.0
    for i in range(6):
        state.missing_torque[i] = torque[i, 0] if solvable else 0.0


@njit
def _are_swapped(state: ResidualState, motor: int, another: int) -> bool:
    """Whether the residual of two motors fits motors that give each other's torque."""
    difference, within = (
        state.mean_torque[motor] - state.mean_torque[another],
        SWAPPED_WITHIN * abs(state.residual[motor]),
    )
    return max(abs(state.residual[motor] - difference), abs(state.residual[another] + difference)) < within


@njit
def fits_motors(state: ResidualState) -> bool:
    """Whether the residual is that of a dead or reversed motor, or of two that are swapped: no impact has its size."""
    motor, another, _, _ = two_largest(state.missing_torque[:])
    sent, rest, friction = state.mean_torque, 0.0, state.friction_bound
    for i in range(6):
        rest = max(rest, abs(state.residual[i]) if i != motor and i != another else 0.0)
    for kind in range(3):
        first = sent[motor] * (1.0 + kind) if kind < 2 else sent[motor] - sent[another]
        second = 0.0 if kind < 2 else -first
        within = SWAPPED_WITHIN * abs(first) + friction
        error = max(abs(state.residual[motor] - first), abs(state.residual[another] - second))
        if max(error, rest) < within:
            return True
    return False


@njit
def is_unexplained(params: ResidualParams, state: ResidualState) -> bool:
    """True if the residual exceeds its bound, or a lower bound where one or two legs dominate.

    What the motors may give more or less than they were asked for adds to both.
    """
    _, _, one, two = two_largest(state.filtered_acceleration[:])
    motor, another, one_motor, two_motors = two_largest(state.missing_torque[:])
    share = 1.0 if _are_swapped(state, motor, another) else TWO_LEGS_SHARE
    alone = max(params.inertia * max(one, TWO_LEGS_SHARE * two), one_motor, share * two_motors)
    # Friction may act on one motor alone, so its whole bound is allowed here.
    unexplained = alone > params.unexplained_alone + state.friction_bound + largest_size(state.doubt[:])
    for i in range(6):
        bound = params.unexplained[i] + state.friction_bound + state.doubt[i]
        unexplained = unexplained or abs(state.residual[i]) > bound
    return unexplained


@njit
def mark_suspects(state: ResidualState, failed: int, unexplained: bool) -> int:
    """Marks one or two faulty legs, from sensor failures, missing readings or the residual.

    Returns:
        The first of them, or -1 for none, such as for a push that moves all cranks.
    """
    first = -1
    for i in range(5, -1, -1):
        if i == failed or state.unread_ticks[i] > 0.0:
            state.suspect[i], first = READING_WRONG, i
    if first >= 0 or not unexplained:
        return first
    sent, residual = state.mean_torque, state.residual
    reading, other, one, two = two_largest(state.filtered_acceleration[:])
    motor, another, one_motor, two_motors = two_largest(state.missing_torque[:])
    by_reading = max(one, two) / largest_size(state.filtered_acceleration[:]) if state.encoders > 0.0 else 0.0
    by_motor = max(one_motor, two_motors) / largest_size(state.missing_torque[:])
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
        # A motor with the opposite sign lacks twice its torque, a dead one lacks its torque.
        is_reversed = residual[motor] * sent[motor] > 1.5 * sent[motor] ** 2
        state.suspect[motor] = MOTOR_REVERSED if is_reversed else MOTOR_WEAK
    return motor


@njit
def speeds_to_stop(params: ResidualParams, state: ResidualState, out: Vec6) -> float:
    """Speeds (6,) [rad/s] of the cranks for a stop, and the fastest one that can be trusted.

    The speed of a crank with a wrong reading counts only as far as it exceeds the slow observer's error by friction.
    """
    # The slow observer's error after a step of friction: its acceleration over the bandwidth.
    fastest, slow_error = 0.0, state.friction_margin / (params.inertia * params.bandwidth[SLOW])
    for i in range(6):
        out[i] = state.speed[FAST, i]
        if state.suspect[i] == READING_WRONG:
            slow = state.speed[SLOW, i]
            out[i] = np.sign(slow) * max(0.0, abs(slow) - slow_error)
        if state.suspect[i] == 0.0:
            fastest = max(fastest, abs(out[i]))
    return fastest


@njit
def motor_torques(state: ResidualState, wanted: Vec6) -> None:
    """Turns torques (6,) at the cranks into commands to motors some of which are reversed or swapped, in place."""
    swapped = -1
    for i in range(6):
        if state.suspect[i] == MOTOR_REVERSED:
            wanted[i] = -wanted[i]
        elif state.suspect[i] == MOTOR_SWAPPED and swapped < 0:
            swapped = i
        elif state.suspect[i] == MOTOR_SWAPPED:
            wanted[i], wanted[swapped] = wanted[swapped], wanted[i]
