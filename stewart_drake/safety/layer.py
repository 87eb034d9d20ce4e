"""A tick of the safety layer, compiled: monitors, levels and reactions."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Vec1, Vec2, Vec6, Vec12, Vec18, record
from stewart_drake.mechanics.dynamics_laws import static_torque
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import Legs, Robot
from stewart_drake.mechanics.linear_algebra import all_finite, any_nonzero, copy_to, set_to, solve
from stewart_drake.mechanics.singularities import WEIGHT_TRUSTED
from stewart_drake.safety.actuators import torques_asked, update_torques
from stewart_drake.safety.limits import (
    AT_LIMIT_TIME,
    RUNAWAY_TIME,
    Observed,
    SafetyParams,
    broken,
    first_least,
    observe,
)
from stewart_drake.safety.lost_encoder import NOT_READY
from stewart_drake.safety.options import (
    ANGLE_RATE,
    COMMAND,
    CONTROLLER,
    DEADLINE,
    MEASUREMENT,
    NO_TRIP,
    NOT_MOVING,
    PARITY,
    READING,
    SENSOR,
    TORQUE_LIMIT,
    TORQUE_RATE,
    UNEXPLAINED,
)
from stewart_drake.safety.residual import (
    MOTOR_WEAK,
    READING_WRONG,
    fits_motors,
    is_unexplained,
    mark_suspects,
    motor_torques,
    speeds_to_stop,
    update_residual,
)
from stewart_drake.safety.state import HOLD, NONE, RAMP, SAFE_HOLD, SafetyState
from stewart_drake.safety.stillness import FROZEN, LEAST_REPEATS, STANDING, cranks_at, watch

MOTOR_TICKS = 1.0  # Ticks of a residual that a faulty motor explains, and no impact does.
IMPLAUSIBLE = 10.0  # Times the torque limit: a larger command is an error of the controller.
REFILL = 0.05  # Ticks of the budget of holding that a good tick gives back: a fault that flickers uses it up too.
REPLACED_AFTER = 0.1  # [s] after which the residual no longer shows that a reading was replaced; assumed.
_ROUNDING = 1e-9
CONTINUE, BLIND, RUNAWAY, HOLD_OVER = range(4)  # How a tick ends; but for CONTINUE the run is over.


@njit
def _whole(value: float) -> int:
    return int(value) if np.isfinite(value) else -1


@njit
def _unusable(
    params: SafetyParams, command: Vec6, asked: Vec6, is_measured: bool, age: float, sensor: Vec2, controller: Vec2
) -> tuple[int, int, int]:
    """What is wrong with the messages of a tick, not their contents: monitor or `NO_TRIP`, leg or -1, cause or 0.

    `asked` (6,) [N m] are the torques of the command.
    """
    if not is_measured:
        return MEASUREMENT, -1, 0
    if sensor[0] != 0.0:
        return SENSOR, _whole(sensor[1]), _whole(sensor[0])
    if controller[0] != 0.0:
        return CONTROLLER, _whole(controller[1]), _whole(controller[0])
    largest, leg = 0.0, 0
    for i in range(6):
        if not np.isfinite(command[i]):
            return COMMAND, i, 0
        share = abs(asked[i]) / params.torque_limit[i]
        if share > largest:
            largest, leg = share, i
    if not age <= params.deadline:
        return DEADLINE, -1, 0
    if largest > IMPLAUSIBLE:
        return TORQUE_LIMIT, leg, 0
    return NO_TRIP, -1, 0


@njit
def safety_tick(
    robot: Robot,
    friction: Friction,
    friction_unknown: Friction,
    gain: Vec6,
    params: SafetyParams,
    user_trip: Vec2,
    command: Vec6,
    measurement: Vec12,
    reference: Vec18,
    age: Vec1,
    sensor: Vec2,
    controller: Vec2,
    angles: Vec6,
    pose_reading: Vec12,
    parity: Vec2,
    legs: Legs,
    observed: Observed,
    state: SafetyState,
) -> tuple[int, float]:
    """One tick; `user_trip` has the number of a user's monitor that trips, 0 for none, and its leg.

    `gain` (6,) are the motors' torques [N m] per unit of a command.

    Returns:
        CONTINUE, BLIND, RUNAWAY or HOLD_OVER; speed of the fastest crank [rad/s].
    """
    robot, friction, params = record(robot), record(friction), record(params)
    legs, observed, state = record(legs), record(observed), record(state)
    read, residual = pose_reading[:6] if pose_reading[0] == pose_reading[0] else measurement[:6], state.residual
    is_first, cranks, torque, asked = state.ticks == 0.0, angles.copy(), state.actuators, np.empty(6)
    if residual.encoders == 0.0 and readings_of(angles) == 0:
        cranks_at(robot, read, legs, cranks)
    update_torques(gain, params.actuators, params.period, state.torque[:], cranks, torque)
    torques_asked(gain, params.actuators, command, torque, asked)
    update_residual(
        robot,
        friction,
        record(friction_unknown),
        params.residual,
        angles,
        read,
        torque.torque[:],
        torque.doubt[:],
        is_first,
        residual,
        legs,
    )
    unexplained = is_unexplained(params.residual, residual)
    is_moved = state.lost[0] >= 0.0 and state.stop_ticks * params.period < REPLACED_AFTER
    fits_motor = unexplained and fits_motors(residual)
    state.unexplained_ticks = 0.0 if is_moved else _counted(state.unexplained_ticks, unexplained)
    state.motor_ticks = 0.0 if is_moved else _counted(state.motor_ticks, fits_motor)
    still, standing = watch(robot, params.still, cranks, reference[:6], legs, state.still)
    state.ticks += 1.0
    is_measured = _is_finite(params, measurement)
    is_observed = is_measured and sensor[0] == 0.0
    if is_observed:
        _observe(robot, params, measurement, reference, legs, observed, state)
    if state.safety.level >= RAMP and state.lost[0] < 0.0:
        return _stop(gain, params, is_observed, unexplained, angles, state)
    # No impact repeats readings to the last bit while the reference moves.
    blind = state.still.repeats >= LEAST_REPEATS
    monitor, level, leg, cause = NO_TRIP, RAMP, -1, 0
    if is_observed:
        monitor, leg = broken(observed)
    if monitor == NO_TRIP and blind and (unexplained or still == FROZEN):
        monitor = READING
    if monitor == NO_TRIP and (state.unexplained_ticks > params.impact or state.motor_ticks > MOTOR_TICKS):
        monitor = UNEXPLAINED
    if monitor == NO_TRIP and still == STANDING:
        monitor, leg = NOT_MOVING, standing
    if monitor == NO_TRIP and parity[0] != 0.0:
        monitor, leg = PARITY, int(parity[1])
    if monitor == NO_TRIP:
        level = HOLD
        monitor, leg, cause = _unusable(params, command, asked, is_measured, age[0], sensor, controller)
    if monitor == NO_TRIP:
        level = RAMP
        if is_observed and user_trip[0] > 0.0:
            monitor, leg = int(user_trip[0]), int(user_trip[1])
        else:
            monitor, leg = _pass_on(gain, params, command, asked, cranks, state)
    if monitor == NO_TRIP:
        return _go_on(params, reference, state), 0.0
    level = _react(params, monitor, level, leg, cause, blind, unexplained, parity, state)
    if level == RAMP and not _loses_encoder(params, parity, state):
        return _stop(gain, params, is_observed, unexplained, angles, state)
    _approach(gain, params, state.good[:], state)
    return CONTINUE, 0.0


@njit
def _is_finite(params: SafetyParams, measurement: Vec12) -> bool:
    """Whether a measurement, and its pose extrapolated by the horizon, is finite."""
    finite = all_finite(measurement[6:])
    for k in range(6):
        finite = finite and np.isfinite(measurement[k] + params.horizon * measurement[6 + k])
    return finite


@njit
def _observe(
    robot: Robot,
    params: SafetyParams,
    measurement: Vec12,
    reference: Vec18,
    legs: Legs,
    observed: Observed,
    state: SafetyState,
) -> None:
    """Margins of a measurement, and the torque of the robot's weight where it can be trusted."""
    observe(robot, params, measurement[:6], measurement[6:], reference[:6], state.assembly_sign, legs, observed)
    if state.assembly_sign == 0.0:
        state.assembly_sign = observed.assembly_sign
    trusted, torque = abs(observed.conditioning) > WEIGHT_TRUSTED.conditioning, np.empty(6)
    for i in range(6):
        trusted = trusted and observed.transmission[i] > WEIGHT_TRUSTED.transmission
    if trusted and static_torque(robot, legs, params.base[:], torque):
        copy_to(state.weight[:], torque)


@njit
def _react(
    params: SafetyParams,
    monitor: int,
    level: int,
    leg: int,
    cause: int,
    blind: bool,
    unexplained: bool,
    parity: Vec2,
    state: SafetyState,
) -> int:
    """Records a trip. Returns the level of the reaction: HOLD as long as the budget lasts, else RAMP."""
    residual = state.residual
    state.hold_used += 1.0
    if level == HOLD and state.hold_used > params.budget:
        level = RAMP
    if level == RAMP:
        if blind:
            set_to(residual.suspect[:], READING_WRONG)
        else:
            suspect = mark_suspects(residual, leg if monitor == SENSOR and leg >= 0 else _whole(parity[1]), unexplained)
            leg = suspect if suspect >= 0 else leg
    state.safety.level, state.safety.monitor, state.safety.leg = level, monitor, leg
    state.worst = max(state.worst, float(level))
    first = state.first
    if first.monitor == 0.0:
        first.monitor, first.level, first.leg, first.tick, first.cause = monitor, level, leg, state.ticks - 1.0, cause
    return level


@njit
def readings_of(angles: Vec6) -> int:
    """Number of cranks that are read."""
    count = 0
    for i in range(6):
        count += 1 if np.isfinite(angles[i]) else 0
    return count


@njit
def _loses_encoder(params: SafetyParams, parity: Vec2, state: SafetyState) -> bool:
    """Whether a fault is the first one, of one encoder alone, and the inertial sensor can replace this encoder."""
    suspects, wrong = 0, -1
    for i in range(6):
        suspects += 1 if state.residual.suspect[i] != 0.0 else 0
        wrong = i if state.residual.suspect[i] == READING_WRONG else wrong
    is_replaced = parity[1] == wrong if parity[0] != 0.0 else parity[1] != NOT_READY
    if params.goes_on > 0.0 and state.stop_ticks == 0.0 and suspects == 1 and wrong >= 0 and is_replaced:
        state.lost[0], state.lost_by, state.stop_ticks = wrong, state.safety.monitor, 1.0
        state.at_limit = state.too_fast = 0.0  # Its torques end.
        return True
    state.lost[0], state.stop_ticks = -1.0, 0.0
    return False


@njit
def _go_on(params: SafetyParams, reference: Vec18, state: SafetyState) -> int:
    """A good tick: nothing more, or with a lost encoder the level, by the reference; HOLD_OVER after the hold."""
    if state.lost[0] < 0.0:
        return CONTINUE
    state.stop_ticks += 1.0
    state.rest_ticks = 0.0 if any_nonzero(reference[6:]) else state.rest_ticks + 1.0
    state.safety.level = SAFE_HOLD if state.rest_ticks > 0.0 else RAMP
    state.safety.monitor, state.safety.leg = state.lost_by, state.lost[0]
    state.worst = max(state.worst, state.safety.level)
    return HOLD_OVER if state.rest_ticks * params.period > params.safe_hold_time + _ROUNDING else CONTINUE


@njit
def _counted(ticks: float, bad: bool) -> float:
    return max(0.0, ticks + (1.0 if bad else -1.0))


@njit
def _pass_on(
    gain: Vec6, params: SafetyParams, command: Vec6, asked: Vec6, cranks: Vec6, state: SafetyState
) -> tuple[int, int]:
    """Passes a command on within the limits; the monitor that trips where this has lasted too long, and its leg.

    Servos limit the torque that an angle asks for by themselves.
    """
    limit, holds = params.torque_limit, params.actuators.holds > 0.0
    torque, spare, steadiness, full, steep = np.empty(6), np.empty(6), np.empty(6), False, False
    for i in range(6):
        # A jump to a lasting wrong torque is found by what it does; a servo would be there first. It may go on as its
        # reference does.
        before, most = state.command[i], limit[i] / gain[i]
        if holds:
            before, most = state.torque[i] + state.still.turn[i], np.inf
        size, change = abs(asked[i]), abs(command[i] - before)
        full = full or size >= limit[i] * (1.0 - _ROUNDING)
        steep = steep or change > _largest_change(gain[i], params, state) * (1.0 + _ROUNDING)
        spare[i], steadiness[i] = -size / limit[i], -change
        torque[i] = min(max(command[i], -most), most)
    state.at_limit, state.too_fast = _counted(state.at_limit, full), _counted(state.too_fast, steep)
    copy_to(state.command[:], command)
    if state.at_limit * params.period > AT_LIMIT_TIME + _ROUNDING:
        return TORQUE_LIMIT, first_least(spare)
    if state.too_fast * params.period > params.jump_time + _ROUNDING:
        return ANGLE_RATE if holds else TORQUE_RATE, first_least(steadiness)
    if steep:
        # To approach a command that chatters would leave a mean torque that nobody asked for.
        copy_to(torque, state.good)
    reached = _approach(gain, params, torque, state)
    if reached and not steep and (holds or not full):
        _plan_rest(gain, params, torque, cranks, state)
        copy_to(state.good[:], torque)
    state.safety.level, state.safety.monitor, state.safety.leg = NONE, NO_TRIP, -1.0
    state.hold_used = max(0.0, state.hold_used - REFILL)
    return NO_TRIP, -1


@njit
def _plan_rest(gain: Vec6, params: SafetyParams, command: Vec6, cranks: Vec6, state: SafetyState) -> None:
    """Angles at which servos would come to rest from a command.

    Without feedback they go on along the path of the reference as far as they go in half of the ramp; a command is
    ahead of its crank by the servo's damping. With feedback a command has an angle for a torque that is not to last:
    they stay where they are, but for the angle that carries the weight. No reading moves a servo otherwise.
    """
    for i in range(6):
        time, speed = 0.5 * params.ramp_time - params.actuators.damping / gain[i], state.still.turn[i] / params.period
        state.rest[i] = command[i] + time * speed
        if params.actuators.follows == 0.0:
            state.rest[i] = cranks[i] + state.weight[i] / gain[i] if np.isfinite(cranks[i]) else command[i]


@njit
def _largest_change(gain: float, params: SafetyParams, state: SafetyState) -> float:
    """Of a command from one tick to the next, for a motor that gives a torque `gain` [N m] for its unit."""
    return np.inf if state.ticks <= 1.0 else params.actuators.steepest + params.torque_change / gain


@njit
def _approach(gain: Vec6, params: SafetyParams, torque: Vec6, state: SafetyState) -> bool:
    """Moves the commands of the motors towards those wanted, at the largest rate; True if they are reached."""
    reached = True
    for i in range(6):
        before, bound = state.torque[i], _largest_change(gain[i], params, state)
        change = torque[i] - before
        state.torque[i] = before + min(max(change, -bound), bound) if abs(change) > bound else torque[i]
        reached = reached and state.torque[i] == torque[i]
    return reached


@njit
def _stop(
    gain: Vec6, params: SafetyParams, is_observed: bool, unexplained: bool, angles: Vec6, state: SafetyState
) -> tuple[int, float]:
    """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on.

    All modes decay with the time constant `params.stopping`. A leg with a suspect reading is damped by the speed that
    torques alone give. That is good for a short time, as it is for a robot with a faulty motor.

    Servos go from the last good angles to rest, where they hold themselves, with readings or without.
    """
    state.stop_ticks += 1.0
    residual, holds = state.residual, params.actuators.holds > 0.0
    if not any_nonzero(residual.suspect[:]):
        leg = mark_suspects(residual, -1, unexplained)
        state.safety.leg = leg if state.safety.leg < 0.0 else state.safety.leg
    is_seen = is_observed or holds or readings_of(angles) >= 5
    if not is_seen and state.hold_used >= params.budget:
        # This robot cannot be held without a measurement: in open loop it falls within half a second.
        return BLIND, 0.0
    speeds, brake, wanted, elapsed = np.empty(6), np.empty((6, 1)), np.empty(6), state.stop_ticks * params.period
    fastest = speeds_to_stop(params.residual, residual, speeds)
    state.runaway_ticks = _counted(state.runaway_ticks, fastest > params.most_speed)
    if state.runaway_ticks * params.period > RUNAWAY_TIME + _ROUNDING:
        return RUNAWAY, fastest
    is_whole = not any_nonzero(residual.suspect[:])
    hold = params.ramp_time + params.safe_hold_time if is_whole else params.suspect_hold_time
    if elapsed > hold + _ROUNDING:
        return HOLD_OVER, 0.0
    # A command that followed a wrong reading is not continued. The inertia of the cranks turns a speed into a torque.
    share = min(1.0, elapsed / params.ramp_time) if is_whole else 1.0
    for i in range(6):
        brake[i, 0], wanted[i] = speeds[i], (1.0 - share) * (gain[i] * state.good[i]) + share * state.weight[i]
    braked = is_seen and not holds and solve(residual.mobility.copy(), brake) != 0.0
    for i in range(6):
        braked = braked and np.isfinite(brake[i, 0])
    for i in range(6):
        # A crank that may have lost its rod tells nothing about its load.
        if braked and residual.suspect[i] != MOTOR_WEAK:
            wanted[i] -= brake[i, 0] / params.stopping
    motor_torques(residual, wanted)
    for i in range(6):
        wanted[i] = min(max(wanted[i], -params.most_torque[i]), params.most_torque[i]) / gain[i]
        if holds:
            wanted[i] = (1.0 - share) * state.good[i] + share * state.rest[i]
    _approach(gain, params, wanted, state)
    state.safety.level = SAFE_HOLD if elapsed >= params.ramp_time else RAMP
    state.worst = max(state.worst, state.safety.level)
    state.hold_used = 0.0 if is_seen else state.hold_used + 1.0
    return CONTINUE, 0.0
