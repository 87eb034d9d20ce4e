"""Regions of poses over a grid: how much of space, or of all orientations, each limit leaves; and the ways out of them.

A position workspace is the set of positions at a fixed orientation, an orientation workspace that of orientations at a
fixed position. What a pose takes up of a limit is its utilisation: 1 at the limit, above 1 outside. It makes limits of
different units comparable; for a quantity x with a lower bound b it is b / x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import reach_margin, rotation_matrix
from stewart_drake.planning.limits import Limits, limit_bounds
from stewart_drake.planning.measures import measure_poses
from stewart_drake.robot import RobotParameters

Kind = Literal["position", "orientation"]
Progress = Callable[[float], None]

COORDINATES: dict[Kind, tuple[int, int, int]] = {"position": (3, 4, 5), "orientation": (0, 1, 2)}
"""The coordinates of a pose that vary over a workspace."""
SINGULARITIES = {"reach": "serial", "transmission": "serial", "conditioning": "parallel"}
"""The kind of singularity that a limit keeps away from."""
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
    robot: RobotParameters, limits: Limits, pose: np.ndarray, measures: np.recarray
) -> dict[str, np.ndarray]:
    """Part (n,) [-] of each limit that is on which poses (n, 6) at rest take up; above 1 it is broken.

    In the order of `LIMIT_NAMES`, from `POSE_MEASURES` records (n,). NaN where a rod cannot span, but for `reach` and
    `euler_pitch`; infinite beyond a parallel singularity and where links overlap.
    """
    bounds = limit_bounds(robot, limits)
    swing = bounds.get("joint_swing")
    allowed = bounds | ({} if swing is None else {"ball_swing": swing, "universal_swing": swing})
    taken = {"reach": 1.0 - measures.reach, "torque": measures.holding_torque, "euler_pitch": np.abs(pose[:, 1])}

    def part(name: str) -> np.ndarray:
        if name == "crank_range":
            return measures.stroke
        use = taken[name] if name in taken else measures[name]
        if name not in _LEAST:
            return use / allowed[name]
        return np.divide(allowed[name], use, out=np.where(np.isnan(use), np.nan, np.inf), where=use > 0.0)

    return {name: part(name) for name in LIMIT_NAMES if name in allowed}


def governing_limit(use: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The largest utilisation (n,) [-] and the index (n,) of its limit in `LIMIT_NAMES`.

    Where a rod cannot span, that is what governs, whatever else is known of the pose.
    """
    stack = np.stack(list(use.values()))
    unknown = np.isnan(stack).any(axis=0)
    stack[1:, unknown] = -np.inf
    of = np.array([LIMIT_NAMES.index(name) for name in use])
    return stack.max(axis=0), of[stack.argmax(axis=0)]


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of a box in three coordinates of the pose; a side of no length makes a slice.

    Attributes:
        coordinates: Indices of the coordinates that vary, `COORDINATES` of a workspace or any others, ascending.
        center: (6,) [rad, m] pose; the other coordinates are taken from it.
        low: (3,) lower corner.
        high: (3,) upper corner.
        counts: Cells along each side.
    """

    coordinates: tuple[int, int, int]
    center: np.ndarray
    low: np.ndarray
    high: np.ndarray
    counts: tuple[int, int, int]

    @property
    def width(self) -> np.ndarray:
        """(3,) [rad] or [m] of a cell."""
        return (self.high - self.low) / self.counts

    @cached_property
    def axes(self) -> tuple[np.ndarray, ...]:
        """Centres of the cells along each side."""
        sides = zip(self.low, self.width, self.counts, strict=True)
        return tuple(low + width * (np.arange(n) + 0.5) for low, width, n in sides)

    @cached_property
    def poses(self) -> np.ndarray:
        """(n, 6) [rad, m] centres of the cells, the last coordinate running fastest."""
        point = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1)
        return poses_at(self.coordinates, self.center, point.reshape(-1, 3))

    @cached_property
    def cell_size(self) -> np.ndarray:
        """(n,) size of each cell: product of its sides; of an orientation workspace, the share [-] of all orientations.

        A random orientation has roll and yaw uniform and pitch of density cos(pitch): 8 pi^2 in all.
        """
        if self.coordinates != COORDINATES["orientation"]:
            return np.full(math.prod(self.counts), float(np.prod(self.width)))
        roll, pitch, yaw = self.width
        upper, lower = self.axes[1] + 0.5 * pitch, self.axes[1] - 0.5 * pitch
        share = roll * yaw * (np.sin(upper) - np.sin(lower)) / (8.0 * np.pi**2)
        return np.broadcast_to(share[:, None], self.counts).ravel()


def poses_at(coordinates: tuple[int, ...], center: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Poses (n, 6) [rad, m] with the given coordinates from `point` (n, k), the others from `center`."""
    pose = np.tile(np.asarray(center, dtype=float), (len(point), 1))
    pose[:, coordinates] = point
    return pose


def spanning_grid(robot: RobotParameters, kind: Kind, center: np.ndarray, samples: int) -> Grid:
    """A grid of about `samples` nearly cubic cells over the poses around a centre (6,) at which all rods can span.

    A coarse grid over `outer_box`, or over all orientations, is cut down to what can be reached and a cell more on each
    side.
    """
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

    No joint is further from its shaft than crank and rod together. Of these positions those on the centre's side of the
    motors' shafts, where it is above or below them all: the other side belongs to another assembly.
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
    """All cells of a grid against the limits.

    Attributes:
        grid: The cells.
        measures: `POSE_MEASURES` records (n,) of their centres.
        use: See `utilisation`.
    """

    grid: Grid
    measures: np.recarray
    use: dict[str, np.ndarray]

    @property
    def spanning(self) -> np.ndarray:
        """(n,) bool, all rods can span."""
        return self.measures.reach >= 0.0

    @cached_property
    def feasible(self) -> np.ndarray:
        """(n,) bool, within every limit."""
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
        # A fifth of a second of import.
        from scipy.ndimage import label

        start = self.grid.center[list(self.grid.coordinates)]
        pieces, _ = label(mask.reshape(self.grid.counts))
        cell = tuple(int(np.abs(axis - x).argmin()) for axis, x in zip(self.grid.axes, start, strict=True))
        inside = bool(((self.grid.low <= start) & (start <= self.grid.high)).all())
        return ((pieces == pieces[cell]) & (pieces > 0) & inside).ravel()

    def size(self, mask: np.ndarray) -> float:
        """Size of the cells of a mask, see `Grid.cell_size`."""
        return float(self.grid.cell_size[mask].sum())

    def bounding_box(self, mask: np.ndarray) -> np.ndarray | None:
        """(2, 3) [rad] or [m] lower and upper corner around the cells of a mask; None where it is empty."""
        if not mask.any():
            return None
        point = self.grid.poses[mask][:, self.grid.coordinates]
        half = 0.5 * self.grid.width
        return np.stack([point.min(axis=0) - half, point.max(axis=0) + half])


def survey(
    robot: RobotParameters,
    limits: Limits,
    grid: Grid,
    gravity: float = STANDARD_GRAVITY,
    progress: Progress | None = None,
) -> Survey:
    """Measures every cell of a grid; force and moment keep to the limit of the torque, where it is on."""
    bounds = limit_bounds(robot, limits)
    measures = measure_poses(robot, grid.poses, gravity, bounds.get("torque"), progress=progress)
    return Survey(grid, measures, utilisation(robot, limits, grid.poses, measures))


@dataclass(frozen=True, eq=False)
class Boundary:
    """Where straight ways from a centre leave the limits, in directions that each stand for an equal solid angle.

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


def spread_directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) on a Fibonacci lattice: equal steps of height, golden steps of angle."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    level = np.sqrt(1.0 - height**2)
    return np.stack([level * np.cos(angle), level * np.sin(angle), height], axis=1)


def boundary(
    robot: RobotParameters,
    limits: Limits,
    kind: Kind,
    center: np.ndarray,
    directions: np.ndarray,
    gravity: float = STANDARD_GRAVITY,
) -> Boundary:
    """Ways from a centre (6,) to the first broken limit, along unit vectors (m, 3) of space, or of roll, pitch, yaw.

    64 steps to the far end, pi or all that can be in reach, find the first pose outside; bisection finds the place, to
    a 65,000th of a step. A gap that lies between two steps is not seen.
    """
    center = np.asarray(center, dtype=float)
    check_center(robot, center)
    torque, coordinates, longest = limit_bounds(robot, limits).get("torque"), COORDINATES[kind], math.pi
    if kind == "position":
        longest = float(np.linalg.norm(np.abs(np.array(outer_box(robot, center)) - center[3:]).max(axis=0)))
    inner, outer = np.zeros(len(directions)), np.full(len(directions), longest)
    limit = np.full(len(directions), -1)

    def look(rays: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Moves the inner or the outer end of each of the rays to `radius`; the rays that were within."""
        pose = poses_at(coordinates, center, center[list(coordinates)] + radius[:, None] * directions[rays])
        use, cause = governing_limit(utilisation(robot, limits, pose, measure_poses(robot, pose, gravity, torque)))
        out = use > 1.0
        outer[rays[out]], limit[rays[out]], inner[rays[~out]] = radius[out], cause[out], radius[~out]
        return rays[~out]

    rays = np.arange(len(directions))
    for step in range(_STEPS + 1):
        rays = look(rays, np.full(len(rays), longest * step / _STEPS))
    cut = np.flatnonzero(limit >= 0)
    for _ in range(_BISECTIONS):
        look(cut, 0.5 * (inner[cut] + outer[cut]))
    return Boundary(inner, limit)
