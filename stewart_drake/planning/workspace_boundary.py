"""Where straight ways from a pose leave the limits: the boundary of a workspace, and which limit cuts first."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.planning.limits import Limits, limit_bounds
from stewart_drake.planning.measures import measure_poses
from stewart_drake.planning.workspace import (
    COORDINATES,
    LIMIT_NAMES,
    Kind,
    check_center,
    governing_limit,
    outer_box,
    poses_at,
    utilisation,
)
from stewart_drake.robot import RobotParameters

_STEPS = 64
_BISECTIONS = 16


@dataclass(frozen=True, eq=False)
class Boundary:
    """Where straight ways from the centre leave the limits, in directions that each stand for an equal solid angle.

    Attributes:
        radius: (m,) [m] or [rad] way to the first broken limit.
        limit: (m,) index of that limit in `LIMIT_NAMES`; -1 where none is broken up to the end of the search.
    """

    radius: np.ndarray
    limit: np.ndarray

    @property
    def volume(self) -> float:
        """[m^3] or [rad^3] all that can be reached straight from the centre."""
        return float(4.0 / 3.0 * np.pi * (self.radius**3).mean())

    def first(self) -> dict[str, float]:
        """Share [-] of the directions in which each limit is the first to be broken, largest first."""
        share = np.bincount(self.limit[self.limit >= 0], minlength=len(LIMIT_NAMES)) / len(self.limit)
        return {LIMIT_NAMES[i]: float(share[i]) for i in np.argsort(-share, kind="stable") if share[i] > 0.0}


def boundary(
    robot: RobotParameters,
    limits: Limits,
    kind: Kind,
    center: np.ndarray,
    count: int = 10_000,
    gravity: float = STANDARD_GRAVITY,
    progress: Callable[[float], None] | None = None,
) -> Boundary:
    """`follow_rays` in `count` evenly spread directions."""
    return Boundary(*follow_rays(robot, limits, kind, center, spread_directions(count), gravity, progress))


def spread_directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) on a Fibonacci lattice: equal steps of height, golden steps of angle."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    level = np.sqrt(1.0 - height**2)
    return np.stack([level * np.cos(angle), level * np.sin(angle), height], axis=1)


def follow_rays(
    robot: RobotParameters,
    limits: Limits,
    kind: Kind,
    center: np.ndarray,
    directions: np.ndarray,
    gravity: float = STANDARD_GRAVITY,
    progress: Callable[[float], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Ways from the centre to the first broken limit: straight in space, or in roll, pitch, yaw.

    64 steps to the far end, pi or all that can be in reach, find the first pose outside; bisection finds the place, to
    a 65,000th of a step. A gap that lies between two steps is not seen.

    Args:
        robot: Geometry, masses, effort limit.
        limits: What to keep to.
        kind: What varies.
        center: (6,) [rad, m].
        directions: (m, 3) unit vectors.
        gravity: [m/s^2] along -z of B.
        progress: Called with the share done, 0 to 1.

    Returns:
        radius (m,) [m] or [rad] of the last pose within, and the index (m,) in `LIMIT_NAMES` of the limit that cuts,
        -1 where none does.

    Raises:
        ConfigurationError: A center that `check_center` refuses.
    """
    center = np.asarray(center, dtype=float)
    check_center(robot, center)
    bounds = limit_bounds(robot, limits)
    coordinates = COORDINATES[kind]
    longest = math.pi
    if kind == "position":
        corners = np.abs(np.array(outer_box(robot, center)) - center[3:])
        longest = float(np.linalg.norm(corners.max(axis=0)))
    inner, outer = np.zeros(len(directions)), np.full(len(directions), longest)
    limit = np.full(len(directions), -1)

    def look(rays: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Moves the inner or the outer end of each of the rays to `radius`; the rays that were within."""
        pose = poses_at(coordinates, center, center[list(coordinates)] + radius[:, None] * directions[rays])
        measures = measure_poses(robot, pose, gravity, bounds.get("torque"))
        use, cause = governing_limit(utilisation(robot, limits, pose, measures))
        out = use > 1.0
        outer[rays[out]], limit[rays[out]], inner[rays[~out]] = radius[out], cause[out], radius[~out]
        return rays[~out]

    rays, total = np.arange(len(directions)), max(1, len(directions))
    for step in range(_STEPS + 1):
        rays = look(rays, np.full(len(rays), longest * step / _STEPS))
        if progress is not None:
            progress(0.7 * (1.0 - len(rays) / total))
    cut = np.flatnonzero(limit >= 0)
    for step in range(_BISECTIONS):
        look(cut, 0.5 * (inner[cut] + outer[cut]))
        if progress is not None:
            progress(0.7 + 0.3 * (step + 1) / _BISECTIONS)
    return inner, limit
