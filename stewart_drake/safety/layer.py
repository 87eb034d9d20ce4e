"""A tick of the safety layer, compiled: its levels, its reactions, and the part of a loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from stewart_drake.errors import FAILURES, SafetyStop
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics_laws import static_torque
from stewart_drake.mechanics.kinematics_laws import LEGS, robot_record
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.part import WELL, Part
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.monitors import (
    FROZEN,
    INNOVATION,
    NOTHING_FROZEN,
    QUIET,
    SEEN,
    TORQUE_LIMIT,
    TORQUE_RATE,
    broken,
    failed,
    frozen,
    measured,
    see,
    setup_of,
    unexplained,
    unusable,
)
from stewart_drake.safety.safety_options import MEANINGS, MONITORS, SafetyInputs, SafetyOptions

LEVELS = ("none", "hold", "ramp", "safe_hold", "end")
NONE, HOLD, RAMP, SAFE_HOLD, END = range(5)

REFILL = 0.05
"""Ticks by which the budget of holding recovers in a good tick, so that a fault that flickers uses it up too."""
USABLE_TRANSMISSION, USABLE_CONDITIONING = 0.02, 0.01
"""Nearer to a singularity the weight's torque is not trusted any more, and the last one stays."""
_ROUNDING = 1e-9

SAFETY_STATE = fields(
    torque=6, safety=3, good=6, weight=6, held=(), at_limit=(), too_fast=(), unexplained=(), since=(), side=(),
    ticks=(), first=5, worst=(), command=6, acceleration=(), readings=6, anchors=(6, 6), encoders=(),
)  # fmt: skip
"""torque: for the motors [N m]. safety: numbers of level in `LEVELS` and monitor in `MONITORS`, leg or -1. good: last
good command, one that no limit touched [N m]. weight: last torque that carried the robot's weight [N m]. held: ticks of
holding, less what good ones gave back; while stopping, ticks without a measurement. at_limit, too_fast, unexplained:
ticks at the torque limit, of commands that jumped and of innovations that were too large, less good ones. since: ticks
of ramp and safe hold. side: sign of the rods' determinant at the start, 0 before the first tick. ticks: done. first:
monitor, level, leg, tick and cause in `FAILURES` of the first trip, zeros before. worst: highest level so far. command:
that of the last tick, if it was finite [N m]. acceleration: see `monitors.unexplained` [rad/s^2]. readings, anchors,
encoders: see `monitors.frozen`."""

GOES_ON, BLIND, RUNAWAY, HELD = range(4)
"""How a tick ends: the run goes on, or is over: blind, with a robot that runs away, or held for long enough."""

NOT_THERE = {
    "age": np.zeros(1),
    "sensor_health": np.array(WELL),
    "controller_health": np.array(WELL),
    "angles": np.full(6, np.nan),
    "innovation": np.full(6, np.nan),
    "pose_reading": np.full(12, np.nan),
}
"""What stands at a port for which a loop has no signal."""


@njit
def safety_tick(
    robots: Any, setups: Any, command: Any, measurement: Any, reference: Any, age: Any, sensor: Any, controller: Any,
    angles: Any, innovation: Any, pose_reading: Any, own: Any, leg_records: Any, seens: Any, states: Any,
) -> Any:  # fmt: skip
    """One tick of the safety layer.

    Args:
        robots: `ROBOT` record, as believed.
        setups: `monitors.SETUP` record.
        command: (6,) [N m] of the controller.
        measurement: (12,) pose [rad, m] and its rate.
        reference: (18,) of which the pose is compared.
        age: (1,) [ticks] of the command.
        sensor: (2,) health of the estimator, see `part.guarded`.
        controller: (2,) health of the controller.
        angles: (6,) [rad] readings of encoders, or NaN.
        innovation: (6,) [rad] of an observer, or NaN.
        pose_reading: (12,) of a sensor of the pose behind which an observer stands, or NaN.
        own: (2,) monitor of the user's own that trips, and its leg; zeros for none.
        leg_records: `LEGS` record, overwritten.
        seens: `monitors.SEEN` record, overwritten.
        states: `SAFETY_STATE` record, in place.

    Returns:
        GOES_ON, BLIND, RUNAWAY or HELD, and the fastest crank [rad/s].
    """
    robot, setup, legs, seen, state = (
        record(robots), record(setups), record(leg_records), record(seens), record(states),
    )  # fmt: skip
    health, wanted = sensor.copy(), reference[:6]
    pose = pose_reading[:6] if pose_reading[0] == pose_reading[0] else measurement[:6]
    leg = frozen(robot, setup, angles, pose, wanted, state, legs)
    if leg != NOTHING_FROZEN:
        health[0], health[1] = FROZEN, leg
    state.ticks += 1.0
    state.acceleration = unexplained(setup, innovation)
    is_measured = measured(setup, measurement)
    is_seen = is_measured and not failed(setup, health[0])
    if is_seen:
        see(robot, setup.home[:], setup.horizon, measurement[:6], measurement[6:], wanted, state.side, legs, seen)
        _weigh(robot, setup, legs, seen, state)
    if state.safety[0] >= RAMP:
        return _stop(setup, is_seen, seen, state)

    monitor, level, leg, cause = QUIET, RAMP, -1, 0
    if is_seen:
        monitor, leg = broken(setup, seen)
    if monitor == QUIET:
        level = HOLD
        monitor, leg, cause = unusable(setup, command, is_measured, age[0], health, controller)
    if monitor == QUIET:
        level = RAMP
        if is_seen and own[0] > 0.0:
            monitor, leg = int(own[0]), int(own[1])
        else:
            monitor, leg = _pass_on(setup, command, state)
    if monitor == QUIET:
        return GOES_ON, 0.0
    return _react(setup, monitor, level, leg, cause, is_seen, seen, state)


@njit
def _weigh(robot: Any, setup: Any, legs: Any, seen: Any, state: Any) -> None:
    """Keeps the torque that carries the robot where it is seen, and the side on which it started."""
    if state.side == 0.0:
        state.side = seen.side
    far = seen.transmission.min() > USABLE_TRANSMISSION and abs(seen.conditioning) > USABLE_CONDITIONING
    torque = np.empty(6)
    if seen.reached > 0.0 and far and static_torque(robot, legs, setup.gravity, torque):
        copy_to(state.weight[:], torque)


@njit
def _pass_on(setup: Any, command: Any, state: Any) -> tuple[int, int]:
    """Passes a command on within the limits; a monitor that finds this has gone on for too long, and its leg."""
    period, jump = setup.period, _largest_change(setup, state) * (1.0 + _ROUNDING)
    torque, full, steep, most_full, most_steep = np.empty(6), False, False, 0, 0
    for i in range(6):
        limit, change = setup.torque_limit[i], abs(command[i] - state.command[i])
        torque[i] = min(max(command[i], -limit), limit)
        full = full or abs(command[i]) >= limit * (1.0 - _ROUNDING)
        steep = steep or change > jump
        if abs(command[i]) / limit > abs(command[most_full]) / setup.torque_limit[most_full]:
            most_full = i
        if change > abs(command[most_steep] - state.command[most_steep]):
            most_steep = i
    if steep:
        # Led after it, a command that chatters would leave a mean torque that nobody asked for.
        copy_to(torque, state.good[:])
    copy_to(state.command[:], command)
    state.at_limit = max(0.0, state.at_limit + (1.0 if full else -1.0))
    state.too_fast = max(0.0, state.too_fast + (1.0 if steep else -1.0))
    state.unexplained = max(0.0, state.unexplained + (1.0 if state.acceleration > setup.innovation else -1.0))
    if state.at_limit * period > setup.torque_limit_time + _ROUNDING:
        return TORQUE_LIMIT, most_full
    if state.too_fast * period > setup.torque_rate_time + _ROUNDING:
        return TORQUE_RATE, most_steep
    if state.unexplained * period > setup.innovation_time + _ROUNDING:
        return INNOVATION, -1
    led = _led(setup, torque, state)
    if not (full or steep) and (led == torque).all():
        copy_to(state.good[:], torque)
    copy_to(state.torque[:], led)
    state.safety[0], state.safety[1], state.safety[2] = NONE, QUIET, -1.0
    state.held = max(0.0, state.held - REFILL)
    return QUIET, -1


@njit
def _largest_change(setup: Any, state: Any) -> float:
    """[N m] from one tick to the next; the first command has nothing before it."""
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
def _react(setup: Any, monitor: int, level: int, leg: int, cause: int, is_seen: bool, seen: Any, state: Any) -> Any:
    """Holds where that may still be done, else begins to ramp."""
    state.held += 1.0
    if level == HOLD and state.held > setup.budget:
        level = RAMP
    state.safety[0], state.safety[1], state.safety[2] = level, monitor, leg
    state.worst = max(state.worst, float(level))
    if state.first[0] == 0.0:
        first = state.first
        first[0], first[1], first[2], first[3], first[4] = monitor, level, leg, state.ticks - 1.0, cause
    if level == RAMP:
        return _stop(setup, is_seen, seen, state)
    copy_to(state.torque[:], _led(setup, state.good[:], state))
    return GOES_ON, 0.0


@njit
def _stop(setup: Any, is_seen: bool, seen: Any, state: Any) -> Any:
    """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on."""
    state.since += 1.0
    if not is_seen and state.held >= setup.budget:
        # Nobody can hold this robot without seeing it: an open loop falls over within half a second.
        return BLIND, 0.0
    speed, torque, elapsed = np.zeros(6), np.empty(6), state.since * setup.period
    if is_seen and seen.reached > 0.0:
        copy_to(speed, seen.speed[:])
    fastest = np.abs(speed).max()
    if fastest > setup.most_speed:
        return RUNAWAY, fastest
    if elapsed > setup.ramp_time + setup.safe_hold_time + _ROUNDING:
        return HELD, 0.0
    share = min(1.0, elapsed / setup.ramp_time)
    for i in range(6):
        limit = setup.most_torque[i]
        wanted = (1.0 - share) * state.good[i] + share * state.weight[i] - setup.damping * speed[i]
        torque[i] = min(max(wanted, -limit), limit)
    copy_to(state.torque[:], _led(setup, torque, state))
    state.safety[0] = SAFE_HOLD if share >= 1.0 else RAMP
    state.worst = max(state.worst, state.safety[0])
    state.held = 0.0 if is_seen else state.held + 1.0
    return GOES_ON, 0.0


def safety_part(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    period: float,
    initial: np.ndarray,
    quantum: float = 0.0,
    innovation_scale: tuple[float, float] = (0.0, 1.0),
) -> Part:
    """The safety layer, see `safety_tick` for its inputs; `torque` (6,) [N m] for the motors, `safety` (3,).

    Its ports for which a loop may have no signal read `NOT_THERE`, unless `reads` is replaced. `initial` (6,) [N m] are
    held where the very first command is bad; `quantum` [rad] is a count of the encoders; for `innovation_scale` see
    `observer.innovation_scale`.
    """
    own, setup = robot_record(robot), setup_of(robot, options, gravity, period, quantum, innovation_scale)
    none = np.full((6, 6), np.nan)
    first = new_record(
        SAFETY_STATE,
        torque=initial,
        safety=(NONE, QUIET, -1.0),
        good=initial,
        weight=initial,
        command=initial,
        readings=none[0],
        anchors=none,
    )
    nothing, legs, seen, law = np.zeros(2), np.empty(1, LEGS), np.empty(1, SEEN), cast(Any, safety_tick)

    def tick(*ports: np.ndarray) -> None:
        *inputs, state = ports
        trip = None
        if options.monitors and np.isfinite(inputs[1]).all():
            command, measured_now, wanted, age, sensor, controller, *_ = inputs
            pose, rate, health = measured_now[:6], measured_now[6:], (tuple(sensor), tuple(controller))
            trip = options.first_own(SafetyInputs(command, pose, rate, wanted[:6], float(age[0]), *health))
        asked = nothing if trip is None else np.array(trip, dtype=float)
        status, fastest = law(own, setup, *inputs, asked, legs, seen, state)
        if status != GOES_ON:
            raise _stopped(options, period, status, fastest, state)

    sizes = {"command": 6, "measurement": 12, "reference": 18} | {name: len(each) for name, each in NOT_THERE.items()}
    return Part("safety", sizes, ("torque", "safety"), first, tick, reads=NOT_THERE)


def _stopped(options: SafetyOptions, period: float, status: int, fastest: float, state: np.ndarray) -> SafetyStop:
    """The end of the run."""
    names, (_, monitor, leg) = options.monitor_names, state["safety"][0]
    name = names[int(monitor)]
    what = {
        BLIND: "stopped: no measurement to hold the robot by",
        RUNAWAY: f"stopping, but a crank turns at {fastest:.3g} rad/s",
        HELD: f"stopped, and held for {options.safe_hold_time:g} s",
    }[status]
    text = "; ".join(filter(None, (MEANINGS.get(name), what)))
    if status != HELD:
        state["safety"][0, 0] = state["worst"] = END
    return SafetyStop(name, f"{name}: {text}", int(leg) if leg >= 0.0 else None, first_trip(state, period, names))


def first_trip(state: np.ndarray, period: float, names: Sequence[str] = MONITORS) -> dict[str, Any] | None:
    """What the layer has to tell of a run; None where no monitor tripped.

    Args:
        state: `SAFETY_STATE` record of the last tick.
        period: [s] of the ticks.
        names: Of the monitors, see `SafetyOptions.monitor_names`.

    Returns:
        monitor, level, time [s], leg (or None) and cause (or None) of the first trip; worst, the highest level; last,
        the level now; stopped, monitor, time and leg (or None) of the trip for which the robot was taken from its
        controller for good, or None.
    """
    now: Any = state[0]
    monitor, level, leg, tick, cause = now["first"]
    if monitor == 0.0:
        return None

    def told(monitor: float, tick: float, leg: float) -> dict[str, Any]:
        time = round(float(tick) * period, 9)
        return {"monitor": names[int(monitor)], "time": time, "leg": int(leg) if leg >= 0.0 else None}

    last, by, at = now["safety"]
    return {
        **told(monitor, tick, leg),
        "level": LEVELS[int(level)],
        "cause": FAILURES[int(cause) - 1] if cause > 0.0 else None,
        "worst": LEVELS[int(now["worst"])],
        "last": LEVELS[int(last)],
        "stopped": told(by, now["ticks"] - now["since"], at) if last >= RAMP else None,
    }
