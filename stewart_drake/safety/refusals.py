"""What can be known before a run, and is refused then."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import inverse_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.kinematics_laws import LEGS, robot_record
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.monitors import LIMITS, OF_LEGS, SEEN, margins_along, setup_of
from stewart_drake.safety.safety_options import MONITORS, SafetyInputs, SafetyOptions


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
    _, start = _margins(robot, options, 0.0, pose[:1], rate[:1], pose[:1])
    # The poses themselves, and what the layer looks at: the poses led ahead.
    for horizon in (0.0, options.horizon):
        by, _ = _margins(robot, options, horizon, pose, rate, pose, start)
        for row, (monitor, key) in enumerate(LIMITS):
            margin = by[:, row] if OF_LEGS[row] else by[:, row, :1]
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
    by, _ = _margins(robot, options, options.horizon, pose[None], pose_rate[None], reference[None])
    trips = [MONITORS[monitor] for (monitor, _), margin in zip(LIMITS, by[0], strict=True) if not margin.min() >= 0.0]
    if trips:
        if np.array_equal(pose, reference):
            # The motion itself has been looked at: it is the look ahead that leads out of bounds.
            raise ConfigurationError(
                "safety.horizon", options.horizon, f"one whose first tick does not trip {trips[0]}"
            )
        away = (pose - reference).tolist()
        raise ConfigurationError("initial_offset", away, f"a start that does not trip {trips[0]}")
    if options.torque_limit is not None:
        needed = np.abs(static_torque(robot, pose, gravity)[None])
        allowed = f"enough to stand at the start, which needs up to {needed.max():.3g} N m; the limit is exceeded"
        margin = options.torque_limit * robot.effort_limits - needed
        _refuse("torque_limit", options.torque_limit, margin, np.zeros(1), allowed)


def _margins(
    robot: RobotParameters,
    options: SafetyOptions,
    horizon: float,
    pose: np.ndarray,
    rate: np.ndarray,
    reference: np.ndarray,
    side: float = 0.0,
) -> tuple[np.ndarray, float]:
    """Margins (n, 5, 6) of `LIMITS` along a motion led ahead by a horizon [s], and the side at its end."""
    # Of these limits none asks for gravity or period.
    by, setup = np.empty((len(pose), len(LIMITS), 6)), setup_of(robot, options, 0.0, 1.0)
    poses, rates, wanted = (np.ascontiguousarray(each, dtype=float) for each in (pose, rate, reference))
    return by, margins_along(
        robot_record(robot), setup, horizon, poses, rates, wanted, side, np.empty(1, LEGS), np.empty(1, SEEN), by
    )


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
