"""Options and limits of the safety layer: what a tick breaks of them, and what a run is refused for beforehand."""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Fraction, Natural, NotNegative, Positive, PositivePair, Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import UserMade
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.base.registry import OWN_MONITORS
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import inverse_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.mechanics.singularities import MONITORED, WEIGHT_TRUSTED, crank_speeds, measure_pose
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import LENGTH, TORQUE
from stewart_drake.safety.residual import LONGEST_HALF, ONE_LEG_SHARE
from stewart_drake.safety.stillness import FROZEN_AFTER, SHARE, still_params

MONITORS = (
    "none", "measurement_not_finite", "sensor_failed", "controller_failed", "command_not_finite", "deadline",
    "workspace", "serial_singularity", "parallel_singularity", "crank_speed", "following_error", "torque_limit",
    "torque_rate", "innovation", "reading_stuck", "unexplained_torque", "not_moving",
)  # fmt: skip
"""Stable names of the monitors, by their number in the log: new ones come last. `innovation` is in old logs alone."""
MEANINGS = {
    "reading_stuck": "a sensor repeats itself, or no crank moves at all",
    "not_moving": "a crank stands, or its reading does, while its reference moves",
    "unexplained_torque": "a reading or a motor is wrong, or load and friction exceed safety.unexplained_torque",
}
"""What a name leaves open, for the message of a run that the monitor ends."""

HOLD_TIME = 0.03  # [s] for which the last good command is repeated at most.


class SafetyOptions(Section, key="safety"):
    """Limits and reactions of the safety layer; null switches a limit off.

    The defaults are assumptions of this project: wide enough for every motion within `limits`, and tighter than what
    the controllers themselves can bear. Default lengths and torques scale with the robot's characteristic length and
    effort limit.
    """

    deadline: Annotated[Natural, Field(le=1000)] | None = 2
    """[ticks] longest time without a new command; a constant `command_delay` does not count."""
    unexplained_torque: Fraction | None = 0.2
    """[-] share of each motor's limit by which torques may differ from inverse dynamics of the readings: what payload,
    pushes and friction that is not compensated take. A fifth of it counts where the difference is that of one
    leg alone, two fifths where it is that of two; a blow of 5 ms passes. It detects wrong readings and motors.
    Friction that is believed comes on top, and with `adaptation` what is not known of it yet."""
    frozen: Positive | None = FROZEN_AFTER
    """[rad] travel of a crank's reference after which readings are frozen that have all repeated to the last bit."""
    standstill: Fraction | None = SHARE
    """[-] share of its reference's travel in the last second that a crank must have moved by. Travel within 0.03 rad,
    which play and friction take, does not count; a reference that moves by less is not compared."""
    torque_limit: Annotated[Positive, Field(le=1.0)] | None = 1.0
    """[-] largest command as a fraction of the motors' limit; commands are cut there. They may be there or beyond for
    0.1 s in sum."""
    torque_rate: Annotated[Positive | None, TORQUE] = 4000.0
    """[N m/s] largest rate of a motor's torque. A command that jumps further is replaced by the last good one, for up
    to 10 ms in sum; the next good command is approached at this rate."""
    workspace: Annotated[PositivePair | None, LENGTH] = (1.2, 0.12)
    """[rad, m] largest distance from the home pose: angle of the rotation, and distance of P."""
    transmission: Fraction | None = MONITORED.transmission
    """[-] smallest distance |e_l . e_N| of a crank from its dead centre (serial singularity), where it is 0."""
    conditioning: Fraction | None = MONITORED.conditioning
    """[-] smallest distance from a parallel singularity: sigma_min / sigma_max of the rods' lines, without crossing
    zero."""
    horizon: NotNegative = 0.01
    """[s] prediction horizon of `workspace`, `transmission` and `conditioning`: the pose is extrapolated at its
    measured rate."""
    crank_speed: Positive | None = 15.0
    """[rad/s] largest measured crank speed |theta'|."""
    following_error: Annotated[PositivePair | None, LENGTH] = (0.1, 0.02)
    """[rad, m] largest following error, to the reference: angle of the rotation, and distance of P."""
    hold_ticks: Annotated[Natural, Field(le=20)] = 20
    """[ticks] longest repetition of the last good command, up to 20 ticks and 30 ms."""
    ramp_time: Positive = 0.02
    """[s] time from the last good command to the safe hold; short, for that command may have been wrong for a while."""
    safe_hold_time: Positive = 0.5
    """[s] duration of a safe hold, after which the run ends; a stop with a suspect leg ends after 40 ms."""
    monitors: tuple[Annotated[Any, OWN_MONITORS], ...] = ()
    """Your own monitors, each a class by its import path, see `UserMonitor`."""

    @property
    def monitor_names(self) -> tuple[str, ...]:
        """By the number in the log, those of `monitors` last."""
        return (*MONITORS, *(getattr(monitor, "name", monitor.kind) for monitor in self.monitors))

    def budget(self, period: float) -> int:
        """Ticks of a period [s] that may be held."""
        return min(self.hold_ticks, math.floor(HOLD_TIME / period + 1e-6))

    def first_user_trip(self, inputs: SafetyInputs) -> tuple[int, int] | None:
        """Number and leg of the first of `monitors` that trips; None for none."""
        for index, monitor in enumerate(self.monitors):
            leg = monitor.look(inputs)
            if leg is not None:
                return len(MONITORS) + index, leg
        return None


class SafetyInputs(NamedTuple):
    """What a monitor of the user gets."""

    command: np.ndarray  # (6,) [N m].
    pose: np.ndarray  # (6,) [rad, m] measured.
    pose_rate: np.ndarray  # (6,) [rad/s, m/s] measured.
    reference: np.ndarray  # (6,) [rad, m] pose that is wanted.
    age: float = 0.0  # [ticks] of the command.
    # What is wrong with the estimator, see `errors.FAILURES`, and its leg or -1.
    sensor: tuple[float, float] = (0.0, -1.0)
    controller: tuple[float, float] = (0.0, -1.0)  # What is wrong with the controller, likewise.


class UserMonitor(UserMade, key="safety.monitors"):
    """Your own safety monitor: `look(inputs)` is called once a tick.

    It gets `SafetyInputs` with a finite measurement. It returns the leg with a fault, -1 for the robot as a whole, None
    for no fault. If it reports a fault and no other monitor trips, the safety layer takes over from the controller.
    """

    asked = "look(inputs) returns a leg, -1 or None"

    @property
    def name(self) -> str:
        return self.code.name

    def look(self, inputs: SafetyInputs) -> int | None:
        leg = self.made.look(inputs)
        if leg is None:
            return None
        number = isinstance(leg, (int, float, np.number)) and not isinstance(leg, bool)
        if not number or leg not in range(-1, 6):
            raise self.refusal(reprlib.repr(leg))
        return int(leg)


# --- limits of what is measured --------------------------------------------------------------------------------------

(
    NO_TRIP, MEASUREMENT, SENSOR, CONTROLLER, COMMAND, DEADLINE, WORKSPACE, SERIAL, PARALLEL, CRANK_SPEED, FOLLOWING,
    TORQUE_LIMIT, TORQUE_RATE, _, READING, UNEXPLAINED, NOT_MOVING,
) = range(len(MONITORS))  # fmt: skip
"""Places in `MONITORS`."""
LIMITS = (
    (WORKSPACE, "workspace", False),
    (CRANK_SPEED, "crank_speed", True),
    (SERIAL, "transmission", True),
    (PARALLEL, "conditioning", False),
    (FOLLOWING, "following_error", False),
)
"""Monitors of what is measured, their keys of `safety`, and whether there is one of each leg. The rows of margins, in
the order in which they are asked: what the first see explains the others."""
_OF_ROW = np.array([(monitor, of_legs) for monitor, _, of_legs in LIMITS])

TIE = 1e-6  # What numbers of two legs may differ by, in any unit, where the first of them is named.

PARAMS = fields(
    period=(), gravity=(), horizon=(), home=6,
    deadline=(), frozen=(), share=(), block=(),
    torque_limit=6, torque_change=(), workspace=2, transmission=(), conditioning=(), crank_speed=(),
    following_error=2, half=(), blow=(), unexplained=6, unexplained_alone=(), lasting=(), inertia=(),
    follow=2, most_correction=2, impossible=(), remembered=(), budget=(), ramp_time=(), safe_hold_time=(),
    suspect_hold_time=(), stopping=(), most_torque=6, most_speed=(),
)  # fmt: skip
"""`SafetyOptions` as numbers, infinite for a limit that is off; beside these home pose [rad, m], share and block: see
`STILL_PARAMS`, torque_change: in a tick [N m]. Of the residual half: of its window [ticks], blow: ticks for which one
shows, unexplained, also of a leg or two alone, beside friction [N m], lasting: share of a tick, inertia: of a crank [kg
m^2]. For `residual._follow` follow: bandwidth, most_correction and impossible: change of a crank's speed in a tick
[rad/s], remembered: ticks for which that counts. budget: ticks that may be held, suspect_hold_time: of a stop with a
suspect leg [s], stopping: time constant of a stop [s], most_torque of it [N m], most_speed: at which it is given up
[rad/s]."""
AT_LIMIT_TIME, TOO_FAST_TIME = 0.1, 0.01
"""[s] for which, in sum, commands may be at the torque limit, or jump. Good ticks take away from the sum."""
RUNAWAY_TIME = 0.005
"""[s] for which a crank of a robot that stops may turn too fast: a reading may jump."""
BLOW = 0.005  # [s] that a blow lasts at most, as `disturbances` has it.
SIGMAS = 8.0  # Of noise in a residual that its bound leaves room for: its window is so long.
LASTING, REMEMBERED = 0.01, 0.05  # [s] of a change that lasts, and for which a jump of a reading counts; assumed.
FOLLOW, CORRECTION = (150.0, 10.0), 0.3  # [rad/s] bandwidths; most that the slow one is corrected by; assumed.
STOPPING, STOPPING_TICKS = 0.008, 4.0  # [s], [ticks] time constant of a stop: the loop has the delay of a tick.
SUSPECT_HOLD = 0.04  # [s] for which torques alone tell a speed; five time constants of a stop.
RUNAWAY, FASTEST = 2.0, 15.0  # [-] times the crank speed, or where that is off times this one [rad/s].

OBSERVED = fields(reach_margin=6, transmission=6, conditioning=(), assembly_sign=(), speed=6, margin=(5, 6))
"""What a measurement means, extrapolated: that of `measure_pose`, and margin: by which each of `LIMITS` is kept, for
each leg, negative where it is broken, infinite where it is off. conditioning: a lower bound where that is enough,
negative where the lines' determinant has changed its sign, infinite out of reach. speed: out of reach those of the pose
that is not extrapolated, or 0."""


def params_of(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    period: float,
    noise: float = 1e-5,
) -> np.ndarray:
    """`PARAMS` record, see `safety_part`."""
    bound = (math.inf if options.unexplained_torque is None else options.unexplained_torque) * robot.effort_limits
    inertia = np.linalg.inv(pose_jacobian(robot, robot.home_pose) @ pose_acceleration_map(robot, robot.home_pose))
    # A second difference of noise has sqrt(6) times its size, over the square of half the window.
    largest = np.linalg.norm(inertia, axis=1).max() * math.sqrt(6.0) * noise
    half = min(LONGEST_HALF, max(2, math.ceil(math.sqrt(SIGMAS * largest / bound.min()) / period)))
    # Of a slow controller the bandwidths are those that its ticks bear.
    follow = min(FOLLOW[0], 0.3 / period), min(FOLLOW[1], 0.02 / period)
    rate, share = options.torque_rate, options.torque_limit
    return new_record(
        PARAMS,
        options,
        period=period,
        gravity=gravity,
        home=robot.home_pose,
        **still_params(period, options.standstill, options.frozen),
        torque_limit=(math.inf if share is None else share) * robot.effort_limits,
        torque_change=math.inf if rate is None else rate * period,
        transmission=-math.inf if options.transmission is None else options.transmission,
        conditioning=-math.inf if options.conditioning is None else options.conditioning,
        half=half,
        blow=BLOW / period + 2.0 * half + 1e-6,
        unexplained=bound,
        unexplained_alone=ONE_LEG_SHARE * bound.min(),
        inertia=inertia.diagonal().min(),
        lasting=min(0.5, period / LASTING),
        follow=follow,
        most_correction=(math.inf, CORRECTION),
        impossible=FASTEST + 12.0 * noise / period,
        remembered=REMEMBERED / period,
        suspect_hold_time=min(SUSPECT_HOLD, options.ramp_time + options.safe_hold_time),
        stopping=max(STOPPING, STOPPING_TICKS * period),
        budget=options.budget(period),
        most_torque=(1.0 if share is None else share) * robot.effort_limits,
        most_speed=RUNAWAY * (FASTEST if options.crank_speed is None else options.crank_speed),
    )


@njit
def _angle(trace: float) -> float:
    """Angle [rad] of a rotation with this trace."""
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@njit
def _distance(pose: Any, other: Any) -> float:
    """[m]."""
    return np.sqrt((pose[3] - other[3]) ** 2 + (pose[4] - other[4]) ** 2 + (pose[5] - other[5]) ** 2)


@njit
def _margin(limit: float, value: float) -> float:
    """What is left up to a limit; of one that is off infinity, whatever the value is."""
    return np.inf if limit == np.inf else limit - value


@njit
def observe(
    robot: Any, params: Any, pose: Any, rate: Any, reference: Any, assembly_sign: float, legs: Any, observed: Any
) -> None:
    """What a finite measurement of pose and rate (6,) means, beside the pose (6,) that is wanted.

    `assembly_sign` is the sign of the rods' determinant at the start, 0 if that is now.
    """
    wanted, margin, twist = np.empty((3, 3)), observed.margin, np.empty(6)
    ahead, turn = pose + params.horizon * rate, np.empty((3, 3))
    laws.twist_of(pose, rate, twist)
    enough = max(params.conditioning, WEIGHT_TRUSTED.conditioning)
    reached = measure_pose(robot, ahead, twist, laws.QUICK, enough, legs, np.empty((6, 1)), observed)
    angle = _angle(legs.rotation[0, 0] + legs.rotation[1, 1] + legs.rotation[2, 2])
    margin[0] = min(_margin(params.workspace[0], angle), _margin(params.workspace[1], _distance(ahead, params.home)))
    if reached:
        if assembly_sign != 0.0 and observed.assembly_sign != assembly_sign:
            observed.conditioning = -observed.conditioning
    else:
        observed.conditioning, observed.assembly_sign = np.inf, assembly_sign
        observed.speed[:] = 0.0
        if laws.legs_at(robot, pose, legs) < 0:
            crank_speeds(robot, legs, twist, observed.speed[:])
    margin[3] = np.inf if params.conditioning == -np.inf else observed.conditioning - params.conditioning
    for i in range(6):
        margin[1, i] = _margin(params.crank_speed, abs(observed.speed[i]))
        margin[2, i] = observed.transmission[i] - params.transmission
    laws.rotation(pose[:3], turn)
    laws.rotation(reference[:3], wanted)
    angle, distance = _angle((turn * wanted).sum()), _distance(pose, reference)
    margin[4] = np.minimum(_margin(params.following_error[0], angle), _margin(params.following_error[1], distance))


@njit
def margins_along(
    robot: Any, params: Any, poses: Any, rates: Any, references: Any, assembly_sign: float, legs: Any, observed: Any,
    out: Any,
) -> float:  # fmt: skip
    """Margins (n, 5, 6) of `LIMITS` for poses (n, 6) [rad, m], rates and poses wanted; assembly sign at the end."""
    robot, params, legs, observed = record(robot), record(params), record(legs), record(observed)
    for row in range(len(poses)):
        observe(robot, params, poses[row], rates[row], references[row], assembly_sign, legs, observed)
        for k in range(len(LIMITS)):
            copy_to(out[row, k], observed.margin[k])
    return observed.assembly_sign


@njit
def first_least(values: Any) -> int:
    """The leg of the first of six values that is no number, or of the least; of a tie the first on any processor."""
    leg = 0
    for i in range(1, 6):
        if values[leg] > -np.inf and not values[i] >= values[leg] - TIE:
            leg = i
    return leg


@njit
def broken(observed: Any) -> tuple[int, int]:
    """Monitor of the first limit that a measurement breaks, or `NO_TRIP`; its leg or -1."""
    for row in range(5):
        leg = first_least(observed.margin[row])
        if not observed.margin[row, leg] >= 0.0:
            return _OF_ROW[row, 0], leg if _OF_ROW[row, 1] else -1
    return NO_TRIP, -1


def sample_times(duration: float, period: float) -> np.ndarray:
    """Times (n,) [s] at which a motion is looked at before the start: ticks, or some thousand evenly spread."""
    return np.linspace(0.0, duration, min(4000, max(2, round(duration / period) + 1)))


def refuse_motion(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Refuses a motion (n, 6) with two derivatives that, followed without error, would trip a monitor."""
    pose, rate, _ = motion
    inverse_kinematics(robot, pose)
    _, start = _margins(robot, options, pose[:1], rate[:1], pose[:1])
    margins, _ = _margins(robot, options, pose, rate, pose, start)
    for row, (_, key, of_legs) in enumerate(LIMITS):
        _refuse(key, getattr(options, key), margins[:, row] if of_legs else margins[:, row, :1], time)
    torque, step = inverse_dynamics(robot, *motion, gravity), np.diff(time, prepend=2.0 * time[0] - time[1])
    change = np.abs(np.diff(torque, axis=0, prepend=torque[:1])) / step[:, None]
    for key, unit, size, scale, longest in (
        ("torque_limit", "N m", np.abs(torque), robot.effort_limits, AT_LIMIT_TIME),
        ("torque_rate", "N m/s", change, np.ones(6), TOO_FAST_TIME),
    ):
        given = getattr(options, key)
        limit = np.inf if given is None else given * scale
        # Counted as the layer does it.
        beyond = size > limit
        total = np.cumsum(np.where(beyond.any(axis=1), step, -step))
        total -= np.minimum(np.minimum.accumulate(total), 0.0)
        too_long = beyond & (total > longest + 1e-9)[:, None]
        needs = f"enough for the motion, which needs up to {size.max():.3g} {unit}; the limit is exceeded for too long"
        _refuse(key, given, np.where(too_long, limit - size, 0.0), time, needs)


def refuse_start(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    reference: np.ndarray,
) -> None:
    """Refuses a start at which a monitor would trip in the very first tick, or where the robot cannot be held."""
    margins, _ = _margins(robot, options, pose[None], pose_rate[None], reference[None])
    trips = [MONITORS[limit[0]] for limit, margin in zip(LIMITS, margins[0], strict=True) if not margin.min() >= 0.0]
    if trips:
        away = (pose - reference).tolist()
        raise ConfigurationError("initial_offset", away, f"a start that does not trip {trips[0]}")
    torque = static_torque(robot, pose, gravity)
    trip = options.first_user_trip(SafetyInputs(torque, pose, pose_rate, reference))
    if trip is not None:
        name, place = options.monitor_names[trip[0]], trip[0] - len(MONITORS)
        raise ConfigurationError(f"safety.monitors.{place}", name, "a monitor that does not trip at the start")
    if options.torque_limit is not None:
        needed = np.abs(torque[None])
        allowed = f"enough to hold the start pose, which needs up to {needed.max():.3g} N m; the limit is exceeded"
        margin = options.torque_limit * robot.effort_limits - needed
        _refuse("torque_limit", options.torque_limit, margin, np.zeros(1), allowed)


def _margins(
    robot: RobotParameters,
    options: SafetyOptions,
    pose: np.ndarray,
    rate: np.ndarray,
    wanted: np.ndarray,
    assembly_sign: float = 0.0,
) -> tuple[np.ndarray, float]:
    """Margins (n, 5, 6) of poses, rates and poses wanted (n, 6), and the assembly sign at their end."""
    # Of these limits none asks for gravity or period.
    out, params = np.empty((len(pose), len(LIMITS), 6)), params_of(robot, options, 0.0, 1.0)
    pose, rate, wanted = (np.ascontiguousarray(rows, dtype=float) for rows in (pose, rate, wanted))
    legs, observed = laws.Legs.empty(), np.empty(1, OBSERVED)
    return out, margins_along(laws.robot_record(robot), params, pose, rate, wanted, assembly_sign, legs, observed, out)


def _refuse(
    name: str,
    given: Any,
    margin: np.ndarray,
    time: np.ndarray,
    allowed: str = "a limit that the reference keeps; it is exceeded",
) -> None:
    """Raises for the first sample whose margin (n,), or (n, 6) of any leg, is negative."""
    margin = margin.reshape(len(time), -1)
    bad = ~(margin >= 0.0)
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        where = f", leg {int(bad[row].argmax())}" if margin.shape[1] == 6 else ""
        raise ConfigurationError(f"safety.{name}", given, f"{allowed} at t = {time[row]:.3f} s{where}")
