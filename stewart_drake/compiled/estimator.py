"""Pose and rate from the motor encoders."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import ESTIMATOR_MEMORY, ESTIMATOR_NUMBERS, SAME_BRANCH
from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import solve
from stewart_drake.compiled.mechanism import (
    CRANK_LENGTH,
    NO_CONVERGENCE,
    OK,
    QUARTER,
    ZERO,
    euler_rates,
    forward_kinematics,
    leg_vectors,
    rod_lines,
)

_M, _N = ESTIMATOR_MEMORY, ESTIMATOR_NUMBERS


@njit(cache=True, error_model="numpy")
def estimate(robot: np.ndarray, numbers: np.ndarray, angles: np.ndarray, memory: np.ndarray, result: np.ndarray) -> int:
    """Reference `estimator.estimate`.

    Args:
        robot: From `mechanism.pack`.
        numbers: `ESTIMATOR_NUMBERS`.
        angles: (6,) [rad].
        memory: `ESTIMATOR_MEMORY` of the tick before.
        result: Out, that of this tick.

    Returns:
        OK, or anything else where the reference raises.
    """
    started, elapsed = memory[_M.started] > 0.0, numbers[_N.period] * (1.0 + memory[_M.held])
    for k in range(6):
        if not np.isfinite(angles[k]) or (
            started and abs(angles[k] - memory[_M.angles + k]) > numbers[_N.max_speed] * elapsed
        ):
            return NO_CONVERGENCE
        result[_M.pose + k], result[_M.angles + k] = memory[_M.pose + k], angles[k]
    pose = result[: _M.rate]
    if (
        not forward_kinematics(robot, angles, pose, numbers[_N.tolerance], int(numbers[_N.iterations]))
        <= numbers[_N.tolerance]
    ):
        return NO_CONVERGENCE
    legs, lines, twist = np.empty((6, 14)), np.empty((6, 6)), np.empty((6, 1))
    if leg_vectors(robot, pose, legs) >= 0:
        return NO_CONVERGENCE
    rod_lines(legs, lines)
    for k in range(6):
        if not abs(pose[k] - memory[_M.pose + k]) <= numbers[_N.max_turn if k < 3 else _N.max_shift]:
            return NO_CONVERGENCE
        along, up = 0.0, 0.0
        for m in range(3):
            along += legs[k, 3 + m] * robot[k, ZERO + m]
            up += legs[k, 3 + m] * robot[k, QUARTER + m]
        if not along * np.cos(angles[k]) + up * np.sin(angles[k]) >= SAME_BRANCH:
            return NO_CONVERGENCE
        result[_M.crank_rates + k] = memory[_M.crank_rates + k]
        if started:
            difference = (angles[k] - memory[_M.angles + k]) / elapsed
            result[_M.crank_rates + k] = memory[_M.crank_rates + k] + numbers[_N.smoothing] * (
                difference - memory[_M.crank_rates + k]
            )
        twist[k, 0] = robot[k, CRANK_LENGTH] * legs[k, 12] * result[_M.crank_rates + k]
    sign = solve(lines, twist)
    if sign == 0.0 or (started and sign != memory[_M.side]):
        return NO_CONVERGENCE
    for k in range(6):
        result[_M.rate + k] = twist[k, 0]
    euler_rates(pose[:3], result[_M.rate : _M.rate + 3])
    result[_M.held], result[_M.side], result[_M.started] = 0.0, sign, 1.0
    return OK


@njit(cache=True, error_model="numpy")
def read(
    angles: np.ndarray, offset: np.ndarray, noise: float, drawn: np.ndarray, quantum: float, result: np.ndarray
) -> None:
    """Reference `estimator.EncoderOptions.read`.

    Args:
        angles: (6,) [rad] true.
        offset: (6,) [rad] added to them.
        noise: [rad] standard deviation.
        drawn: (6,) standard normal numbers.
        quantum: [rad] of a count; 0 for none.
        result: (6,) [rad] out.
    """
    for k in range(6):
        angle = angles[k] + offset[k] + noise * drawn[k]
        result[k] = np.rint(angle / quantum) * quantum if quantum > 0.0 else angle
