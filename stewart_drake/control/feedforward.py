"""Feedforward without feedback: inverse dynamics of the reference, for motors with a position loop."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from stewart_drake.base.config import Period
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, TickResult, Vec1, Vec6, Vec9, Vec12, Vec18, record
from stewart_drake.control.base import AT_REFERENCE, ControllerOptions, ControllerState, controller_part
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque, static_torque
from stewart_drake.mechanics.kinematics_laws import OK, PARALLEL, UNREACHABLE, Legs, Robot, legs_at
from stewart_drake.robot.gravity import base_reading


class FeedforwardOptions(ControllerOptions):
    """Torque of the exact model at the reference. The feedback is left to the position loops of the motors.

    The reference is evaluated at the time when the command acts: after the delays, plus half a period for the hold.
    """

    feedback: ClassVar[bool] = False

    kind: Literal["feedforward"] = "feedforward"
    period: Period = 0.02
    feedforward: Literal["none", "gravity", "full"] = "full"
    """The torque. none: zero; motors that take angles then get the angles of the inverse kinematics. gravity: static
    torque at the reference. full: inverse dynamics of the motion."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        level = {"none": 0.0, "gravity": 1.0, "full": 2.0}[self.feedforward]
        params = FeedforwardParams.new(base=base_reading(context.gravity), level=level)
        return (controller_part(feedforward_tick, context.robot, params, ControllerState, Legs),)


def lead_part(period: float) -> Part:
    """`reference` (18,) -> `shifted_reference` (18,), later by the learnt delay, which adds to that of the model."""
    numbers = {"command_lead": np.zeros(1), "params": LeadParams.new(period=period)}
    return Part(
        "reference_lead", lead_tick, {}, {"reference": 18}, ("shifted_reference",), LeadState.new(), parameters=numbers
    )


class LeadParams(Record):
    """Parameters of `lead_tick`."""

    period: float  # [s]


class LeadState(Record):
    """State of `lead_tick`."""

    shifted_reference: Vec18  # Reference at the time when the command acts.
    acceleration: Vec6  # [rad/s^2, m/s^2] of the reference at the tick before.
    ticks: float  # Number of ticks so far.


@njit
def lead_tick(command_lead: Vec1, params: LeadParams, reference: Vec18, state: LeadState) -> None:
    """Extrapolates a reference (18,) by `command_lead` [s] with a Taylor series; the jerk is a difference quotient."""
    state, h = record(state), command_lead[0]
    for k in range(6):
        pose, rate, acceleration, jerk = reference[k], reference[6 + k], reference[12 + k], 0.0
        if state.ticks > 0.0:
            jerk = (acceleration - state.acceleration[k]) / record(params).period
        state.shifted_reference[k] = pose + h * (rate + h * (acceleration / 2.0 + h * jerk / 6.0))
        state.shifted_reference[6 + k] = rate + h * (acceleration + h * jerk / 2.0)
        state.shifted_reference[12 + k] = acceleration + h * jerk
        state.acceleration[k] = acceleration
    state.ticks += 1.0


class FeedforwardParams(Record):
    """Parameters of the feedforward."""

    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    level: float  # 0 for no torque, 1 for the static one, 2 for inverse dynamics.


@njit
def feedforward_tick(
    robot: Robot, params: FeedforwardParams, _: Vec12, reference: Vec18, legs: Legs, state: ControllerState
) -> TickResult:
    """Torque (6,) [N m] of a reference (18,), see `FeedforwardParams.level`.

    Returns status, leg or -1, and its reach margin.
    """
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    bad = legs_at(robot, reference[:6], legs)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, legs.reach_margin[bad]
    torque, done = np.zeros(6), True
    if params.level == 1.0:
        done = static_torque(robot, legs, params.base[:], torque)
    elif params.level == 2.0:
        done = motion_torque(robot, legs, reference[:12], reference[12:], params.base[:], torque)
    if not done:
        return AT_REFERENCE + PARALLEL, -1, 0.0
    for i in range(6):
        state.torque[i] = torque[i]
    return OK, -1, 0.0
