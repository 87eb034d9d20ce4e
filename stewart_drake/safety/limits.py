"""Limits of what is measured: what a tick breaks of them, compiled; what a run is refused for beforehand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import inverse_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.linear_algebra import copy_to, solve
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.safety_options import MONITORS, SafetyInputs, SafetyOptions

(
    QUIET, MEASUREMENT, SENSOR, CONTROLLER, COMMAND, DEADLINE, WORKSPACE, SERIAL, PARALLEL, CRANK_SPEED, FOLLOWING,
    TORQUE_LIMIT, TORQUE_RATE, INNOVATION, READING,
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

SMALLEST = 1e-9
"""Transmission at a dead centre, for the speed of that crank."""

SETUP = fields(
    period=(), gravity=(), horizon=(), home=6,
    finite=(), failures=(), deadline=(), frozen_encoder=(), frozen_pose=6, innovation=(), innovation_noise=(),
    innovation_scale=(), innovation_time=(), torque_limit=6, torque_limit_time=(), torque_change=(),
    torque_rate_time=(), workspace=2, transmission=(), conditioning=(), crank_speed=(), following_error=2,
    budget=(), ramp_time=(), safe_hold_time=(), damping=(), most_torque=6, most_speed=(),
)  # fmt: skip
"""`SafetyOptions` as numbers, infinite for a limit that is off; beside these home pose [rad, m], what the innovation's
noise is [rad] and what an acceleration leaves in it [s^2], torque_change: in a tick [N m], budget: ticks that may be
held, most_torque: of a robot that stops [N m], most_speed: at which it is given up [rad/s]."""

SEEN = fields(reached=(), side=(), speed=6, least_transmission=(), conditioning=(), margin=(5, 6))
"""What a measurement means, led ahead. reached: whether that pose is within reach. side: sign of the rods' determinant.
speed: of the cranks [rad/s]; where the pose led ahead is out of reach those of the pose itself, and 0 where that is.
conditioning: negative where the determinant has changed its sign. margin: by which each of `LIMITS` is kept, for each
leg: negative where it is broken, infinite where it is off."""


def setup_of(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    period: float,
    quantum: float = 0.0,
    innovation_scale: tuple[float, float] = (0.0, 1.0),
) -> np.ndarray:
    """`SETUP` record, see `safety_part` for the arguments."""
    pose, rate, share = options.frozen_pose, options.torque_rate, options.torque_limit
    fastest = 15.0 if options.crank_speed is None else options.crank_speed
    return new_record(
        SETUP,
        options,
        period=period,
        gravity=gravity,
        home=robot.home_pose,
        # A reading in counts stays the same for longer.
        frozen_encoder=math.inf if options.frozen_encoder is None else options.frozen_encoder + 50.0 * quantum,
        frozen_pose=math.inf if pose is None else np.repeat(pose, 3),
        innovation_noise=innovation_scale[0],
        innovation_scale=innovation_scale[1],
        torque_limit=(math.inf if share is None else share) * robot.effort_limits,
        torque_change=math.inf if rate is None else rate * period,
        transmission=-math.inf if options.transmission is None else options.transmission,
        conditioning=-math.inf if options.conditioning is None else options.conditioning,
        budget=options.budget(period),
        damping=0.7 * options.largest_damping(robot, period) if options.damping is None else options.damping,
        most_torque=(1.0 if share is None else share) * robot.effort_limits,
        most_speed=options.runaway * fastest,
    )


# --- in a tick ------------------------------------------------------------------------------------------------------


@njit
def _angle(trace: float) -> float:
    """Angle [rad] of a rotation with this trace."""
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@njit
def _distance(pose: Any, other: Any) -> float:
    """[m]."""
    return np.sqrt((pose[3] - other[3]) ** 2 + (pose[4] - other[4]) ** 2 + (pose[5] - other[5]) ** 2)


@njit
def _left(limit: float, value: float) -> float:
    """What is left up to a limit; of one that is off infinity, whatever the value is."""
    return np.inf if limit == np.inf else limit - value


@njit
def see(robot: Any, setup: Any, pose: Any, rate: Any, reference: Any, side: float, legs: Any, seen: Any) -> None:
    """What a finite measurement of pose and rate (6,) means, beside the pose (6,) that is wanted.

    `side` is the sign of the rods' determinant at the start, 0 if that is now. The `LEGS` become those of the pose led
    ahead; where that is out of reach those of the pose, or else of home.
    """
    home, wanted, margin, twist = setup.home[:], np.empty((3, 3)), seen.margin, np.empty(6)
    ahead, turn = pose + setup.horizon * rate, np.empty((3, 3))
    reached = laws.legs_at(robot, ahead, legs) < 0
    within, reach = reached, legs.reach.copy()
    angle = _angle(legs.rotation[0, 0] + legs.rotation[1, 1] + legs.rotation[2, 2])
    distance = _distance(ahead, home)
    margin[0] = min(_left(setup.workspace[0], angle), _left(setup.workspace[1], distance))
    if not reached:
        # Of a pose that is itself out of reach there is nothing to say; any that is within will do.
        within = laws.legs_at(robot, pose, legs) < 0
        if not within:
            laws.legs_at(robot, home, legs)
    seen.reached = 1.0 if reached else 0.0
    seen.conditioning, seen.side = np.inf, side
    if reached:
        seen.side = solve(legs.line.copy(), np.empty((6, 1)))
        crossed = side != 0.0 and seen.side != side
        seen.conditioning = laws.conditioning(robot, legs, laws.QUICK) * (-1.0 if crossed else 1.0)
    margin[3] = np.inf if setup.conditioning == -np.inf else seen.conditioning - setup.conditioning
    laws.twist_of(pose, rate, twist)
    seen.least_transmission = np.inf
    for i in range(6):
        size = abs(legs.transmission[i])
        if size < SMALLEST:
            legs.lever[i] = SMALLEST * robot.crank_length[i] * (-1.0 if legs.transmission[i] < 0.0 else 1.0)
        # 0 where a rod does not span.
        size = size if reach[i] >= 0.0 else 0.0
        seen.least_transmission = min(seen.least_transmission, size)
        margin[2, i] = size - setup.transmission
    laws.crank_rates(legs, twist, seen.speed[:])
    if not within:
        seen.speed[:] = 0.0
    for i in range(6):
        margin[1, i] = _left(setup.crank_speed, abs(seen.speed[i]))
    laws.rotation(pose[:3], turn)
    laws.rotation(reference[:3], wanted)
    angle, distance = _angle((turn * wanted).sum()), _distance(pose, reference)
    margin[4] = np.minimum(_left(setup.following_error[0], angle), _left(setup.following_error[1], distance))


@njit
def margins_along(
    robots: Any, setups: Any, poses: Any, rates: Any, references: Any, side: float, leg_records: Any, seens: Any,
    out: Any,
) -> float:  # fmt: skip
    """Margins (n, 5, 6) of `LIMITS` for poses (n, 6) [rad, m], rates and poses wanted; the side at the last."""
    robot, setup, legs, seen = record(robots), record(setups), record(leg_records), record(seens)
    for row in range(len(poses)):
        see(robot, setup, poses[row], rates[row], references[row], side, legs, seen)
        for k in range(len(LIMITS)):
            copy_to(out[row, k], seen.margin[k])
    return seen.side


@njit
def broken(seen: Any) -> tuple[int, int]:
    """Monitor of the first limit that a measurement breaks, or `QUIET`; its leg or -1."""
    for row in range(5):
        leg = 0
        for i in range(1, 6):
            if not seen.margin[row, i] >= seen.margin[row, leg]:
                leg = i
        if not seen.margin[row, leg] >= 0.0:
            return _OF_ROW[row, 0], leg if _OF_ROW[row, 1] else -1
    return QUIET, -1


# --- before a run ---------------------------------------------------------------------------------------------------


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
    """Refuses a motion that, followed without error, would trip a monitor.

    Args: robot as believed, gravity [m/s^2], times (n,) [s], and poses (n, 6) [rad, m] with their two derivatives.

    Raises:
        ConfigurationError: Names the limit, its time and leg.
        UnreachablePoseError: A pose out of reach.
    """
    pose, rate, _ = motion
    inverse_kinematics(robot, pose)
    _, start = _margins(robot, options, 0.0, (pose[:1], rate[:1], pose[:1]))
    # The poses themselves, and what the layer looks at: the poses led ahead.
    for horizon in (0.0, options.horizon):
        by, _ = _margins(robot, options, horizon, (pose, rate, pose), start)
        for row, (monitor, key, of_legs) in enumerate(LIMITS):
            margin = by[:, row] if of_legs else by[:, row, :1]
            if horizon == 0.0:
                _refuse(key, getattr(options, key), margin, time)
            else:
                allowed = f"one that does not trip {MONITORS[monitor]} along the reference, as it does"
                _refuse("horizon", options.horizon, margin, time, allowed)
    torque = inverse_dynamics(robot, *motion, gravity)
    for row in range(len(time) if options.monitors else 0):
        trip = options.first_own(SafetyInputs(torque[row], pose[row], rate[row], pose[row]))
        if trip is not None:
            key = f"monitors.{trip[0] - len(MONITORS)}"
            allowed = "one that the reference does not trip, as it does"
            _refuse(key, options.monitor_names[trip[0]], np.full(1, -1.0), time[row : row + 1], allowed)
    if options.torque_limit is not None:
        step = np.diff(time, prepend=time[0] - (time[1] - time[0] if len(time) > 1 else 0.0))
        limit = options.torque_limit * robot.effort_limits
        _refuse_for_long("torque_limit", options, np.abs(torque), limit, time, step, "N m")
    if options.torque_rate is not None and len(time) > 1:
        step = np.diff(time)
        change = np.abs(np.diff(torque, axis=0)) / step[:, None]
        _refuse_for_long("torque_rate", options, change, options.torque_rate, time[1:], step, "N m/s")


def _refuse_for_long(
    key: str, options: SafetyOptions, size: np.ndarray, limit: Any, time: np.ndarray, step: np.ndarray, unit: str
) -> None:
    """Refuses a limit above which sizes (n, 6) are for longer than is allowed, counted as the layer does it.

    Samples of `step` (n,) [s] with a motor beyond add to a sum, others take away from it, down to zero.
    """
    beyond = size > limit
    any_beyond = beyond.any(axis=1)
    total = np.cumsum(np.where(any_beyond, step, -step))
    total -= np.minimum(np.minimum.accumulate(total), 0.0)
    too_long = beyond & (total > getattr(options, f"{key}_time") + 1e-9)[:, None]
    allowed = f"enough for the motion, which needs up to {size.max():.3g} {unit}; the limit is exceeded for too long"
    _refuse(key, getattr(options, key), np.where(too_long, limit - size, 0.0), time, allowed)


def refuse_start(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    reference: np.ndarray,
) -> None:
    """Refuses a start at which a monitor would trip in the very first tick, or where the motors cannot hold the robot.

    Args are as of `refuse_motion`, at the start: pose and rate of the robot, and the pose that is wanted.

    Raises:
        ConfigurationError: Names the monitor.
    """
    by, _ = _margins(robot, options, options.horizon, (pose[None], pose_rate[None], reference[None]))
    trips = [MONITORS[limit[0]] for limit, margin in zip(LIMITS, by[0], strict=True) if not margin.min() >= 0.0]
    if trips:
        if np.array_equal(pose, reference):
            # The motion itself has been looked at: it is the look ahead that leads out of bounds.
            allowed = f"one whose first tick does not trip {trips[0]}"
            raise ConfigurationError("safety.horizon", options.horizon, allowed)
        away = (pose - reference).tolist()
        raise ConfigurationError("initial_offset", away, f"a start that does not trip {trips[0]}")
    if options.torque_limit is not None:
        needed = np.abs(static_torque(robot, pose, gravity)[None])
        allowed = f"enough to stand at the start, which needs up to {needed.max():.3g} N m; the limit is exceeded"
        margin = options.torque_limit * robot.effort_limits - needed
        _refuse("torque_limit", options.torque_limit, margin, np.zeros(1), allowed)


def _margins(
    robot: RobotParameters, options: SafetyOptions, horizon: float, motion: tuple[np.ndarray, ...], side: float = 0.0
) -> tuple[np.ndarray, float]:
    """Margins (n, 5, 6) of poses, rates and poses wanted, led ahead by a horizon [s], and the side at their end."""
    # Of these limits none asks for gravity or period.
    out, setup = np.empty((len(motion[0]), len(LIMITS), 6)), setup_of(robot, options, 0.0, 1.0)
    setup["horizon"] = horizon
    poses, rates, wanted = (np.ascontiguousarray(each, dtype=float) for each in motion)
    own, legs, seen = laws.robot_record(robot), np.empty(1, laws.LEGS), np.empty(1, SEEN)
    return out, margins_along(own, setup, poses, rates, wanted, side, legs, seen, out)


def _refuse(
    name: str,
    given: Any,
    margin: np.ndarray,
    time: np.ndarray,
    allowed: str = "a limit that the reference keeps to; the limit is exceeded",
) -> None:
    """Raises for the first sample whose margin (n,), or (n, 6) of any leg, is negative."""
    margin = margin.reshape(len(time), -1)
    bad = ~(margin >= 0.0)
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        where = f", leg {int(bad[row].argmax())}" if margin.shape[1] == 6 else ""
        raise ConfigurationError(f"safety.{name}", given, f"{allowed} at t = {time[row]:.3f} s{where}")
