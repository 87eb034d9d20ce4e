"""A tick of the safety layer in which nothing is wrong."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.jit import njit
from stewart_drake.compiled.linear_algebra import solve
from stewart_drake.compiled.mechanism import (
    CRANK_LENGTH,
    CRANK_MASS,
    PLATFORM_MASS,
    ROD_MASS,
    angular_velocity,
    leg_vectors,
    line_conditioning,
    platform_moment,
    rod_lines,
    rotation,
    scalar,
)


@njit(cache=True, error_model="numpy")
def quiet_tick(
    robot: np.ndarray,
    numbers: np.ndarray,
    command: np.ndarray,
    measured: np.ndarray,
    reference: np.ndarray,
    memory: np.ndarray,
    result: np.ndarray,
) -> bool:
    """Reference `safety.safety_tick`, as long as no monitor has anything to say.

    Args:
        robot: From `mechanism.pack`.
        numbers: (17,) horizon [s], workspace [rad, m], transmission, conditioning, crank speed [rad/s], following error
            [rad, m], torque limit [N m], change of torque in a tick [N m], gravity [m/s^2], home position [m] (3),
            budget given back, usable transmission, usable conditioning.
        command: (6,) [N m].
        measured: (12,).
        reference: (18,).
        memory: (39,) of the tick before, `safety.SafetyMemory`.
        result: (39,) out, that of this tick; worthless where the answer is False.

    Returns:
        Whether nothing was wrong; if not, ask the reference.
    """
    if memory[6] != 0.0:
        return False
    result[:] = memory
    ahead, legs, lines = np.empty(6), np.empty((6, 14)), np.empty((6, 6))
    turn, wanted = np.empty((3, 3)), np.empty((3, 3))
    for k in range(6):
        if not (np.isfinite(measured[k]) and np.isfinite(measured[6 + k]) and abs(command[k]) < numbers[8]):
            return False
        change = max(abs(command[k] - memory[k]), abs(command[k] - memory[33 + k]))
        if memory[26] > 0.0 and not change <= numbers[9]:
            return False
        ahead[k] = measured[k] + numbers[0] * measured[6 + k]
    rotation(ahead[:3], turn)
    if not _angle(turn[0, 0] + turn[1, 1] + turn[2, 2]) <= numbers[1]:
        return False
    if not np.sqrt(((ahead[3:] - numbers[11:14]) ** 2).sum()) <= numbers[2]:
        return False
    rotation(measured[:3], turn)
    rotation(reference[:3], wanted)
    if not _angle((turn * wanted).sum()) <= numbers[6]:
        return False
    if not np.sqrt(((measured[3:6] - reference[3:6]) ** 2).sum()) <= numbers[7]:
        return False
    if leg_vectors(robot, ahead, legs) >= 0:
        return False
    rod_lines(legs, lines)
    conditioning, smallest = line_conditioning(robot, lines), np.abs(legs[:, 12]).min()
    if not (conditioning >= numbers[4] and smallest >= numbers[3]):
        return False
    if not (conditioning > numbers[16] and smallest > numbers[15]):
        return False
    omega = np.empty(3)
    angular_velocity(measured[:3], measured[6:9], omega)
    for i in range(6):
        along = 0.0
        for k in range(3):
            along += lines[i, k] * omega[k] + lines[i, 3 + k] * measured[9 + k]
        if not abs(along / (robot[i, CRANK_LENGTH] * legs[i, 12])) <= numbers[5]:
            return False
    half = 0.5 * scalar(robot, ROD_MASS) * numbers[10]
    transposed, forces = np.empty((6, 6)), np.zeros((6, 1))
    for i in range(6):
        forces[0, 0] += half * legs[i, 1]
        forces[1, 0] -= half * legs[i, 0]
        for k in range(6):
            transposed[k, i] = lines[i, k]
    rotation(ahead[:3], turn)
    c0, c1, _ = platform_moment(robot, turn)
    forces[0, 0] += numbers[10] * c1
    forces[1, 0] -= numbers[10] * c0
    forces[5, 0] = scalar(robot, PLATFORM_MASS) * numbers[10] + 6.0 * half
    side = solve(transposed, forces)
    if side == 0.0 or (memory[25] != 0.0 and side != memory[25]):
        return False
    own = half + 0.5 * scalar(robot, CRANK_MASS) * numbers[10]
    for i in range(6):
        a = robot[i, CRANK_LENGTH]
        result[i] = result[9 + i] = result[33 + i] = command[i]
        result[15 + i] = a * legs[i, 12] * forces[i, 0] + a * own * legs[i, 8]
    result[7], result[8] = 0.0, -1.0
    result[21] = max(0.0, memory[21] - numbers[14])
    result[22] = max(0.0, memory[22] - 1.0)
    result[23] = max(0.0, memory[23] - 1.0)
    result[25], result[26] = side, memory[26] + 1.0
    return True


@njit(cache=True, error_model="numpy", inline="always")
def _angle(trace: float) -> float:
    """Angle [rad] of a rotation with this trace."""
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))
