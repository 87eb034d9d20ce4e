"""One tick of the safety layer as a pure function, with its reactions."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from stewart_drake.compiled.constants import SAFETY_NUMBERS, filled
from stewart_drake.errors import SafetyStop
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.memory import (
    END,
    HOLD,
    MEMORY_SIZE,
    MONITORS,
    RAMP,
    SAFE_HOLD,
    SafetyInputs,
    SafetyMemory,
    Trip,
    first_trip,
)
from stewart_drake.safety.monitors import (
    USABLE_CONDITIONING,
    USABLE_TRANSMISSION,
    View,
    failed,
    further,
    look,
    measured,
    unusable,
)
from stewart_drake.safety.safety_options import SafetyOptions

_REFILL = 0.05
"""Ticks by which the budget of holding recovers in a good tick, so that a fault that flickers uses it up too."""


def safety_tick(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    period: float,
    inputs: SafetyInputs,
    memory: SafetyMemory,
) -> SafetyMemory:
    """One tick of the safety layer.

    Args:
        robot: As believed.
        options: Limits and reactions.
        gravity: [m/s^2].
        period: [s] of the ticks.
        inputs: See `SafetyInputs`.
        memory: Of the tick before, see `initial_memory`.

    Raises:
        SafetyStop: The run is over; its reason is the monitor that tripped.
    """
    # A finite blow-up may overflow on the way; what is not a number then trips a monitor.
    with np.errstate(all="ignore"):
        seen = measured(options, inputs) and not failed(options, inputs.sensor)
        view = look(robot, options, gravity, inputs, memory.side) if seen else None
    memory = memory._replace(ticks=memory.ticks + 1.0)
    if view is not None:
        memory = memory._replace(
            side=memory.side or view.side, weight=memory.weight if view.weight is None else view.weight
        )
    if memory.level >= RAMP:
        return _stopping(robot, options, period, view, memory)
    limit = math.inf if options.torque_limit is None else options.torque_limit * robot.effort_limit
    trip = view.trip if view is not None else None
    trip = trip or unusable(options, inputs, limit)
    if trip is None and seen:
        trip = further(options, inputs)
    if trip is not None:
        return _react(robot, options, period, view, memory, trip)

    command = inputs.command
    torque = np.clip(command, -limit, limit)
    full = np.abs(command) >= limit * (1.0 - 1e-9)
    change = command - memory.command
    bound = _largest_change(options, period, memory)
    steep = np.abs(change) > bound * (1.0 + 1e-9)
    if steep.any():
        # Led after it, a command that chatters would leave a mean torque that nobody asked for.
        torque = memory.good
    led = _led(torque, memory, bound)
    memory = memory._replace(
        command=command,
        at_limit=max(0.0, memory.at_limit + (1.0 if full.any() else -1.0)),
        too_fast=max(0.0, memory.too_fast + (1.0 if steep.any() else -1.0)),
    )
    if memory.at_limit * period > options.torque_limit_time + 1e-9:
        trip = Trip(MONITORS.index("torque_limit"), RAMP, int(np.abs(command).argmax()))
    elif memory.too_fast * period > options.torque_rate_time + 1e-9:
        trip = Trip(MONITORS.index("torque_rate"), RAMP, int(np.abs(change).argmax()))
    if trip is not None:
        return _react(robot, options, period, view, memory, trip)
    good = memory.good if full.any() or steep.any() or np.any(led != torque) else torque
    return memory._replace(
        torque=led, good=good, level=0.0, monitor=0.0, leg=-1.0, held=max(0.0, memory.held - _REFILL)
    )


def _largest_change(options: SafetyOptions, period: float, memory: SafetyMemory) -> float:
    """[N m] from one tick to the next; the first command has nothing before it."""
    return math.inf if options.torque_rate is None or memory.ticks <= 1.0 else options.torque_rate * period


def _led(torque: np.ndarray, memory: SafetyMemory, bound: float) -> np.ndarray:
    """Torques (6,) [N m] towards those wanted; to the last bit those, where nothing limits the change."""
    ahead = torque - memory.torque
    return np.where(np.abs(ahead) > bound, memory.torque + np.clip(ahead, -bound, bound), torque)


FlatTick = Callable[[SafetyInputs, np.ndarray], np.ndarray]


def flat_tick(
    robot: RobotParameters, options: SafetyOptions, gravity: float, period: float, compiled: bool
) -> FlatTick:
    """`safety_tick` as a function of inputs and memory (39,) alone, its quiet ticks compiled or not."""

    def reference(inputs: SafetyInputs, memory: np.ndarray) -> np.ndarray:
        before = SafetyMemory.from_flat(memory)
        return safety_tick(robot, options, gravity, period, inputs, before).flat()

    if not compiled or options.monitors:
        return reference
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled.mechanism import pack
    from stewart_drake.compiled.safety import quiet_tick

    def bound(value: float | None, otherwise: float) -> float:
        return otherwise if value is None else value

    packed = pack(robot)
    pairs = [(math.inf, math.inf) if p is None else p for p in (options.workspace, options.following_error)]
    numbers = filled(
        SAFETY_NUMBERS,
        horizon=options.horizon,
        workspace_angle=pairs[0][0],
        workspace_position=pairs[0][1],
        transmission=bound(options.transmission, 0.0),
        conditioning=bound(options.conditioning, 0.0),
        crank_speed=bound(options.crank_speed, math.inf),
        following_angle=pairs[1][0],
        following_position=pairs[1][1],
        torque_limit=bound(options.torque_limit, math.inf) * robot.effort_limit * (1.0 - 1e-9),
        torque_change=bound(options.torque_rate, math.inf) * period,
        gravity=gravity,
        home=robot.home_pose[3:],
        refill=_REFILL,
        usable_transmission=USABLE_TRANSMISSION,
        usable_conditioning=USABLE_CONDITIONING,
    )
    oldest = bound(options.deadline, math.inf)

    def tick(inputs: SafetyInputs, memory: np.ndarray) -> np.ndarray:
        if inputs.age <= oldest and inputs.sensor[0] == 0.0 and inputs.controller[0] == 0.0:
            result = np.empty(MEMORY_SIZE)
            measured = np.concatenate([inputs.pose, inputs.pose_rate])
            if quiet_tick(packed, numbers, inputs.command, measured, inputs.reference, memory, result):
                return result
        return reference(inputs, memory)

    return tick


def _react(
    robot: RobotParameters,
    options: SafetyOptions,
    period: float,
    view: View | None,
    memory: SafetyMemory,
    trip: Trip,
) -> SafetyMemory:
    """Holds where that may still be done, else begins to ramp."""
    first = memory.first
    held = memory.held + 1.0
    level = HOLD if trip.level == HOLD and held <= options.budget(period) else RAMP
    if first[0] == 0.0:
        first = np.array([trip.monitor, level, trip.leg, memory.ticks - 1.0, trip.cause], dtype=float)
    memory = memory._replace(
        level=float(level),
        monitor=float(trip.monitor),
        leg=float(trip.leg),
        held=held,
        first=first,
        worst=max(memory.worst, float(level)),
    )
    if level == HOLD:
        return memory._replace(torque=_led(memory.good, memory, _largest_change(options, period, memory)))
    return _stopping(robot, options, period, view, memory)


def _stopping(
    robot: RobotParameters, options: SafetyOptions, period: float, view: View | None, memory: SafetyMemory
) -> SafetyMemory:
    """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on."""
    memory = memory._replace(since=memory.since + 1.0)
    if view is None and memory.held >= options.budget(period):
        # Nobody can hold this robot without seeing it: an open loop falls over within half a second.
        raise _stop(options, memory, period, "stopped: no measurement to hold the robot by", held=False)
    speed = np.zeros(6) if view is None else view.speed
    fastest = options.runaway * (15.0 if options.crank_speed is None else options.crank_speed)
    if np.abs(speed).max() > fastest:
        raise _stop(
            options, memory, period, f"stopping, but a crank turns at {np.abs(speed).max():.3g} rad/s", held=False
        )
    if memory.since * period > options.ramp_time + options.safe_hold_time + 1e-9:
        raise _stop(options, memory, period, f"stopped, and held for {options.safe_hold_time:g} s", held=True)
    share = min(1.0, memory.since * period / options.ramp_time)
    level = SAFE_HOLD if share >= 1.0 else RAMP
    damping = 0.7 * options.largest_damping(robot, period) if options.damping is None else options.damping
    torque = (1.0 - share) * memory.good + share * memory.weight - damping * speed
    limit = robot.effort_limit * (1.0 if options.torque_limit is None else options.torque_limit)
    return memory._replace(
        torque=_led(np.clip(torque, -limit, limit), memory, _largest_change(options, period, memory)),
        level=float(level),
        held=memory.held + 1.0 if view is None else 0.0,
        worst=max(memory.worst, float(level)),
    )


def _stop(options: SafetyOptions, memory: SafetyMemory, period: float, what: str, held: bool) -> SafetyStop:
    name = options.monitor_names[int(memory.monitor)]
    trip = first_trip(
        memory if held else memory._replace(level=float(END), worst=float(END)), period, options.monitor_names
    )
    return SafetyStop(name, f"{name}: {what}", int(memory.leg) if memory.leg >= 0.0 else None, trip)
