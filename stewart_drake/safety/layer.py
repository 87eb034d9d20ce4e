"""A tick of the safety layer, compiled: its monitors, its levels and reactions, and the part of a loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np

from stewart_drake.base.errors import FAILURES, SafetyStop
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.loop.part import HEALTHY, LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import static_torque
from stewart_drake.mechanics.friction import FRICTION
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, solve
from stewart_drake.mechanics.singularities import WEIGHT_TRUSTED
from stewart_drake.safety import limits
from stewart_drake.safety.limits import MEANINGS, MONITORS, NO_TRIP, OBSERVED, SafetyInputs, SafetyOptions
from stewart_drake.safety.residual import (
    MOTOR_WEAK,
    READING_WRONG,
    RESIDUAL,
    is_unexplained,
    mark_suspects,
    motor_torques,
    speeds_to_stop,
    update_residual,
)
from stewart_drake.safety.stillness import FROZEN, REPEATED, STANDS, STILLNESS, cranks_at, watch

LEVELS = ("none", "hold", "ramp", "safe_hold", "end")
NONE, HOLD, RAMP, SAFE_HOLD, END = range(5)
ABSURD = 10.0  # A command of so many times the limit is an error of the controller and no wish for torque.
REFILL = 0.05  # Ticks of the budget of holding that a good tick gives back: a fault that flickers uses it up too.
_ROUNDING = 1e-9

_STATE = np.dtype([*fields(
    torque=6, safety=3, good=6, weight=6, hold_used=(), at_limit=(), too_fast=(), since=(), assembly_sign=(),
    ticks=(), first=5, worst=(), command=6, unexplained_ticks=(), fast=(),
).descr, *RESIDUAL.descr, *STILLNESS.descr])  # fmt: skip
"""torque: for the motors [N m]. safety: numbers of level in `LEVELS` and monitor in `MONITORS`, leg or -1. good: last
good command, one that no limit touched [N m]. weight: last torque that carried the robot's weight [N m]. hold_used:
ticks of holding, less what good ones gave back; while stopping, ticks without a measurement. at_limit, too_fast,
unexplained_ticks, fast: ticks at the torque limit, of commands that jumped, of residuals that were too large, and of a
stop that runs away, less good ones. since: ticks of ramp and safe hold. assembly_sign: sign of the rods' determinant at
the start, 0 before the first tick. ticks: done. first: monitor, level, leg, tick and cause in `FAILURES` of the first
trip, zeros before. worst: highest level so far. command: that of the last tick, if it was finite [N m]. The rest: see
`RESIDUAL` and `STILLNESS`."""

GOES_ON, BLIND, RUNAWAY, HOLD_OVER = range(4)  # How a tick ends: in the last three the run is over.

NOT_THERE = {
    "age": np.zeros(1),
    "sensor_health": np.array(HEALTHY),
    "controller_health": np.array(HEALTHY),
    "angles": np.full(6, np.nan),
    "pose_reading": np.full(12, np.nan),
}
"""What stands at a port for which a loop has no signal."""


@njit
def _whole(value: float) -> int:
    return int(value) if np.isfinite(value) else -1


@njit
def _unusable(params: Any, command: Any, is_measured: bool, age: float, sensor: Any, controller: Any) -> Any:
    """What is wrong with this tick's messages, not their contents: monitor or `NO_TRIP`, leg or -1, cause or 0."""
    if not is_measured:
        return limits.MEASUREMENT, -1, 0
    if sensor[0] != 0.0:
        return limits.SENSOR, _whole(sensor[1]), _whole(sensor[0])
    if controller[0] != 0.0:
        return limits.CONTROLLER, _whole(controller[1]), _whole(controller[0])
    largest, leg = 0.0, 0
    for i in range(6):
        if not np.isfinite(command[i]):
            return limits.COMMAND, i, 0
        share = abs(command[i]) / params.torque_limit[i]
        if share > largest:
            largest, leg = share, i
    if not age <= params.deadline:
        return limits.DEADLINE, -1, 0
    if largest > ABSURD:
        return limits.TORQUE_LIMIT, leg, 0
    return NO_TRIP, -1, 0


@njit
def _tick(
    robot: Any, friction: Any, friction_unknown: Any, params: Any, user_trip: Any, command: Any, measurement: Any,
    reference: Any, age: Any, sensor: Any, controller: Any, angles: Any, pose_reading: Any, legs: Any,
    observed: Any, state: Any,
) -> Any:  # fmt: skip
    """One tick; `user_trip` (2,): a user's monitor that trips, and its leg.

    Returns GOES_ON, BLIND, RUNAWAY or HOLD_OVER, and the speed of the fastest crank.
    """
    robot, friction, params, legs, observed, state = (
        record(robot), record(friction), record(params), record(legs), record(observed), record(state),
    )  # fmt: skip
    pose, rate, wanted = measurement[:6], measurement[6:], reference[:6]
    read = pose_reading[:6] if pose_reading[0] == pose_reading[0] else pose
    update_residual(
        robot, friction, record(friction_unknown), params, angles, read, state.torque, state.ticks == 0.0, state, legs
    )
    unexplained = is_unexplained(params, state)
    state.unexplained_ticks = _counted(state.unexplained_ticks, unexplained)
    cranks = angles.copy()
    if state.encoders == 0.0:
        cranks_at(robot, read, legs, cranks)
    still, standing = watch(robot, params, cranks, wanted, legs, state)
    state.ticks += 1.0
    is_measured = all_finite(rate) and all_finite(pose + params.horizon * rate)
    is_observed = is_measured and sensor[0] == 0.0
    if is_observed:
        limits.observe(robot, params, pose, rate, wanted, state.assembly_sign, legs, observed)
        if state.assembly_sign == 0.0:
            state.assembly_sign = observed.assembly_sign
        trusted = observed.transmission.min() > WEIGHT_TRUSTED.transmission
        trusted = trusted and abs(observed.conditioning) > WEIGHT_TRUSTED.conditioning
        torque = np.empty(6)
        if trusted and static_torque(robot, legs, params.gravity, torque):
            copy_to(state.weight[:], torque)
    if state.safety[0] >= RAMP:
        return _stop(params, is_observed, unexplained, angles, state)
    monitor, level, leg, cause = NO_TRIP, RAMP, -1, 0
    if is_observed:
        monitor, leg = limits.broken(observed)
    # No blow repeats readings to the last bit while the reference moves.
    blind = state.moved >= REPEATED
    if monitor == NO_TRIP and blind and (unexplained or still == FROZEN):
        monitor = limits.READING
    if monitor == NO_TRIP and state.unexplained_ticks > params.blow:
        monitor = limits.UNEXPLAINED
    if monitor == NO_TRIP and still == STANDS:
        monitor, leg = limits.NOT_MOVING, standing
    if monitor == NO_TRIP:
        level = HOLD
        monitor, leg, cause = _unusable(params, command, is_measured, age[0], sensor, controller)
    if monitor == NO_TRIP:
        level = RAMP
        if is_observed and user_trip[0] > 0.0:
            monitor, leg = int(user_trip[0]), int(user_trip[1])
        else:
            monitor, leg = _pass_on(params, command, state)
    if monitor == NO_TRIP:
        return GOES_ON, 0.0
    # Holds where that may still be done, else begins to ramp.
    state.hold_used += 1.0
    if level == HOLD and state.hold_used > params.budget:
        level = RAMP
    if level == RAMP:
        if blind:
            state.suspect[:] = READING_WRONG
        else:
            suspect = mark_suspects(state, leg if monitor == limits.SENSOR else -1, unexplained)
            leg = suspect if suspect >= 0 else leg
    state.safety[0], state.safety[1], state.safety[2] = level, monitor, leg
    state.worst = max(state.worst, float(level))
    if state.first[0] == 0.0:
        first = state.first
        first[0], first[1], first[2], first[3], first[4] = monitor, level, leg, state.ticks - 1.0, cause
    if level == RAMP:
        return _stop(params, is_observed, unexplained, angles, state)
    copy_to(state.torque[:], _rate_limited(params, state.good[:], state))
    return GOES_ON, 0.0


@njit
def _counted(ticks: float, bad: bool) -> float:
    return max(0.0, ticks + (1.0 if bad else -1.0))


@njit
def _pass_on(params: Any, command: Any, state: Any) -> tuple[int, int]:
    """Passes a command on within the limits; a monitor that finds this has gone on for too long, and its leg."""
    size, change, limit = np.abs(command), np.abs(command - state.command), params.torque_limit
    full = (size >= limit * (1.0 - _ROUNDING)).any()
    steep = (change > _largest_change(params, state) * (1.0 + _ROUNDING)).any()
    state.at_limit, state.too_fast = _counted(state.at_limit, full), _counted(state.too_fast, steep)
    copy_to(state.command[:], command)
    if state.at_limit * params.period > limits.AT_LIMIT_TIME + _ROUNDING:
        return limits.TORQUE_LIMIT, limits.first_least(-size / limit)
    if state.too_fast * params.period > limits.TOO_FAST_TIME + _ROUNDING:
        return limits.TORQUE_RATE, limits.first_least(-change)
    # Led after it, a command that chatters would leave a mean torque that nobody asked for.
    torque = state.good.copy() if steep else np.minimum(np.maximum(command, -limit), limit)
    led = _rate_limited(params, torque, state)
    if not (full or steep) and (led == torque).all():
        copy_to(state.good[:], torque)
    copy_to(state.torque[:], led)
    state.safety[0], state.safety[1], state.safety[2] = NONE, NO_TRIP, -1.0
    state.hold_used = max(0.0, state.hold_used - REFILL)
    return NO_TRIP, -1


@njit
def _largest_change(params: Any, state: Any) -> float:
    """[N m] from one tick to the next."""
    return np.inf if state.ticks <= 1.0 else params.torque_change


@njit
def _rate_limited(params: Any, torque: Any, state: Any) -> Any:
    """Torques (6,) [N m] towards those wanted; to the last bit those, where nothing limits the change."""
    led, bound = np.empty(6), _largest_change(params, state)
    for i in range(6):
        ahead = torque[i] - state.torque[i]
        led[i] = state.torque[i] + min(max(ahead, -bound), bound) if abs(ahead) > bound else torque[i]
    return led


@njit
def _stop(params: Any, is_observed: bool, unexplained: bool, angles: Any, state: Any) -> Any:
    """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on.

    All ways of moving die away alike, in `params.stopping`. A leg whose reading is suspect is damped by the speed that
    torques alone say it has. That is good for a short time, as is a robot with a motor that fails.
    """
    state.since += 1.0
    if not state.suspect.any():
        leg = mark_suspects(state, -1, unexplained)
        state.safety[2] = leg if state.safety[2] < 0.0 else state.safety[2]
    is_seen = is_observed or np.isfinite(angles).sum() >= 5
    if not is_seen and state.hold_used >= params.budget:
        # Nobody can hold this robot without seeing it: an open loop falls over within half a second.
        return BLIND, 0.0
    brake, elapsed, limit = np.zeros((6, 1)), state.since * params.period, params.most_torque
    fastest = speeds_to_stop(params, state, brake[:, 0])
    state.fast = _counted(state.fast, fastest > params.most_speed)
    if state.fast * params.period > limits.RUNAWAY_TIME + _ROUNDING:
        return RUNAWAY, fastest
    is_whole = not state.suspect.any()
    hold = params.ramp_time + params.safe_hold_time if is_whole else params.suspect_hold_time
    if elapsed > hold + _ROUNDING:
        return HOLD_OVER, 0.0
    # A command that came from a wrong reading is not led on. The inertia of the cranks makes a torque of a speed.
    share = min(1.0, elapsed / params.ramp_time) if is_whole else 1.0
    wanted = (1.0 - share) * state.good + share * state.weight
    if is_seen and solve(state.mobility.copy(), brake) != 0.0 and all_finite(brake[:, 0]):
        # Of a crank that may have lost its rod nothing says how much it bears.
        wanted -= np.where(state.suspect == MOTOR_WEAK, 0.0, brake[:, 0]) / params.stopping
    motor_torques(state, wanted)
    copy_to(state.torque[:], _rate_limited(params, np.minimum(np.maximum(wanted, -limit), limit), state))
    state.safety[0] = SAFE_HOLD if elapsed >= params.ramp_time else RAMP
    state.worst = max(state.worst, state.safety[0])
    state.hold_used = 0.0 if is_seen else state.hold_used + 1.0
    return GOES_ON, 0.0


def safety_part(options: SafetyOptions, context: LoopContext) -> Part:
    """The safety layer; ports for which a loop may have no signal read `NOT_THERE`.

    Where the very first command is bad, `context.initial_torque` is held.
    """
    robot, period = context.robot, context.period
    params = limits.params_of(robot, options, context.gravity, period, context.noise)
    torques = dict.fromkeys(("torque", "good", "weight", "command", "sent"), context.initial_torque)
    unread = dict.fromkeys(("angles", "poses"), np.nan)
    first = new_record(_STATE, **torques, **unread, safety=(NONE, NO_TRIP, -1.0))
    kernel: Any = _tick
    numbers = {"robot": laws.robot_record(robot), "friction": context.friction.record()}
    numbers["friction_unknown"] = np.zeros(1, FRICTION)
    constants: dict[str, Any] = {"user_trip": np.zeros(2)}
    if options.monitors:
        kernel, constants = _tick_with_monitors, {**constants, "options": options}
    inputs = {"command": 6, "measurement": 12, "reference": 18}
    inputs |= {name: len(value) for name, value in NOT_THERE.items()}
    error = partial(_stopped, options, period)
    part = Part("safety", kernel, constants, inputs, ("torque", "safety"), first, (laws.Legs, OBSERVED), error=error)
    return part._replace(connections=NOT_THERE, parameters={**numbers, "params": params})


def _tick_with_monitors(
    robot: np.ndarray, friction: np.ndarray, friction_unknown: np.ndarray, params: np.ndarray,
    user_trip: np.ndarray, options: SafetyOptions, *arguments: np.ndarray,
) -> Any:  # fmt: skip
    """`_tick` with the first of a user's monitors that trips, if any."""
    command, measured, wanted, age, sensor, controller, *_ = arguments
    user_trip[:] = 0.0
    if np.isfinite(measured).all():
        health = tuple(sensor), tuple(controller)
        inputs = SafetyInputs(command, measured[:6], measured[6:], wanted[:6], float(age[0]), *health)
        trip = options.first_user_trip(inputs)
        user_trip[:] = user_trip if trip is None else trip
    return cast(Any, _tick)(robot, friction, friction_unknown, params, user_trip, *arguments)


def _stopped(options: SafetyOptions, period: float, result: Any, arguments: Mapping[str, Any]) -> SafetyStop:
    (status, fastest), state = result, arguments["state"]
    names, (_, monitor, leg) = options.monitor_names, state["safety"][0]
    name = names[int(monitor)]
    longest = limits.SUSPECT_HOLD if state["suspect"].any() else np.inf
    what = {
        BLIND: "stopped: no measurement to hold the robot by",
        RUNAWAY: f"stopping, but a crank turns at {fastest:.3g} rad/s",
        HOLD_OVER: f"stopped, and held for {min(longest, options.safe_hold_time):g} s",
    }[status]
    text = "; ".join(filter(None, (MEANINGS.get(name), what)))
    if status != HOLD_OVER:
        state["safety"][0, 0] = state["worst"] = END
    return SafetyStop(name, f"{name}: {text}", int(leg) if leg >= 0.0 else None, first_trip(state, period, names))


def first_trip(state: np.ndarray, period: float, names: Sequence[str] = MONITORS) -> dict[str, Any] | None:
    """What the layer's last state has to tell of a run of ticks of a period [s]; None where no monitor tripped.

    monitor, level, time [s], leg, cause of the first trip; worst, the highest level; last, the level now; stopped, the
    trip for which the robot was taken from its controller for good, or None.
    """
    now: Any = state[0]
    monitor, level, leg, tick, cause = now["first"]
    if monitor == 0.0:
        return None

    def trip(monitor: float, tick: float, leg: float) -> dict[str, Any]:
        time = round(float(tick) * period, 9)
        return {"monitor": names[int(monitor)], "time": time, "leg": int(leg) if leg >= 0.0 else None}

    last, by, at = now["safety"]
    return {
        **trip(monitor, tick, leg),
        "level": LEVELS[int(level)],
        "cause": FAILURES[int(cause) - 1] if cause > 0.0 else None,
        "worst": LEVELS[int(now["worst"])],
        "last": LEVELS[int(last)],
        "stopped": trip(by, now["ticks"] - now["since"], at) if last >= RAMP else None,
    }
