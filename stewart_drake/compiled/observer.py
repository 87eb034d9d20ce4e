"""The observer: prediction by the exact model, correction by readings of the cranks' angles."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import OBSERVER_MEMORY, OBSERVER_NUMBERS, WHITE_SHARE
from stewart_drake.compiled.dynamics import inverse_dynamics, task_inertia
from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import solve
from stewart_drake.compiled.mechanism import (
    CRANK_LENGTH,
    NO_CONVERGENCE,
    OK,
    QUARTER,
    ZERO,
    angular_velocity,
    euler_drift,
    euler_rates,
    leg_vectors,
    rod_lines,
    rotation,
    speed_along,
)
from stewart_drake.compiled.riccati import spectral_factor

_M, _N = OBSERVER_MEMORY, OBSERVER_NUMBERS


@njit(cache=True, error_model="numpy")
def pose_acceleration(
    robot: np.ndarray,
    pose: np.ndarray,
    rate: np.ndarray,
    torque: np.ndarray,
    surplus: np.ndarray,
    gravity: float,
    out: np.ndarray,
) -> bool:
    """Reference `dynamics.forward_dynamics`, and what a `surplus` (6,) [rad/s^2] of the cranks adds.

    Returns:
        False out of reach or at a singularity.
    """
    legs, lines, turn = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3))
    if leg_vectors(robot, pose, legs) >= 0:
        return False
    rod_lines(legs, lines)
    rotation(pose[:3], turn)
    twist, still, load = np.empty(6), np.zeros(6), np.empty(6)
    angular_velocity(pose[:3], rate[:3], twist[:3])
    twist[3:] = rate[3:]
    if not inverse_dynamics(robot, legs, lines, turn, twist, still, gravity, load):
        return False
    inertia, pushed, more = np.empty((6, 6)), np.zeros((6, 1)), np.empty((6, 1))
    task_inertia(robot, legs, lines, turn, inertia)
    for i in range(6):
        lever = robot[i, CRANK_LENGTH] * legs[i, 12]
        force = (torque[i] - load[i]) / lever
        more[i, 0] = lever * surplus[i]
        for k in range(6):
            pushed[k, 0] += lines[i, k] * force
    if solve(inertia, pushed) == 0.0 or solve(lines, more) == 0.0:
        return False
    euler_drift(pose[:3], rate[:3], still[:3])
    for k in range(6):
        out[k] = pushed[k, 0] + more[k, 0] - still[k]
    euler_rates(pose[:3], out[:3])
    return True


@njit(cache=True, error_model="numpy")
def advance(
    robot: np.ndarray, numbers: np.ndarray, pose: np.ndarray, rate: np.ndarray, torque: np.ndarray, surplus: np.ndarray
) -> bool:
    """Reference `observer.advance`; pose and rate (6,) in place."""
    period, acceleration = numbers[_N.period], np.empty(6)
    if not pose_acceleration(robot, pose, rate, torque, surplus, numbers[_N.gravity], acceleration):
        return False
    for k in range(6):
        pose[k] += period * (rate[k] + 0.5 * period * acceleration[k])
        rate[k] += period * acceleration[k]
    return True


@njit(cache=True, error_model="numpy")
def kalman_gains(bandwidth: float, period: float, gains: np.ndarray) -> bool:
    """Reference `observer.kalman_gains`, of a bandwidth [rad/s]; gains (3,) out, False where there are none."""
    wandering, white = (bandwidth * period) ** 6, WHITE_SHARE**2 * (bandwidth * period) ** 4
    c2, c1, c0, low = spectral_factor(0.25 * white + wandering / 16.0, white + 0.5 * wandering, wandering)
    gains[0], gains[1], gains[2] = (c2 + 0.25 * c0) * low, c1 * low / period, c0 * low / period**2
    return gains[0] > 0.0 and gains[0] < np.inf


@njit(cache=True, error_model="numpy")
def observe(
    robot: np.ndarray,
    numbers: np.ndarray,
    angles: np.ndarray,
    sent: np.ndarray,
    reference: np.ndarray,
    disturbance: np.ndarray,
    memory: np.ndarray,
    result: np.ndarray,
) -> int:
    """Reference `observer.observe`.

    Args:
        robot: From `mechanism.pack`.
        numbers: `OBSERVER_NUMBERS`.
        angles: (6,) [rad].
        sent: (6,) [N m].
        reference: (18,).
        disturbance: (1,).
        memory: `OBSERVER_MEMORY` and commands of the tick before.
        result: Out, those of this tick.

    Returns:
        OK, or anything else where the reference raises.
    """
    result[_M.size : -6] = memory[_M.size + 6 :]
    result[-6:] = sent if np.isfinite(sent).all() else memory[-6:]
    pose, rate, surplus = result[: _M.rate], result[_M.rate : _M.pose_ahead], result[_M.surplus : _M.missed]
    pose[:], rate[:] = memory[: _M.rate], memory[_M.rate : _M.pose_ahead]
    surplus[:] = memory[_M.surplus : _M.missed]
    if not advance(robot, numbers, pose, rate, result[_M.size : _M.size + 6], surplus):
        return NO_CONVERGENCE
    legs, lines, gains = np.empty((6, 14)), np.empty((6, 6)), np.empty(3)
    period = numbers[_N.period]
    bandwidth = (disturbance[0] / (numbers[_N.noise] * np.sqrt(period))) ** (1.0 / 3.0)
    if not kalman_gains(bandwidth, period, gains) or leg_vectors(robot, pose, legs) >= 0:
        return NO_CONVERGENCE
    arrived = max(numbers[_N.arrived], numbers[_N.slip] / (bandwidth * bandwidth))
    rod_lines(legs, lines)
    turned = np.empty((6, 2))
    for i in range(6):
        along, up = 0.0, 0.0
        for m in range(3):
            along += legs[i, 3 + m] * robot[i, ZERO + m]
            up += legs[i, 3 + m] * robot[i, QUARTER + m]
        # Of the reading against the crank expected, within half a turn.
        cosine, sine = np.cos(angles[i]), np.sin(angles[i])
        innovation = np.arctan2(sine * along - cosine * up, cosine * along + sine * up)
        missed = memory[_M.missed + i]
        if abs(innovation) <= numbers[_N.max_innovation]:
            missed = 0.0
        else:
            innovation, missed = 0.0, missed + 1.0
            if missed > numbers[_N.hold_ticks]:
                return NO_CONVERGENCE
        result[_M.innovation + i], result[_M.missed + i] = innovation, missed
        lever = robot[i, CRANK_LENGTH] * legs[i, 12]
        turned[i, 0] = lever * gains[0] * innovation
        turned[i, 1] = lever * gains[1] * innovation
    kept = lines.copy()
    if solve(lines, turned) == 0.0:
        return NO_CONVERGENCE
    change = np.empty((2, 6))
    omega, stands = np.empty((2, 3)), numbers[_N.arrived] > 0.0
    for row in range(2):
        change[row] = turned[:, row]
        euler_rates(pose[:3], change[row, :3])
    pose += change[0]
    rate += change[1]
    angular_velocity(pose[:3], pose[:3] - reference[:3], omega[0])
    angular_velocity(pose[:3], reference[6:9], omega[1])
    for i in range(6):
        off = speed_along(kept, i, omega[0], pose[3:] - reference[3:6])
        turning = speed_along(kept, i, omega[1], reference[9:12])
        lever = abs(robot[i, CRANK_LENGTH] * legs[i, 12])
        stands = stands and abs(off) <= arrived * lever and abs(turning) <= numbers[_N.rests] * lever
    if not stands:
        surplus += gains[2] * result[_M.innovation : _M.surplus]

    ahead, rate_ahead = result[_M.pose_ahead : _M.rate_ahead], result[_M.rate_ahead : _M.compensation]
    ahead[:], rate_ahead[:] = pose, rate
    for start in range(_M.size + 6, result.size, 6):
        if not advance(robot, numbers, ahead, rate_ahead, result[start : start + 6], surplus):
            return NO_CONVERGENCE
    if leg_vectors(robot, ahead, legs) >= 0:
        return NO_CONVERGENCE
    rod_lines(legs, lines)
    turn, inertia, transposed, more = np.empty((3, 3)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 1))
    rotation(ahead[:3], turn)
    task_inertia(robot, legs, lines, turn, inertia)
    for i in range(6):
        more[i, 0] = robot[i, CRANK_LENGTH] * legs[i, 12] * surplus[i]
        for k in range(6):
            transposed[k, i] = lines[i, k]
    # A sign that differs between now and the time ahead is a singularity as well.
    side = solve(lines, more)
    if side == 0.0 or side != memory[_M.side]:
        return NO_CONVERGENCE
    wrench = np.zeros((6, 1))
    for j in range(6):
        for k in range(6):
            wrench[j, 0] += inertia[j, k] * more[k, 0]
    if solve(transposed, wrench) == 0.0:
        return NO_CONVERGENCE
    for i in range(6):
        result[_M.compensation + i] = -robot[i, CRANK_LENGTH] * legs[i, 12] * wrench[i, 0]
    result[_M.side] = side
    return OK
