"""Regions of poses over a grid: how much of space, or of all orientations, each limit leaves; and the ways out of them.

What a pose takes up of a limit is its utilisation: 1 at the limit, above 1 outside; b / x for a lower bound b.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import reach_margin, rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.limits import ReferenceLimits, limit_bounds, measure_poses

Kind = Literal["position", "orientation"]

COORDINATES: dict[Kind, list[int]] = {"position": [3, 4, 5], "orientation": [0, 1, 2]}
"""The coordinates of a pose that vary over a workspace."""
KINDS: tuple[Kind, Kind] = ("position", "orientation")
LIMIT_NAMES = (
    *("reach", "transmission", "conditioning", "ball_swing", "universal_swing"),
    *("clearance", "torque", "euler_pitch", "crank_range"),
)
"""Limits that a pose at rest can break; those of `limits.RULES`, the swings of the two joints apart."""
ALL_ANGLES = np.array([np.pi, 0.5 * np.pi, np.pi])
"""[rad] roll, pitch and yaw, either way, that cover all orientations."""

_LEAST = {"transmission", "conditioning", "clearance"}  # of which there must be at least so much
_COARSE = 40**3  # cells to find the box of the poses in reach with
_STEPS, _BISECTIONS = 64, 16


def utilisation(
    robot: RobotParameters, limits: ReferenceLimits, pose: np.ndarray, measures: np.recarray
) -> dict[str, np.ndarray]:
    """Part (n,) [-] of each limit that is on which poses (n, 6) at rest take up; NaN where a rod cannot span."""
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
    """The largest utilisation (n,) [-] and its place in `LIMIT_NAMES`; reach, where a rod cannot span."""
    stack = np.stack(list(use.values()))
    unknown = np.isnan(stack).any(axis=0)
    stack[1:, unknown] = -np.inf
    of = np.array([LIMIT_NAMES.index(name) for name in use])
    return stack.max(axis=0), of[stack.argmax(axis=0)]


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of a box in three coordinates of the pose, `low` to `high` (3,); the others as in `center` (6,)."""

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
        """(n, 6) [rad, m] centres of the cells, the last coordinate running fastest."""
        poses = np.tile(self.center, (math.prod(self.counts), 1))
        poses[:, self.coordinates] = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return poses

    @cached_property
    def cell_size(self) -> np.ndarray:
        """(n,) product of a cell's sides; of orientations the share of all, 8 pi^2 with pitch of density cos(pitch)."""
        if self.coordinates != COORDINATES["orientation"]:
            return np.full(math.prod(self.counts), float(np.prod(self.width)))
        roll, pitch, yaw = self.width
        upper, lower = self.axes[1] + 0.5 * pitch, self.axes[1] - 0.5 * pitch
        share = roll * yaw * (np.sin(upper) - np.sin(lower)) / (8.0 * np.pi**2)
        return np.broadcast_to(share[:, None], self.counts).ravel()


def spanning_grid(robot: RobotParameters, kind: Kind, center: np.ndarray, samples: int) -> Grid:
    """A grid of about `samples` nearly cubic cells over the poses around a centre (6,) at which all rods can span."""
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
    """Refuses what cannot be the centre of a workspace: no pose, angles beyond `ALL_ANGLES`, or out of reach."""
    if center.shape != (6,) or not np.isfinite(center).all() or (np.abs(center[:3]) > ALL_ANGLES).any():
        allowed = "six finite numbers, roll and yaw within +-pi, pitch within +-pi/2"
        raise ConfigurationError("center", center.tolist(), allowed)
    if reach_margin(robot, center).min() < 0.0:
        raise ConfigurationError("center", center.tolist(), "a pose that all rods can reach")


def outer_box(robot: RobotParameters, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of a box around the positions in reach at the orientation of a `center` in reach.

    Of these those on the centre's side of the shafts, where it is above or below them all: the rest is another
    assembly.
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
    """All cells of a grid against the limits: `POSE_MEASURES` records (n,) of their centres, and `utilisation`."""

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
        """(n,) bool, in reach of the centre without passing a singularity of either kind, whatever the limits say."""
        return self._joined(self.spanning & (np.nan_to_num(self.measures.conditioning) > 0.0))

    @cached_property
    def connected(self) -> np.ndarray:
        """(n,) bool, in reach of the centre without breaking a limit."""
        return self._joined(self.feasible)

    def _joined(self, mask: np.ndarray) -> np.ndarray:
        """The cells of a mask that are joined to the centre's through faces."""
        from scipy.ndimage import label

        start = self.grid.center[self.grid.coordinates]
        pieces, _ = label(mask.reshape(self.grid.counts))
        cell = tuple(int(np.abs(axis - x).argmin()) for axis, x in zip(self.grid.axes, start, strict=True))
        inside = bool(((self.grid.low <= start) & (start <= self.grid.high)).all())
        return ((pieces == pieces[cell]) & (pieces > 0) & inside).ravel()

    def size(self, mask: np.ndarray) -> float:
        return float(self.grid.cell_size[mask].sum())

    def bounding_box(self, mask: np.ndarray) -> np.ndarray | None:
        """(2, 3) [rad] or [m] corners around the cells of a mask; None for none."""
        if not mask.any():
            return None
        point = self.grid.poses[mask][:, self.grid.coordinates]
        half = 0.5 * self.grid.width
        return np.stack([point.min(axis=0) - half, point.max(axis=0) + half])


def survey(robot: RobotParameters, limits: ReferenceLimits, grid: Grid, gravity: float = STANDARD_GRAVITY) -> Survey:
    """Measures every cell of a grid."""
    measures = measure_poses(robot, grid.poses, gravity)
    return Survey(grid, measures, utilisation(robot, limits, grid.poses, measures))


def way_out(
    robot: RobotParameters,
    limits: ReferenceLimits,
    start: np.ndarray,
    ways: np.ndarray,
    steps: np.ndarray,
    gravity: float = STANDARD_GRAVITY,
    most: float = 1.0,
    bisections: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """How far (m,) along ways (m, 6) no limit is taken up by more than `most`; which one (m,) then is, or -1."""
    inner, outer = np.zeros(len(ways)), np.full(len(ways), steps[-1])
    limit = np.full(len(ways), -1)

    def look(rays: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Moves the inner or the outer end of each of the rays to `radius`; the rays that were within."""
        pose = start + radius[:, None] * ways[rays]
        use, cause = governing_limit(utilisation(robot, limits, pose, measure_poses(robot, pose, gravity)))
        out = use > most
        outer[rays[out]], limit[rays[out]], inner[rays[~out]] = radius[out], cause[out], radius[~out]
        return rays[~out]

    rays = np.arange(len(ways))
    for step in steps:
        rays = look(rays, np.full(len(rays), step))
    cut = np.flatnonzero(limit >= 0)
    for _ in range(bisections):
        look(cut, 0.5 * (inner[cut] + outer[cut]))
    return inner, limit


class Boundary(NamedTuple):
    """Ways (m,) [m] or [rad] to the first broken limit, and its index in `LIMIT_NAMES`; -1 where there is none."""

    radius: np.ndarray
    limit: np.ndarray


def spread_directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) on a Fibonacci lattice: equal steps of height, golden steps of angle."""
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
    gravity: float = STANDARD_GRAVITY,
) -> Boundary:
    """Ways from a centre (6,) to the first broken limit, along unit vectors (m, 3): 64 steps, then bisection."""
    center = np.asarray(center, dtype=float)
    check_center(robot, center)
    longest = math.pi
    if kind == "position":
        longest = float(np.linalg.norm(np.abs(np.array(outer_box(robot, center)) - center[3:]).max(axis=0)))
    ways = np.zeros((len(directions), 6))
    ways[:, COORDINATES[kind]] = directions
    steps = longest * np.arange(_STEPS + 1) / _STEPS
    return Boundary(*way_out(robot, limits, center, ways, steps, gravity, bisections=_BISECTIONS))


def slices(
    robot: RobotParameters, limits: ReferenceLimits, gravity: float, region: Survey, pixels: int
) -> list[Survey]:
    """Five slices across the third coordinate of a survey and one along it, through what the limits leave."""
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
    gravity: float,
    center: np.ndarray,
    samples: int,
    directions: int,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[dict[str, Any], dict[Kind, Survey]]:
    """What the poses around a centre (6,) [rad, m] allow: plain numbers, and a survey of each of both workspaces.

    Sizes are in m^3, or shares of all orientations.
    """
    center = np.asarray(center, dtype=float)
    surveys: dict[Kind, Survey] = {}
    for kind in KINDS:
        surveys[kind] = survey(robot, limits, spanning_grid(robot, kind, center, samples), gravity)
        progress(0.4 * len(surveys))
    axes = np.concatenate([-np.eye(3), np.eye(3)])
    # Of orientations first, as in a pose.
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


def _workspace(region: Survey, radius: np.ndarray, limit: np.ndarray) -> dict[str, Any]:
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
