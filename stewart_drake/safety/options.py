"""Options of the safety layer, its monitors, and monitors of the user."""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Fraction, Natural, NotNegative, Positive, PositivePair, Section
from stewart_drake.base.families import UserMade
from stewart_drake.base.registry import OWN_MONITORS
from stewart_drake.mechanics.singularities import MONITORED
from stewart_drake.robot.robot_scale import LENGTH, TORQUE
from stewart_drake.safety.stillness import FROZEN_AFTER, TRAVEL_SHARE

MONITORS = (
    *("none", "measurement_not_finite", "sensor_failed", "controller_failed", "command_not_finite", "deadline"),
    *("workspace", "serial_singularity", "parallel_singularity", "crank_speed", "following_error", "torque_limit"),
    *("torque_rate", "innovation", "reading_stuck", "unexplained_torque", "not_moving", "parity", "angle_rate"),
)
"""Stable names of the monitors, by their number in the log: new ones come last. `innovation` is in old logs alone."""
NO_TRIP, MEASUREMENT, SENSOR, CONTROLLER, COMMAND, DEADLINE, WORKSPACE, SERIAL, PARALLEL, CRANK_SPEED = range(10)
FOLLOWING, TORQUE_LIMIT, TORQUE_RATE, INNOVATION, READING, UNEXPLAINED, NOT_MOVING, PARITY = range(10, 18)
ANGLE_RATE = 18
"""Numbers of the monitors."""
MEANINGS = {
    "reading_stuck": "a sensor repeats itself, or no crank moves at all",
    "not_moving": "a crank stands, or its reading does, while its reference moves",
    "parity": "an encoder is wrong",
    "unexplained_torque": "a reading or a motor is wrong, or load and friction exceed safety.unexplained_torque",
    "angle_rate": "commanded angles jump: a crank would have to turn faster than safety.crank_speed",
}
"""More about a monitor, for the message of a run that it ends."""
INERTIAL_WRONG = "the inertial sensor on the platform is wrong or gives no new readings, or several encoders are wrong"
"""The same for `parity` without a leg."""

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
    """[-] share of the motors' limit by which torques may differ from inverse dynamics of the readings, because of
    payload, pushes and friction that is not compensated. A fifth of it applies where the difference is that of one
    leg alone, two fifths where it is that of two; an impact of 5 ms passes. It detects wrong readings and motors.
    Friction of `model` is added, and with `adaptation` its uncertainty; with motors that take angles or currents also a
    fifth of their torque, and with angles what play, dead band and half a tick of delay may make of it."""
    frozen: Positive | None = FROZEN_AFTER
    """[rad] travel of a crank's reference after which readings are frozen that have all repeated to the last bit."""
    standstill: Fraction | None = TRAVEL_SHARE
    """[-] share of its reference's travel in the last second by which a crank must have moved. Travel within 0.03 rad
    does not count, because of play and friction; a reference that moves by less is not compared."""
    parity: Positive | None = math.radians(1.0)
    """[rad] largest difference of the platform's orientation by the encoders and by an inertial sensor on it, where the
    model has one. A wrong encoder is named by the direction of the difference. A sensor that gives no new readings for
    0.2 s, or five of its periods, stops the robot too: without it the next wrong encoder would go unnoticed."""
    on_lost_encoder: Literal["stop", "hold", "home"] | None = None
    """Reaction to one encoder that is wrong. stop: as to any other fault. hold: the robot comes to rest, and is held on
    five encoders and the inertial sensor on the platform; home: it is led home slowly as well. At rest it is held for
    `safe_hold_time`; a second fault stops it. Null for hold with such a sensor, at most 4 ticks old, and torques; else
    for stop."""
    torque_limit: Annotated[Positive, Field(le=1.0)] | None = 1.0
    """[-] largest command as a fraction of the motors' limit; commands are cut there. They may be there or beyond for
    0.1 s in sum. An angle [rad] counts as the torque that it asks of the servo, and is not cut."""
    torque_rate: Annotated[Positive | None, TORQUE] = 4000.0
    """[N m/s] largest rate of a motor's torque. A command that jumps further is replaced by the last good one, for up
    to 10 ms in sum, or a tick; the next good command is approached at this rate. Commanded angles [rad] have the limit
    `crank_speed` instead, besides the angle for a torque at this rate where the controller has feedback."""
    workspace: Annotated[PositivePair | None, LENGTH] = (1.2, 0.12)
    """[rad, m] largest distance from the home pose: angle of the rotation, and distance of P."""
    transmission: Fraction | None = MONITORED.transmission
    """[-] smallest distance |e_l . e_N| of a crank from its dead centre (serial singularity), at which it is 0."""
    conditioning: Fraction | None = MONITORED.conditioning
    """[-] smallest distance from a parallel singularity: sigma_min / sigma_max of the rods' lines, without crossing
    zero."""
    horizon: NotNegative = 0.01
    """[s] prediction horizon of `workspace`, `transmission` and `conditioning`: the pose is extrapolated at its
    measured rate."""
    crank_speed: Positive | None = 15.0
    """[rad/s] largest measured crank speed |theta'|, and largest rate of a commanded angle (monitor `angle_rate`); for
    that also the servo's speed without load."""
    following_error: Annotated[PositivePair | None, LENGTH] = (0.1, 0.02)
    """[rad, m] largest following error, to the reference: angle of the rotation, and distance of P."""
    hold_ticks: Annotated[Natural, Field(le=20)] = 20
    """[ticks] longest repetition of the last good command, up to 20 ticks and 30 ms."""
    ramp_time: Positive = 0.02
    """[s] time from the last good command to the safe hold; short, because that command may have been wrong."""
    safe_hold_time: Positive = 0.5
    """[s] duration of a safe hold, after which the run ends; a stop with a suspect leg ends after 40 ms, unless
    `on_lost_encoder` goes on."""
    monitors: tuple[Annotated[Any, OWN_MONITORS], ...] = ()
    """Your monitors, classes by their import paths, see `UserMonitor`."""

    @property
    def monitor_names(self) -> tuple[str, ...]:
        """By their numbers in the log, those of `monitors` last."""
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
    """Input of a monitor of the user."""

    command: np.ndarray  # (6,) [N m], or in the motors' unit.
    pose: np.ndarray  # (6,) [rad, m] measured.
    pose_rate: np.ndarray  # (6,) [rad/s, m/s] measured.
    reference: np.ndarray  # (6,) [rad, m] its pose.
    age: float = 0.0  # [ticks] of the command.
    # What is wrong with the estimator, see `errors.FAILURES`, and its leg or -1.
    sensor: tuple[float, float] = (0.0, -1.0)
    controller: tuple[float, float] = (0.0, -1.0)  # What is wrong with the controller, likewise.


class UserMonitor(UserMade, key="safety.monitors"):
    """A safety monitor of yours: `look(inputs)` is called once a tick.

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
