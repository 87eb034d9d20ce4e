"""One tick of the safety layer as a pure function, with its reactions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stewart_drake.compiled.constants import SAFETY_NUMBERS, filled
from stewart_drake.errors import SafetyStop
from stewart_drake.mechanics import dynamics_core
from stewart_drake.mechanics.arrays import arrays_of
from stewart_drake.registry import BUILT_IN_MONITORS
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
from stewart_drake.safety.monitors import Seen, broken, failed, further, measured, see, surprising, unusable
from stewart_drake.safety.safety_options import SafetyOptions

_REFILL = 0.05
"""Ticks by which the budget of holding recovers in a good tick, so that a fault that flickers uses it up too."""
USABLE_TRANSMISSION, USABLE_CONDITIONING = 0.02, 0.01
"""Nearer to a singularity the weight's torque is not trusted any more, and the last one stays."""
COMPILED = 14
"""Monitors, the first of the registry, that the compiled tick knows; with others the reference runs alone."""


class _Layer(NamedTuple):
    """What stays the same from tick to tick: robot as believed, options, gravity [m/s^2], period [s]."""

    robot: RobotParameters
    options: SafetyOptions
    gravity: float
    period: float

    def limit(self, otherwise: float) -> np.ndarray:
        """(6,) [N m] of the motors; `otherwise` times what they can where the limit is off."""
        limit = self.options.torque_limit
        return (otherwise if limit is None else limit) * self.robot.effort_limits

    def led(self, torque: np.ndarray, memory: SafetyMemory) -> np.ndarray:
        """Torques (6,) [N m] towards those wanted; to the last bit those, where nothing limits the change."""
        ahead, bound = torque - memory.torque, self.largest_change(memory)
        return np.where(np.abs(ahead) > bound, memory.torque + np.clip(ahead, -bound, bound), torque)

    def largest_change(self, memory: SafetyMemory) -> float:
        """[N m] from one tick to the next; the first command has nothing before it."""
        rate = self.options.torque_rate
        return math.inf if rate is None or memory.ticks <= 1.0 else rate * self.period

    def weight(self, seen: Seen) -> np.ndarray | None:
        """Torques (6,) [N m] that carry the robot where it is seen; None out of reach or too near to a singularity."""
        far = seen.transmission.min() > USABLE_TRANSMISSION and np.abs(seen.conditioning) > USABLE_CONDITIONING
        if not (seen.reached and far):
            return None
        own = arrays_of(self.robot, seen.speed)
        return np.asarray(dynamics_core.static_torque(own, seen.legs, self.gravity, masked=False))

    def react(self, seen: Seen | None, memory: SafetyMemory, trip: Trip) -> SafetyMemory:
        """Holds where that may still be done, else begins to ramp."""
        first, held = memory.first, memory.held + 1.0
        level = HOLD if trip.level == HOLD and held <= self.options.budget(self.period) else RAMP
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
        return memory._replace(torque=self.led(memory.good, memory)) if level == HOLD else self.stopping(seen, memory)

    def stopping(self, seen: Seen | None, memory: SafetyMemory) -> SafetyMemory:
        """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on."""
        options, period = self.options, self.period
        memory = memory._replace(since=memory.since + 1.0)
        if seen is None and memory.held >= options.budget(period):
            # Nobody can hold this robot without seeing it: an open loop falls over within half a second.
            raise self.stop(memory, "stopped: no measurement to hold the robot by", held=False)
        speed = seen.speed if seen is not None and seen.reached else np.zeros(6)
        fastest = options.runaway * (15.0 if options.crank_speed is None else options.crank_speed)
        if np.abs(speed).max() > fastest:
            text = f"stopping, but a crank turns at {np.abs(speed).max():.3g} rad/s"
            raise self.stop(memory, text, held=False)
        if memory.since * period > options.ramp_time + options.safe_hold_time + 1e-9:
            raise self.stop(memory, f"stopped, and held for {options.safe_hold_time:g} s", held=True)
        share = min(1.0, memory.since * period / options.ramp_time)
        level = SAFE_HOLD if share >= 1.0 else RAMP
        largest = options.largest_damping(self.robot, period)
        damping = 0.7 * largest if options.damping is None else options.damping
        torque = (1.0 - share) * memory.good + share * memory.weight - damping * speed
        limit = self.limit(1.0)
        return memory._replace(
            torque=self.led(np.clip(torque, -limit, limit), memory),
            level=float(level),
            held=memory.held + 1.0 if seen is None else 0.0,
            worst=max(memory.worst, float(level)),
        )

    def stop(self, memory: SafetyMemory, what: str, held: bool) -> SafetyStop:
        """The end of the run."""
        names = self.options.monitor_names
        name = names[int(memory.monitor)]
        meaning = BUILT_IN_MONITORS[name].meaning if name in BUILT_IN_MONITORS.names else ""
        last = memory if held else memory._replace(level=float(END), worst=float(END))
        leg = int(memory.leg) if memory.leg >= 0.0 else None
        text = "; ".join(filter(None, (meaning, what)))
        return SafetyStop(name, f"{name}: {text}", leg, first_trip(last, self.period, names))


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
    layer, seen = _Layer(robot, options, gravity, period), None
    memory = memory._replace(ticks=memory.ticks + 1.0)
    # A finite blow-up may overflow on the way; what is not a number then trips a monitor.
    with np.errstate(all="ignore"):
        if measured(options, inputs) and not failed(options, inputs.sensor):
            seen = see(robot, options.horizon, inputs.pose, inputs.pose_rate, inputs.reference, memory.side)
            weight = layer.weight(seen)
            memory = memory._replace(
                side=memory.side or float(seen.side), weight=memory.weight if weight is None else weight
            )
    if memory.level >= RAMP:
        return layer.stopping(seen, memory)
    limit = layer.limit(math.inf)
    trip = None if seen is None else broken(options, seen)
    trip = trip or unusable(options, inputs, limit)
    if trip is None and seen is not None:
        trip = further(options, inputs)
    if trip is not None:
        return layer.react(seen, memory, trip)

    command = inputs.command
    torque = np.clip(command, -limit, limit)
    full = np.abs(command) >= limit * (1.0 - 1e-9)
    change = command - memory.command
    steep = np.abs(change) > layer.largest_change(memory) * (1.0 + 1e-9)
    if steep.any():
        # Led after it, a command that chatters would leave a mean torque that nobody asked for.
        torque = memory.good
    led = layer.led(torque, memory)
    memory = memory._replace(
        command=command,
        at_limit=max(0.0, memory.at_limit + (1.0 if full.any() else -1.0)),
        too_fast=max(0.0, memory.too_fast + (1.0 if steep.any() else -1.0)),
        surprised=max(0.0, memory.surprised + (1.0 if surprising(options, inputs) else -1.0)),
    )
    if memory.at_limit * period > options.torque_limit_time + 1e-9:
        trip = Trip(MONITORS.index("torque_limit"), RAMP, int((np.abs(command) / limit).argmax()))
    elif memory.too_fast * period > options.torque_rate_time + 1e-9:
        trip = Trip(MONITORS.index("torque_rate"), RAMP, int(np.abs(change).argmax()))
    elif memory.surprised * period > options.innovation_time + 1e-9:
        trip = Trip(MONITORS.index("innovation"), RAMP)
    if trip is not None:
        return layer.react(seen, memory, trip)
    good = memory.good if full.any() or steep.any() or np.any(led != torque) else torque
    return memory._replace(
        torque=led, good=good, level=0.0, monitor=0.0, leg=-1.0, held=max(0.0, memory.held - _REFILL)
    )


FlatTick = Callable[[SafetyInputs, np.ndarray], np.ndarray]


def flat_tick(
    robot: RobotParameters, options: SafetyOptions, gravity: float, period: float, compiled: bool
) -> FlatTick:
    """`safety_tick` as a function of inputs and memory (40,) alone, its quiet ticks compiled or not."""

    def reference(inputs: SafetyInputs, memory: np.ndarray) -> np.ndarray:
        before = SafetyMemory.from_flat(memory)
        return safety_tick(robot, options, gravity, period, inputs, before).flat()

    if not compiled or options.monitors or len(BUILT_IN_MONITORS.names) > COMPILED:
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
        torque_limit=bound(options.torque_limit, math.inf) * robot.effort_limits * (1.0 - 1e-9),
        torque_change=bound(options.torque_rate, math.inf) * period,
        gravity=gravity,
        home=robot.home_pose[3:],
        refill=_REFILL,
        usable_transmission=USABLE_TRANSMISSION,
        usable_conditioning=USABLE_CONDITIONING,
    )
    oldest = bound(options.deadline, math.inf)

    def tick(inputs: SafetyInputs, memory: np.ndarray) -> np.ndarray:
        well = inputs.age <= oldest and inputs.sensor[0] == 0.0 and inputs.controller[0] == 0.0
        if well and not surprising(options, inputs):
            result = np.empty(MEMORY_SIZE)
            measured = np.concatenate([inputs.pose, inputs.pose_rate])
            if quiet_tick(packed, numbers, inputs.command, measured, inputs.reference, memory, result):
                return result
        return reference(inputs, memory)

    return tick
