"""Ticks of joint PID and of computed torque."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import COMPUTED_TORQUE_NUMBERS, PID_NUMBERS
from stewart_drake.compiled.dynamics import inverse_dynamics
from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.mechanism import (
    CRANK_LENGTH,
    EFFORT,
    QUARTER,
    ZERO,
    angular_velocity,
    euler_drift,
    leg_vectors,
    line_conditioning,
    rod_lines,
    rotation,
    scalar,
)

_P, _T = PID_NUMBERS, COMPUTED_TORQUE_NUMBERS


@njit(cache=True, error_model="numpy")
def _usable(
    robot: np.ndarray, transmission: float, conditioning: float, measured: np.ndarray, legs: np.ndarray,
    lines: np.ndarray, turn: np.ndarray,
) -> bool:  # fmt: skip
    """Whether `inputs.checked_legs` would pass a measurement (12,), whose legs, lines and R_BP are written out."""
    for k in range(12):
        if not np.isfinite(measured[k]):
            return False
    if leg_vectors(robot, measured[:6], legs) >= 0:
        return False
    for i in range(6):
        if not abs(legs[i, 12]) >= transmission:
            return False
    rod_lines(legs, lines)
    rotation(measured[:3], turn)
    return line_conditioning(robot, lines) >= conditioning


@njit(cache=True, error_model="numpy")
def computed_torque_tick(
    robot: np.ndarray, numbers: np.ndarray, measured: np.ndarray, wanted: np.ndarray, memory: np.ndarray,
    result: np.ndarray,
) -> bool:  # fmt: skip
    """Reference `computed_torque.computed_torque_tick`.

    Args:
        robot: From `mechanism.pack`.
        numbers: `COMPUTED_TORQUE_NUMBERS`.
        measured: (12,).
        wanted: (18,).
        memory: (18,) `ComputedTorqueMemory` of the tick before, in a row.
        result: (18,) out, that of this tick.

    Returns:
        False where the reference raises.
    """
    legs, lines, turn = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3))
    if not _usable(robot, numbers[_T.min_transmission], numbers[_T.min_conditioning], measured, legs, lines, turn):
        return False
    omega, twist, twist_rate, drift = numbers[_T.natural_frequency], np.empty(6), np.empty(6), np.empty(3)
    asked = np.empty(6)
    for k in range(6):
        error, rate_error = measured[k] - wanted[k], measured[6 + k] - wanted[6 + k]
        asked[k] = wanted[12 + k] - 2.0 * numbers[_T.damping] * omega * rate_error
        asked[k] -= omega * omega * (error + numbers[_T.integral_frequency] * memory[12 + k])
        result[6 + k] = error
    angular_velocity(measured[:3], measured[6:9], twist[:3])
    angular_velocity(measured[:3], asked[:3], twist_rate[:3])
    euler_drift(measured[:3], measured[6:9], drift)
    for k in range(3):
        twist[3 + k], twist_rate[3 + k] = measured[9 + k], asked[3 + k]
        twist_rate[k] += drift[k]
    if not inverse_dynamics(robot, legs, lines, turn, twist, twist_rate, numbers[_T.gravity], result[:6]):
        return False
    grows = True
    for i in range(6):
        value, limit = result[i], scalar(robot, EFFORT + i)
        if not np.isfinite(value):
            return False
        if numbers[_T.clamp] > 0.0 and abs(value) > limit:
            grows = False
            result[i] = limit if value > 0.0 else -limit
    for k in range(6):
        result[12 + k] = memory[12 + k] + (numbers[_T.period] * result[6 + k] if grows else 0.0)
    return True


@njit(cache=True, error_model="numpy")
def pid_tick(
    robot: np.ndarray, numbers: np.ndarray, measured: np.ndarray, wanted: np.ndarray, memory: np.ndarray,
    result: np.ndarray,
) -> bool:  # fmt: skip
    """Reference `joint_pid.pid_tick`; `PID_NUMBERS`, `PidMemory` (12,) in a row, else as `computed_torque_tick`."""
    legs, lines, turn = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3))
    if not _usable(robot, numbers[_P.min_transmission], numbers[_P.min_conditioning], measured, legs, lines, turn):
        return False
    other, other_lines = np.empty((6, 14)), np.empty((6, 6))
    for k in range(12):
        if not np.isfinite(wanted[k]):
            return False
    if leg_vectors(robot, wanted[:6], other) >= 0:
        return False
    rod_lines(other, other_lines)
    force, still = np.zeros(6), np.zeros(6)
    if numbers[_P.gravity] != 0.0 and not inverse_dynamics(
        robot, legs, lines, turn, still, still, numbers[_P.gravity], force
    ):
        return False
    twist, wanted_twist = np.empty(6), np.empty(6)
    angular_velocity(measured[:3], measured[6:9], twist[:3])
    angular_velocity(wanted[:3], wanted[6:9], wanted_twist[:3])
    twist[3:], wanted_twist[3:] = measured[9:12], wanted[9:12]
    saturation, ki, period = numbers[_P.saturation], numbers[_P.ki], numbers[_P.period]
    for i in range(6):
        error = _angle(robot, legs, i) - _angle(robot, other, i)
        error -= 2.0 * np.pi * np.rint(error / (2.0 * np.pi))
        rate_error, a = 0.0, robot[i, CRANK_LENGTH]
        for k in range(6):
            rate_error += lines[i, k] * twist[k] / (a * legs[i, 12])
            rate_error -= other_lines[i, k] * wanted_twist[k] / (a * other[i, 12])
        value = force[i] - (numbers[_P.kp] * error + numbers[_P.kd] * rate_error + ki * memory[6 + i])
        if not np.isfinite(value):
            return False
        result[i], growth = value, period * error
        limit = numbers[_P.limit + i]
        if saturation > 0.0 and abs(value) > limit:
            result[i] = limit if value > 0.0 else -limit
            if saturation == 1.0:
                growth = 0.0
            elif ki > 0.0:
                growth += min(1.0, period / numbers[_P.reset_time]) * (value - result[i]) / ki
        result[6 + i] = memory[6 + i] + growth
    return True


@njit(cache=True, error_model="numpy", inline="always")
def _angle(robot: np.ndarray, legs: np.ndarray, i: int) -> float:
    """[rad] of a crank."""
    along, up = 0.0, 0.0
    for k in range(3):
        along += legs[i, 3 + k] * robot[i, ZERO + k]
        up += legs[i, 3 + k] * robot[i, QUARTER + k]
    return np.arctan2(up, along)
