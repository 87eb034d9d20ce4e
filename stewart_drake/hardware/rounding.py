"""Rounding of angle commands to whole counts, so that a servo's resolution disturbs a slow motion less.

Rounding the commands one by one gives random errors of up to half a count. Two methods make them smaller. Noise shaping
by linear prediction adds the last two rounding errors to the next command, so that they cancel in the servo's velocity.
And of the whole counts near the six commands those are chosen that move the platform least, because the errors of six
cranks can cancel there.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat6, Record, Vec2, Vec6, Vec18, record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics import crank_inertia
from stewart_drake.mechanics.kinematics_laws import (
    Legs,
    Robot,
    crank_jacobian,
    crank_rates,
    legs_at,
    robot_record,
    twist_of,
)
from stewart_drake.mechanics.linear_algebra import largest_size, solve

RESTING = 1e-4
"""[rad/s] speed of all cranks below which commands are rounded one by one, so that a robot at rest does not hunt."""


class RoundingParams(Record):
    """Parameters of the rounding."""

    count: float  # [rad]
    shares: Vec2  # Shares of the last two errors that are added to the next command.
    length: float  # [m] for a rotation of the platform by 1 rad, as an error.


class RoundingState(Record):
    """State of the rounding."""

    command: Vec6  # [rad]
    errors: Annotated[np.ndarray, (2, 6)]  # [rad] by which the last two commands were too low, newest first.


def shaping(stiffness: float, damping: float, inertia: float, period: float) -> np.ndarray:
    """Shares (2,) of the last two rounding errors to add to the next command.

    They minimise the power of the velocity that the errors, held for a period [s], cause in a servo of stiffness
    [N m/rad], damping [N m s/rad] and inertia [kg m^2]: linear prediction of its response.
    """
    half, square = 0.5 * damping / inertia, stiffness / inertia
    # With a slight detuning of a double root.
    root = np.sqrt(complex(half**2 - square) or 1e-12 * square)
    samples, periods = 32, int(np.ceil(np.clip(20.0 / (half - root.real + 1e-9) / period, 4.0, 2000.0)))
    time = np.arange(samples * periods) * period / samples
    step = (square * (np.exp((root - half) * time) - np.exp(-(root + half) * time)) / (2.0 * root)).real
    pulse = step - np.concatenate([np.zeros(samples), step[:-samples]])
    power = [pulse[lag:] @ pulse[: len(pulse) - lag] for lag in (0, samples, 2 * samples)]
    return np.asarray(np.linalg.solve([power[:2], power[1::-1]], power[1:]))


def rounding_part(context: LoopContext, stiffness: float, damping: float, count: float) -> Part:
    """`command` (6,) [rad] along a `reference` (18,) -> commands in whole counts [rad], see `shaping`."""
    robot = context.robot
    inertia = float(np.trace(crank_inertia(robot, context.pose))) / 6.0
    shares = shaping(stiffness, damping, inertia, context.period)
    params = RoundingParams.new(count=count, shares=shares, length=robot.characteristic_length)
    numbers, inputs = {"robot": robot_record(robot), "params": params}, {"command": 6, "reference": 18}
    first = RoundingState.new()
    return Part("rounding", round_commands, {}, inputs, ("command",), first, (Legs,), parameters=numbers)


@njit
def round_commands(
    robot: Robot, params: RoundingParams, command: Vec6, reference: Vec18, legs: Legs, state: RoundingState
) -> None:
    """Rounds the commands [rad] of a tick to whole counts."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    jacobian, twist, rates = np.empty((6, 6)), np.empty(6), np.empty(6)
    wanted, motion, cost = np.empty(6), np.zeros((6, 6)), np.empty((6, 6))
    moving = legs_at(robot, reference[:6], legs) < 0
    if moving:
        twist_of(reference[:6], reference[6:12], twist)
        crank_rates(legs, twist, rates)
        moving = largest_size(rates) > RESTING
    if moving:
        # `motion` of the platform per error of a command.
        for i in range(6):
            motion[i, i] = 1.0
        crank_jacobian(legs, jacobian)
        moving = solve(jacobian, motion) != 0.0
    if not moving:
        for i in range(6):
            state.command[i] = params.count * np.rint(command[i] / params.count)
            state.errors[0, i] = state.errors[1, i] = 0.0
        return
    # Cost of errors: the square of the platform's motion.
    for i in range(3):
        for j in range(6):
            motion[i, j] *= params.length
    for i in range(6):
        for j in range(6):
            cost[i, j] = 0.0
            for m in range(6):
                cost[i, j] += motion[m, i] * motion[m, j]
    for i in range(6):
        wanted[i] = command[i] + params.shares[0] * state.errors[0, i] + params.shares[1] * state.errors[1, i]
        state.command[i] = params.count * np.rint(wanted[i] / params.count)
    _reduce_cost(cost, params.count, wanted, state.command[:])
    for i in range(6):
        state.errors[1, i] = state.errors[0, i]
        state.errors[0, i] = wanted[i] - state.command[i]


@njit
def _reduce_cost(cost: Mat6, count: float, wanted: Vec6, rounded: Vec6) -> None:
    """Changes one or two of the rounded angles by a count, if and where that reduces the cost most."""
    slope = np.zeros(6)
    for i in range(6):
        for k in range(6):
            slope[i] += cost[i, k] * (rounded[k] - wanted[k])
    best, first, second, first_step, second_step = 0.0, -1, -1, 0.0, 0.0
    for i in range(6):
        for sign in range(2):
            step = count if sign == 1 else -count
            change = 2.0 * step * slope[i] + step * step * cost[i, i]
            if change < best:
                best, first, second, first_step = change, i, -1, step
            for j in range(i):
                for other_sign in range(2):
                    other = count if other_sign == 1 else -count
                    both = change + 2.0 * other * (slope[j] + step * cost[i, j]) + other * other * cost[j, j]
                    if both < best:
                        best, first, second, first_step, second_step = both, i, j, step, other
    if first >= 0:
        rounded[first] += first_step
    if second >= 0:
        rounded[second] += second_step
