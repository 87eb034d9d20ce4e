"""Pose and rate from the motor encoders."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import SAME_BRANCH
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


@njit(cache=True, error_model="numpy")
def estimate(robot: np.ndarray, numbers: np.ndarray, angles: np.ndarray, memory: np.ndarray, result: np.ndarray) -> int:
    """Reference `estimator.estimate`.

    Args:
        robot: From `mechanism.pack`.
        numbers: (7,) period [s], share of a new difference, max_speed [rad/s], max_step [rad, m], tolerance [m],
            iterations.
        angles: (6,) [rad].
        memory: (27,) of the tick before.
        result: (27,) out, that of this tick.

    Returns:
        OK, or anything else where the reference raises.
    """
    started, elapsed = memory[26] > 0.0, numbers[0] * (1.0 + memory[24])
    for k in range(6):
        if not np.isfinite(angles[k]) or (started and abs(angles[k] - memory[12 + k]) > numbers[2] * elapsed):
            return NO_CONVERGENCE
        result[k], result[12 + k] = memory[k], angles[k]
    pose = result[:6]
    if not forward_kinematics(robot, angles, pose, numbers[5], int(numbers[6])) <= numbers[5]:
        return NO_CONVERGENCE
    legs, lines, twist = np.empty((6, 14)), np.empty((6, 6)), np.empty((6, 1))
    if leg_vectors(robot, pose, legs) >= 0:
        return NO_CONVERGENCE
    rod_lines(legs, lines)
    for k in range(6):
        if not abs(pose[k] - memory[k]) <= numbers[3 if k < 3 else 4]:
            return NO_CONVERGENCE
        along, up = 0.0, 0.0
        for m in range(3):
            along += legs[k, 3 + m] * robot[k, ZERO + m]
            up += legs[k, 3 + m] * robot[k, QUARTER + m]
        if not along * np.cos(angles[k]) + up * np.sin(angles[k]) >= SAME_BRANCH:
            return NO_CONVERGENCE
        result[18 + k] = memory[18 + k]
        if started:
            difference = (angles[k] - memory[12 + k]) / elapsed
            result[18 + k] = memory[18 + k] + numbers[1] * (difference - memory[18 + k])
        twist[k, 0] = robot[k, CRANK_LENGTH] * legs[k, 12] * result[18 + k]
    sign = solve(lines, twist)
    if sign == 0.0 or (started and sign != memory[25]):
        return NO_CONVERGENCE
    for k in range(6):
        result[6 + k] = twist[k, 0]
    euler_rates(pose[:3], result[6:9])
    result[24], result[25], result[26] = 0.0, sign, 1.0
    return OK


@njit(cache=True, error_model="numpy")
def read(state: np.ndarray, index: np.ndarray, zero: np.ndarray, quantum: float, result: np.ndarray) -> None:
    """Reference `estimator.EncoderOptions.read` without noise, of entries `index` (6,) of the plant's state.

    Args:
        state: (n,).
        index: (6,) of int.
        zero: (6,) [rad] added to them.
        quantum: [rad] of a count; 0 for none.
        result: (6,) [rad] out.
    """
    for k in range(6):
        angle = state[index[k]] + zero[k]
        result[k] = np.rint(angle / quantum) * quantum if quantum > 0.0 else angle
