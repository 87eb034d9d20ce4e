"""Singular poses along rays from home, serial and parallel told apart, and the rank of (28) there."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from stewart_drake.control.state_space import hautus_stabilisability, input_matrix, mass_diagonal, state_matrix
from stewart_drake.mechanics.force_map import ForceMapKind, force_map_of_legs
from stewart_drake.mechanics.kinematics import LegGeometry, leg_geometry, line_conditioning, reach_margin, rod_lines
from stewart_drake.robot import RobotParameters

DEAD = 1e-6
"""[-] a transmission below this is a dead centre found by bisection: it vanishes with the root of the distance."""


@dataclass(frozen=True)
class Singularity:
    """The first singular pose on a ray from home.

    Attributes:
        kind: `serial`, a crank at its dead centre, or `parallel`, the rods' lines of rank five.
        direction: (6,) [rad, m] step along the ray per unit of `distance`.
        distance: [-] how far along the ray.
        leg: The crank of a serial one, 0..5.
    """

    kind: Literal["serial", "parallel"]
    direction: np.ndarray
    distance: float
    leg: int | None = None

    def pose(self, robot: RobotParameters, back: float = 0.0) -> np.ndarray:
        """(6,) [rad, m] the pose, or one `back` short of it in units of `distance`."""
        return np.asarray(robot.home_pose + (self.distance - back) * self.direction)


def first_singularity(
    robot: RobotParameters, direction: np.ndarray, most: float, samples: int = 400
) -> Singularity | None:
    """Follows a ray from home until a crank reaches its dead centre or the determinant of the rods' lines changes sign.

    Args:
        robot: Geometry; home must be regular.
        direction: (6,) [rad, m] per unit of distance.
        most: Where the search ends, in units of distance.
        samples: Poses looked at on the way; two sign changes between neighbours go unseen.

    Returns:
        The first singularity, to the last digits; None where there is none.
    """

    def margin(distance: float) -> float:
        return float(reach_margin(robot, robot.home_pose + distance * direction).min())

    def determinant(distance: float) -> float:
        return float(np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose + distance * direction))))

    distances = np.linspace(0.0, most, samples + 1)
    reached = reach_margin(robot, robot.home_pose + distances[:, None] * direction).min(axis=-1) >= 0.0
    inside = len(distances) if reached.all() else int(reached.argmin())
    end = most
    if inside < len(distances):
        end = brentq(margin, distances[inside - 1], distances[inside], xtol=1e-16, rtol=1e-15)
        while margin(end) < 0.0:
            end = float(np.nextafter(end, 0.0))
    walk = distances[:inside]
    if inside < len(distances) and end > walk[-1]:
        walk = np.append(walk, end)
    signs = np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose + walk[:, None] * direction)))
    crossed = signs * signs[0] < 0.0
    if crossed.any():
        at = int(crossed.argmax())
        distance = brentq(determinant, walk[at - 1], walk[at], xtol=1e-16, rtol=1e-15)
        return Singularity("parallel", direction, float(distance))
    if inside == len(distances):
        return None
    leg = int(reach_margin(robot, robot.home_pose + end * direction).argmin())
    return Singularity("serial", direction, float(end), leg)


def measures(robot: RobotParameters, pose: np.ndarray) -> dict[str, float]:
    """What tells singularities apart: least `transmission` of a leg and `conditioning` of the rods' lines [-]."""
    legs = _dead_made_exact(leg_geometry(robot, pose))
    return {
        "transmission": float(np.abs(legs.transmission).min()),
        "conditioning": float(line_conditioning(robot, legs)),
    }


def stabilisability_rank(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind) -> int | None:
    """Rank (28) of [lambda I - A, B] at a pose; None where the map is infinite."""
    legs = _dead_made_exact(leg_geometry(robot, pose))
    if kind == "statics" and not legs.transmission.all():
        return None
    return hautus_stabilisability(state_matrix(), input_matrix(_acceleration_map(robot, legs, kind)))


def nonzero_columns(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind) -> int:
    """Columns of B that are not zero, which the paper's text counts in place of the rank."""
    return int(np.any(_acceleration_map(robot, _dead_made_exact(leg_geometry(robot, pose)), kind) != 0.0, axis=0).sum())


def _acceleration_map(robot: RobotParameters, legs: LegGeometry, kind: ForceMapKind) -> np.ndarray:
    return np.asarray(force_map_of_legs(robot, legs, kind) / mass_diagonal(robot)[:, None])


def _dead_made_exact(legs: LegGeometry) -> LegGeometry:
    """Legs whose transmission is rounding away from zero are put at zero."""
    dead = np.abs(legs.transmission) < DEAD
    return dataclasses.replace(legs, transmission=np.where(dead, 0.0, legs.transmission))
