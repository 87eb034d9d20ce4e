"""What the monitors see in a measurement and in a message; pure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stewart_drake.errors import UnreachablePoseError, failure_code
from stewart_drake.mechanics.dynamics import static_torque_of_legs
from stewart_drake.mechanics.kinematics import (
    crank_rates,
    leg_geometry,
    line_conditioning,
    pose_rate_to_twist,
    rod_lines,
    rotation_angle,
    rotation_matrix,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.memory import HOLD, MONITORS, RAMP, SafetyInputs, Trip
from stewart_drake.safety.safety_options import SafetyOptions

_ABSURD = 10.0
"""A command of so many times the limit is an error of the controller and no wish for torque."""
USABLE_TRANSMISSION, USABLE_CONDITIONING = 0.02, 0.01
"""Nearer to a singularity the weight's torque is not trusted any more, and the last one stays."""


class View(NamedTuple):
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


def look(robot: RobotParameters, options: SafetyOptions, gravity: float, inputs: SafetyInputs, side: float) -> View:
    """Speeds, weight and broken limits at a finite measurement.

    Args:
        robot: As believed.
        options: Limits.
        gravity: [m/s^2].
        inputs: See `SafetyInputs`.
        side: Sign of the rods' determinant at the start; 0 if that is now.
    """
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
        return View(still, None, side, trip)
    transmission = np.abs(legs.transmission)
    lines = rod_lines(legs)
    conditioning, now = float(line_conditioning(robot, legs)), float(np.sign(np.linalg.det(lines)))
    smallest = max(float(transmission.min()), 1e-9)
    speed = lines @ pose_rate_to_twist(pose, rate) / (robot.crank_lengths * np.maximum(transmission, 1e-9))
    speed *= np.where(legs.transmission < 0.0, -1.0, 1.0)
    usable = smallest > USABLE_TRANSMISSION and conditioning > USABLE_CONDITIONING
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
    return View(speed, weight, now, trip)


def _too_fast(robot: RobotParameters, options: SafetyOptions, pose: np.ndarray, rate: np.ndarray) -> Trip | None:
    """Whether the cranks turn too fast at a pose of which only what lies ahead of it is out of reach."""
    if options.crank_speed is None:
        return None
    try:
        legs = leg_geometry(robot, pose)
    except UnreachablePoseError:
        return None
    speed = np.abs(crank_rates(robot, legs, pose, rate))
    return (
        None if speed.max() <= options.crank_speed else Trip(MONITORS.index("crank_speed"), RAMP, int(speed.argmax()))
    )


def _beyond(values: tuple[float, float], limits: tuple[float, float]) -> bool:
    """Whether one of two values is above its limit, or not a number."""
    return not (values[0] <= limits[0] and values[1] <= limits[1])


def measured(options: SafetyOptions, inputs: SafetyInputs) -> bool:
    """Whether the measurement is one, and can be led ahead."""
    with np.errstate(all="ignore"):
        ahead = inputs.pose + options.horizon * inputs.pose_rate
    return bool(np.isfinite(ahead).all() and np.isfinite(inputs.pose_rate).all())


def failed(options: SafetyOptions, health: tuple[float, float]) -> bool:
    """Whether a sensor or controller has failed; a frozen sensor has switches of its own."""
    return health[0] == failure_code("frozen") or (options.failures and health[0] != 0.0)


def unusable(options: SafetyOptions, inputs: SafetyInputs, limit: float) -> Trip | None:
    """What is wrong with this tick's messages, apart from what they say."""
    if options.finite and not measured(options, inputs):
        return Trip(MONITORS.index("measurement_not_finite"), HOLD)
    for name, health in (("sensor_failed", inputs.sensor), ("controller_failed", inputs.controller)):
        if failed(options, health):
            cause, leg = (float(x) if np.isfinite(x) else -1.0 for x in health)
            return Trip(MONITORS.index(name), HOLD, int(leg), int(cause))
    finite = np.isfinite(inputs.command)
    if options.finite and not finite.all():
        return Trip(MONITORS.index("command_not_finite"), HOLD, int(finite.argmin()))
    if options.deadline is not None and not inputs.age <= options.deadline:
        return Trip(MONITORS.index("deadline"), HOLD)
    if np.abs(inputs.command).max() > _ABSURD * limit:
        return Trip(MONITORS.index("torque_limit"), HOLD, int(np.abs(inputs.command).argmax()))
    return None


def further(options: SafetyOptions, inputs: SafetyInputs) -> Trip | None:
    """What the user's own monitors say of a finite measurement."""
    for index, monitor in enumerate(options.monitors):
        leg = monitor.look(inputs)
        if leg is not None:
            return Trip(len(MONITORS) + index, RAMP, leg)
    return None
