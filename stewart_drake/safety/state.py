"""State of the safety layer, its levels, and what it reads in loops without some of its signals."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.records import Record, Vec1, Vec6
from stewart_drake.loop.part import HEALTHY
from stewart_drake.safety.actuators import ActuatorState
from stewart_drake.safety.residual import ResidualState
from stewart_drake.safety.stillness import StillState

LEVELS = ("none", "hold", "ramp", "safe_hold", "end")
NONE, HOLD, RAMP, SAFE_HOLD, END = range(5)


class SafetyStatus(Record):
    """State of the layer as it is logged."""

    level: float  # Number in `LEVELS`.
    monitor: float  # Number in `MONITORS`.
    leg: float  # -1 for none.


class Trip(Record):
    """The first trip of a run, zeros before."""

    monitor: float
    level: float
    leg: float  # -1 for none.
    tick: float
    cause: float  # Number in `FAILURES`, from 1; 0 for none.


class SafetyState(Record):
    """State of the safety layer, commands in the motors' unit. Counts of bad ticks are less those of good ones."""

    torque: Vec6  # Command for the motors.
    safety: SafetyStatus
    good: Vec6  # Last command that no limit touched.
    rest: Vec6  # [rad] angles that then would have brought servos to rest.
    weight: Vec6  # [N m] last torque that carried the robot's weight.
    hold_used: float  # Ticks of holding, less those given back; while stopping, ticks without a measurement.
    at_limit: float  # Ticks at the torque limit.
    too_fast: float  # Ticks of commands that jumped.
    unexplained_ticks: float  # Ticks of residuals that were too large.
    motor_ticks: float  # Those of them that a faulty motor explains.
    runaway_ticks: float  # Ticks of a stop in which a crank turned too fast.
    stop_ticks: float  # Ticks of ramp and safe hold so far.
    assembly_sign: float  # Sign of the rods' determinant at the start, 0 before the first tick.
    ticks: float  # Number of ticks so far.
    first: Trip
    worst: float  # Highest level so far.
    command: Vec6  # Of the last tick in which it was finite.
    actuators: ActuatorState
    residual: ResidualState
    still: StillState
    lost: Vec1  # Leg whose encoder is lost, while the robot goes on; else -1.
    lost_by: float  # Monitor that named it.
    rest_ticks: float  # Ticks at rest since then.


NOT_THERE = {
    "age": np.zeros(1),
    "sensor_health": np.array(HEALTHY),
    "controller_health": np.array(HEALTHY),
    "angles": np.full(6, np.nan),
    "pose_reading": np.full(12, np.nan),
    "parity": np.array([0.0, -1.0]),
}
"""Inputs in loops that have no signal for a port."""
