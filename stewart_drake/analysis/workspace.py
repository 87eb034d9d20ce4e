"""Workspaces over a grid of positions or orientations: the regions that the limits leave, and their boundaries.

The utilisation of a limit at a pose is 1 at the limit and above 1 outside; for a lower bound b it is b / x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import reach_margin, rotation_matrix
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.scenario.limits import ReferenceLimits, limit_bounds, measure_poses

Kind = Literal["position", "orientation"]

COORDINATES: dict[Kind, list[int]] = {"position": [3, 4, 5], "orientation": [0, 1, 2]}
"""The coordinates of a pose that vary over a workspace."""
KINDS: tuple[Kind, Kind] = ("position", "orientation")
LIMIT_NAMES = (
    *("reach", "transmission", "conditioning", "ball_swing", "universal_swing"),
    *("clearance", "torque", "euler_pitch", "crank_range"),
)
"""Limits of `limits.RULES` that a pose at rest can break, with one for the swing of either joint."""
ALL_ANGLES = np.array([np.pi, 0.5 * np.pi, np.pi])
"""[rad] largest roll, pitch and yaw; together they cover all orientations."""

_LEAST = {"transmission", "conditioning", "clearance"}  # Lower bounds.
_COARSE = 40**3  # Cells of the search for the box of the poses in reach.
_STEPS, _BISECTIONS = 64, 16


def utilisation(
    robot: RobotParameters, limits: ReferenceLimits, pose: np.ndarray, measures: np.recarray
) -> dict[str, np.ndarray]:
    """Utilisation (n,) [-] of the limits at poses (n, 6) at rest; NaN where a rod cannot span."""
    bounds = limit_bounds(robot, limits)
    if "joint_swing" in bounds:
        bounds["ball_swing"] = bounds["universal_swing"] = bounds["joint_swing"]
    if "crank_range" in bounds:
        bounds["crank_range"] = 1.0
    x = {name: measures[name] for name in ("ball_swing", "universal_swing", *_LEAST)}
    x |= {"reach": 1.0 - measures.reach_margin, "torque": measures.holding_torque}
    x |= {"euler_pitch": np.abs(pose[:, 1]), "crank_range": measures.stroke}
    use = {}
    for name in (name for name in LIMIT_NAMES if name in bounds):
        if name in _LEAST:
            with np.errstate(divide="ignore"):
                use[name] = np.where(x[name] <= 0.0, np.inf, bounds[name] / x[name])
        else:
            use[name] = x[name] / bounds[name]
    return use


def governing_limit(use: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Largest utilisation (n,) [-] and its index in `LIMIT_NAMES`; reach where a rod cannot span."""
    stack = np.stack(list(use.values()))
    unknown = np.isnan(stack).any(axis=0)
    stack[1:, unknown] = -np.inf
    of = np.array([LIMIT_NAMES.index(name) for name in use])
    return stack.max(axis=0), of[stack.argmax(axis=0)]


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of a box in three coordinates of the pose, `low` to `high` (3,); the others are those of `center` (6,)."""

    coordinates: list[int]
    center: np.ndarray
    low: np.ndarray
    high: np.ndarray
    counts: tuple[int, int, int]

    @property
    def width(self) -> np.ndarray:
        """(3,) [rad] or [m]."""
        return (self.high - self.low) / self.counts

    @cached_property
    def axes(self) -> tuple[np.ndarray, ...]:
        sides = zip(self.low, self.width, self.counts, strict=True)
        return tuple(low + width * (np.arange(n) + 0.5) for low, width, n in sides)

    @cached_property
    def poses(self) -> np.ndarray:
        """(n, 6) [rad, m] centres of the cells; the last coordinate varies fastest."""
        poses = np.tile(self.center, (math.prod(self.counts), 1))
        poses[:, self.coordinates] = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return poses

    @cached_property
    def cell_size(self) -> np.ndarray:
        """(n,) volumes [m^3], or shares of all orientations, with the measure cos(pitch) / (8 pi^2)."""
        if self.coordinates != COORDINATES["orientation"]:
            return np.full(math.prod(self.counts), float(np.prod(self.width)))
        roll, pitch, yaw = self.width
        upper, lower = self.axes[1] + 0.5 * pitch, self.axes[1] - 0.5 * pitch
        share = roll * yaw * (np.sin(upper) - np.sin(lower)) / (8.0 * np.pi**2)
        return np.broadcast_to(share[:, None], self.counts).ravel()


def spanning_grid(robot: RobotParameters, kind: Kind, center: np.ndarray, samples: int) -> Grid:
    """A grid of about `samples` nearly cubic cells over the poses around a centre (6,) that all rods can reach."""
    center = np.asarray(center, dtype=float)
    check_center(robot, center)
    if samples < 8:
        raise ConfigurationError("samples", samples, "at least 8")
    low, high = outer_box(robot, center) if kind == "position" else (-ALL_ANGLES, ALL_ANGLES.copy())
    coarse = Grid(COORDINATES[kind], center, low, high, _counts(high - low, _COARSE))
    inside = reach_margin(robot, coarse.poses).min(axis=1).reshape(coarse.counts) >= 0.0
    for axis in range(3) if inside.any() else ():
        along = np.flatnonzero(inside.any(axis=tuple({0, 1, 2} - {axis})))
        edges = low[axis] + coarse.width[axis] * np.array([along[0] - 1, along[-1] + 2])
        low[axis], high[axis] = max(low[axis], edges[0]), min(high[axis], edges[1])
    return Grid(COORDINATES[kind], center, low, high, _counts(high - low, samples))


def check_center(robot: RobotParameters, center: np.ndarray) -> None:
    """Raises a ConfigurationError for a centre that is no pose, beyond `ALL_ANGLES` or out of reach."""
    if center.shape != (6,) or not np.isfinite(center).all() or (np.abs(center[:3]) > ALL_ANGLES).any():
        allowed = "six finite numbers, roll and yaw within +-pi, pitch within +-pi/2"
        raise ConfigurationError("center", center.tolist(), allowed)
    if reach_margin(robot, center).min() < 0.0:
        raise ConfigurationError("center", center.tolist(), "a pose that all rods can reach")


def outer_box(robot: RobotParameters, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of a box around the positions in reach at the orientation of a `center`.

    If the centre is above all shafts, or below, only positions on its side: the others are another assembly.
    """
    about = robot.shaft_positions - robot.platform_joints @ rotation_matrix(center[:3]).T
    reach = (robot.crank_lengths + robot.rod_lengths)[:, None]
    low, high = (about - reach).max(axis=0), (about + reach).min(axis=0)
    heights = robot.shaft_positions[:, 2]
    if center[5] >= heights.max():
        low[2] = max(low[2], heights.min())
    elif center[5] <= heights.min():
        high[2] = min(high[2], heights.max())
    return low, high


def _counts(size: np.ndarray, samples: int) -> tuple[int, int, int]:
    edge = float(np.prod(size) / samples) ** (1.0 / 3.0)
    x, y, z = (max(2, round(side / edge)) for side in size.tolist())
    return x, y, z


@dataclass(frozen=True, eq=False)
class Survey:
    """The cells of a grid: `POSE_MEASURES` records (n,) at their centres, and `utilisation` of the limits."""

    grid: Grid
    measures: np.recarray
    use: dict[str, np.ndarray]

    @property
    def spanning(self) -> np.ndarray:
        return self.measures.reach_margin >= 0.0

    @cached_property
    def feasible(self) -> np.ndarray:
        return np.all([u <= 1.0 for u in self.use.values()], axis=0)

    @cached_property
    def regular(self) -> np.ndarray:
        """(n,) bool, connected to the centre without a singularity of either kind, regardless of the limits."""
        return self._joined(self.spanning & (np.nan_to_num(self.measures.conditioning) > 0.0))

    @cached_property
    def connected(self) -> np.ndarray:
        """(n,) bool, connected to the centre within the limits."""
        return self._joined(self.feasible)

    def _joined(self, mask: np.ndarray) -> np.ndarray:
        """The cells of a mask that are connected to the centre's through faces."""
        from scipy.ndimage import label

        start = self.grid.center[self.grid.coordinates]
        pieces, _ = label(mask.reshape(self.grid.counts))
        cell = tuple(int(np.abs(axis - x).argmin()) for axis, x in zip(self.grid.axes, start, strict=True))
        inside = bool(((self.grid.low <= start) & (start <= self.grid.high)).all())
        return ((pieces == pieces[cell]) & (pieces > 0) & inside).ravel()

    def size(self, mask: np.ndarray) -> float:
        return float(self.grid.cell_size[mask].sum())

    def bounding_box(self, mask: np.ndarray) -> np.ndarray | None:
        """(2, 3) [rad] or [m] corners around the cells of a mask; None if it is empty."""
        if not mask.any():
            return None
        point = self.grid.poses[mask][:, self.grid.coordinates]
        half = 0.5 * self.grid.width
        return np.stack([point.min(axis=0) - half, point.max(axis=0) + half])


def survey(robot: RobotParameters, limits: ReferenceLimits, grid: Grid, gravity: Gravity = STANDARD_GRAVITY) -> Survey:
    """Measures and utilisation of every cell of a grid."""
    measures = measure_poses(robot, grid.poses, gravity)
    return Survey(grid, measures, utilisation(robot, limits, grid.poses, measures))


def distances_to_limits(
    robot: RobotParameters,
    limits: ReferenceLimits,
    start: np.ndarray,
    directions: np.ndarray,
    steps: np.ndarray,
    gravity: Gravity = STANDARD_GRAVITY,
    most: float = 1.0,
    bisections: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (m,) along directions (m, 6) to a utilisation of `most`, and the limits (m,), or -1."""
    inner, outer = np.zeros(len(directions)), np.full(len(directions), steps[-1])
    limit = np.full(len(directions), -1)

    def probe(rays: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Moves the inner or the outer end of rays to `radius`; returns the rays that are within there."""
        pose = start + radius[:, None] * directions[rays]
        use, cause = governing_limit(utilisation(robot, limits, pose, measure_poses(robot, pose, gravity)))
        out = use > most
        outer[rays[out]], limit[rays[out]], inner[rays[~out]] = radius[out], cause[out], radius[~out]
        return rays[~out]

    rays = np.arange(len(directions))
    for step in steps:
        rays = probe(rays, np.full(len(rays), step))
    cut = np.flatnonzero(limit >= 0)
    for _ in range(bisections):
        probe(cut, 0.5 * (inner[cut] + outer[cut]))
    return inner, limit


class Boundary(NamedTuple):
    """Distances (m,) [m] or [rad] to the first broken limit, and its index in `LIMIT_NAMES`, or -1."""

    radius: np.ndarray
    limit: np.ndarray


def spread_directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) on a Fibonacci lattice."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    level = np.sqrt(1.0 - height**2)
    return np.stack([level * np.cos(angle), level * np.sin(angle), height], axis=1)


def boundary(
    robot: RobotParameters,
    limits: ReferenceLimits,
    kind: Kind,
    center: np.ndarray,
    directions: np.ndarray,
    gravity: Gravity = STANDARD_GRAVITY,
) -> Boundary:
    """Distances from a centre (6,) to the first broken limit along unit vectors (m, 3): 64 steps, then bisection."""
    center = np.asarray(center, dtype=float)
    check_center(robot, center)
    longest = math.pi
    if kind == "position":
        longest = float(np.linalg.norm(np.abs(np.array(outer_box(robot, center)) - center[3:]).max(axis=0)))
    rays = np.zeros((len(directions), 6))
    rays[:, COORDINATES[kind]] = directions
    steps = longest * np.arange(_STEPS + 1) / _STEPS
    return Boundary(*distances_to_limits(robot, limits, center, rays, steps, gravity, bisections=_BISECTIONS))


def slices(
    robot: RobotParameters, limits: ReferenceLimits, gravity: Gravity, region: Survey, pixels: int
) -> list[Survey]:
    """Five slices across the third coordinate of a survey and one along it, through the region within the limits."""
    grid, middle = region.grid, region.grid.center[region.grid.coordinates]
    box = region.bounding_box(region.connected)
    if box is None:
        box = np.stack([grid.low, grid.high])
    room = 0.4 * (box[1] - box[0])
    corners = np.maximum(box[0] - room, grid.low), np.minimum(box[1] + room, grid.high)
    heights = np.linspace(box[0, 2], box[1, 2], 7)[1:-1]
    heights[np.abs(heights - middle[2]).argmin()] = middle[2]

    def cut(axis: int, level: float) -> Survey:
        low, high = (corner.copy() for corner in corners)
        low[axis] = high[axis] = level
        counts = np.maximum(2, np.round(pixels * (high - low) / (high - low).max())).astype(int)
        counts[axis] = 1
        x, y, z = counts.tolist()
        return survey(robot, limits, Grid(grid.coordinates, grid.center, low, high, (x, y, z)), gravity)

    along = 1 if grid.coordinates == COORDINATES["position"] else 0
    return [*(cut(2, float(height)) for height in heights), cut(along, float(middle[along]))]


def study_poses(
    robot: RobotParameters,
    limits: ReferenceLimits,
    gravity: Gravity,
    center: np.ndarray,
    samples: int,
    directions: int,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Document, dict[Kind, Survey]]:
    """Workspaces around a centre (6,) [rad, m]: plain numbers, and surveys of positions and orientations.

    Sizes are in m^3, or shares of all orientations.
    """
    center = np.asarray(center, dtype=float)
    surveys: dict[Kind, Survey] = {}
    for kind in KINDS:
        surveys[kind] = survey(robot, limits, spanning_grid(robot, kind, center, samples), gravity)
        progress(0.4 * len(surveys))
    axes = np.concatenate([-np.eye(3), np.eye(3)])
    # Orientations first, as in a pose.
    ends = [boundary(robot, limits, kind, center, axes, gravity).radius.reshape(2, 3) for kind in reversed(KINDS)]
    along = spread_directions(directions)
    boundaries = {kind: boundary(robot, limits, kind, center, along, gravity) for kind in KINDS}
    progress(1.0)
    numbers = {
        "poses": sum(len(region.grid.poses) for region in surveys.values()),
        "center": center.tolist(),
        "ranges": (center + np.hstack(ends) * [[-1.0], [1.0]]).tolist(),
        "workspaces": {kind: _workspace(surveys[kind], *boundaries[kind]) for kind in KINDS},
    }
    return numbers, surveys


def _workspace(region: Survey, radius: np.ndarray, limit: np.ndarray) -> dict[str, object]:
    box, within = region.bounding_box(region.connected), region.measures[region.connected]
    first = np.bincount(limit[limit >= 0], minlength=len(LIMIT_NAMES)) / len(limit)
    return {
        "cells": list(region.grid.counts),
        **{mask: region.size(getattr(region, mask)) for mask in ("spanning", "regular", "feasible", "connected")},
        "box": None if box is None else box.tolist(),
        "inscribed_radius": float(radius.min()),
        "first": {LIMIT_NAMES[i]: float(first[i]) for i in np.argsort(-first, kind="stable") if first[i] > 0.0},
        "smallest": {
            name: float(within[name].min()) if len(within) else None
            for name in ("force", "moment", "conditioning", "transmission")
        },
    }
