"""Motors: what they make of the torque asked for, what is added against their friction."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from stewart_drake.config import LegNumber, Natural, NotNegative, Positive, Section
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.faults import MotorFault, Signal
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.friction import dry_level
from stewart_drake.mechanics.kinematics_laws import LEGS, crank_rates, legs_at, robot_record, twist_of
from stewart_drake.part import Part
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import SMALLEST, FrictionOptions


class DeadMotor(Section, key="motors.dead"):
    """A motor without torque from some time on; its crank turns freely."""

    leg: LegNumber
    """0 to 5."""
    time: NotNegative = 0.0
    """[s] when it dies."""


class MotorOptions(Section, key="motors"):
    """Imperfections of the motors; by default there are none."""

    ripple: NotNegative = 0.0
    """[N m] amplitude of the torque ripple (cogging), added as a sine of the crank's angle."""
    ripple_periods: Annotated[Natural, Field(ge=1, le=10_000)] = 12
    """Periods of the ripple in a turn."""
    resolution: NotNegative = 0.0
    """[N m] step of the amplifier; the torque is rounded to whole steps. 0 for none."""
    dead: DeadMotor | None = None
    """A motor that fails; null for none."""
    faults: tuple[MotorFault, ...] = ()
    """Motors wired wrong, in order, between amplifier and motor."""

    def rules(self) -> None:
        """See `Section.rules`."""
        # In steps yet smaller every torque is infinitely many.
        if 0.0 < self.resolution < SMALLEST:
            raise ConfigurationError("resolution", self.resolution, f"0, or at least {SMALLEST:g} N m")

    @cached_property
    def perfect(self) -> bool:
        """Whether the torque asked for is the torque."""
        return self.ripple == 0.0 and self.resolution == 0.0 and self.dead is None and not self.faults

    def torque(self, wanted: np.ndarray, crank_angles: np.ndarray, time: float) -> np.ndarray:
        """What the motors give (6,) [N m] for torques (6,) that are wanted, before the plant's effort limit."""
        torque = np.array(wanted, dtype=float)
        if self.resolution > 0.0:
            torque = np.rint(torque / self.resolution) * self.resolution
        for fault in self.faults:
            fault.spoil(Signal(torque, time))
        if self.ripple > 0.0:
            torque += self.ripple * np.sin(self.ripple_periods * crank_angles)
        if self.dead is not None and time >= self.dead.time:
            torque[self.dead.leg] = 0.0
        return torque


def motor_part(options: MotorOptions) -> Part:
    """`torque` (6,) [N m], `time` (1,) [s], `crank_state` (12,), angles [rad] and rates -> `torque` that they give."""

    def tick(torque: np.ndarray, time: np.ndarray, crank_state: np.ndarray, state: np.ndarray) -> None:
        state["torque"][0] = options.torque(torque, crank_state[:6], float(time[0]))

    inputs = {"torque": 6, "time": 1, "crank_state": 12}
    return Part("motors", inputs, ("torque",), new_record(fields(torque=6)), tick, every_step=True)


# --- against friction -------------------------------------------------------------------------------------------------


class FrictionCompensation(FrictionOptions, key="friction_compensation"):
    """Friction of the motors as the controller believes it; its torque along the reference is added to the command.

    Along the reference and not along the measurement: noise cannot make it chatter, nor can it push a robot that is to
    stand still.
    """

    width: Positive = 0.002
    """[rad/s] a crank that is to turn at this rate gets 76 % of its dry friction: reversals are that smooth."""


_BELIEVED = fields(coulomb=6, break_away=6, stribeck_rate=6, viscous=6, width=())
"""[N m], [N m], [rad/s], [N m s/rad], [rad/s]."""
_FRICTION_STATE = fields(against_friction=6)


@njit
def against_friction(robots: Any, believed: Any, reference: Any, leg_records: Any, states: Any) -> None:
    """Torques g(rate) tanh(rate / width) + viscous rate of cranks that follow a reference.

    Zeros where the reference is out of reach, or a crank at its dead centre.

    Args:
        robots: `ROBOT` record.
        believed: `_BELIEVED` record.
        reference: (18,) pose [rad, m], its rate and its acceleration.
        leg_records: `LEGS`, overwritten.
        states: `_FRICTION_STATE` record, out.
    """
    robot, friction, legs, out = record(robots), record(believed), record(leg_records), record(states).against_friction
    twist, rates = np.empty(6), np.empty(6)
    out[:] = 0.0
    if legs_at(robot, reference[:6], legs) >= 0:
        return
    twist_of(reference[:6], reference[6:12], twist)
    crank_rates(legs, twist, rates)
    for i in range(6):
        if not np.isfinite(rates[i]):
            return
    for i in range(6):
        dry = dry_level(friction.coulomb[i], friction.break_away[i], friction.stribeck_rate[i], rates[i])
        out[i] = dry * np.tanh(rates[i] / friction.width) + friction.viscous[i] * rates[i]


def friction_part(robot: RobotParameters, options: FrictionCompensation) -> Part:
    """`reference` (18,) -> `against_friction` (6,) [N m], for a robot as believed."""
    own, legs = robot_record(robot), np.empty(1, LEGS)
    levels = dict(zip(("coulomb", "break_away", "stribeck_rate", "viscous"), options.levels, strict=True))
    believed = new_record(_BELIEVED, **levels, width=options.width)

    def tick(reference: np.ndarray, state: np.ndarray) -> None:
        against_friction(own, believed, reference, legs, state)

    return Part("friction_compensation", {"reference": 18}, ("against_friction",), new_record(_FRICTION_STATE), tick)
