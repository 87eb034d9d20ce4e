"""Distance of a pose from where the robot cannot be controlled: the end of its reach and its singularities.

At a serial singularity a crank is in line with its rod, at its dead centre; at a parallel one the rods' lines lose rank
and cannot hold the platform.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Record, Vec6
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, conditioning, crank_rates, legs_at
from stewart_drake.mechanics.linear_algebra import solve


class Distance(NamedTuple):
    """Smallest distances from singularities of both kinds that are accepted."""

    transmission: float  # [-] |e_l . e_N| of a crank, zero at its dead centre.
    conditioning: float  # [-] sigma_min / sigma_max of the rods' lines, zero where they lose rank.


PLANNED = Distance(0.2, 0.05)
"""Limit for planned motions, the default of `limits`. The distance to MONITORED is room for tracking errors."""
MONITORED = Distance(0.1, 0.04)
"""Limit at which the safety layer takes over, the default of `safety`: outside of planned motions, and early enough to
stop the robot before WEIGHT_TRUSTED."""
WEIGHT_TRUSTED = Distance(0.02, 0.01)
"""Limit beyond which the torque that carries the weight is unreliable: the safety layer keeps the last reliable one."""
CONTROLLED = Distance(0.02, 0.005)
"""Limit beyond which no controller acts: the force map, and so every gain, is meaningless."""
ASSEMBLED = 1e-6
"""[-] transmission, and sine of a rod's angle from its joint's axis, below which velocities are not defined."""
DEAD_CENTRE = 1e-9
"""[-] least transmission from which the speed of a crank is computed, so that it is finite."""


class PoseMeasures(Record):
    """Reach, distance from singularities and crank speeds at a pose."""

    reach_margin: Vec6  # See `Legs.reach_margin`.
    transmission: Vec6  # |e_l . e_N|, zero of a leg that cannot span.
    conditioning: float  # See `kinematics_laws.conditioning`.
    assembly_sign: float  # Sign of the determinant of the rods' lines.
    speed: Vec6  # [rad/s] of the cranks.


@njit
def measure_pose(
    robot: Robot, pose: Vec6, twist: Vec6, tolerance: float, enough: float, legs: Legs, right: Matrix, out: PoseMeasures
) -> bool:
    """Measures of a pose, for planning and for the safety layer.

    Args:
        robot: Geometry.
        pose: [rad, m].
        twist: [rad/s, m/s].
        tolerance: Of `conditioning`.
        enough: Likewise.
        legs: Out; a lever at a dead centre is that of `DEAD_CENTRE`.
        right: (6, k) right sides of equations with the rods' lines as matrix, solved in place.
        out: Measures. Where a leg cannot span, conditioning, assembly sign and speeds are not changed.

    Returns:
        Whether all legs span.
    """
    spans = legs_at(robot, pose, legs) < 0
    for i in range(6):
        # NaN: so far off that squares overflow.
        out.reach_margin[i] = -np.inf if np.isnan(legs.reach_margin[i]) else legs.reach_margin[i]
        out.transmission[i] = abs(legs.transmission[i]) if out.reach_margin[i] >= 0.0 else 0.0
    if spans:
        out.conditioning = conditioning(robot, legs, tolerance, enough)
        out.assembly_sign = solve(legs.line.copy(), right)
        crank_speeds(robot, legs, twist, out.speed[:])
    return spans


@njit
def crank_speeds(robot: Robot, legs: Legs, twist: Vec6, out: Vec6) -> None:
    """Crank rates [rad/s] from a twist, finite at a dead centre; changes the lever there."""
    for i in range(6):
        if abs(legs.transmission[i]) < DEAD_CENTRE:
            legs.lever[i] = DEAD_CENTRE * robot.crank_length[i] * (-1.0 if legs.transmission[i] < 0.0 else 1.0)
    crank_rates(legs, twist, out)
