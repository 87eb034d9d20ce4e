"""How a command becomes a torque, by the controller's model of the motors, and how well that is known.

Torques and currents give a torque in proportion. A servo follows an angle by itself: its torque is in proportion to the
difference of that angle and its crank's, less its damping, see `PositionServos`.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec6
from stewart_drake.loop.part import LoopContext
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.options import SafetyOptions

ROWS = 22  # Commands that are kept.
MOST_LATE = ROWS - 2.0  # [ticks] at which a command is kept as long as it counts.
DRIVE_ERROR = 0.2
"""Share of a torque by which stiffness, damping or torque constants of the model may be wrong; assumed."""
LATE_ERROR = 0.5  # [ticks] by which a servo's command may act sooner or later than the model has it.


class ActuatorParams(Record):
    """Motors in the controller's model."""

    holds: float  # 1 where a command is an angle [rad], 0 where it is in proportion to a torque.
    follows: float  # 1 for a controller without feedback, whose commands are as steady as its reference.
    limit: Vec6  # [N m] largest torque.
    damping: float  # [N m s/rad] of a servo.
    error: float  # [-] share of a torque by which it may be wrong.
    slack: float  # [rad] difference of the angles that may give no torque.
    late: float  # [ticks] from a command that is an angle to its torque, as it shows in readings.
    steepest: float  # [rad] largest change of a commanded angle in a tick, besides that for a torque.


class ActuatorState(Record):
    """Commands, angles and torques of the last ticks."""

    torque: Vec6  # [N m] mean of the last tick.
    doubt: Vec6  # [N m] by which it may be wrong.
    cranks: Vec6  # [rad] read in the last tick.
    turn: Vec6  # [rad] by which they turned in it.
    sent: Annotated[np.ndarray, (ROWS, 6)]  # Commands, newest first; used where they are angles.


def actuator_params(robot: RobotParameters, options: SafetyOptions, context: LoopContext | None) -> ActuatorParams:
    """The motors of a loop; those that take torques exactly for None."""
    if context is None:
        return ActuatorParams.new(limit=robot.effort_limits)
    motors, speed = context.motors, options.crank_speed
    fastest = min(math.inf if speed is None else speed, getattr(motors, "no_load_speed", None) or math.inf)
    return ActuatorParams.new(
        holds=float(motors.holds),
        follows=float(motors.holds and not context.feedback),
        limit=np.minimum(robot.effort_limits, getattr(motors, "supply", 1.0) * motors.limits(robot)),
        damping=getattr(motors, "damping", 0.0) if motors.holds else 0.0,
        error=0.0 if motors.by_torque else DRIVE_ERROR,
        slack=motors.slack,
        late=(motors.dead_time + context.reading_age) / context.period,
        steepest=fastest * context.period if motors.holds else 0.0,
    )


@njit
def _turn(angle: float) -> float:
    """An angle [rad] less its whole turns, as servos take it."""
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))


@njit
def torques_asked(gain: Vec6, params: ActuatorParams, command: Vec6, state: ActuatorState, out: Vec6) -> None:
    """Torques (6,) [N m] that a command asks for, beyond any limit; 0 where a crank is not read.

    A commanded angle counts from where its crank will be in the middle of the tick in which it acts; it may be off by a
    whole turn, but not by many.
    """
    for i in range(6):
        out[i] = gain[i] * command[i]
        if params.holds > 0.0:
            angle = state.cranks[i] + (params.late + 0.5) * state.turn[i]
            error = command[i] - angle
            out[i] = gain[i] * (_turn(error) if abs(error) < 3.0 * np.pi else error) if np.isfinite(angle) else 0.0


@njit
def update_torques(
    gain: Vec6, params: ActuatorParams, period: float, command: Vec6, cranks: Vec6, state: ActuatorState
) -> None:
    """Mean torque (6,) [N m] of the last tick and its uncertainty, for the command sent in it and the cranks now.

    Where a crank is not read they stay what they were.
    """
    if params.holds == 0.0:
        for i in range(6):
            state.torque[i] = gain[i] * command[i]
            state.doubt[i] = params.error * abs(state.torque[i])
        return
    for row in range(ROWS - 1, 0, -1):
        copy_to(state.sent[row], state.sent[row - 1])
    copy_to(state.sent[0], command)
    late = min(params.late, MOST_LATE)
    newest = int(late)
    older = late - newest
    for i in range(6):
        turn = _turn(cranks[i] - state.cranks[i])
        state.turn[i] = 0.0
        if np.isfinite(turn):
            state.turn[i] = turn
            change = state.sent[newest, i] - state.sent[newest + 1, i]
            error = _turn(state.sent[newest, i] - older * change - cranks[i] + 0.5 * turn)
            drive = min(max(gain[i] * error, -params.limit[i]), params.limit[i])
            loss = params.damping * turn / period
            state.torque[i] = drive - loss
            state.doubt[i] = params.error * (abs(drive) + abs(loss))
            state.doubt[i] += gain[i] * (params.slack + LATE_ERROR * abs(change))
            if params.late > MOST_LATE:
                # A command that is not known explains any torque.
                state.doubt[i] = np.inf
        state.cranks[i] = cranks[i]
