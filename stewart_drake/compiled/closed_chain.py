"""Steps of the closed chain in its six coordinates."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import CHAIN_STATE
from stewart_drake.compiled.dynamics import loads, task_inertia
from stewart_drake.compiled.friction import BREAK_AWAY, VISCOUS, implicit_torque, moved
from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import solve
from stewart_drake.compiled.mechanism import (
    CRANK_LENGTH,
    EFFORT,
    QUARTER,
    ZERO,
    euler_rates,
    leg_vectors,
    rod_lines,
    rotation,
    scalar,
)

_S = CHAIN_STATE


@njit(cache=True, error_model="numpy")
def advance(
    robot: np.ndarray,
    law: np.ndarray,
    gravity: float,
    step: float,
    sweeps: int,
    torque: np.ndarray,
    outside: np.ndarray,
    now: np.ndarray,
    then: np.ndarray,
) -> tuple[int, float]:
    """Reference `closed_chain.advanced`.

    Args:
        robot: From `mechanism.pack`.
        law: (6, 6) of friction.
        gravity: [m/s^2].
        step: [s].
        sweeps: Over the motors, of friction.
        torque: (6,) [N m] asked of the motors.
        outside: (6,) [N m, N] wrench on the platform.
        now: (36,) `CHAIN_STATE`.
        then: (36,) out, a step later.

    Returns:
        -1, or the leg that cannot span; its margin.
    """
    legs, lines, turn, turned = np.empty((6, 14)), np.empty((6, 6)), np.empty((3, 3)), np.empty((3, 3))
    jacobian, inertia, columns = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 7))
    wrench, own, still = np.empty((6, 1)), np.empty(6), np.zeros(6)
    rates, mobility, dry = np.empty(6), np.empty((6, 6)), np.empty(6)
    rubs = False
    for i in range(6):
        rubs = rubs or law[BREAK_AWAY, i] > 0.0 or law[VISCOUS, i] > 0.0
    bad = leg_vectors(robot, now[: _S.pose_rate], legs)
    if bad >= 0:
        return bad, legs[bad, 13]
    pose, twist = now[: _S.pose_rate], now[_S.twist : _S.angles]
    rod_lines(legs, lines)
    rotation(pose[:3], turn)
    task_inertia(robot, legs, lines, turn, inertia)
    loads(robot, legs, turn, twist, still, gravity, wrench, own)
    # M a = J' (torque - own) - wrench + what pushes from outside; beside it M^-1 J' for friction.
    for k in range(6):
        columns[k, 6] = outside[k] - wrench[k, 0]
    for i in range(6):
        limit = scalar(robot, EFFORT + i)
        asked = min(max(torque[i], -limit), limit) - own[i]
        inverse = 1.0 / (robot[i, CRANK_LENGTH] * legs[i, 12])
        for k in range(6):
            jacobian[i, k] = lines[i, k] * inverse
            columns[k, i] = jacobian[i, k]
            columns[k, 6] += jacobian[i, k] * asked
    solve(inertia, columns)
    for k in range(6):
        then[_S.twist + k] = twist[k] + step * columns[k, 6]
    if rubs:
        for i in range(6):
            rates[i] = 0.0
            for k in range(6):
                rates[i] += jacobian[i, k] * then[_S.twist + k]
                mobility[i, k] = 0.0
                for m in range(6):
                    mobility[i, k] += jacobian[i, m] * columns[m, k]
        bristles = now[_S.anchor :].reshape((2, 6))
        implicit_torque(law, bristles, now[_S.angles : _S.anchor], rates, mobility, step, sweeps, dry)
        for k in range(6):
            for i in range(6):
                then[_S.twist + k] += step * columns[k, i] * dry[i]
    _turn(turn, then[_S.twist : _S.twist + 3], step, turned)
    then[0] = np.arctan2(turned[2, 1], turned[2, 2])
    then[1] = np.arcsin(min(1.0, max(-1.0, -turned[2, 0])))
    then[2] = np.arctan2(turned[1, 0], turned[0, 0])
    for k in range(6):
        then[_S.pose_rate + k] = then[_S.twist + k]
    euler_rates(then[:3], then[_S.pose_rate : _S.pose_rate + 3])
    for k in range(3):
        then[3 + k] = pose[3 + k] + step * then[_S.twist + 3 + k]
    bad = leg_vectors(robot, then[: _S.pose_rate], legs)
    if bad >= 0:
        return bad, legs[bad, 13]
    for i in range(6):
        along, up = 0.0, 0.0
        for k in range(3):
            along += legs[i, 3 + k] * robot[i, ZERO + k]
            up += legs[i, 3 + k] * robot[i, QUARTER + k]
        ahead = np.arctan2(up, along) - now[_S.angles + i]
        then[_S.angles + i] = now[_S.angles + i] + ahead - 2.0 * np.pi * np.rint(ahead / (2.0 * np.pi))
    then[_S.anchor :] = now[_S.anchor :]
    moved(law, then[_S.anchor :].reshape((2, 6)), then[_S.angles : _S.anchor], step)
    return -1, 0.0


@njit(cache=True, error_model="numpy")
def _turn(turn: np.ndarray, omega: np.ndarray, step: float, out: np.ndarray) -> None:
    """R_BP (3, 3) after a step of a quaternion along its rate at an angular velocity in B, made of length one again."""
    x, y, z = 0.5 * step * omega[0], 0.5 * step * omega[1], 0.5 * step * omega[2]
    scale = 2.0 / (1.0 + x * x + y * y + z * z)
    for k in range(3):
        a, b, c = turn[0, k], turn[1, k], turn[2, k]
        # v + 2 q x (v + q x v) / (1 + q q)
        u, v, w = a + y * c - z * b, b + z * a - x * c, c + x * b - y * a
        out[0, k] = a + scale * (y * w - z * v)
        out[1, k] = b + scale * (z * u - x * w)
        out[2, k] = c + scale * (x * v - y * u)
