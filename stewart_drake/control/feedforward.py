"""Feedforward alone: the torque that the reference takes, for motors with a loop of their own. It needs no reading."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from stewart_drake.base.config import Period
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.control.base import AT_REFERENCE, ControllerOptions, controller_part
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque, static_torque
from stewart_drake.mechanics.kinematics_laws import OK, PARALLEL, UNREACHABLE, Legs, legs_at


class FeedforwardOptions(ControllerOptions):
    """What the exact model asks for at the reference, and no feedback: that is left to motors which take angles.

    The reference is that of the time at which the command acts: the delay of commands and motors, and half a period.
    """

    feedback: ClassVar[bool] = False

    kind: Literal["feedforward"] = "feedforward"
    period: Period = 0.02
    feedforward: Literal["none", "gravity", "full"] = "full"
    """The torque. none: none, so that motors which take angles get those of the inverse kinematics. gravity: what holds
    the robot there. full: inverse dynamics of the motion."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        level = {"none": 0.0, "gravity": 1.0, "full": 2.0}[self.feedforward]
        params = new_record(_PARAMS, gravity=context.gravity, level=level)
        return (controller_part(feedforward_tick, context.robot, params, fields(torque=6, health=2), Legs),)


def lead_part(period: float) -> Part:
    """`reference` (18,) -> `aimed` (18,), a little later, by what a delay turns out to be more than it was believed."""
    numbers = {"lead": np.zeros(1), "params": new_record(fields(period=()), period=period)}
    return Part("lead", lead_tick, {}, {"reference": 18}, ("aimed",), new_record(_LEAD), parameters=numbers)


_LEAD = fields(aimed=18, acceleration=6, ticks=())
"""aimed: reference. acceleration: that of the tick before [rad/s^2, m/s^2]. ticks: done."""


@njit
def lead_tick(lead: Any, params: Any, reference: Any, state: Any) -> None:
    """A reference (18,) later by `lead` (1,) [s]: its Taylor series, the jerk by the difference of two ticks."""
    state, h = record(state), lead[0]
    for k in range(6):
        pose, rate, acceleration, jerk = reference[k], reference[6 + k], reference[12 + k], 0.0
        if state.ticks > 0.0:
            jerk = (acceleration - state.acceleration[k]) / record(params).period
        state.aimed[k] = pose + h * (rate + h * (acceleration / 2.0 + h * jerk / 6.0))
        state.aimed[6 + k] = rate + h * (acceleration + h * jerk / 2.0)
        state.aimed[12 + k] = acceleration + h * jerk
        state.acceleration[k] = acceleration
    state.ticks += 1.0


_PARAMS = fields(gravity=(), level=())  # [m/s^2]; 0 for no torque, 1 for that at rest, 2 for that of the motion.


@njit
def feedforward_tick(robot: Any, params: Any, _: Any, reference: Any, legs: Any, state: Any) -> Any:
    """Torque (6,) [N m] of a reference (18,): inverse dynamics, or at rest; status, leg, margin as of `pid_tick`."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    bad = legs_at(robot, reference[:6], legs)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, legs.reach_margin[bad]
    torque, done = np.zeros(6), True
    if params.level == 1.0:
        done = static_torque(robot, legs, params.gravity, torque)
    elif params.level == 2.0:
        done = motion_torque(robot, legs, reference[:12], reference[12:], params.gravity, torque)
    if not done:
        return AT_REFERENCE + PARALLEL, -1, 0.0
    for i in range(6):
        state.torque[i] = torque[i]
    return OK, -1, 0.0
