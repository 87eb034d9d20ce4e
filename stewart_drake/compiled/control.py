"""One tick of the LQI."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import LQI_CHOICES, LQI_MEMORY, LQI_NUMBERS, SMALLEST_SINGULAR_VALUE
from stewart_drake.compiled.dynamics import inverse_dynamics, motion_torque, task_inertia
from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import singular_vectors, solve
from stewart_drake.compiled.mechanism import (
    AT_REFERENCE,
    CRANK_LENGTH,
    EFFORT,
    NO_GAIN,
    NOT_FINITE,
    OK,
    PARALLEL,
    PLATFORM_INERTIA,
    PLATFORM_MASS,
    SERIAL,
    UNREACHABLE,
    euler_rates,
    leg_vectors,
    line_conditioning,
    rod_lines,
    rotation,
    scalar,
)
from stewart_drake.compiled.riccati import chain_gain


@njit(cache=True, error_model="numpy")
def acceleration_map(
    robot: np.ndarray, exact: bool, printed: bool, pose: np.ndarray, legs: np.ndarray, lines: np.ndarray,
    turn: np.ndarray, out: np.ndarray,
) -> bool:  # fmt: skip
    """Transpose of M^-1 tau: row i is the acceleration of the pose per unit of motor i.

    References `state_space.acceleration_map` (paper) and `dynamics.pose_acceleration_map` (exact); out (6, 6).
    """
    if not exact:
        for i in range(6):
            a = robot[i, CRANK_LENGTH]
            force = legs[i, 12] / a if printed else 1.0 / (a * legs[i, 12])
            for k in range(3):
                out[i, k] = lines[i, k] * force / scalar(robot, PLATFORM_INERTIA + k)
                out[i, 3 + k] = lines[i, 3 + k] * force / scalar(robot, PLATFORM_MASS)
        return True
    inertia, columns = np.empty((6, 6)), np.empty((6, 6))
    task_inertia(robot, legs, lines, turn, inertia)
    for i in range(6):
        force = 1.0 / (robot[i, CRANK_LENGTH] * legs[i, 12])
        for k in range(6):
            columns[k, i] = lines[i, k] * force
    if solve(inertia, columns) == 0.0:
        return False
    for i in range(6):
        for k in range(6):
            out[i, k] = columns[k, i]
        euler_rates(pose[:3], out[i, :3])
    return True


@njit(cache=True, error_model="numpy")
def split_gain(
    map_transposed: np.ndarray, length: float, period: float, weights: np.ndarray, exact_hold: bool, gain: np.ndarray
) -> bool:
    """Reference `riccati.split_gain`.

    Args:
        map_transposed: (6, 6) from `acceleration_map`; destroyed.
        length: [m] by which rotations are multiplied in the weights.
        period: [s].
        weights: (4,) q_e, q_v, q_z, r.
        exact_hold: Zero-order hold; else Euler.
        gain: (6, 18) out.

    Returns:
        False where the map is singular or a Riccati equation fails.
    """
    s, v, chain = np.empty(6), np.empty((6, 6)), np.empty((6, 3))
    for i in range(6):
        for k in range(3):
            map_transposed[i, k] *= length
    singular_vectors(map_transposed, s, v, 1e-14)
    if not s.min() > SMALLEST_SINGULAR_VALUE * s.max():
        return False
    for i in range(6):
        if not chain_gain(s[i], period, weights[0], weights[1], weights[2], weights[3], exact_hold, chain[i]):
            return False
    # Row i of the map now holds s_i u_i in the scaled pose, row i of v what the motors do for it.
    for j in range(6):
        for k in range(6):
            g0, g1, g2 = 0.0, 0.0, 0.0
            for i in range(6):
                both = v[i, j] * map_transposed[i, k] / s[i]
                g0 += both * chain[i, 0]
                g1 += both * chain[i, 1]
                g2 += both * chain[i, 2]
            scale = length if k < 3 else 1.0
            gain[j, 2 * k], gain[j, 2 * k + 1], gain[j, 12 + k] = scale * g0, scale * g1, scale * g2
    return True


@njit(cache=True, error_model="numpy")
def usable_legs(
    robot: np.ndarray,
    min_transmission: float,
    min_conditioning: float,
    pose: np.ndarray,
    legs: np.ndarray,
    lines: np.ndarray,
) -> tuple[int, int, float]:
    """Reference `inputs.checked_legs`; legs (6, 14) and lines (6, 6) out.

    Returns:
        Status as in `mechanism`; leg or -1; margin, or where all is well the conditioning.
    """
    bad = leg_vectors(robot, pose, legs)
    if bad >= 0:
        return UNREACHABLE, bad, legs[bad, 13]
    worst, leg = np.inf, 0
    for i in range(6):
        if not abs(legs[i, 12]) >= worst:
            worst, leg = abs(legs[i, 12]), i
    if worst < min_transmission:
        return SERIAL, leg, worst
    rod_lines(legs, lines)
    ratio = line_conditioning(robot, lines)
    if not ratio >= min_conditioning:
        return PARALLEL, -1, ratio
    return OK, -1, ratio


_M, _N, _C = LQI_MEMORY, LQI_NUMBERS, LQI_CHOICES


@njit(cache=True, error_model="numpy")
def lqi_tick(
    robot: np.ndarray,
    numbers: np.ndarray,
    choices: np.ndarray,
    measurement: np.ndarray,
    reference: np.ndarray,
    weights: np.ndarray,
    memory: np.ndarray,
    result: np.ndarray,
) -> tuple[int, int, float]:
    """Reference `lqi.lqi_tick` with the solver `split`.

    Args:
        robot: From `mechanism.pack`.
        numbers: `LQI_NUMBERS`.
        choices: `LQI_CHOICES`, of int.
        measurement: (12,).
        reference: (18,).
        weights: (2,) omega_Q, omega_R, or (4,) q_e, q_v, q_z, r.
        memory: `LQI_MEMORY` of the tick before.
        result: Out, that of this tick.

    Returns:
        Status as in `mechanism`; leg or -1, or which signal is NOT_FINITE; margin.
    """
    period, gravity, length = numbers[_N.period], numbers[_N.gravity], numbers[_N.length]
    exact_model, feedforward, saturation = choices[_C.exact_model] == 1, choices[_C.feedforward], choices[_C.saturation]
    for k in range(6, 12):
        if not np.isfinite(measurement[k]):
            return NOT_FINITE, 1, 0.0
    for k in range(18):
        if not np.isfinite(reference[k]):
            return NOT_FINITE, 2, 0.0
    for k in range(6):
        if not np.isfinite(measurement[k]):
            return NOT_FINITE, 0, 0.0
    legs, lines, turn = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3))
    pose = measurement[:6]
    status, leg, ratio = usable_legs(
        robot, numbers[_N.min_transmission], numbers[_N.min_conditioning], pose, legs, lines
    )
    if status != OK:
        return status, leg, ratio
    rotation(pose[:3], turn)
    blocks = np.empty(4)
    for k in range(4):
        if weights.size != 4 and weights.size != 2:
            return NO_GAIN, -1, 0.0
        blocks[k] = weights[k] if weights.size == 4 else weights[k // 3]
        if not 0.0 < blocks[k] < np.inf:
            return NO_GAIN, -1, 0.0

    own, work, gain = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 18))
    if not acceleration_map(robot, exact_model, choices[_C.printed_map] == 1, pose, legs, lines, turn, own):
        return PARALLEL, -1, ratio
    work[:] = own
    if not split_gain(work, length, period, blocks, choices[_C.exact_hold] == 1, gain):
        return NO_GAIN, -1, 0.0

    integral = np.empty((6, 1))
    for k in range(6):
        integral[k, 0] = memory[_M.integral + k]
    changed = False
    for k in range(4):
        changed = changed or (memory[_M.weights + k] != blocks[k] and memory[_M.weights] > 0.0)
    before, column = np.empty((6, 18)), np.empty((6, 1))
    if choices[_C.bumpless] == 1 and changed:
        work[:] = own
        if not split_gain(work, length, period, memory[_M.weights : _M.held], choices[_C.exact_hold] == 1, before):
            return NO_GAIN, -1, 0.0
        for i in range(6):
            column[i, 0] = 0.0
            for k in range(6):
                column[i, 0] += before[i, 12 + k] * integral[k, 0]
                work[i, k] = gain[i, 12 + k]
        if solve(work, column) == 0.0:
            return NO_GAIN, -1, 0.0
        integral[:] = column

    force = np.zeros(6)
    if feedforward == 3:
        at = reference[:12] if choices[_C.at_reference] == 1 else measurement
        if choices[_C.at_reference] == 1:
            bad = leg_vectors(robot, at[:6], legs)
            if bad >= 0:
                return AT_REFERENCE + UNREACHABLE, bad, legs[bad, 13]
            rod_lines(legs, lines)
            rotation(at[:3], turn)
        if not motion_torque(robot, legs, lines, turn, at, reference[12:], gravity, force):
            return PARALLEL + (AT_REFERENCE if choices[_C.at_reference] == 1 else 0), -1, 0.0
    elif feedforward > 0:
        if gravity != 0.0:
            still = np.zeros(6)
            if not inverse_dynamics(robot, legs, lines, turn, still, still, gravity, force):
                return PARALLEL, -1, ratio
        if feedforward == 2:
            acceleration_map(robot, False, choices[_C.printed_map] == 1, pose, legs, lines, turn, own)
            for i in range(6):
                column[i, 0] = reference[12 + i]
                for k in range(6):
                    work[k, i] = own[i, k]
            if solve(work, column) == 0.0:
                return PARALLEL, -1, ratio
            for i in range(6):
                force[i] += column[i, 0]

    saturated = False
    for i in range(6):
        value, limit = force[i], scalar(robot, EFFORT + i)
        for k in range(6):
            value -= gain[i, 2 * k] * (measurement[k] - reference[k])
            value -= gain[i, 2 * k + 1] * (measurement[6 + k] - reference[6 + k])
            value -= gain[i, 12 + k] * integral[k, 0]
        if not np.isfinite(value):
            return NOT_FINITE, 3, value
        result[_M.torque + i] = value
        column[i, 0] = 0.0
        if saturation > 0 and abs(value) > limit:
            saturated = True
            result[_M.torque + i] = limit if value > 0.0 else -limit
            column[i, 0] = value - result[_M.torque + i]
    if saturated and saturation == 2:
        for i in range(6):
            for k in range(6):
                work[i, k] = gain[i, 12 + k]
        if solve(work, column) == 0.0:
            return NO_GAIN, -1, 0.0
        for k in range(6):
            integral[k, 0] += min(1.0, period / numbers[_N.reset_time]) * column[k, 0]
    for k in range(6):
        error = measurement[k] - reference[k]
        result[_M.error + k] = error
        if not (saturated and saturation == 1):
            integral[k, 0] += period * error
        bound = numbers[_N.integral_angle] if k < 3 else numbers[_N.integral_position]
        result[_M.integral + k] = min(max(integral[k, 0], -bound), bound)
    for i in range(6):
        for k in range(18):
            result[_M.gain + 18 * i + k] = gain[i, k]
        result[_M.feedforward + i] = force[i]
    for k in range(4):
        result[_M.weights + k] = blocks[k]
    result[_M.held] = 0.0
    return OK, -1, ratio
