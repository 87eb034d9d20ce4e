"""Options of the safety layer, and a monitor of the user's own."""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.config import Fraction, Natural, NotNegative, Positive, PositivePair, Section
from stewart_drake.families import UserMade
from stewart_drake.registry import OWN_MONITORS
from stewart_drake.robot.robot_scale import LENGTH, TORQUE

MONITORS = (
    "none", "measurement_not_finite", "sensor_failed", "controller_failed", "command_not_finite", "deadline",
    "workspace", "serial_singularity", "parallel_singularity", "crank_speed", "following_error", "torque_limit",
    "torque_rate", "innovation", "reading_stuck",
)  # fmt: skip
"""Stable names of the monitors, by their number in the log: new ones come last."""
MEANINGS = {"reading_stuck": "a sensor repeats itself, or friction holds what it reads"}
"""What a name leaves open, for the message of a run that the monitor ends."""

HOLD_TIME = 0.03  # [s] for which the last good command is repeated at most.


class SafetyOptions(Section, key="safety"):
    """Limits and reactions of the safety layer; a limit that is null is off.

    The defaults are assumptions of this project: wide enough for every motion that keeps to `limits`, and inside of
    what the controllers themselves bear. Lengths and torques are for the paper's robot: another has them in proportion
    to its characteristic length and effort limit.
    """

    deadline: Annotated[Natural, Field(le=1000)] | None = 2
    """Ticks for which no newer command may have arrived; a constant `command_delay` does not count."""
    frozen_encoder: Positive | None = 0.04
    """[rad] by which two other cranks may turn, and 50 counts more, while an encoder repeats one reading to the last
    bit and is a quarter as far from where its crank is wanted: one that friction holds stands nearer."""
    frozen_pose: Annotated[PositivePair | None, LENGTH] = (0.01, 0.001)
    """[rad, m] by which an axis of the reference may move while the measured pose, of a sensor that is no encoder,
    stays the same to the last bit."""
    innovation: Positive | None = 100.0
    """[rad/s^2] acceleration of a crank that an observer's model does not explain, as its innovations tell beyond their
    noise, for more than 10 ms in sum: a rod that is lost, a motor that is dead, an encoder that lies."""
    torque_limit: Annotated[Positive, Field(le=1.0)] | None = 1.0
    """[-] of the motors' limit; commands are cut there, and may be there or beyond for 0.1 s in sum."""
    torque_rate: Annotated[Positive | None, TORQUE] = 4000.0
    """[N m/s] by which a motor's torque may change. In a tick whose command jumps further, for 10 ms in sum, the last
    good one stands; what comes next is led after at that rate."""
    workspace: Annotated[PositivePair | None, LENGTH] = (1.2, 0.12)
    """[rad, m] farthest from the home pose: angle of the rotation, and distance of P."""
    transmission: Fraction | None = 0.1
    """[-] smallest |e_l . e_N|: nearer to its dead centre a crank may not come (serial singularity)."""
    conditioning: Fraction | None = 0.04
    """[-] smallest sigma_min / sigma_max of the rods' lines, without crossing zero (parallel singularity)."""
    horizon: NotNegative = 0.01
    """[s] by which the pose is led ahead of the measurement, at its rate, for the three limits above."""
    crank_speed: Positive | None = 15.0
    """[rad/s] largest |theta'|."""
    following_error: Annotated[PositivePair | None, LENGTH] = (0.1, 0.02)
    """[rad, m] largest distance to the reference: angle of the rotation, and distance of P."""
    hold_ticks: Annotated[Natural, Field(le=20)] = 20
    """Ticks for which the last good command is repeated at most, up to 20 and to 30 ms."""
    ramp_time: Positive = 0.02
    """[s] from the last good command to the safe hold: short, for the command may have been wrong for a while."""
    safe_hold_time: Positive = 0.5
    """[s] after which a safe hold ends the run."""
    monitors: tuple[Annotated[Any, OWN_MONITORS], ...] = ()
    """Further monitors, each a class of the user's own by its import path, see `UserMonitor`."""

    @property
    def monitor_names(self) -> tuple[str, ...]:
        """By the number in the log, those of `monitors` last."""
        return (*MONITORS, *(getattr(each, "name", each.kind) for each in self.monitors))

    def budget(self, period: float) -> int:
        """Ticks of a period [s] that may be held."""
        return min(self.hold_ticks, math.floor(HOLD_TIME / period + 1e-6))

    def first_own(self, inputs: SafetyInputs) -> tuple[int, int] | None:
        """Number and leg of the first of `monitors` that trips; None for none."""
        for index, monitor in enumerate(self.monitors):
            leg = monitor.look(inputs)
            if leg is not None:
                return len(MONITORS) + index, leg
        return None


class SafetyInputs(NamedTuple):
    """What a monitor of the user's own gets."""

    command: np.ndarray  # (6,) [N m].
    pose: np.ndarray  # (6,) [rad, m] measured.
    pose_rate: np.ndarray  # (6,) [rad/s, m/s] measured.
    reference: np.ndarray  # (6,) [rad, m] pose that is wanted.
    age: float = 0.0  # [ticks] of the command.
    # What is wrong with the estimator, see `errors.FAILURES`, and its leg or -1.
    sensor: tuple[float, float] = (0.0, -1.0)
    controller: tuple[float, float] = (0.0, -1.0)  # What is wrong with the controller, likewise.


class UserMonitor(UserMade, key="safety.monitors"):
    """What a class of the user's own says with `look(inputs)`, once a tick.

    It gets `SafetyInputs` with a measurement that is finite, and returns the leg with which something is wrong, -1 for
    the robot as a whole, None for nothing. Where something is, and no other monitor trips, the robot is taken from its
    controller.
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
