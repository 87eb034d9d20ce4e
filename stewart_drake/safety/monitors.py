"""The monitors of the safety layer, compiled: what each finds in a measurement, in a message, or in readings.

Where what is measured breaks a limit the robot is taken from its controller; where a message is wrong the last good
command is held.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stewart_drake.errors import failure_code
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.kinematics_laws import (
    QUICK,
    conditioning,
    crank_rates,
    legs_at,
    rotation,
    twist_of,
)
from stewart_drake.mechanics.linear_algebra import copy_to, solve
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.safety_options import SafetyOptions

(
    QUIET, MEASUREMENT, SENSOR, CONTROLLER, COMMAND, DEADLINE, WORKSPACE, SERIAL, PARALLEL, CRANK_SPEED, FOLLOWING,
    TORQUE_LIMIT, TORQUE_RATE, INNOVATION, READING,
) = range(15)  # fmt: skip
"""Places in `MONITORS`."""

LIMITS = (
    (WORKSPACE, "workspace"),
    (CRANK_SPEED, "crank_speed"),
    (SERIAL, "transmission"),
    (PARALLEL, "conditioning"),
    (FOLLOWING, "following_error"),
)
"""Monitors of what is measured and their keys of `safety`, in the order in which they are asked: what the first see
explains the others. The rows of margins."""
OF_LEGS = (False, True, True, False, False)
"""Whether a limit is one of each leg, or the robot's as a whole."""
_MONITOR_OF_ROW = np.array([monitor for monitor, _ in LIMITS])

FROZEN = failure_code("frozen")
ABSURD = 10.0
"""A command of so many times the limit is an error of the controller and no wish for torque."""
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

SEEN = fields(reached=(), from_home=2, transmission=6, conditioning=(), side=(), speed=6, from_reference=2)
"""What a measurement means, led ahead; where that is out of reach, speeds are those of the pose itself. reached:
whether the pose led ahead is within reach. from_home: angle of the rotation and distance [rad, m]. transmission: sizes,
0 where a rod does not span. conditioning: negative where the rods' determinant has changed its sign, infinite out of
reach. side: sign of the rods' determinant. speed: of the cranks [rad/s], 0 where the pose itself is out of reach.
from_reference: as `from_home`, of the pose itself."""


def setup_of(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    period: float,
    quantum: float = 0.0,
    innovation_scale: tuple[float, float] = (0.0, 1.0),
) -> np.ndarray:
    """`SETUP` record, see `layer.safety_part` for the arguments."""
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


# --- what is measured -------------------------------------------------------------------------------------------------


@njit
def see(
    robot: Any, home: Any, horizon: float, pose: Any, rate: Any, reference: Any, side: float, legs: Any, seen: Any
) -> None:
    """What a finite measurement means.

    Args:
        robot: `ROBOT` record.
        home: (6,) [rad, m] home pose.
        horizon: [s] by which the pose is led ahead.
        pose: (6,) [rad, m].
        rate: (6,) [rad/s, m/s].
        reference: (6,) [rad, m].
        side: Sign of the rods' determinant at the start; 0 if that is now.
        legs: `LEGS` record out: of the pose led ahead; where that is out of reach of the pose, or else of home.
        seen: `SEEN` record, out.
    """
    ahead, twist, turn, wanted = pose + horizon * rate, np.empty(6), np.empty((3, 3)), np.empty((3, 3))
    reached = legs_at(robot, ahead, legs) < 0
    within, reach = reached, legs.reach.copy()
    seen.from_home[0] = _angle(legs.rotation[0, 0] + legs.rotation[1, 1] + legs.rotation[2, 2])
    seen.from_home[1] = _distance(ahead, home)
    rotation(pose[:3], turn)
    rotation(reference[:3], wanted)
    seen.from_reference[0] = _angle((turn * wanted).sum())
    seen.from_reference[1] = _distance(pose, reference)
    if not reached:
        # Of a pose that is itself out of reach there is nothing to say; any that is within will do.
        within = legs_at(robot, pose, legs) < 0
        if not within:
            legs_at(robot, home, legs)
    seen.reached = 1.0 if reached else 0.0
    seen.conditioning, seen.side = np.inf, side
    if reached:
        seen.side = _side(legs)
        crossed = side != 0.0 and seen.side != side
        seen.conditioning = conditioning(robot, legs, QUICK) * (-1.0 if crossed else 1.0)
    twist_of(pose, rate, twist)
    for i in range(6):
        size = abs(legs.transmission[i])
        if size < SMALLEST:
            legs.lever[i] = SMALLEST * robot.crank_length[i] * (-1.0 if legs.transmission[i] < 0.0 else 1.0)
        seen.transmission[i] = size if reach[i] >= 0.0 else 0.0
    crank_rates(legs, twist, seen.speed[:])
    if not within:
        seen.speed[:] = 0.0


@njit
def _side(legs: Any) -> float:
    """Sign of the determinant of the rods' lines."""
    return solve(legs.line.copy(), np.empty((6, 1)))


@njit
def _angle(trace: float) -> float:
    """Angle [rad] of a rotation with this trace."""
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@njit
def _distance(pose: Any, other: Any) -> float:
    return np.sqrt((pose[3] - other[3]) ** 2 + (pose[4] - other[4]) ** 2 + (pose[5] - other[5]) ** 2)


@njit
def margins(setup: Any, seen: Any, out: Any) -> None:
    """By which each of `LIMITS` is kept, for each leg (5, 6): negative where it is broken, infinite where it is off."""
    out[:] = np.inf
    if setup.workspace[0] < np.inf:
        out[0] = np.minimum(setup.workspace[0] - seen.from_home[0], setup.workspace[1] - seen.from_home[1])
    if setup.following_error[0] < np.inf:
        apart, limit = seen.from_reference, setup.following_error
        out[4] = np.minimum(limit[0] - apart[0], limit[1] - apart[1])
    if setup.conditioning > -np.inf:
        out[3] = seen.conditioning - setup.conditioning
    for i in range(6):
        if setup.crank_speed < np.inf:
            out[1, i] = setup.crank_speed - abs(seen.speed[i])
        if setup.transmission > -np.inf:
            out[2, i] = seen.transmission[i] - setup.transmission


@njit
def broken(setup: Any, seen: Any) -> tuple[int, int]:
    """Monitor of the first limit that a measurement breaks, or `QUIET`; its leg or -1."""
    by = np.empty((5, 6))
    margins(setup, seen, by)
    for row in range(5):
        leg = 0
        for i in range(1, 6):
            if not by[row, i] >= by[row, leg]:
                leg = i
        if not by[row, leg] >= 0.0:
            return _MONITOR_OF_ROW[row], leg if OF_LEGS[row] else -1
    return QUIET, -1


@njit
def margins_along(
    robots: Any, setups: Any, horizon: float, poses: Any, rates: Any, references: Any, side: float, leg_records: Any,
    seens: Any, out: Any,
) -> float:  # fmt: skip
    """`margins` (n, 5, 6) of poses (n, 6) [rad, m] with their rates (n, 6) and the poses that are wanted, led ahead.

    Returns the sign of the rods' determinant at the last; `leg_records` and `seens` are overwritten.
    """
    robot, setup, legs, seen = record(robots), record(setups), record(leg_records), record(seens)
    for row in range(len(poses)):
        see(robot, setup.home[:], horizon, poses[row], rates[row], references[row], side, legs, seen)
        margins(setup, seen, out[row])
    return seen.side


# --- messages ---------------------------------------------------------------------------------------------------------


@njit
def measured(setup: Any, measurement: Any) -> bool:
    """Whether the measurement is one, and can be led ahead."""
    for k in range(6):
        if not (np.isfinite(measurement[k] + setup.horizon * measurement[6 + k]) and np.isfinite(measurement[6 + k])):
            return False
    return True


@njit
def failed(setup: Any, cause: float) -> bool:
    """Whether a sensor or controller has failed; a reading that is stuck has switches of its own."""
    return cause == FROZEN or (setup.failures != 0.0 and cause != 0.0)


@njit
def unusable(setup: Any, command: Any, is_measured: bool, age: float, sensor: Any, controller: Any) -> Any:
    """What is wrong with this tick's messages, apart from what they say: monitor or `QUIET`, leg or -1, cause or 0."""
    if setup.finite != 0.0 and not is_measured:
        return MEASUREMENT, -1, 0
    stuck = sensor[0] == FROZEN
    if not stuck and failed(setup, sensor[0]):
        return SENSOR, _whole(sensor[1]), _whole(sensor[0])
    if failed(setup, controller[0]):
        return CONTROLLER, _whole(controller[1]), _whole(controller[0])
    largest, leg = 0.0, 0
    for i in range(6):
        if setup.finite != 0.0 and not np.isfinite(command[i]):
            return COMMAND, i, 0
        share = abs(command[i]) / setup.torque_limit[i]
        if share > largest:
            largest, leg = share, i
    if not age <= setup.deadline:
        return DEADLINE, -1, 0
    if largest > ABSURD:
        return TORQUE_LIMIT, leg, 0
    if stuck:
        return READING, int(sensor[1]), 0
    return QUIET, -1, 0


@njit
def _whole(value: float) -> int:
    return int(value) if np.isfinite(value) else -1


@njit
def unexplained(setup: Any, innovation: Any) -> float:
    """[rad/s^2] of a crank that the largest innovation (6,) [rad] speaks of, beyond noise; NaN counts as nothing."""
    largest = 0.0
    for i in range(6):
        largest = max(largest, abs(innovation[i])) if innovation[i] == innovation[i] else largest
    return (largest - setup.innovation_noise) / setup.innovation_scale


# --- frozen sensors ---------------------------------------------------------------------------------------------------

NOTHING_FROZEN = -2


@njit
def frozen(robot: Any, setup: Any, angles: Any, pose: Any, reference: Any, state: Any, legs: Any) -> int:
    """Looks for a reading that stays the same while things move.

    Its sensor is frozen, or friction holds the crank, or the platform, that it reads: six encoders measure six degrees
    of freedom, so they can never contradict each other and nobody can tell which. Nor can anybody tell while the robot
    stands still. A crank that friction holds where it turns back does not count: it stands about where it is wanted.

    Readings are angles (6,) [rad] of encoders, NaN from the start where there are none, or else the pose (6,). The
    state has `readings` (6,) of the tick before; for each of them in `anchors` (6, 6) what it is compared with as it
    was when the reading changed; and whether there are `encoders`. The `LEGS` are overwritten.

    Returns:
        Leg whose reading is stuck, -1 for the pose as a whole, or `NOTHING_FROZEN`.
    """
    if state.encoders == 0.0 and np.isfinite(angles).any():
        state.encoders = 1.0
    if state.encoders == 0.0:
        return _frozen_pose(setup, pose, reference, state)
    limit, leg, farthest = setup.frozen_encoder, NOTHING_FROZEN, 0.0
    for i in range(6):
        # NaN never equals itself; the monitor `measurement_not_finite` looks for it.
        if angles[i] != state.readings[i]:
            copy_to(state.anchors[i], angles)
        # How far the last but one has turned: one that jumps would make all that stand still look frozen.
        most, travel = 0.0, 0.0
        for k in range(6):
            moved = abs(angles[k] - state.anchors[i, k])
            moved = moved if moved < np.inf else np.inf
            most, travel = max(most, moved), max(travel, min(most, moved))
        if limit < travel < np.inf and travel > farthest and not _stands_near(robot, angles, i, reference, limit, legs):
            leg, farthest = i, travel
    copy_to(state.readings[:], angles)
    return leg


@njit
def _stands_near(robot: Any, angles: Any, leg: int, reference: Any, limit: float, legs: Any) -> bool:
    """Whether a crank is within a quarter of the limit [rad] of where it is wanted; out of reach nobody can say."""
    legs_at(robot, reference, legs)
    off = angles[leg] - np.arctan2(legs.sine[leg], legs.cosine[leg])
    return legs.reach[leg] >= 0.0 and abs((off + np.pi) % (2.0 * np.pi) - np.pi) <= 0.25 * limit


@njit
def _frozen_pose(setup: Any, pose: Any, reference: Any, state: Any) -> int:
    same = (pose == state.readings).all()
    copy_to(state.readings[:], pose)
    if not same:
        copy_to(state.anchors[0], reference)
    for k in range(6):
        if abs(reference[k] - state.anchors[0, k]) > setup.frozen_pose[k]:
            return -1
    return NOTHING_FROZEN
