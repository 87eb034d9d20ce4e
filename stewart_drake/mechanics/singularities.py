"""How near a pose is to where the robot cannot be controlled: out of reach, or at a singularity; and who acts how near.

At a serial singularity a crank is in line with its rod, at its dead centre; at a parallel one the rods' lines lose rank
and cannot hold the platform.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.mechanics.kinematics_laws import conditioning, crank_rates, legs_at
from stewart_drake.mechanics.linear_algebra import solve


class Distance(NamedTuple):
    """Smallest distances from singularities of both kinds that someone accepts."""

    transmission: float  # [-] |e_l . e_N| of a crank, zero at its dead centre.
    conditioning: float  # [-] sigma_min / sigma_max of the rods' lines, zero where they lose rank.


PLANNED = Distance(0.2, 0.05)
"""Of a motion that is asked for, the default of `limits`: what tracking errors take must still be left above the next.
"""
MONITORED = Distance(0.1, 0.04)
"""Where the safety layer takes over, the default of `safety`: no planned motion comes there, and the robot can still be
stopped before the next."""
WEIGHT_TRUSTED = Distance(0.02, 0.01)
"""Where the safety layer no longer trusts the torque that carries the weight, and keeps the last one."""
CONTROLLED = Distance(0.02, 0.005)
"""Where no controller acts: the force map, and with it every gain, loses its meaning."""
ASSEMBLED = 1e-6
"""[-] transmission, and sine of a rod's angle from its joint's axis, below which a state has no velocities."""
DEAD_CENTRE = 1e-9
"""[-] transmission that counts at least for the speed of a crank, so that it stays a number."""


@njit
def measure_pose(
    robot: Any, pose: Any, twist: Any, tolerance: float, enough: float, legs: Any, right: Any, out: Any
) -> bool:
    """Reach, distance from singularities and crank speeds at a pose: the law of planning and of the safety layer.

    Args:
        robot: `Robot` record.
        pose: (6,) [rad, m].
        twist: (6,) [rad/s, m/s].
        tolerance: Of `conditioning`.
        enough: Likewise.
        legs: `Legs` record, out; a lever at a dead centre is that of `DEAD_CENTRE`.
        right: (6, k) right sides of equations whose matrix is the rods' lines, solved in place.
        out: Record with `reach_margin` (6,) as in `Legs` and `transmission` (6,) |e_l . e_N|, zero of a leg that cannot
            span. Where all legs span also `conditioning`, `assembly_sign`, the sign of the lines' determinant, and
            `speed` (6,) of the cranks [rad/s]; elsewhere these are left as they were.

    Returns:
        Whether all legs span.
    """
    spans = legs_at(robot, pose, legs) < 0
    for i in range(6):
        # So far off that squares leave floating point: beyond any reach.
        out.reach_margin[i] = -np.inf if np.isnan(legs.reach_margin[i]) else legs.reach_margin[i]
        out.transmission[i] = abs(legs.transmission[i]) if out.reach_margin[i] >= 0.0 else 0.0
    if spans:
        out.conditioning = conditioning(robot, legs, tolerance, enough)
        out.assembly_sign = solve(legs.line.copy(), right)
        crank_speeds(robot, legs, twist, out.speed[:])
    return spans


@njit
def crank_speeds(robot: Any, legs: Any, twist: Any, out: Any) -> None:
    """Rates of the cranks (6,) [rad/s] from a twist (6,), finite at a dead centre, whose lever they change."""
    for i in range(6):
        if abs(legs.transmission[i]) < DEAD_CENTRE:
            legs.lever[i] = DEAD_CENTRE * robot.crank_length[i] * (-1.0 if legs.transmission[i] < 0.0 else 1.0)
    crank_rates(legs, twist, out)
