"""Where straight ways from a pose leave the limits: the boundary of a workspace, and which limit cuts first."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stewart_drake.limits import Limits, limit_bounds
from stewart_drake.rigid_body_model import STANDARD_GRAVITY
from stewart_drake.robot import RobotParameters
from stewart_drake.workspace import measure_poses
from stewart_drake.workspace_region import LIMIT_NAMES, Kind, governing_limit, outer_box, poses_at, utilisation, varied

_STEPS = 64
_BISECTIONS = 20


@dataclass(frozen=True, eq=False)
class Boundary:
    """Where straight ways from the centre leave the limits.

    Attributes:
        kind: What varies.
        center: (6,) [rad, m].
        directions: (m, 3) unit vectors, evenly spread.
        triangles: (k, 3) indices of the directions: faces of the surface.
        radius: (m,) [m] or [rad] way to the first broken limit.
        limit: (m,) index of that limit in `LIMIT_NAMES`; -1 where none is broken up to the end of the search.
    """

    kind: Kind
    center: np.ndarray
    directions: np.ndarray
    triangles: np.ndarray
    radius: np.ndarray
    limit: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """(m, 3) [m] or [rad] the surface."""
        return self.center[varied(self.kind)] + self.radius[:, None] * self.directions

    @property
    def volume(self) -> float:
        """[m^3] or [rad^3] inside the surface: all that can be seen from the centre."""
        corners = (self.radius[:, None] * self.directions)[self.triangles]
        return float(np.abs(np.linalg.det(corners)).sum() / 6.0)

    def first(self) -> dict[str, float]:
        """Share [-] of the directions in which each limit is the first to be broken, largest first."""
        count = np.bincount(self.limit[self.limit >= 0], minlength=len(LIMIT_NAMES)) / len(self.limit)
        order = np.argsort(-count, kind="stable")
        return {LIMIT_NAMES[i]: float(count[i]) for i in order if count[i] > 0.0}


def boundary(
    robot: RobotParameters,
    limits: Limits,
    kind: Kind,
    center: np.ndarray,
    subdivisions: int = 4,
    gravity: float = STANDARD_GRAVITY,
    progress: Callable[[float], None] | None = None,
) -> Boundary:
    """`follow_rays` in all directions, evenly.

    Args:
        robot: Geometry, masses, effort limit.
        limits: What to keep to.
        kind: What varies.
        center: (6,) [rad, m].
        subdivisions: See `icosphere`.
        gravity: [m/s^2] along -z of B.
        progress: Called with the share done, 0 to 1.

    Raises:
        ConfigurationError: No position can be reached at this orientation.
    """
    directions, triangles = icosphere(subdivisions)
    radius, limit = follow_rays(robot, limits, kind, center, directions, gravity, progress)
    return Boundary(kind, np.asarray(center, dtype=float), directions, triangles, radius, limit)


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
    a millionth of a step. A gap that lies between two steps is not seen.

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
        ConfigurationError: No position can be reached at this orientation.
    """
    center = np.asarray(center, dtype=float)
    bounds = limit_bounds(robot, limits)
    longest = math.pi
    if kind == "position":
        corners = np.abs(np.array(outer_box(robot, center)) - center[3:])
        longest = float(np.linalg.norm(corners.max(axis=0)))
    inner, outer = np.zeros(len(directions)), np.full(len(directions), longest)
    limit = np.full(len(directions), -1)

    def look(rays: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Moves the inner or the outer end of each of the rays to `radius`; the rays that were within."""
        pose = poses_at(kind, center, center[varied(kind)] + radius[:, None] * directions[rays])
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


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread unit vectors (m, 3) and the triangles (k, 3) between them, outward.

    Args:
        subdivisions: How often each triangle of an icosahedron is cut into four.
    """
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    cyclic = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    corners = np.array([np.roll(v, shift) for shift in range(3) for v in cyclic]) / math.sqrt(1.0 + golden**2)
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1)
    near = (apart > 0.0) & (apart < 1.1)  # edges of length 1.05
    triangles = [
        (i, j, k) if np.linalg.det(corners[[i, j, k]]) > 0.0 else (i, k, j)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    vertices, faces = corners, np.array(triangles)
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].sum(axis=1)
        a, b, c = faces.T
        ab, bc, ca = (len(vertices) + index.reshape(-1, 3)).T
        vertices = np.concatenate([vertices, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        faces = np.concatenate([np.stack(f, axis=1) for f in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return vertices, faces
