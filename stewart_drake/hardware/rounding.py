"""Angles in whole counts, six rounded together: a servo's resolution is what makes a slow motion tremble.

Rounded alone, each command is off by up to half a count at random. Two things make less of it. What the last two
commands were off by is added to the next so that the errors cancel in the velocity that the servo makes of them
(noise shaping by linear prediction). And of the whole counts near the six commands those are taken that move the
platform least from where it should be, since errors of six cranks may cancel in it too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics import crank_inertia
from stewart_drake.mechanics.kinematics_laws import Legs, crank_jacobian, legs_at, robot_record, twist_of
from stewart_drake.mechanics.linear_algebra import solve

RESTING = 1e-4
"""[rad/s] speed of all cranks below which each command is rounded alone: nothing hunts about a place to rest at."""


def shaping(stiffness: float, damping: float, inertia: float, period: float) -> np.ndarray:
    """Shares (2,) of the last two errors of a command to add to the next one.

    They make the power of the velocity least that errors of a command, held for a period [s] each, cause in a servo of
    stiffness [N m/rad], damping [N m s/rad] and inertia [kg m^2]: the linear prediction of its response.
    """
    half, square = 0.5 * damping / inertia, stiffness / inertia
    # The smallest of detunings, where both roots are one.
    root = np.sqrt(complex(half**2 - square) or 1e-12 * square)
    samples, periods = 32, int(np.ceil(np.clip(20.0 / (half - root.real + 1e-9) / period, 4.0, 2000.0)))
    time = np.arange(samples * periods) * period / samples
    step = (square * (np.exp((root - half) * time) - np.exp(-(root + half) * time)) / (2.0 * root)).real
    pulse = step - np.concatenate([np.zeros(samples), step[:-samples]])
    power = [pulse[lag:] @ pulse[: len(pulse) - lag] for lag in (0, samples, 2 * samples)]
    shares: np.ndarray = np.linalg.solve([power[:2], power[1::-1]], power[1:])
    return shares


def rounding_part(context: LoopContext, stiffness: float, damping: float, count: float) -> Part:
    """`command` (6,) [rad] along a `reference` (18,) -> commands in whole counts [rad], see `shaping`."""
    robot = context.robot
    inertia = float(np.trace(crank_inertia(robot, context.pose))) / 6.0
    shares = shaping(stiffness, damping, inertia, context.period)
    params = new_record(_PARAMS, count=count, shares=shares, length=robot.characteristic_length)
    numbers, inputs = {"robot": robot_record(robot), "params": params}, {"command": 6, "reference": 18}
    return Part("rounding", round_together, {}, inputs, ("command",), new_record(_STATE), (Legs,), parameters=numbers)


_PARAMS = fields(count=(), shares=2, length=())
"""count: [rad]. length: [m] of the platform's turn by a radian, as an error."""
_STATE = fields(command=6, errors=(2, 6))
"""command: [rad]. errors: what the last commands and those before fell short by [rad]."""


@njit
def round_together(robot: Any, params: Any, command: Any, reference: Any, legs: Any, state: Any) -> None:
    """Kernel of `rounding_part`."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    jacobian, twist, wanted, weight = np.empty((6, 6)), np.empty(6), np.empty(6), np.zeros((6, 6))
    moving = legs_at(robot, reference[:6], legs) < 0
    if moving:
        crank_jacobian(legs, jacobian)
        twist_of(reference[:6], reference[6:12], twist)
        moving = np.abs(jacobian @ twist).max() > RESTING
    if moving:
        for i in range(6):
            weight[i, i] = 1.0
        moving = solve(jacobian, weight) != 0.0
    if not moving:
        for i in range(6):
            state.command[i] = params.count * np.rint(command[i] / params.count)
            state.errors[0, i] = state.errors[1, i] = 0.0
        return
    # What errors of the six commands cost: the square of how far they move the platform.
    for i in range(3):
        for j in range(6):
            weight[i, j] *= params.length
    cost = weight.T @ weight
    for i in range(6):
        wanted[i] = command[i] + params.shares[0] * state.errors[0, i] + params.shares[1] * state.errors[1, i]
        state.command[i] = params.count * np.rint(wanted[i] / params.count)
    _improve(cost, params.count, state.command, wanted)
    for i in range(6):
        state.errors[1, i] = state.errors[0, i]
        state.errors[0, i] = wanted[i] - state.command[i]


@njit
def _improve(cost: Any, count: float, rounded: Any, wanted: Any) -> None:
    """Moves one or two of six angles by a count, in place, where the error costs least for it."""
    pull = cost @ (rounded - wanted)
    best, first, second, by_first, by_second = 0.0, -1, -1, 0.0, 0.0
    for i in range(6):
        for one in (-count, count):
            alone = 2.0 * one * pull[i] + one * one * cost[i, i]
            if alone < best:
                best, first, second, by_first = alone, i, -1, one
            for j in range(i):
                for other in (-count, count):
                    both = alone + 2.0 * other * (pull[j] + one * cost[i, j]) + other * other * cost[j, j]
                    if both < best:
                        best, first, second, by_first, by_second = both, i, j, one, other
    if first >= 0:
        rounded[first] += by_first
    if second >= 0:
        rounded[second] += by_second
