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
from stewart_drake.planning.measures import PoseMeasures, measure_poses
from stewart_drake.robot import RobotParameters

Kind = Literal["position", "orientation"]
Progress = Callable[[float], None]

COORDINATES: dict[Kind, tuple[int, int, int]] = {"position": (3, 4, 5), "orientation": (0, 1, 2)}
"""The coordinates of a pose that vary over a workspace."""

SINGULARITIES = {"reach": "serial", "transmission": "serial", "conditioning": "parallel"}
"""The kind of singularity that a limit keeps away from."""
LIMIT_NAMES = (
    "reach",
    "transmission",
    "conditioning",
    "ball_swing",
    "universal_swing",
    "clearance",
    "torque",
    "euler_pitch",
    "crank_range",
)
"""Limits that a pose at rest can break; those of `limits.RULES`, the swings of the two joints apart."""
_LEAST = {"transmission", "conditioning", "clearance"}  # of which there must be at least so much
ALL_ANGLES = np.array([np.pi, 0.5 * np.pi, np.pi])
"""[rad] roll, pitch and yaw, either way, that cover all orientations."""

_COARSE = 40**3  # cells to find the box of the poses in reach with


def utilisation(
    robot: RobotParameters, limits: Limits, pose: np.ndarray, measures: PoseMeasures
) -> dict[str, np.ndarray]:
    """Part of each limit that is on which each pose takes up; above 1 it is broken.

    Args:
        robot: Effort limit.
        limits: What to keep to; limits of the speed do not count at rest.
        pose: (n, 6) [rad, m].
        measures: Of these poses.

    Returns:
        (n,) [-] per limit, in the order of `LIMIT_NAMES`; NaN where a rod cannot span, but for `reach` and
        `euler_pitch`; infinite beyond a parallel singularity and where links overlap.
    """
    bounds = limit_bounds(robot, limits)
    swing = bounds.get("joint_swing")
    allowed = bounds | ({} if swing is None else {"ball_swing": swing, "universal_swing": swing})
    use = {
        "reach": 1.0 - measures.reach,
        "transmission": measures.transmission,
        "conditioning": measures.conditioning,
        "ball_swing": measures.ball_swing,
        "universal_swing": measures.universal_swing,
        "clearance": measures.clearance,
        "torque": measures.holding_torque,
        "euler_pitch": np.abs(pose[:, 1]),
        "crank_range": measures.stroke,
    }

    def part(name: str) -> np.ndarray:
        if name == "crank_range":
            return use[name]
        if name not in _LEAST:
            return use[name] / allowed[name]
        beyond = np.where(np.isnan(use[name]), np.nan, np.inf)
        return np.divide(allowed[name], use[name], out=beyond, where=use[name] > 0.0)

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
        return tuple(
            low + width * (np.arange(n) + 0.5) for low, width, n in zip(self.low, self.width, self.counts, strict=True)
        )

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
    """A grid of about `samples` nearly cubic cells over the poses at which all rods can span.

    No joint is further from its shaft than crank and rod together, which bounds the positions; of these, those on the
    centre's side of the motors' plane are taken: the other side belongs to another assembly. Orientations start from
    all of them. A coarse grid then cuts the box down to what can be reached, and a cell more on each side.

    Args:
        robot: Geometry.
        kind: What varies.
        center: (6,) [rad, m].
        samples: At least 8.

    Raises:
        ConfigurationError: A center that `check_center` refuses; too few samples.
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
    """Refuses what cannot be the centre of a workspace.

    Raises:
        ConfigurationError: Not six finite numbers, angles beyond `ALL_ANGLES`, or out of reach.
    """
    if center.shape != (6,) or not np.isfinite(center).all() or (np.abs(center[:3]) > ALL_ANGLES).any():
        raise ConfigurationError(
            "center", center.tolist(), "six finite numbers, roll and yaw within +-pi, pitch within +-pi/2"
        )
    if reach_margin(robot, center).min() < 0.0:
        raise ConfigurationError("center", center.tolist(), "a pose that all rods can reach")


def outer_box(robot: RobotParameters, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of a box around the positions in reach at the orientation of a `center` in reach.

    Of these, the positions on the centre's side of the motors' shafts, where it is above or below them all.
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
    """Measures of all cells of a grid against the limits.

    Attributes:
        grid: The cells.
        measures: Of their centres.
        use: Utilisation of each limit, see `utilisation`.
    """

    grid: Grid
    measures: PoseMeasures
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
        start = self.grid.center[list(self.grid.coordinates)]
        seed = np.zeros(self.grid.counts, dtype=bool)
        if ((self.grid.low <= start) & (start <= self.grid.high)).all():
            seed[tuple(int(np.abs(axis - x).argmin()) for axis, x in zip(self.grid.axes, start, strict=True))] = True
        return flood(seed, mask.reshape(self.grid.counts)).ravel()

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


@dataclass(frozen=True)
class Loss:
    """What one limit takes away, as shares [-] of `Survey.regular`.

    Attributes:
        limit: One of `LIMIT_NAMES`.
        broken: Poses that break it.
        alone: Poses that break it and no other: what would be won if it were lifted.
    """

    limit: str
    broken: float
    alone: float


def losses(found: Survey) -> list[Loss]:
    """What each limit takes of the poses that the mechanism could reach, in the order of `LIMIT_NAMES`."""
    total = found.size(found.regular)
    broken = {name: found.regular & (use > 1.0) for name, use in found.use.items()}
    count = np.sum(list(broken.values()), axis=0)

    def share(mask: np.ndarray) -> float:
        return found.size(mask) / total if total > 0.0 else 0.0

    return [Loss(name, share(mask), share(mask & (count == 1))) for name, mask in broken.items()]


def flood(seed: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Cells of `allowed` that are joined to those of `seed` through faces; boolean arrays of one shape."""
    reached, before = seed & allowed, -1
    while (now := int(reached.sum())) != before:
        before = now
        for axis in range(reached.ndim):
            along, open_to = np.moveaxis(reached, axis, 0), np.moveaxis(allowed, axis, 0)
            for i in range(1, len(along)):
                along[i] |= along[i - 1] & open_to[i]
            for i in range(len(along) - 2, -1, -1):
                along[i] |= along[i + 1] & open_to[i]
    return reached
