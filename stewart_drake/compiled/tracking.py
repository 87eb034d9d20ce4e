"""Ticks of computed torque and of the PID."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import COMPUTED_TORQUE_NUMBERS, PID_NUMBERS
from stewart_drake.compiled.control import usable_legs
from stewart_drake.compiled.dynamics import inverse_dynamics, motion_torque
from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.mechanism import (
    CRANK_LENGTH,
    OK,
    QUARTER,
    ZERO,
    angular_velocity,
    leg_vectors,
    rod_lines,
    rotation,
    speed_along,
)

_C, _P = COMPUTED_TORQUE_NUMBERS, PID_NUMBERS


@njit(cache=True, error_model="numpy")
def computed_torque_tick(
    robot: np.ndarray,
    numbers: np.ndarray,
    measurement: np.ndarray,
    reference: np.ndarray,
    memory: np.ndarray,
    result: np.ndarray,
) -> bool:
    """Reference `computed_torque.computed_torque_tick`.

    Args:
        robot: From `mechanism.pack`.
        numbers: `COMPUTED_TORQUE_NUMBERS`.
        measurement: (12,).
        reference: (18,).
        memory: (18,) torque, error, integral of the tick before.
        result: Out, those of this tick.

    Returns:
        False where the reference raises.
    """
    legs, lines, turn, wanted = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3)), np.empty(6)
    status, _, _ = usable_legs(
        robot, numbers[_C.min_transmission], numbers[_C.min_conditioning], measurement[:6], legs, lines
    )
    if status != OK:
        return False
    omega = numbers[_C.frequency]
    for k in range(6):
        result[6 + k] = measurement[k] - reference[k]
        stiff = omega * omega * (result[6 + k] + numbers[_C.integral_frequency] * memory[12 + k])
        damped = 2.0 * numbers[_C.damping] * omega * (measurement[6 + k] - reference[6 + k])
        wanted[k] = reference[12 + k] - damped - stiff
    rotation(measurement[:3], turn)
    if not motion_torque(robot, legs, lines, turn, measurement, wanted, numbers[_C.gravity], result[:6]):
        return False
    cut = False
    for i in range(6):
        if not np.isfinite(result[i]):
            return False
        limit = numbers[_C.limit + i]
        if abs(result[i]) > limit:
            cut = True
            result[i] = limit if result[i] > 0.0 else -limit
    for k in range(6):
        result[12 + k] = memory[12 + k] + (0.0 if cut else numbers[_C.period] * result[6 + k])
    return True


@njit(cache=True, error_model="numpy")
def pid_tick(
    robot: np.ndarray,
    numbers: np.ndarray,
    measurement: np.ndarray,
    reference: np.ndarray,
    memory: np.ndarray,
    result: np.ndarray,
) -> bool:
    """Reference `joint_pid.pid_tick`; arguments as for `computed_torque_tick`, memory (12,) torque and integral."""
    legs, lines, far, rods = np.empty((6, 14)), np.empty((6, 6)), np.empty((6, 14)), np.empty((6, 6))
    status, _, _ = usable_legs(
        robot, numbers[_P.min_transmission], numbers[_P.min_conditioning], measurement[:6], legs, lines
    )
    if status != OK or leg_vectors(robot, reference[:6], far) >= 0:
        return False
    rod_lines(far, rods)
    weight, turn, still = np.zeros(6), np.empty((3, 3)), np.zeros(6)
    if numbers[_P.gravity] != 0.0:
        rotation(measurement[:3], turn)
        if not inverse_dynamics(robot, legs, lines, turn, still, still, numbers[_P.gravity], weight):
            return False
    spin, wanted = np.empty(3), np.empty(3)
    angular_velocity(measurement[:3], measurement[6:9], spin)
    angular_velocity(reference[:3], reference[6:9], wanted)
    for i in range(6):
        along, up, far_along, far_up = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            along += legs[i, 3 + k] * robot[i, ZERO + k]
            up += legs[i, 3 + k] * robot[i, QUARTER + k]
            far_along += far[i, 3 + k] * robot[i, ZERO + k]
            far_up += far[i, 3 + k] * robot[i, QUARTER + k]
        rate, far_rate = speed_along(lines, i, spin, measurement[9:]), speed_along(rods, i, wanted, reference[9:12])
        error = np.arctan2(up * far_along - along * far_up, along * far_along + up * far_up)
        rate_error = (rate / legs[i, 12] - far_rate / far[i, 12]) / robot[i, CRANK_LENGTH]
        integral = memory[6 + i]
        asked = weight[i] - (numbers[_P.kp] * error + numbers[_P.kd] * rate_error + numbers[_P.ki] * integral)
        if not np.isfinite(asked):
            return False
        limit, growth = numbers[_P.limit + i], numbers[_P.period] * error
        result[i] = min(max(asked, -limit), limit)
        cut = asked - result[i]
        if numbers[_P.given_back] >= 0.0:
            growth += numbers[_P.given_back] * cut
        elif cut != 0.0:
            growth = 0.0
        result[6 + i] = integral + growth
    return True
