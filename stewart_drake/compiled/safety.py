"""A tick of the safety layer in which nothing is wrong."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import SAFETY_MEMORY, SAFETY_NUMBERS
from stewart_drake.compiled.dynamics import platform_moment
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
    rod_lines,
    rotation,
    scalar,
    speed_along,
)

_M, _N = SAFETY_MEMORY, SAFETY_NUMBERS


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
        numbers: `SAFETY_NUMBERS`.
        command: (6,) [N m].
        measured: (12,).
        reference: (18,).
        memory: `SAFETY_MEMORY` of the tick before.
        result: Out, that of this tick; worthless where the answer is False.

    Returns:
        Whether nothing was wrong; if not, ask the reference.
    """
    if memory[_M.level] != 0.0:
        return False
    result[:] = memory
    ahead, legs, lines = np.empty(6), np.empty((6, 14)), np.empty((6, 6))
    turn, wanted = np.empty((3, 3)), np.empty((3, 3))
    for k in range(6):
        if not (
            np.isfinite(measured[k]) and np.isfinite(measured[6 + k]) and abs(command[k]) < numbers[_N.torque_limit + k]
        ):
            return False
        change = max(abs(command[k] - memory[_M.torque + k]), abs(command[k] - memory[_M.command + k]))
        if memory[_M.ticks] > 0.0 and not change <= numbers[_N.torque_change]:
            return False
        ahead[k] = measured[k] + numbers[_N.horizon] * measured[6 + k]
    rotation(ahead[:3], turn)
    if not _angle(turn[0, 0] + turn[1, 1] + turn[2, 2]) <= numbers[_N.workspace_angle]:
        return False
    if not np.sqrt(((ahead[3:] - numbers[_N.home : _N.refill]) ** 2).sum()) <= numbers[_N.workspace_position]:
        return False
    rotation(measured[:3], turn)
    rotation(reference[:3], wanted)
    if not _angle((turn * wanted).sum()) <= numbers[_N.following_angle]:
        return False
    if not np.sqrt(((measured[3:6] - reference[3:6]) ** 2).sum()) <= numbers[_N.following_position]:
        return False
    if leg_vectors(robot, ahead, legs) >= 0:
        return False
    rod_lines(legs, lines)
    conditioning, smallest = line_conditioning(robot, lines), np.abs(legs[:, 12]).min()
    if not (conditioning >= numbers[_N.conditioning] and smallest >= numbers[_N.transmission]):
        return False
    if not (conditioning > numbers[_N.usable_conditioning] and smallest > numbers[_N.usable_transmission]):
        return False
    omega = np.empty(3)
    angular_velocity(measured[:3], measured[6:9], omega)
    for i in range(6):
        along = speed_along(lines, i, omega, measured[9:])
        if not abs(along / (robot[i, CRANK_LENGTH] * legs[i, 12])) <= numbers[_N.crank_speed]:
            return False
    half = 0.5 * scalar(robot, ROD_MASS) * numbers[_N.gravity]
    transposed, forces = np.empty((6, 6)), np.zeros((6, 1))
    for i in range(6):
        forces[0, 0] += half * legs[i, 1]
        forces[1, 0] -= half * legs[i, 0]
        for k in range(6):
            transposed[k, i] = lines[i, k]
    rotation(ahead[:3], turn)
    c0, c1, _ = platform_moment(robot, turn)
    forces[0, 0] += numbers[_N.gravity] * c1
    forces[1, 0] -= numbers[_N.gravity] * c0
    forces[5, 0] = scalar(robot, PLATFORM_MASS) * numbers[_N.gravity] + 6.0 * half
    side = solve(transposed, forces)
    if side == 0.0 or (memory[_M.side] != 0.0 and side != memory[_M.side]):
        return False
    own = half + 0.5 * scalar(robot, CRANK_MASS) * numbers[_N.gravity]
    for i in range(6):
        a = robot[i, CRANK_LENGTH]
        result[_M.torque + i] = result[_M.good + i] = result[_M.command + i] = command[i]
        result[_M.weight + i] = a * legs[i, 12] * forces[i, 0] + a * own * legs[i, 8]
    result[_M.monitor], result[_M.leg] = 0.0, -1.0
    result[_M.held] = max(0.0, memory[_M.held] - numbers[_N.refill])
    result[_M.at_limit] = max(0.0, memory[_M.at_limit] - 1.0)
    result[_M.too_fast] = max(0.0, memory[_M.too_fast] - 1.0)
    result[_M.surprised] = max(0.0, memory[_M.surprised] - 1.0)
    result[_M.side], result[_M.ticks] = side, memory[_M.ticks] + 1.0
    return True


@njit(cache=True, error_model="numpy")
def moving(
    readings: np.ndarray,
    compared: np.ndarray,
    together: bool,
    limits: np.ndarray,
    memory: np.ndarray,
    after: np.ndarray,
) -> bool:
    """Reference `safety.frozen_tick`, as long as no sensor may be one that repeats itself.

    Args:
        readings: (6,) of encoders [rad], or a pose.
        compared: (6,) the same readings, or the pose that is wanted.
        together: Whether readings repeat all at once, or each for itself; then it is the last but one that tells.
        limits: (6,) by which what they are compared with may move meanwhile.
        memory: (42,) of the tick before.
        after: (42,) out, of this tick.

    Returns:
        False where the reference has to look.
    """
    same = True
    for k in range(6):
        same = same and readings[k] == memory[k]
    quiet = True
    for i in range(6):
        after[i] = readings[i]
        repeats = same if together else readings[i] == memory[i]
        most, travel = 0.0, 0.0
        for k in range(6):
            anchor = memory[6 + 6 * i + k] if repeats else compared[k]
            after[6 + 6 * i + k] = anchor
            moved = abs(compared[k] - anchor)
            if together:
                quiet = quiet and not moved > limits[k]
                continue
            # What is no number counts as the largest, as a sort has it.
            moved = moved if moved < np.inf else np.inf
            if moved > most:
                most, travel = moved, most
            elif moved > travel:
                travel = moved
        quiet = quiet and not travel > limits[i]
    return quiet


@njit(cache=True, error_model="numpy", inline="always")
def _angle(trace: float) -> float:
    """Angle [rad] of a rotation with this trace."""
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))
