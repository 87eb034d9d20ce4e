"""The safety layer's check of a measurement against its limits, and of a motion before a run."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Record, Vec2, Vec6, Vec9, record
from stewart_drake.loop.part import LoopContext
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import inverse_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.mechanics.kinematics_laws import Legs, Robot
from stewart_drake.mechanics.linear_algebra import copy_to, set_to
from stewart_drake.mechanics.singularities import WEIGHT_TRUSTED, PoseMeasures, crank_speeds, measure_pose
from stewart_drake.robot import Gravity, RobotParameters, base_reading
from stewart_drake.safety.actuators import ActuatorParams, actuator_params
from stewart_drake.safety.options import (
    CRANK_SPEED,
    FOLLOWING,
    MONITORS,
    NO_TRIP,
    PARALLEL,
    SERIAL,
    WORKSPACE,
    SafetyInputs,
    SafetyOptions,
)
from stewart_drake.safety.residual import LONGEST_HALF, ONE_LEG_SHARE, ResidualParams
from stewart_drake.safety.stillness import StillParams, still_params

if TYPE_CHECKING:
    from stewart_drake.hardware.motors import MotorOptions

LIMITS = (
    (WORKSPACE, "workspace", False),
    (CRANK_SPEED, "crank_speed", True),
    (SERIAL, "transmission", True),
    (PARALLEL, "conditioning", False),
    (FOLLOWING, "following_error", False),
)
"""Monitors of the measurement, their keys of `safety`, and whether they have a margin for each leg. The rows of margins
have this order, in which they are checked: the first to trip explains the others."""
_OF_ROW = np.array([(monitor, of_legs) for monitor, _, of_legs in LIMITS])

TIE = 1e-6  # Difference of two legs, in any unit, below which the first leg is named.
AT_LIMIT_TIME, TOO_FAST_TIME = 0.1, 0.01
"""[s] total time for which commands may be at the torque limit, and may jump, or a tick. Good ticks are subtracted from
it."""
RUNAWAY_TIME = 0.005
"""[s] for which a crank of a stopping robot may turn too fast: a reading may jump."""
IMPACT = 0.005  # [s] longest impact, as `disturbances` has it.
SIGMAS = 8.0  # Standard deviations of the residual's noise that fit in its bound; this sets the length of the window.
FILTER_TIME, UNREAD_TIME = 0.01, 0.05
"""[s] time constant of the unexplained acceleration; time for which a jump of a reading counts; assumed."""
BANDWIDTHS, CORRECTION = (150.0, 10.0), 0.3
"""[rad/s] bandwidths of the observers; largest correction of the slow one in a tick; assumed."""
STOPPING, STOPPING_TICKS = 0.008, 4.0  # [s], [ticks] time constant of a stop: the loop has the delay of a tick.
SUSPECT_HOLD = 0.04  # [s] for which torques alone give a speed; five time constants of a stop.
RUNAWAY, FASTEST = 2.0, 15.0  # Factor on `crank_speed`; [rad/s] speed if `crank_speed` is null.
NOISE = 1e-5  # [rad] noise of a crank's angle, if it is not given.


class SafetyParams(Record):
    """Numbers of `SafetyOptions`, infinite for a limit that is off, and what follows from them."""

    period: float  # [s]
    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    horizon: float  # [s]
    home: Vec6  # [rad, m]
    deadline: float  # [ticks]
    torque_limit: Vec6  # [N m]
    torque_change: float  # [N m] in a tick.
    jump_time: float  # [s] for which commands may jump.
    workspace: Vec2  # [rad, m]
    transmission: float
    conditioning: float
    crank_speed: float  # [rad/s]
    following_error: Vec2  # [rad, m]
    impact: float  # [ticks] for which an impact shows in the residual.
    budget: float  # Ticks that may be held.
    goes_on: float  # 1 if the robot is held with one encoder lost, see `lost_encoder`.
    ramp_time: float  # [s]
    safe_hold_time: float  # [s]
    suspect_hold_time: float  # [s] of a stop with a suspect leg.
    stopping: float  # [s] time constant of a stop.
    most_torque: Vec6  # [N m] of a stop.
    most_speed: float  # [rad/s] of a crank at which a stop is given up.
    still: StillParams
    residual: ResidualParams
    actuators: ActuatorParams


class Observed(PoseMeasures):
    """Measures of the measurement, extrapolated by the horizon, and margins to the limits.

    The conditioning is a lower bound where that is enough, negative where the determinant of the rods' lines has
    changed its sign, infinite out of reach. Out of reach speeds are those of the pose as measured, or 0.
    """

    margin: Annotated[np.ndarray, (5, 6)]  # To `LIMITS`, for each leg; negative where broken, infinite where off.


def safety_params(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: Gravity,
    period: float,
    noise: float = NOISE,
    context: LoopContext | None = None,
) -> SafetyParams:
    """The parameters of the layer, for ticks of a period [s] and noise [rad] of a crank's angle.

    Without a `context` motors take torques.
    """
    actuators = actuator_params(robot, options, context)
    rate, share, limits = options.torque_rate, options.torque_limit, actuators["limit"][0]
    residual = _residual_params(robot, options, gravity, period, noise, actuators)
    change = math.inf if rate is None else rate * period
    if actuators["holds"][0]:
        change = 0.0 if actuators["follows"][0] else min(change, 2.0 * limits.max())
    return SafetyParams.new(
        options,
        period=period,
        base=base_reading(gravity),
        home=robot.home_pose,
        torque_limit=(math.inf if share is None else share) * limits,
        torque_change=change,
        jump_time=max(TOO_FAST_TIME, period),
        transmission=-math.inf if options.transmission is None else options.transmission,
        conditioning=-math.inf if options.conditioning is None else options.conditioning,
        impact=IMPACT / period + 2.0 * residual["half"][0] + 1e-6,
        suspect_hold_time=min(SUSPECT_HOLD, options.ramp_time + options.safe_hold_time),
        stopping=max(STOPPING, STOPPING_TICKS * period),
        budget=options.budget(period),
        goes_on=0.0,
        most_torque=(1.0 if share is None else share) * limits,
        most_speed=RUNAWAY * (FASTEST if options.crank_speed is None else options.crank_speed),
        still=still_params(period, options.standstill, options.frozen),
        residual=residual,
        actuators=actuators,
    )


def _residual_params(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: Gravity,
    period: float,
    noise: float,
    actuators: ActuatorParams,
) -> ResidualParams:
    bound = (math.inf if options.unexplained_torque is None else options.unexplained_torque) * actuators["limit"][0]
    inertia = np.linalg.inv(pose_jacobian(robot, robot.home_pose) @ pose_acceleration_map(robot, robot.home_pose))
    # A second difference of noise has sqrt(6) times its size, over the square of half the window.
    largest = np.linalg.norm(inertia, axis=1).max() * math.sqrt(6.0) * noise
    half = min(LONGEST_HALF, max(2, math.ceil(math.sqrt(SIGMAS * largest / bound.min()) / period)))
    return ResidualParams.new(
        period=period,
        base=base_reading(gravity),
        half=half,
        # Torques count a tick late; a servo's depends on the angle, so a tick matters.
        first=0.0 if actuators["holds"][0] else 1.0,
        unexplained=bound,
        unexplained_alone=ONE_LEG_SHARE * bound.min(),
        filter_share=min(0.5, period / FILTER_TIME),
        inertia=inertia.diagonal().min(),
        # The ticks of a slow controller bear no higher bandwidths.
        bandwidth=(min(BANDWIDTHS[0], 0.3 / period), min(BANDWIDTHS[1], 0.02 / period)),
        most_correction=(math.inf, CORRECTION),
        impossible=FASTEST + 12.0 * noise / period,
        unread_time=UNREAD_TIME / period,
    )


@njit
def _angle(trace: float) -> float:
    """Angle [rad] of a rotation with this trace."""
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@njit
def _distance(pose: Vec6, other: Vec6) -> float:
    """[m]."""
    return np.sqrt((pose[3] - other[3]) ** 2 + (pose[4] - other[4]) ** 2 + (pose[5] - other[5]) ** 2)


@njit
def _margin(limit: float, value: float) -> float:
    """Distance to a limit; infinite where the limit is off, whatever the value."""
    return np.inf if limit == np.inf else limit - value


@njit
def observe(
    robot: Robot,
    params: SafetyParams,
    pose: Vec6,
    rate: Vec6,
    reference: Vec6,
    assembly_sign: float,
    legs: Legs,
    observed: Observed,
) -> None:
    """Measures and margins of a finite measurement, beside the pose of the reference.

    `assembly_sign` is the sign of the rods' determinant at the start, 0 if that is now. `legs` become those of the
    extrapolated pose.
    """
    wanted, margin, twist, ahead, turn = np.empty((3, 3)), observed.margin, np.empty(6), np.empty(6), np.empty((3, 3))
    for k in range(6):
        ahead[k] = pose[k] + params.horizon * rate[k]
    laws.twist_of(pose, rate, twist)
    enough = max(params.conditioning, WEIGHT_TRUSTED.conditioning)
    reached = measure_pose(robot, ahead, twist, laws.QUICK, enough, legs, np.empty((6, 1)), observed)
    angle = _angle(legs.rotation[0, 0] + legs.rotation[1, 1] + legs.rotation[2, 2])
    from_home = min(_margin(params.workspace[0], angle), _margin(params.workspace[1], _distance(ahead, params.home)))
    if reached:
        if assembly_sign != 0.0 and observed.assembly_sign != assembly_sign:
            observed.conditioning = -observed.conditioning
    else:
        observed.conditioning, observed.assembly_sign = np.inf, assembly_sign
        set_to(observed.speed[:], 0.0)
        if laws.legs_at(robot, pose, legs) < 0:
            crank_speeds(robot, legs, twist, observed.speed[:])
    conditioning = np.inf if params.conditioning == -np.inf else observed.conditioning - params.conditioning
    laws.rotation(pose[:3], turn)
    laws.rotation(reference[:3], wanted)
    trace = 0.0
    for i in range(3):
        for k in range(3):
            trace += turn[i, k] * wanted[i, k]
    angle, distance = _angle(trace), _distance(pose, reference)
    # The minimum with a NaN is NaN, which counts as a violation.
    following = np.minimum(_margin(params.following_error[0], angle), _margin(params.following_error[1], distance))
    for i in range(6):
        margin[0, i], margin[3, i], margin[4, i] = from_home, conditioning, following
        margin[1, i] = _margin(params.crank_speed, abs(observed.speed[i]))
        margin[2, i] = observed.transmission[i] - params.transmission


@njit
def margins_along(
    robot: Robot,
    params: SafetyParams,
    poses: Matrix,
    rates: Matrix,
    references: Matrix,
    assembly_sign: float,
    legs: Legs,
    observed: Observed,
    out: np.ndarray,
) -> float:
    """Margins (n, 5, 6) to `LIMITS` of poses (n, 6) [rad, m], rates and references; assembly sign at the end."""
    robot, params, legs, observed = record(robot), record(params), record(legs), record(observed)
    for row in range(len(poses)):
        observe(robot, params, poses[row], rates[row], references[row], assembly_sign, legs, observed)
        for k in range(len(LIMITS)):
            copy_to(out[row, k], observed.margin[k])
    return observed.assembly_sign


@njit
def first_least(values: Vec6) -> int:
    """The leg of the first of six values that is NaN, or of the least; of a tie the first, on any processor."""
    leg = 0
    for i in range(1, 6):
        if values[leg] > -np.inf and not values[i] >= values[leg] - TIE:
            leg = i
    return leg


@njit
def broken(observed: Observed) -> tuple[int, int]:
    """Monitor of the first limit that a measurement breaks, or `NO_TRIP`; its leg or -1."""
    for row in range(5):
        leg = first_least(observed.margin[row])
        if not observed.margin[row, leg] >= 0.0:
            return _OF_ROW[row, 0], leg if _OF_ROW[row, 1] else -1
    return NO_TRIP, -1


def sample_times(duration: float, period: float) -> np.ndarray:
    """Times (n,) [s] at which a motion is checked before the start: ticks, or some thousand evenly spread."""
    return np.linspace(0.0, duration, min(4000, max(2, round(duration / period) + 1)))


def refuse_motion(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: Gravity,
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    motors: MotorOptions | None = None,
) -> None:
    """Refuses a motion (n, 6) with two derivatives that would trip a monitor if it were followed without error.

    Without `motors` they take torques.
    """
    pose, rate, _ = motion
    angles = np.unwrap(inverse_kinematics(robot, pose), axis=0)
    _, start = _margins(robot, options, pose[:1], rate[:1], pose[:1])
    margins, _ = _margins(robot, options, pose, rate, pose, start)
    for row, (_, key, of_legs) in enumerate(LIMITS):
        _refuse(key, getattr(options, key), margins[:, row] if of_legs else margins[:, row, :1], time)
    torque, step = inverse_dynamics(robot, *motion, gravity), np.diff(time, prepend=2.0 * time[0] - time[1])
    limits, fast, per_second, sent = robot.effort_limits, "torque_rate", "N m/s", torque
    if motors is not None:
        limits = motors.limits(robot)
    if motors is not None and motors.holds:
        fast, per_second = "crank_speed", "rad/s"
        sent = angles + (torque + getattr(motors, "damping", 0.0) * np.gradient(angles, time, axis=0)) / motors.gains
    change = np.abs(np.diff(sent, axis=0, prepend=sent[:1])) / step[:, None]
    for key, unit, size, scale, longest in (
        ("torque_limit", "N m", np.abs(torque), limits, AT_LIMIT_TIME),
        (fast, per_second, change, np.ones(6), TOO_FAST_TIME),
    ):
        given = getattr(options, key)
        limit = np.inf if given is None else given * scale
        # Counted as in the layer.
        beyond = size > limit
        total = np.cumsum(np.where(beyond.any(axis=1), step, -step))
        total -= np.minimum(np.minimum.accumulate(total), 0.0)
        too_long = beyond & (total > longest + 1e-9)[:, None]
        needs = f"enough for the motion, which needs up to {size.max():.3g} {unit}; the limit is exceeded for too long"
        _refuse(key, given, np.where(too_long, limit - size, 0.0), time, needs)


def refuse_start(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: Gravity,
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
    """Margins (n, 5, 6) of poses, rates and reference poses (n, 6), and the assembly sign at the end."""
    # None of these limits depends on gravity or period.
    out, params = np.empty((len(pose), len(LIMITS), 6)), safety_params(robot, options, 0.0, 1.0)
    pose, rate, wanted = (np.ascontiguousarray(rows, dtype=float) for rows in (pose, rate, wanted))
    legs, observed = Legs.empty(), Observed.empty()
    return out, margins_along(laws.robot_record(robot), params, pose, rate, wanted, assembly_sign, legs, observed, out)


def _refuse(
    name: str,
    given: object,
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
