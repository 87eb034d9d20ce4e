"""What can be known before a run, and is refused then."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.kinematics import (
    crank_rates,
    leg_geometry,
    line_conditioning,
    rod_lines,
    rotation_angle,
    rotation_matrix,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.memory import MONITORS, SafetyInputs
from stewart_drake.safety.monitors import look
from stewart_drake.safety.options import SafetyOptions

_SAMPLES = 4000


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
    speed = np.abs(crank_rates(robot, legs, pose, pose_rate))
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
    trip = look(robot, options, 0.0, SafetyInputs(np.zeros(6), pose, pose_rate, reference), 0.0).trip
    if trip is not None:
        name = MONITORS[trip.monitor]
        if np.array_equal(pose, reference):
            # The motion itself has been looked at: it is the look ahead that leads out of bounds.
            raise ConfigurationError("safety.horizon", options.horizon, f"one whose first tick does not trip {name}")
        raise ConfigurationError("initial_offset", (pose - reference).tolist(), f"a start that does not trip {name}")


def sample_times(duration: float, period: float) -> np.ndarray:
    """Times (n,) [s] at which a motion is looked at before the start: ticks, or some thousand evenly spread."""
    return np.linspace(0.0, duration, min(_SAMPLES, max(2, round(duration / period) + 1)))


def _refuse(name: str, given: Any, values: np.ndarray, largest: float, time: np.ndarray, what: str = "it") -> None:
    """Raises for the first sample (of any leg) above a bound."""
    values = values.reshape(len(time), -1)
    bad = ~(values <= largest)
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        where = f", leg {int(bad[row].argmax())}" if values.shape[1] == 6 else ""
        allowed = f"a limit that the reference keeps to; {what} is broken at t = {time[row]:.3f} s{where}"
        raise ConfigurationError(f"safety.{name}", given, allowed)
