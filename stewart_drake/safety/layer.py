"""A tick of the safety layer, compiled: its monitors, its levels and reactions, and the part of a loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np

from stewart_drake.errors import FAILURES, SafetyStop, failure_code
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import static_torque
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, solve
from stewart_drake.part import HEALTHY, Part, Setup
from stewart_drake.safety import limits
from stewart_drake.safety.limits import MEANINGS, MONITORS, OBSERVED, QUIET, SafetyInputs, SafetyOptions
from stewart_drake.safety.residual import (
    EXPLAINED,
    MOTOR_WEAK,
    explain,
    is_odd,
    mark_suspects,
    motor_torques,
    speeds_to_stop,
)

LEVELS = ("none", "hold", "ramp", "safe_hold", "end")
NONE, HOLD, RAMP, SAFE_HOLD, END = range(5)
FROZEN = failure_code("frozen")
ABSURD = 10.0  # A command of so many times the limit is an error of the controller and no wish for torque.
REFILL = 0.05  # Ticks of the budget of holding that a good tick gives back: a fault that flickers uses it up too.
# Nearer to a singularity the weight's torque is not trusted any more, and the last one stays.
USABLE_TRANSMISSION, USABLE_CONDITIONING = 0.02, 0.01
_ROUNDING = 1e-9

_STATE = np.dtype([*fields(
    torque=6, safety=3, good=6, weight=6, held=(), at_limit=(), too_fast=(), since=(), side=(),
    ticks=(), first=5, worst=(), command=6, readings=6, stood=6, odd=(), fast=(),
).descr, *EXPLAINED.descr])  # fmt: skip
"""torque: for the motors [N m]. safety: numbers of level in `LEVELS` and monitor in `MONITORS`, leg or -1. good: last
good command, one that no limit touched [N m]. weight: last torque that carried the robot's weight [N m]. held: ticks of
holding, less what good ones gave back; while stopping, ticks without a measurement. at_limit, too_fast, odd, fast:
ticks at the torque limit, of commands that jumped, of residuals that were too large, and of a stop that runs away, less
good ones. since: ticks of ramp and safe hold. side: sign of the rods' determinant at the start, 0 before the first
tick. ticks: done. first: monitor, level, leg, tick and cause in `FAILURES` of the first trip, zeros before. worst:
highest level so far. command: that of the last tick, if it was finite [N m]. readings, stood: last pose read, and the
reference when it came [rad, m]. The rest: see `EXPLAINED`."""

GOES_ON, BLIND, RUNAWAY, HELD = range(4)  # How a tick ends: in the last three the run is over.

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
def _unusable(setup: Any, command: Any, is_measured: bool, age: float, sensor: Any, controller: Any) -> Any:
    """What is wrong with this tick's messages, apart from what they say: monitor or `QUIET`, leg or -1, cause or 0."""
    if not is_measured:
        return limits.MEASUREMENT, -1, 0
    stuck = sensor[0] == FROZEN
    if not stuck and sensor[0] != 0.0:
        return limits.SENSOR, _whole(sensor[1]), _whole(sensor[0])
    if controller[0] != 0.0:
        return limits.CONTROLLER, _whole(controller[1]), _whole(controller[0])
    largest, leg = 0.0, 0
    for i in range(6):
        if not np.isfinite(command[i]):
            return limits.COMMAND, i, 0
        share = abs(command[i]) / setup.torque_limit[i]
        if share > largest:
            largest, leg = share, i
    if not age <= setup.deadline:
        return limits.DEADLINE, -1, 0
    if largest > ABSURD:
        return limits.TORQUE_LIMIT, leg, 0
    return (limits.READING, int(sensor[1]), 0) if stuck else (QUIET, -1, 0)


@njit
def _pose_stuck(setup: Any, pose: Any, reference: Any, state: Any) -> bool:
    """Whether a measured pose (6,) stays the same to the last bit while the reference moves on."""
    if not (pose == state.readings).all():
        copy_to(state.stood[:], reference)
    copy_to(state.readings[:], pose)
    return (np.abs(reference - state.stood) > setup.frozen_pose).any()


@njit
def _tick(
    robots: Any, setups: Any, own: Any, command: Any, measurement: Any, reference: Any, age: Any, sensor: Any,
    controller: Any, angles: Any, pose_reading: Any, leg_records: Any, observations: Any, states: Any,
) -> Any:  # fmt: skip
    """One tick; `own` (2,): a user's monitor that trips, its leg. GOES_ON, BLIND, RUNAWAY or HELD; fastest crank."""
    robot, setup, legs, observed, state = (
        record(robots), record(setups), record(leg_records), record(observations), record(states),
    )  # fmt: skip
    pose, rate, wanted, health = measurement[:6], measurement[6:], reference[:6], sensor.copy()
    read = pose_reading[:6] if pose_reading[0] == pose_reading[0] else pose
    explain(robot, setup, angles, read, state.torque, state.ticks == 0.0, state, legs)
    odd = is_odd(setup, state)
    state.odd = _counted(state.odd, odd)
    if state.encoders == 0.0 and _pose_stuck(setup, read, wanted, state):
        health[0], health[1] = FROZEN, -1.0
    state.ticks += 1.0
    is_measured = all_finite(rate) and all_finite(pose + setup.horizon * rate)
    is_observed = is_measured and health[0] == 0.0
    if is_observed:
        limits.observe(robot, setup, pose, rate, wanted, state.side, legs, observed)
        if state.side == 0.0:
            state.side = observed.side
        far = observed.least_transmission > USABLE_TRANSMISSION and abs(observed.conditioning) > USABLE_CONDITIONING
        torque = np.empty(6)
        if observed.reached > 0.0 and far and static_torque(robot, legs, setup.gravity, torque):
            copy_to(state.weight[:], torque)
    if state.safety[0] >= RAMP:
        return _stop(setup, is_observed, odd, angles, state)
    monitor, level, leg, cause = QUIET, RAMP, -1, 0
    if is_observed:
        monitor, leg = limits.broken(observed)
    if monitor == QUIET and state.odd > setup.blow:
        monitor = limits.UNEXPLAINED
    if monitor == QUIET:
        level = HOLD
        monitor, leg, cause = _unusable(setup, command, is_measured, age[0], health, controller)
    if monitor == QUIET:
        level = RAMP
        if is_observed and own[0] > 0.0:
            monitor, leg = int(own[0]), int(own[1])
        else:
            monitor, leg = _pass_on(setup, command, state)
    if monitor == QUIET:
        return GOES_ON, 0.0
    # Holds where that may still be done, else begins to ramp.
    state.held += 1.0
    if level == HOLD and state.held > setup.budget:
        level = RAMP
    if level == RAMP:
        suspect = mark_suspects(state, leg if monitor == limits.SENSOR else -1, odd)
        leg = suspect if suspect >= 0 else leg
    state.safety[0], state.safety[1], state.safety[2] = level, monitor, leg
    state.worst = max(state.worst, float(level))
    if state.first[0] == 0.0:
        first = state.first
        first[0], first[1], first[2], first[3], first[4] = monitor, level, leg, state.ticks - 1.0, cause
    if level == RAMP:
        return _stop(setup, is_observed, odd, angles, state)
    copy_to(state.torque[:], _led(setup, state.good[:], state))
    return GOES_ON, 0.0


@njit
def _counted(ticks: float, bad: bool) -> float:
    return max(0.0, ticks + (1.0 if bad else -1.0))


@njit
def _pass_on(setup: Any, command: Any, state: Any) -> tuple[int, int]:
    """Passes a command on within the limits; a monitor that finds this has gone on for too long, and its leg."""
    size, change, limit = np.abs(command), np.abs(command - state.command), setup.torque_limit
    full = (size >= limit * (1.0 - _ROUNDING)).any()
    steep = (change > _largest_change(setup, state) * (1.0 + _ROUNDING)).any()
    state.at_limit, state.too_fast = _counted(state.at_limit, full), _counted(state.too_fast, steep)
    copy_to(state.command[:], command)
    if state.at_limit * setup.period > limits.AT_LIMIT_TIME + _ROUNDING:
        return limits.TORQUE_LIMIT, (size / limit).argmax()
    if state.too_fast * setup.period > limits.TOO_FAST_TIME + _ROUNDING:
        return limits.TORQUE_RATE, change.argmax()
    # Led after it, a command that chatters would leave a mean torque that nobody asked for.
    torque = state.good.copy() if steep else np.minimum(np.maximum(command, -limit), limit)
    led = _led(setup, torque, state)
    if not (full or steep) and (led == torque).all():
        copy_to(state.good[:], torque)
    copy_to(state.torque[:], led)
    state.safety[0], state.safety[1], state.safety[2] = NONE, QUIET, -1.0
    state.held = max(0.0, state.held - REFILL)
    return QUIET, -1


@njit
def _largest_change(setup: Any, state: Any) -> float:
    """[N m] from one tick to the next."""
    return np.inf if state.ticks <= 1.0 else setup.torque_change


@njit
def _led(setup: Any, torque: Any, state: Any) -> Any:
    """Torques (6,) [N m] towards those wanted; to the last bit those, where nothing limits the change."""
    led, bound = np.empty(6), _largest_change(setup, state)
    for i in range(6):
        ahead = torque[i] - state.torque[i]
        led[i] = state.torque[i] + min(max(ahead, -bound), bound) if abs(ahead) > bound else torque[i]
    return led


@njit
def _stop(setup: Any, is_observed: bool, odd: bool, angles: Any, state: Any) -> Any:
    """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on.

    All ways of moving die away alike, in `setup.stopping`. A leg whose reading is suspect is damped by the speed that
    torques alone say it has. That is good for a short time, as is a robot with a motor that fails.
    """
    state.since += 1.0
    if not state.suspect.any():
        leg = mark_suspects(state, -1, odd)
        state.safety[2] = leg if state.safety[2] < 0.0 else state.safety[2]
    is_seen = is_observed or np.isfinite(angles).sum() >= 5
    if not is_seen and state.held >= setup.budget:
        # Nobody can hold this robot without seeing it: an open loop falls over within half a second.
        return BLIND, 0.0
    brake, elapsed, limit = np.zeros((6, 1)), state.since * setup.period, setup.most_torque
    fastest = speeds_to_stop(state, brake[:, 0])
    state.fast = _counted(state.fast, fastest > setup.most_speed)
    if state.fast * setup.period > limits.RUNAWAY_TIME + _ROUNDING:
        return RUNAWAY, fastest
    is_whole = not state.suspect.any()
    hold = setup.ramp_time + setup.safe_hold_time if is_whole else setup.suspect_hold_time
    if elapsed > hold + _ROUNDING:
        return HELD, 0.0
    # A command that came from a wrong reading is not led on. The inertia of the cranks makes a torque of a speed.
    share = min(1.0, elapsed / setup.ramp_time) if is_whole else 1.0
    wanted = (1.0 - share) * state.good + share * state.weight
    if is_seen and solve(state.mobility.copy(), brake) != 0.0 and all_finite(brake[:, 0]):
        # Of a crank that may have lost its rod nothing says how much it bears.
        wanted -= np.where(state.suspect == MOTOR_WEAK, 0.0, brake[:, 0]) / setup.stopping
    motor_torques(state, wanted)
    copy_to(state.torque[:], _led(setup, np.minimum(np.maximum(wanted, -limit), limit), state))
    state.safety[0] = SAFE_HOLD if elapsed >= setup.ramp_time else RAMP
    state.worst = max(state.worst, state.safety[0])
    state.held = 0.0 if is_seen else state.held + 1.0
    return GOES_ON, 0.0


def safety_part(options: SafetyOptions, setup: Setup) -> Part:
    """The safety layer; ports for which a loop may have no signal read `NOT_THERE`, unless `reads` is replaced.

    Where the very first command is bad, `setup.initial_torque` is held.
    """
    robot, period = setup.robot, setup.period
    params = limits.setup_of(robot, options, setup.gravity, period, setup.noise, setup.friction, setup.viscous)
    held = dict.fromkeys(("torque", "good", "weight", "command", "sent"), setup.initial_torque)
    unread = dict.fromkeys(("readings", "stood", "angles", "poses"), np.nan)
    first = new_record(_STATE, **held, **unread, safety=(NONE, QUIET, -1.0))
    kernel: Any = _tick
    constants: dict[str, Any] = {"robot": laws.robot_record(robot), "params": params, "own": np.zeros(2)}
    if options.monitors:
        kernel, constants = _tick_with_monitors, {**constants, "options": options}
    inputs = {"command": 6, "measurement": 12, "reference": 18} | {name: len(each) for name, each in NOT_THERE.items()}
    error = partial(_stopped, options, period)
    part = Part("safety", kernel, constants, inputs, ("torque", "safety"), first, (laws.LEGS, OBSERVED), error)
    return part._replace(connections=NOT_THERE)


def _tick_with_monitors(
    robots: np.ndarray, params: np.ndarray, own: np.ndarray, options: SafetyOptions, *arguments: np.ndarray
) -> Any:
    """`_tick` with what the first of a user's monitors that trips says, if any."""
    command, measured, wanted, age, sensor, controller, *_ = arguments
    own[:] = 0.0
    if np.isfinite(measured).all():
        health = tuple(sensor), tuple(controller)
        trip = options.first_own(SafetyInputs(command, measured[:6], measured[6:], wanted[:6], float(age[0]), *health))
        own[:] = own if trip is None else trip
    return cast(Any, _tick)(robots, params, own, *arguments)


def _stopped(options: SafetyOptions, period: float, result: Any, arguments: Mapping[str, Any]) -> SafetyStop:
    (status, fastest), state = result, arguments["state"]
    names, (_, monitor, leg) = options.monitor_names, state["safety"][0]
    name = names[int(monitor)]
    longest = limits.SUSPECT_HOLD if state["suspect"].any() else np.inf
    what = {
        BLIND: "stopped: no measurement to hold the robot by",
        RUNAWAY: f"stopping, but a crank turns at {fastest:.3g} rad/s",
        HELD: f"stopped, and held for {min(longest, options.safe_hold_time):g} s",
    }[status]
    text = "; ".join(filter(None, (MEANINGS.get(name), what)))
    if status != HELD:
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
