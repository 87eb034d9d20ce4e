"""What the regression has learnt, as constants of other parts and as numbers with intervals, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import njit, record
from stewart_drake.control.arrow_factor import COMMON, JOINT, OWN, PLACE, spread_along
from stewart_drake.mechanics.kinematics_laws import Robot

LEAST_DAMPING, MOST_DAMPING, MOST_COULOMB = -0.1, 0.6, 0.4
"""Bounds [-] of the torque limit. A delay believed too long may be a damping below zero."""
HALF_WIDTH = 1.96
"""[-] of the standard deviation: half of a 95 % interval."""
ROBOT_SIZE = Robot.layout.itemsize // 8
MASS, MOMENT = (int(Robot.layout.fields[name][1]) // 8 for name in ("platform_mass", "platform_moment"))  # type: ignore[index]
"""Where mass and first moment of the head are in a robot's record."""


@njit
def stand_in(params: Any, bodies: Any, friction: Any, state: Any) -> None:
    """Constants of other parts, by the numbers that are used."""
    common, own, believed = state.used_common, state.used_own, record(friction)
    head, links = _masses_of(params, common)
    for k in range(ROBOT_SIZE):
        state.robot[k] = bodies[k, 0] + links * bodies[k, 1] + head * bodies[k, 2]
    for n in range(len(common) - COMMON - state.sharp.shape[1] + 1):
        state.robot[MOMENT + n] += links * common[COMMON + n]
    state.lead[0] = common[4]
    for i in range(6):
        damping, coulomb = _friction_of(params, own[i], common, i)
        drive = np.exp(-(common[1] + own[i, 0])) if params.by_gain == 1.0 else 1.0
        viscous, more = drive * damping - params.servo_damping, believed.break_away[i] - believed.coulomb[i]
        if params.cautious == 1.0:
            viscous *= 1.0 - _doubt(params, state, i, 1) ** 2 if viscous > 0.0 else 1.0
            known = 1.0 - _doubt(params, state, i, 2) ** 2
            coulomb, more = known * coulomb, known * more
        state.gain[i] = drive * params.gain[i]
        state.friction.coulomb[i] = drive * coulomb
        state.friction.break_away[i] = drive * coulomb + more
        state.friction.viscous[i] = viscous
    joint_count = state.sharp.shape[1] - 1
    for n in range(joint_count):
        at, known = len(common) - joint_count + n, 1.0
        if params.cautious == 1.0:
            row = np.zeros(OWN + len(common))
            row[OWN + at] = 1.0
            known -= (_deviation(params, state, 0, row) / params.common[at]) ** 2
        state.joints[n] = known * np.exp(-common[1] * params.by_gain) * common[at]


@njit
def show(params: Any, bodies: Any, state: Any) -> None:
    """The estimate with its intervals, and how far what is used may be from it."""
    common, own, row = state.held_common, state.held_own, np.zeros(OWN + len(state.common))
    head, links = _masses_of(params, common)
    state.learnt[0] = bodies[MASS, 2] * head
    row[OWN], row[OWN + 1] = state.learnt[0], state.learnt[0] * (1.0 - params.by_gain)
    state.learnt_half_width[0] = _half_width(params, state, 0, row)
    state.learnt[1] = common[4]
    if params.by_angle == 1.0:
        row[OWN + 4] = 1.0
        state.learnt_half_width[1] = _half_width(params, state, 0, row)
    for i in range(6):
        drive = np.exp(-(common[1] + own[i, 0]))
        size, values = drive if params.by_gain == 1.0 else 1.0, np.ones(OWN)
        values[1], values[2] = _friction_of(params, own[i], common, i)
        state.learnt[2 + i] = drive
        state.learnt[8 + i] = size * values[1] - params.servo_damping
        state.learnt[14 + i] = size * values[2]
        for k in range(OWN):
            row[k] = row[OWN + 1 + k] = size
            if k == 0:
                row[0] = row[OWN + 1] = -drive
            elif params.by_gain == 1.0:
                # It is a torque as believed, times the drive.
                row[0] = row[OWN + 1] = -size * values[k]
            state.learnt_half_width[2 + 6 * k + i] = _half_width(params, state, i, row)
        state.doubt[i] = _doubt(params, state, i, 2)
        of_coulomb = state.learnt[14 + i] - state.friction.coulomb[i]
        of_damping = state.learnt[8 + i] - state.friction.viscous[i]
        state.friction_unknown.coulomb[i] = state.learnt_half_width[14 + i] + abs(of_coulomb)
        state.friction_unknown.viscous[i] = state.learnt_half_width[8 + i] + abs(of_damping)
    joint_count = state.sharp.shape[1] - 1
    for n in range(joint_count):
        at, size = len(common) - joint_count + n, np.exp(-common[1] * params.by_gain)
        state.learnt_joints[n] = size * common[at]
        row[OWN + at], row[OWN + 1] = size, -size * common[at] * params.by_gain
        state.learnt_joints[JOINT + n] = _half_width(params, state, 0, row)
    for n in range(len(common) - COMMON - joint_count):
        moment = head * bodies[MOMENT + n, 2] + links * common[COMMON + n]
        state.learnt_center_of_mass[n] = moment / state.learnt[0]
        # Moment over mass: of what is beyond the believed centre, the mass is in it too.
        row[OWN + COMMON + n], row[OWN] = links / state.learnt[0], -links * common[COMMON + n] / state.learnt[0]
        state.learnt_center_of_mass[PLACE + n] = _half_width(params, state, 0, row)


@njit
def show_first(params: Any, bodies: Any, state: Any) -> None:
    """`show` of arrays, before the first tick."""
    show(record(params), bodies, record(state))


@njit
def _half_width(params: Any, state: Any, leg: int, row: Any) -> float:
    """Half the 95 % interval of a motor's numbers times a row, which becomes zero."""
    wide = HALF_WIDTH * _deviation(params, state, leg, row)
    row[:] = 0.0
    return wide


@njit
def _doubt(params: Any, state: Any, leg: int, which: int) -> float:
    """Standard deviation of a number of a motor, over that at first."""
    row = np.zeros(OWN + len(state.common))
    row[which] = row[OWN + 1 + which] = 1.0
    return _deviation(params, state, leg, row) / np.hypot(params.common[1 + which], params.own[which])


@njit
def _deviation(params: Any, state: Any, leg: int, row: Any) -> float:
    """Standard deviation of a motor's numbers times a row, at most what the uncertainty of the beginning gives."""
    first = 0.0
    for k in range(len(row)):
        first += (row[k] * (params.own[k] if k < OWN else params.common[k - OWN])) ** 2
    variance = state.noise_scale**2 * spread_along(state.information[leg], state.shared, row)
    return np.sqrt(min(variance, first))


@njit
def _masses_of(params: Any, common: Any) -> Any:
    """Mass of the head, and of cranks and rods, in units of what is believed."""
    links = np.exp(common[1]) if params.by_gain == 0.0 else 1.0
    return links * np.exp(common[0]), links


@njit
def _friction_of(params: Any, own: Any, common: Any, leg: int) -> Any:
    """Damping [N m s/rad] and Coulomb friction [N m] of a motor, within bounds, in units of its command's torque."""
    limit = params.limit[leg]
    damping, coulomb = params.damping[leg] + common[2] + own[1], common[3] + own[2]
    # What an earlier run has learnt, and is believed now, is not cut.
    most_damping = max(MOST_DAMPING * limit, params.damping[leg])
    most_coulomb = max(MOST_COULOMB * limit, params.coulomb[leg])
    return min(max(damping, LEAST_DAMPING * limit), most_damping), min(max(coulomb, 0.0), most_coulomb)
