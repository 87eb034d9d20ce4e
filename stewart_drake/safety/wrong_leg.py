"""Which leg's reading is wrong, by how the orientation of the readings differs from that of an inertial sensor."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat6x3, Vec3
from stewart_drake.mechanics.kinematics_laws import Legs, dot
from stewart_drake.mechanics.linear_algebra import solve

ONE_LINE, OTHER_LINES = 0.35, 0.7
"""Share of the difference that is off a leg's line, below which the leg is named; and its largest share of that of the
next leg."""


@njit
def encoder_lines(legs: Legs, out: Mat6x3) -> bool:
    """Turn of the platform [rad] in B per radian of each crank, rows (6, 3); False at a singularity."""
    columns, lines = np.zeros((6, 6)), legs.line.copy()
    for i in range(6):
        columns[i, i] = legs.lever[i]
    if solve(lines, columns) == 0.0:
        return False
    for i in range(6):
        for k in range(3):
            out[i, k] = columns[k, i]
    return True


@njit
def suspect_leg(lines: Mat6x3, difference: Vec3, down: Vec3) -> tuple[int, float]:
    """The leg along whose line (6, 3) a difference (3,) [rad] lies, and the error [rad] of its reading; -1 for none.

    The part of the difference along `down`, a unit vector, may have decayed; zeros where nothing has. None: the
    inertial sensor is wrong, or more than one encoder.
    """
    level, own, size = np.empty(3), np.empty(3), np.sqrt(dot(difference, difference))
    leg, error, best, second, part = -1, 0.0, np.inf, np.inf, dot(difference, down)
    for k in range(3):
        level[k] = difference[k] - part * down[k]
    for i in range(6):
        along = dot(lines[i], down)
        for k in range(3):
            own[k] = lines[i, k] - along * down[k]
        angle = dot(own, level) / dot(own, own)
        left = part - min(max(part, min(0.0, angle * along)), max(0.0, angle * along))
        rest = left * left
        for k in range(3):
            rest += (level[k] - angle * own[k]) ** 2
        rest = np.sqrt(rest) / size
        if rest < best:
            leg, error, best, second = i, angle, rest, best
        elif rest < second:
            second = rest
    if best < ONE_LINE and best < OTHER_LINES * second:
        return leg, error
    return -1, 0.0
