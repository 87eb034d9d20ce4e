"""Motors: what they make of the torque asked for, what is added against their friction, what five of six hold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
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


# --- what five motors hold -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HoldableLoad:
    """What five motors hold at rest beside the robot's own weight, see `holdable_load`.

    Attributes:
        weight: Whether they hold the weight alone.
        support: [N] smallest force at P, in its best direction, with which they do; 0 where the weight needs none and
            infinite where no force helps.
        force: [N] largest force at P that they hold; None where the weight alone is too much.
        moment: [N m] largest moment that they hold; None where the weight alone is too much.
    """

    weight: bool
    support: float
    force: float | None
    moment: float | None


def holdable_load(weight_torque: np.ndarray, jacobian: np.ndarray, limit: float, dead: int) -> HoldableLoad:
    """Statics over the five motors that are left.

    At rest T = G - J^-T w for an external wrench w on the platform, and T must vanish at the dead motor: six equations
    for five torques. Any load must lie in the one plane where they agree, and gravity seldom does.

    Args:
        weight_torque: (6,) [N m] that hold the robot itself, `dynamics.static_torque`.
        jacobian: (6, 6) d(theta)/d(twist), `kinematics.twist_jacobian`.
        limit: [N m] of each motor.
        dead: The leg without torque.
    """
    per_wrench = -np.linalg.inv(jacobian.T)
    forces = _corners(weight_torque, per_wrench[:, 3:], limit, dead)
    if abs(weight_torque[dead]) < 1e-9 * limit and bool((np.abs(weight_torque) <= limit).all()):
        moments = _corners(weight_torque, per_wrench[:, :3], limit, dead)
        return HoldableLoad(True, 0.0, *(float(np.linalg.norm(c, axis=1).max()) for c in (forces, moments)))
    # The smallest force in the polygon: the nearest in its plane, or else one of its corners.
    normal = per_wrench[dead, 3:]
    load = -weight_torque[dead] * normal / (normal @ normal)
    if not (np.abs(weight_torque + per_wrench[:, 3:] @ load) <= limit * (1.0 + 1e-9)).all():
        return HoldableLoad(False, float(np.linalg.norm(forces, axis=1).min(initial=np.inf)), None, None)
    return HoldableLoad(False, float(np.linalg.norm(load)), None, None)


def _corners(weight: np.ndarray, per_load: np.ndarray, limit: float, dead: int) -> np.ndarray:
    """Corners (n, 3) of the polygon of loads that the motors hold; a norm is largest at one of them."""
    found = []
    for one, other in combinations([leg for leg in range(6) if leg != dead], 2):
        legs = [dead, one, other]
        for bounds in product((1, -1), repeat=2):
            wanted = np.array([0.0, limit * bounds[0], limit * bounds[1]]) - weight[legs]
            load = np.linalg.lstsq(per_load[legs], wanted, rcond=None)[0]
            torque = weight + per_load @ load
            if abs(torque[dead]) < 1e-9 * limit and (np.abs(torque) <= limit * (1.0 + 1e-9)).all():
                found.append(load)
    return np.array(found).reshape(-1, 3)
