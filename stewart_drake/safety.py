"""What stands between any controller and the motors: monitors, and a reaction in levels; pure.

Levels, each entered from the one before: `hold` repeats the last good command for as long as its budget lasts; `ramp`
leads to the torque that carries the robot's weight where it stands, with damping; `safe_hold` stays there; then the run
ends with the monitor's name. Only `hold` is left again by itself. What can be known beforehand is refused before the
start, see `refuse_motion`.

Torque and torque-rate limits with a named stop are libfranka's habit (`limitRate`, `controller_torque_discontinuity`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from stewart_drake.errors import FAILURES, ConfigurationError, SafetyStop, UnreachablePoseError
from stewart_drake.kinematics import (
    leg_geometry,
    line_conditioning,
    pose_rate_to_twist,
    rod_lines,
    rotation_matrix,
)
from stewart_drake.rigid_body_model import static_torque_of_legs
from stewart_drake.robot import RobotParameters
from stewart_drake.scalars import SECTION, Count, Flag, Real, is_finite
from stewart_drake.seeded import check_positive, check_real

Level = Literal["none", "hold", "ramp", "safe_hold", "end"]
LEVELS: tuple[Level, ...] = ("none", "hold", "ramp", "safe_hold", "end")
NONE, HOLD, RAMP, SAFE_HOLD, END = range(5)

MONITORS = (
    "none",
    "measurement_not_finite",
    "sensor_failed",
    "controller_failed",
    "command_not_finite",
    "deadline",
    "workspace",
    "serial_singularity",
    "parallel_singularity",
    "crank_speed",
    "following_error",
    "torque_limit",
    "torque_rate",
)
"""Stable names, by their number in the log. The first five after `none`, and a torque far beyond all limits, are held;
the others ramp at once."""

_ABSURD = 10.0
"""A command of so many times the limit is an error of the controller and no wish for torque."""
_REFILL = 0.05
"""Ticks by which the budget of holding recovers in a good tick, so that a fault that flickers uses it up too."""
_SAMPLES = 4000
_USABLE_TRANSMISSION, _USABLE_CONDITIONING = 0.02, 0.01
"""Nearer to a singularity the weight's torque is not trusted any more, and the last one stays."""

MEMORY_SIZE = 39


@dataclass(frozen=True, kw_only=True)
class SafetyOptions:
    """Limits and reactions of the safety layer; a limit that is null is off.

    The defaults are assumptions of this project: wide enough for every motion that keeps to `limits`, and inside of
    what the controllers themselves bear.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    finite: Flag = True
    """Commands and measurements must be finite."""
    failures: Flag = True
    """A tick of estimator or controller that fails is held like a late one; otherwise it ends the run at once."""
    deadline: Count | None = 2
    """Ticks that a command may be old."""
    frozen_encoder: Real | None = 0.04
    """[rad] by which two other cranks may turn, and 50 counts more, while an encoder repeats one reading to the last
    bit."""
    frozen_pose: tuple[Real, Real] | None = (0.01, 0.001)
    """[rad, m] by which an axis of the reference may move while the measured pose, of a sensor that is no encoder,
    stays the same to the last bit."""
    torque_limit: Real | None = 1.0
    """[-] of the motors' limit; commands are cut there."""
    torque_limit_time: Real = 0.1
    """[s] for which a command may be at the limit or beyond, in sum; good ticks take away from the sum."""
    torque_rate: Real | None = 4000.0
    """[N m/s] by which a motor's torque may change. In a tick whose command jumps further the last good one stands;
    what comes next is led after at that rate."""
    torque_rate_time: Real = 0.01
    """[s] for which commands may jump further, in sum; good ticks take away from the sum."""
    workspace: tuple[Real, Real] | None = (1.2, 0.12)
    """[rad, m] farthest from the home pose: angle of the rotation, and distance of P."""
    transmission: Real | None = 0.1
    """[-] smallest |e_l . e_N|: nearer to its dead centre a crank may not come (serial singularity)."""
    conditioning: Real | None = 0.04
    """[-] smallest sigma_min / sigma_max of the rods' lines, without crossing zero (parallel singularity)."""
    horizon: Real = 0.01
    """[s] by which the pose is led ahead of the measurement, at its rate, for the three limits above."""
    crank_speed: Real | None = 15.0
    """[rad/s] largest |theta'|."""
    following_error: tuple[Real, Real] | None = (0.1, 0.02)
    """[rad, m] largest distance to the reference: angle of the rotation, and distance of P."""
    hold_ticks: Count = 20
    """Ticks for which the last good command is repeated at most, up to 20."""
    hold_time: Real = 0.03
    """[s] for which it is, at most, up to 0.03."""
    ramp_time: Real = 0.02
    """[s] from the last good command to the safe hold: short, for the command may have been wrong for a while."""
    damping: Real | None = None
    """[N m s/rad] of each crank while ramping and in the safe hold; null takes 0.7 of `largest_damping`."""
    safe_hold_time: Real = 0.5
    """[s] after which a safe hold ends the run."""
    runaway: Real = 2.0
    """[-] times `crank_speed` (times 15 rad/s where that is off) at which a robot that is ramping or held is given up:
    the run ends at once."""

    def __post_init__(self) -> None:
        for name in ("torque_limit", "torque_rate", "transmission", "conditioning", "crank_speed", "frozen_encoder"):
            value = getattr(self, name)
            if value is not None and not (is_finite(value) and value > 0.0):
                raise ConfigurationError(f"safety.{name}", value, "a positive number, or null")
        for name in ("transmission", "conditioning"):
            value = getattr(self, name)
            if value is not None and value >= 1.0:
                raise ConfigurationError(f"safety.{name}", value, "a number below 1, or null")
        if self.torque_limit is not None and self.torque_limit > 1.0:
            raise ConfigurationError("safety.torque_limit", self.torque_limit, "at most 1, or null")
        for name in ("workspace", "following_error", "frozen_pose"):
            pair = getattr(self, name)
            if pair is not None and not (len(pair) == 2 and all(is_finite(x) and x > 0.0 for x in pair)):
                raise ConfigurationError(f"safety.{name}", pair, "two positive numbers [rad, m], or null")
        if self.deadline is not None and (type(self.deadline) is not int or not 0 <= self.deadline <= 1000):
            raise ConfigurationError("safety.deadline", self.deadline, "a whole number from 0 to 1000, or null")
        if type(self.hold_ticks) is not int or not 0 <= self.hold_ticks <= 20:
            raise ConfigurationError("safety.hold_ticks", self.hold_ticks, "a whole number from 0 to 20")
        if not (is_finite(self.hold_time) and 0.0 <= self.hold_time <= 0.03):
            raise ConfigurationError("safety.hold_time", self.hold_time, "a number from 0 to 0.03 s")
        for name in ("torque_limit_time", "torque_rate_time", "horizon"):
            check_real(f"safety.{name}", getattr(self, name))
        if self.damping is not None:
            check_real("safety.damping", self.damping)
        for name in ("ramp_time", "safe_hold_time"):
            check_positive(f"safety.{name}", getattr(self, name))
        check_real("safety.runaway", self.runaway, 1.0, "a number, at least 1")

    def budget(self, period: float) -> int:
        """Ticks that may be held."""
        return min(self.hold_ticks, math.floor(self.hold_time / period + 1e-6))

    def largest_damping(self, robot: RobotParameters, period: float) -> float:
        """[N m s/rad] that a crank alone, its rod broken off, bears in torques held over a period."""
        return 2.0 * robot.crank_axis_inertia / period


class SafetyInputs(NamedTuple):
    """What a tick sees.

    Attributes:
        command: (6,) [N m].
        pose: (6,) [rad, m] measured.
        pose_rate: (6,) [rad/s, m/s] measured.
        reference: (6,) [rad, m] pose that is wanted.
        age: [ticks] of the command.
        sensor: What is wrong with the estimator, see `errors.FAILURES`, and its leg or -1.
        controller: What is wrong with the controller, likewise.
    """

    command: np.ndarray
    pose: np.ndarray
    pose_rate: np.ndarray
    reference: np.ndarray
    age: float = 0.0
    sensor: tuple[float, float] = (0.0, -1.0)
    controller: tuple[float, float] = (0.0, -1.0)


class SafetyMemory(NamedTuple):
    """What a tick says, and what the next one needs of it.

    Attributes:
        torque: (6,) [N m] for the motors.
        level: Number in `LEVELS`.
        monitor: Number in `MONITORS` of what is wrong.
        leg: 0 to 5, or -1.
        good: (6,) [N m] last good command: one that no limit touched.
        weight: (6,) [N m] last torque that carried the robot's weight.
        held: Ticks of holding, less what good ones gave back; while stopping, ticks without a measurement.
        at_limit: Ticks at the torque limit, less good ones.
        too_fast: Ticks whose command jumped, less good ones.
        since: Ticks in `ramp` and `safe_hold`.
        side: Sign of the rods' determinant at the start; 0 before the first tick.
        ticks: Done.
        first: (5,) monitor, level, leg, tick and cause (number in `FAILURES`) of the first trip; zeros before.
        worst: Highest level so far.
        command: (6,) [N m] that came in the last tick, if it was finite.
    """

    torque: np.ndarray
    level: float
    monitor: float
    leg: float
    good: np.ndarray
    weight: np.ndarray
    held: float
    at_limit: float
    too_fast: float
    since: float
    side: float
    ticks: float
    first: np.ndarray
    worst: float
    command: np.ndarray

    def flat(self) -> np.ndarray:
        """All in one vector (39,), in the order of the attributes."""
        return np.concatenate([np.atleast_1d(value) for value in self])

    @classmethod
    def from_flat(cls, values: np.ndarray) -> SafetyMemory:
        """Inverse of `flat`."""
        level, monitor, leg = (float(x) for x in values[6:9])
        held, at_limit, too_fast, since, side, ticks = (float(x) for x in values[21:27])
        return cls(
            values[:6],
            level,
            monitor,
            leg,
            values[9:15],
            values[15:21],
            held,
            at_limit,
            too_fast,
            since,
            side,
            ticks,
            values[27:32],
            float(values[32]),
            values[33:],
        )


class Trip(NamedTuple):
    """What a monitor says: its number, the level that it asks for, the leg or -1, and a cause in `FAILURES` or 0."""

    monitor: int
    level: int
    leg: int = -1
    cause: int = 0


class _View(NamedTuple):
    """What a measurement means.

    Attributes:
        speed: (6,) [rad/s] of the cranks.
        weight: (6,) [N m] that carry the robot there; None too near to a singularity.
        side: Sign of the rods' determinant.
        trip: What the pose breaks.
    """

    speed: np.ndarray
    weight: np.ndarray | None
    side: float
    trip: Trip | None


def initial_memory(torque: np.ndarray) -> SafetyMemory:
    """Memory before the first tick; `torque` (6,) [N m] is what holds the robot at its start."""
    torque = np.asarray(torque, dtype=float)
    return SafetyMemory(torque, 0.0, 0.0, -1.0, torque, torque, *(0.0,) * 6, np.zeros(5), 0.0, torque)


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
    seen = bool(np.isfinite(inputs.pose).all() and np.isfinite(inputs.pose_rate).all()) and inputs.sensor[0] == 0.0
    # A finite blow-up may overflow on the way; what is not a number then trips a monitor.
    with np.errstate(all="ignore"):
        view = _look(robot, options, gravity, inputs, memory.side) if seen else None
    memory = memory._replace(ticks=memory.ticks + 1.0)
    if view is not None:
        memory = memory._replace(
            side=memory.side or view.side, weight=memory.weight if view.weight is None else view.weight
        )
    if memory.level >= RAMP:
        return _stopping(robot, options, period, view, memory)
    limit = math.inf if options.torque_limit is None else options.torque_limit * robot.effort_limit
    trip = view.trip if view is not None else None
    trip = trip or _unusable(options, inputs, limit)
    if trip is not None:
        return _react(robot, options, period, view, memory, trip)

    command = inputs.command
    torque = np.clip(command, -limit, limit)
    full = np.abs(command) >= limit * (1.0 - 1e-9)
    change = command - memory.command
    # The first command has nothing before it.
    bound = math.inf if options.torque_rate is None or memory.ticks <= 1.0 else options.torque_rate * period
    steep = np.abs(change) > bound * (1.0 + 1e-9)
    if steep.any():
        # Led after it, a command that chatters would leave a mean torque that nobody asked for.
        torque = memory.good
    ahead = torque - memory.torque
    # To the last bit the command, where nothing limits it.
    led = np.where(np.abs(ahead) > bound, memory.torque + np.clip(ahead, -bound, bound), torque)
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


FlatTick = Callable[[SafetyInputs, np.ndarray], np.ndarray]


def flat_tick(
    robot: RobotParameters, options: SafetyOptions, gravity: float, period: float, compiled: bool
) -> FlatTick:
    """`safety_tick` as a function of inputs and memory (39,) alone, its quiet ticks compiled or not."""

    def reference(inputs: SafetyInputs, memory: np.ndarray) -> np.ndarray:
        before = SafetyMemory.from_flat(memory)
        return safety_tick(robot, options, gravity, period, inputs, before).flat()

    if not compiled:
        return reference
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled.mechanism import pack
    from stewart_drake.compiled.safety import quiet_tick

    def bound(value: float | None, otherwise: float) -> float:
        return otherwise if value is None else value

    packed = pack(robot)
    pairs = [(math.inf, math.inf) if p is None else p for p in (options.workspace, options.following_error)]
    numbers = np.array(
        [
            options.horizon,
            *pairs[0],
            bound(options.transmission, 0.0),
            bound(options.conditioning, 0.0),
            bound(options.crank_speed, math.inf),
            *pairs[1],
            bound(options.torque_limit, math.inf) * robot.effort_limit * (1.0 - 1e-9),
            bound(options.torque_rate, math.inf) * period,
            gravity,
            *robot.home_pose[3:],
            _REFILL,
            _USABLE_TRANSMISSION,
            _USABLE_CONDITIONING,
        ]
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


FROZEN_SIZE = 42
"""Readings of the tick before, and for each of the six what it is compared with as it was when the reading changed."""


def frozen_tick(
    options: SafetyOptions,
    quantum: float,
    angles: np.ndarray | None,
    pose: np.ndarray,
    reference: np.ndarray,
    memory: np.ndarray,
) -> tuple[int | None, np.ndarray]:
    """Looks for a sensor that repeats itself while things move.

    In a robot that stands still nobody can tell: the six encoders of six freedoms contradict each other never.

    Args:
        options: Limits.
        quantum: [rad] of an encoder's count.
        angles: (6,) [rad] readings of encoders; None where there are none.
        pose: (6,) [rad, m] measured.
        reference: (6,) [rad, m].
        memory: (42,) of the tick before, NaN before the first; see `FROZEN_SIZE`.

    Returns:
        Leg whose encoder is frozen, -1 for the pose as a whole, None for nothing; and the memory (42,) of this tick.
    """
    readings, compared = (pose, reference) if angles is None else (angles, angles)
    # What is not a number is another monitor's affair, and no repetition.
    same = readings == memory[:6]
    if angles is None:
        same[:] = same.all()
    anchors = np.where(same[:, None], memory[6:].reshape(6, 6), compared)
    after = np.concatenate([readings, anchors.ravel()])
    moved = np.abs(compared - anchors)
    if angles is None:
        bound = options.frozen_pose
        far = bound is not None and bool((moved[0] > np.repeat(bound, 3)).any())
        return (-1 if far else None), after
    if options.frozen_encoder is None:
        return None, after
    # Two others: one that jumps would make all that stand still look frozen.
    travel = np.sort(moved, axis=1)[:, -2]
    leg = int(travel.argmax())
    return (leg if travel[leg] > options.frozen_encoder + 50.0 * quantum else None), after


def refuse_motion(
    robot: RobotParameters, options: SafetyOptions, time: np.ndarray, pose: np.ndarray, pose_rate: np.ndarray
) -> None:
    """Refuses a motion that, followed without error, would trip a monitor.

    Args:
        robot: As believed.
        options: Limits.
        time: (n,) [s].
        pose: (n, 6) [rad, m], within reach.
        pose_rate: (n, 6) [rad/s, m/s].

    Raises:
        ConfigurationError: Names the limit, its time and leg.
    """
    legs = leg_geometry(robot, pose)
    lines = rod_lines(legs)
    turn = rotation_angle(rotation_matrix(pose[:, :3]))
    away = np.linalg.norm(pose[:, 3:] - robot.home_pose[3:], axis=1)
    transmission = np.abs(legs.transmission)
    crossed = np.sign(np.linalg.det(lines)) * np.sign(np.linalg.det(lines[0]))
    conditioning = line_conditioning(robot, legs) * crossed
    along = np.einsum("nij,nj->ni", lines, pose_rate_to_twist(pose, pose_rate))
    speed = np.abs(along / (robot.crank_length * legs.transmission))
    if options.workspace is not None:
        _refuse("workspace", options.workspace, turn / options.workspace[0], 1.0, time, "the angle")
        _refuse("workspace", options.workspace, away / options.workspace[1], 1.0, time, "the distance")
    if options.transmission is not None:
        _refuse("transmission", options.transmission, -transmission, -options.transmission, time)
    if options.conditioning is not None:
        _refuse("conditioning", options.conditioning, -conditioning, -options.conditioning, time)
    if options.crank_speed is not None:
        _refuse("crank_speed", options.crank_speed, speed, options.crank_speed, time)


def refuse_start(
    robot: RobotParameters, options: SafetyOptions, pose: np.ndarray, pose_rate: np.ndarray, reference: np.ndarray
) -> None:
    """Refuses a start at which a monitor would trip in the very first tick.

    Args:
        robot: As believed.
        options: Limits.
        pose: (6,) [rad, m] at the start.
        pose_rate: (6,) [rad/s, m/s].
        reference: (6,) [rad, m].

    Raises:
        ConfigurationError: Names the monitor.
    """
    trip = _look(robot, options, 0.0, SafetyInputs(np.zeros(6), pose, pose_rate, reference), 0.0).trip
    if trip is not None:
        name = MONITORS[trip.monitor]
        raise ConfigurationError("initial_offset", (pose - reference).tolist(), f"a start that does not trip {name}")


def rotation_angle(rotation: np.ndarray) -> np.ndarray:
    """Angle (...) [rad] of rotations (..., 3, 3)."""
    return np.arccos(np.clip(0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0), -1.0, 1.0))


def first_trip(memory: SafetyMemory, period: float) -> dict[str, Any] | None:
    """monitor, level, time [s], leg (or None) and cause (or None) of the first trip; worst, the highest level."""
    monitor, level, leg, tick, cause = memory.first
    if monitor == 0.0:
        return None
    return {
        "monitor": MONITORS[int(monitor)],
        "level": LEVELS[int(level)],
        "time": round(float(tick) * period, 9),
        "leg": int(leg) if leg >= 0.0 else None,
        "cause": FAILURES[int(cause) - 1] if cause > 0.0 else None,
        "worst": LEVELS[int(memory.worst)],
    }


def _look(robot: RobotParameters, options: SafetyOptions, gravity: float, inputs: SafetyInputs, side: float) -> _View:
    """Speeds, weight and broken limits at a finite measurement."""
    pose, rate = inputs.pose, inputs.pose_rate
    ahead = pose + options.horizon * rate
    still = np.zeros(6)
    turn = float(rotation_angle(rotation_matrix(ahead[:3])))
    outside = turn, float(np.linalg.norm(ahead[3:] - robot.home_pose[3:]))
    far = options.workspace is not None and _beyond(outside, options.workspace)
    beyond = Trip(MONITORS.index("workspace"), RAMP) if far else None
    try:
        legs = leg_geometry(robot, ahead)
    except UnreachablePoseError as error:
        # A crank carried across its dead centre: reach ends there.
        trip = beyond or _too_fast(robot, options, pose, rate)
        if trip is None and options.transmission is not None:
            trip = Trip(MONITORS.index("serial_singularity"), RAMP, -1 if error.leg is None else error.leg)
        return _View(still, None, side, trip)
    transmission = np.abs(legs.transmission)
    lines = rod_lines(legs)
    conditioning, now = float(line_conditioning(robot, legs)), float(np.sign(np.linalg.det(lines)))
    smallest = max(float(transmission.min()), 1e-9)
    speed = lines @ pose_rate_to_twist(pose, rate) / (robot.crank_length * np.maximum(transmission, 1e-9))
    speed *= np.where(legs.transmission < 0.0, -1.0, 1.0)
    usable = smallest > _USABLE_TRANSMISSION and conditioning > _USABLE_CONDITIONING
    weight = static_torque_of_legs(robot, legs, gravity) if usable else None
    trip = beyond
    if trip is None and options.crank_speed is not None and not np.abs(speed).max() <= options.crank_speed:
        trip = Trip(MONITORS.index("crank_speed"), RAMP, int(np.abs(speed).argmax()))
    if trip is None and options.transmission is not None and not smallest >= options.transmission:
        trip = Trip(MONITORS.index("serial_singularity"), RAMP, int(transmission.argmin()))
    across = side != 0.0 and now != side
    if trip is None and options.conditioning is not None and (not conditioning >= options.conditioning or across):
        trip = Trip(MONITORS.index("parallel_singularity"), RAMP)
    if trip is None and options.following_error is not None:
        off = rotation_matrix(pose[:3]) @ rotation_matrix(inputs.reference[:3]).T
        away = float(rotation_angle(off)), float(np.linalg.norm(pose[3:] - inputs.reference[3:]))
        if _beyond(away, options.following_error):
            trip = Trip(MONITORS.index("following_error"), RAMP)
    return _View(speed, weight, now, trip)


def _too_fast(robot: RobotParameters, options: SafetyOptions, pose: np.ndarray, rate: np.ndarray) -> Trip | None:
    """Whether the cranks turn too fast at a pose of which only what lies ahead of it is out of reach."""
    if options.crank_speed is None:
        return None
    try:
        legs = leg_geometry(robot, pose)
    except UnreachablePoseError:
        return None
    speed = np.abs(rod_lines(legs) @ pose_rate_to_twist(pose, rate) / (robot.crank_length * legs.transmission))
    return (
        None if speed.max() <= options.crank_speed else Trip(MONITORS.index("crank_speed"), RAMP, int(speed.argmax()))
    )


def _beyond(values: tuple[float, float], limits: tuple[float, float]) -> bool:
    """Whether one of two values is above its limit, or not a number."""
    return not (values[0] <= limits[0] and values[1] <= limits[1])


def _unusable(options: SafetyOptions, inputs: SafetyInputs, limit: float) -> Trip | None:
    """What is wrong with this tick's messages, apart from what they say."""
    if options.finite and not (np.isfinite(inputs.pose).all() and np.isfinite(inputs.pose_rate).all()):
        return Trip(MONITORS.index("measurement_not_finite"), HOLD)
    for name, (cause, leg) in (("sensor_failed", inputs.sensor), ("controller_failed", inputs.controller)):
        if options.failures and cause > 0.0:
            return Trip(MONITORS.index(name), HOLD, int(leg), int(cause))
    finite = np.isfinite(inputs.command)
    if options.finite and not finite.all():
        return Trip(MONITORS.index("command_not_finite"), HOLD, int(finite.argmin()))
    if options.deadline is not None and inputs.age > options.deadline:
        return Trip(MONITORS.index("deadline"), HOLD)
    if np.abs(inputs.command).max() > _ABSURD * limit:
        return Trip(MONITORS.index("torque_limit"), HOLD, int(np.abs(inputs.command).argmax()))
    return None


def _react(
    robot: RobotParameters,
    options: SafetyOptions,
    period: float,
    view: _View | None,
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
        return memory._replace(torque=memory.good)
    return _stopping(robot, options, period, view, memory)


def _stopping(
    robot: RobotParameters, options: SafetyOptions, period: float, view: _View | None, memory: SafetyMemory
) -> SafetyMemory:
    """Ramp and safe hold: from the last good command to the weight's torque, damped from the first tick on."""
    since = memory.since + 1.0
    if view is None and memory.held >= options.budget(period):
        # Nobody can hold this robot without seeing it: an open loop falls over within half a second.
        raise _stop(memory, period, "stopped: no measurement to hold the robot by", held=False)
    speed = np.zeros(6) if view is None else view.speed
    fastest = options.runaway * (15.0 if options.crank_speed is None else options.crank_speed)
    if np.abs(speed).max() > fastest:
        raise _stop(memory, period, f"stopping, but a crank turns at {np.abs(speed).max():.3g} rad/s", held=False)
    if since * period > options.ramp_time + options.safe_hold_time + 1e-9:
        raise _stop(memory, period, f"stopped, and held for {options.safe_hold_time:g} s", held=True)
    share = min(1.0, since * period / options.ramp_time)
    level = SAFE_HOLD if share >= 1.0 else RAMP
    damping = 0.7 * options.largest_damping(robot, period) if options.damping is None else options.damping
    torque = (1.0 - share) * memory.good + share * memory.weight - damping * speed
    limit = robot.effort_limit * (1.0 if options.torque_limit is None else options.torque_limit)
    return memory._replace(
        torque=np.clip(torque, -limit, limit),
        level=float(level),
        since=since,
        held=memory.held + 1.0 if view is None else 0.0,
        worst=max(memory.worst, float(level)),
    )


def _stop(memory: SafetyMemory, period: float, what: str, held: bool) -> SafetyStop:
    name = MONITORS[int(memory.monitor)]
    trip = first_trip(memory if held else memory._replace(worst=float(END)), period)
    return SafetyStop(name, f"{name}: {what}", int(memory.leg) if memory.leg >= 0.0 else None, trip)


def _refuse(name: str, given: Any, values: np.ndarray, largest: float, time: np.ndarray, what: str = "it") -> None:
    """Raises for the first sample (of any leg) above a bound."""
    values = values.reshape(len(time), -1)
    bad = ~(values <= largest)
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        where = f", leg {int(bad[row].argmax())}" if values.shape[1] == 6 else ""
        allowed = f"a limit that the reference keeps to; {what} is broken at t = {time[row]:.3f} s{where}"
        raise ConfigurationError(f"safety.{name}", given, allowed)


def sample_times(duration: float, period: float) -> np.ndarray:
    """Times (n,) [s] at which a motion is looked at before the start: ticks, or some thousand evenly spread."""
    return np.linspace(0.0, duration, min(_SAMPLES, max(2, round(duration / period) + 1)))
