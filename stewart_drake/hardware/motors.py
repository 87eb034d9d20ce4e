"""What a motor and its amplifier make of the torque asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.faults import MotorFault, Signal
from stewart_drake.jit import fields, new_record
from stewart_drake.part import Part
from stewart_drake.robot.leg import LEGS, SMALLEST
from stewart_drake.section import LegNumber, Natural, NotNegative, Section


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
        """What the motors give.

        Args:
            wanted: (6,) [N m] asked for.
            crank_angles: (6,) [rad].
            time: [s].

        Returns:
            (6,) [N m], before the plant's effort limit.
        """
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
    weight = abs(weight_torque[dead]) < 1e-9 * limit and bool((np.abs(weight_torque) <= limit).all())
    forces = _corners(weight_torque, per_wrench[:, 3:], limit, dead)
    nearest = _nearest(weight_torque, per_wrench[:, 3:], limit, dead, forces)
    if not weight:
        return HoldableLoad(False, nearest, None, None)
    moments = _corners(weight_torque, per_wrench[:, :3], limit, dead)
    return HoldableLoad(True, 0.0, *(float(np.linalg.norm(c, axis=1).max()) for c in (forces, moments)))


def _corners(weight: np.ndarray, per_load: np.ndarray, limit: float, dead: int) -> np.ndarray:
    """Corners (n, 3) of the polygon of loads that the motors hold; a norm is largest at one of them."""
    alive = [leg for leg in range(LEGS) if leg != dead]
    found = []
    for index, one in enumerate(alive):
        for other in alive[index + 1 :]:
            rows = per_load[[dead, one, other]]
            for bounds in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                wanted = np.array([0.0, limit * bounds[0], limit * bounds[1]]) - weight[[dead, one, other]]
                load = np.linalg.lstsq(rows, wanted, rcond=None)[0]
                torque = weight + per_load @ load
                if abs(torque[dead]) < 1e-9 * limit and (np.abs(torque) <= limit * (1.0 + 1e-9)).all():
                    found.append(load)
    return np.array(found).reshape(-1, 3)


def _nearest(weight: np.ndarray, per_load: np.ndarray, limit: float, dead: int, corners: np.ndarray) -> float:
    """[N] size of the smallest load in the polygon."""
    normal = per_load[dead]
    load = -weight[dead] * normal / (normal @ normal)
    if (np.abs(weight + per_load @ load) <= limit * (1.0 + 1e-9)).all():
        return float(np.linalg.norm(load))
    return float(np.linalg.norm(corners, axis=1).min()) if len(corners) else float("inf")
