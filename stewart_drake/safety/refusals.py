"""What can be known before a run, and is refused then."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import inverse_dynamics, static_torque
from stewart_drake.mechanics.kinematics import (
    crank_rates,
    leg_geometry,
    line_conditioning,
    reach_margin,
    rod_lines,
    rotation_angle,
    rotation_matrix,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.memory import MONITORS, SafetyInputs
from stewart_drake.safety.monitors import further, look
from stewart_drake.safety.safety_options import SafetyOptions

_SAMPLES = 4000


def refuse_motion(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Refuses a motion that, followed without error, would trip a monitor.

    Args:
        robot: As believed.
        options: Limits.
        gravity: [m/s^2].
        time: (n,) [s].
        motion: Poses (n, 6) [rad, m], within reach, with their first and second derivatives (n, 6).

    Raises:
        ConfigurationError: Names the limit, its time and leg.
    """
    pose, rate, _ = motion
    for name, _, values, largest in [*_bounds(robot, options, pose), *_singularities(robot, options, pose)]:
        key, _, what = name.partition(" ")
        allowed = f"a limit that the reference keeps to; {what or 'it'} is broken"
        _refuse(key, getattr(options, key), values, largest, time, allowed)
    if options.crank_speed is not None:
        speed = np.abs(crank_rates(robot, leg_geometry(robot, pose), pose, rate))
        _refuse("crank_speed", options.crank_speed, speed, options.crank_speed, time)
    # What the layer looks at is the pose led ahead. Where that is out of reach, a crank is beyond its dead centre.
    ahead = pose + options.horizon * rate
    reached = (reach_margin(robot, ahead) >= 0.0).all(axis=1)
    looked = [(time, *found[1:]) for found in _bounds(robot, options, ahead)]
    if options.transmission is not None:
        looked.append((time, "serial_singularity", (~reached).astype(float), 0.0))
    if reached.any():
        looked += [(time[reached], *found[1:]) for found in _singularities(robot, options, ahead[reached])]
    for when, monitor, values, largest in looked:
        allowed = f"one that does not trip {monitor} along the reference, as it does"
        _refuse("horizon", options.horizon, values, largest, when, allowed)
    torque = inverse_dynamics(robot, *motion, gravity)
    _refuse_by_further(options, time, motion, torque)
    _refuse_effort(robot, options, time, torque)
    _refuse_torque_rate(options, time, torque)


def _refuse_by_further(
    options: SafetyOptions, time: np.ndarray, motion: tuple[np.ndarray, np.ndarray, np.ndarray], torque: np.ndarray
) -> None:
    """Refuses a monitor of the user's own that the motion itself trips."""
    for row in range(len(time) if options.monitors else 0):
        trip = further(options, SafetyInputs(torque[row], motion[0][row], motion[1][row], motion[0][row]))
        if trip is not None:
            index = trip.monitor - len(MONITORS)
            allowed = f"one that the reference does not trip, as it does at t = {time[row]:.3f} s"
            raise ConfigurationError(f"safety.monitors.{index}", options.monitor_names[trip.monitor], allowed)


def _refuse_effort(robot: RobotParameters, options: SafetyOptions, time: np.ndarray, torque: np.ndarray) -> None:
    """Refuses a limit below which the torques (n, 6) [N m] of the motion do not stay long enough."""
    if options.torque_limit is None:
        return
    needed, limit = np.abs(torque), options.torque_limit * robot.effort_limit
    step = np.diff(time, prepend=time[0] - (time[1] - time[0] if len(time) > 1 else 0.0))
    too_long = _too_long(needed > limit, step, options.torque_limit_time)
    allowed = f"enough for the motion, which needs up to {needed.max():.3g} N m; it is broken for too long"
    _refuse("torque_limit", options.torque_limit, np.where(too_long, needed, 0.0), limit, time, allowed)


def _refuse_torque_rate(options: SafetyOptions, time: np.ndarray, torque: np.ndarray) -> None:
    """Refuses a limit that the motion's own torques (n, 6) [N m] break for too long."""
    if options.torque_rate is None or len(time) < 2:
        return
    step = np.diff(time)
    change = np.abs(np.diff(torque, axis=0)) / step[:, None]
    too_long = np.where(_too_long(change > options.torque_rate, step, options.torque_rate_time), change, 0.0)
    allowed = f"enough for the motion, which needs up to {change.max():.3g} N m/s; it is broken for too long"
    _refuse("torque_rate", options.torque_rate, too_long, options.torque_rate, time[1:], allowed)


def _too_long(beyond: np.ndarray, step: np.ndarray, allowed: float) -> np.ndarray:
    """Where motors (n, 6) are beyond a limit for longer than is allowed, counted as the layer does it; (n, 6).

    Samples with a motor beyond add to a sum, others take away from it, down to zero.
    """
    any_beyond = beyond.any(axis=1)
    total = np.cumsum(np.where(any_beyond, step, -step))
    total -= np.minimum(np.minimum.accumulate(total), 0.0)
    return beyond & (total > allowed + 1e-9)[:, None]


_Found = list[tuple[str, str, np.ndarray, float]]
"""Key of each limit (and what of it), its monitor, values (n,) or (n, 6), and the largest allowed."""


def _bounds(robot: RobotParameters, options: SafetyOptions, pose: np.ndarray) -> _Found:
    """The workspace at poses (n, 6)."""
    if options.workspace is None:
        return []
    turn = np.asarray(rotation_angle(rotation_matrix(pose[:, :3])))
    away = np.linalg.norm(pose[:, 3:] - robot.home_pose[3:], axis=1)
    return [
        ("workspace the angle", "workspace", turn, options.workspace[0]),
        ("workspace the distance", "workspace", away, options.workspace[1]),
    ]


def _singularities(robot: RobotParameters, options: SafetyOptions, pose: np.ndarray) -> _Found:
    """The limits near singularities at poses (n, 6) within reach."""
    legs = leg_geometry(robot, pose)
    found: _Found = []
    if options.transmission is not None:
        found.append(("transmission", "serial_singularity", -np.abs(legs.transmission), -options.transmission))
    if options.conditioning is not None:
        lines = rod_lines(legs)
        crossed = np.sign(np.linalg.det(lines)) * np.sign(np.linalg.det(lines[:1]))
        values = -line_conditioning(robot, legs) * crossed
        found.append(("conditioning", "parallel_singularity", values, -options.conditioning))
    return found


def refuse_start(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    reference: np.ndarray,
) -> None:
    """Refuses a start at which a monitor would trip in the very first tick, or where the motors cannot hold the robot.

    Args:
        robot: As believed.
        options: Limits.
        gravity: [m/s^2].
        pose: (6,) [rad, m] at the start.
        pose_rate: (6,) [rad/s, m/s].
        reference: (6,) [rad, m].

    Raises:
        ConfigurationError: Names the monitor.
    """
    inputs = SafetyInputs(np.zeros(6), pose, pose_rate, reference)
    trip = look(robot, options, 0.0, inputs, 0.0).trip
    if trip is not None:
        name = options.monitor_names[trip.monitor]
        if np.array_equal(pose, reference):
            # The motion itself has been looked at: it is the look ahead that leads out of bounds.
            raise ConfigurationError("safety.horizon", options.horizon, f"one whose first tick does not trip {name}")
        raise ConfigurationError("initial_offset", (pose - reference).tolist(), f"a start that does not trip {name}")
    if options.torque_limit is not None:
        needed, limit = np.abs(static_torque(robot, pose, gravity)[None]), options.torque_limit * robot.effort_limit
        allowed = f"enough to stand at the start, which needs up to {needed.max():.3g} N m; it is broken"
        _refuse("torque_limit", options.torque_limit, needed, limit, np.zeros(1), allowed)


def sample_times(duration: float, period: float) -> np.ndarray:
    """Times (n,) [s] at which a motion is looked at before the start: ticks, or some thousand evenly spread."""
    return np.linspace(0.0, duration, min(_SAMPLES, max(2, round(duration / period) + 1)))


def _refuse(
    name: str,
    given: Any,
    values: np.ndarray,
    largest: float,
    time: np.ndarray,
    allowed: str = "a limit that the reference keeps to; it is broken",
) -> None:
    """Raises for the first sample (of any leg) above a bound."""
    values = values.reshape(len(time), -1)
    bad = ~(values <= largest)
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        where = f", leg {int(bad[row].argmax())}" if values.shape[1] == 6 else ""
        raise ConfigurationError(f"safety.{name}", given, f"{allowed} at t = {time[row]:.3f} s{where}")
