"""Where straight ways from a pose leave the limits: the boundary of a workspace, and which limit cuts first."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.planning.limits import Limits, limit_bounds
from stewart_drake.planning.workspace import measure_poses
from stewart_drake.planning.workspace_region import (
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
_SHARP = math.cos(math.radians(12.0))


@dataclass(frozen=True, eq=False)
class Boundary:
    """Where straight ways from the centre leave the limits: a closed surface of triangles.

    Attributes:
        kind: What varies.
        center: (6,) [rad, m].
        directions: (m, 3) unit vectors.
        triangles: (k, 3) indices of the directions, outward.
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
        return self.center[list(COORDINATES[self.kind])] + self.radius[:, None] * self.directions

    @property
    def volume(self) -> float:
        """[m^3] or [rad^3] inside the surface: all that can be reached straight from the centre."""
        corners = (self.radius[:, None] * self.directions)[self.triangles]
        return float(np.linalg.det(corners).sum() / 6.0)

    @cached_property
    def weight(self) -> np.ndarray:
        """(m,) [-] part of all directions that each stands for; a third of the solid angle of its triangles."""
        a, b, c = np.moveaxis(self.directions[self.triangles], 1, 0)
        cosines = np.sum(a * b, axis=-1) + np.sum(b * c, axis=-1) + np.sum(c * a, axis=-1)
        angle = 2.0 * np.arctan2(np.linalg.det(self.directions[self.triangles]), 1.0 + cosines)
        share = np.repeat(angle / (12.0 * np.pi), 3)
        return np.bincount(self.triangles.ravel(), share, minlength=len(self.directions))

    def first(self) -> dict[str, float]:
        """Share [-] of the directions in which each limit is the first to be broken, largest first."""
        cut = self.limit >= 0
        share = np.bincount(self.limit[cut], self.weight[cut], minlength=len(LIMIT_NAMES))
        return {LIMIT_NAMES[i]: float(share[i]) for i in np.argsort(-share, kind="stable") if share[i] > 0.0}


def boundary(
    robot: RobotParameters,
    limits: Limits,
    kind: Kind,
    center: np.ndarray,
    subdivisions: int = 4,
    refinements: int = 3,
    gravity: float = STANDARD_GRAVITY,
    progress: Callable[[float], None] | None = None,
) -> Boundary:
    """`follow_rays` in all directions, more of them where the surface has an edge.

    Args:
        robot: Geometry, masses, effort limit.
        limits: What to keep to.
        kind: What varies.
        center: (6,) [rad, m].
        subdivisions: Of the icosahedron to start from, see `icosphere`.
        refinements: How often to halve the triangles' sides along edges.
        gravity: [m/s^2] along -z of B.
        progress: Called with the share done, 0 to 1.

    Raises:
        ConfigurationError: A center that `workspace_region.check_center` refuses.
    """

    def follow(directions: np.ndarray, done: int) -> tuple[np.ndarray, np.ndarray]:
        def advance(share: float) -> None:
            if progress is not None:
                progress((done + share) / (1 + refinements))

        return follow_rays(robot, limits, kind, center, directions, gravity, advance)

    directions, triangles = icosphere(subdivisions)
    radius, limit = follow(directions, 0)
    for done in range(refinements):
        old = len(directions)
        directions, triangles = split_edges(
            directions, triangles, _sharp_edges(radius[:, None] * directions, limit, triangles)
        )
        more = follow(directions[old:], done + 1)
        radius, limit = np.concatenate([radius, more[0]]), np.concatenate([limit, more[1]])
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
        ConfigurationError: A center that `workspace_region.check_center` refuses.
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


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread unit vectors (m, 3), m = 10 * 4^subdivisions + 2, and the triangles (k, 3) between them, outward.

    Args:
        subdivisions: How often each triangle of an icosahedron is cut into four.
    """
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    cyclic = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    vertices = np.array([np.roll(v, shift) for shift in range(3) for v in cyclic]) / math.sqrt(1.0 + golden**2)
    near = np.linalg.norm(vertices[:, None] - vertices, axis=-1) < 1.1  # edges of length 1.05
    i, j, k = np.array([(a, b, c) for a in range(12) for b in range(a) for c in range(b)]).T
    triangles = np.stack([i, j, k], axis=1)[near[i, j] & near[j, k] & near[i, k]]
    inward = np.linalg.det(vertices[triangles]) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    for _ in range(subdivisions):
        every = _edges(triangles)[0]
        vertices, triangles = split_edges(vertices, triangles, np.ones(len(every), dtype=bool))
    return vertices, triangles


def split_edges(vertices: np.ndarray, triangles: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cuts chosen edges of a mesh on the unit sphere in the middle, and the triangles with them; no gaps arise.

    Args:
        vertices: (m, 3) unit vectors.
        triangles: (k, 3).
        chosen: (e,) bool, in the order of `numpy.unique` over the edges' sorted vertices.

    Returns:
        Vertices, the new ones after the old, and triangles, turned as before.
    """
    edges, of_triangle = _edges(triangles)
    number = np.full(len(edges), -1)
    number[chosen] = len(vertices) + np.arange(int(chosen.sum()))
    middle = vertices[edges[chosen]].sum(axis=1)
    vertices = np.concatenate([vertices, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
    # Turned so that of one cut side it is the first, and of two the first and the second.
    cut = number[of_triangle] >= 0
    count = cut.sum(axis=1)
    turn = np.where(count == 1, cut.argmax(axis=1), np.where(count == 2, cut.argmin(axis=1) + 1, 0))
    order = (turn[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles, order, axis=1).T
    ab, bc, ca = np.take_along_axis(number[of_triangle], order, axis=1).T
    parts = {
        0: ((a, b, c),),
        1: ((a, ab, c), (ab, b, c)),
        2: ((ab, b, bc), (a, ab, bc), (a, bc, c)),
        3: ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)),
    }
    new = [np.stack(corner, axis=1)[count == n] for n, corners in parts.items() for corner in corners]
    return vertices, np.concatenate(new)


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (e, 2), sorted, and for each triangle the indices (k, 3) of its sides 01, 12, 20."""
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, index = np.unique(sides, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def _sharp_edges(points: np.ndarray, limit: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Edges (e,) of triangles that meet a neighbour at an angle, or whose corners belong to different limits."""
    edges, of_triangle = _edges(triangles)
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    # Every edge has two triangles, one that runs along it each way.
    order = np.argsort(of_triangle.ravel(), kind="stable").reshape(-1, 2) // 3
    bent = np.sum(normal[order[:, 0]] * normal[order[:, 1]], axis=1) < _SHARP
    rough = (limit[triangles] != limit[triangles][:, :1]).any(axis=1)
    rough[order[bent]] = True
    chosen = np.zeros(len(edges), dtype=bool)
    chosen[of_triangle[rough]] = True
    return chosen
