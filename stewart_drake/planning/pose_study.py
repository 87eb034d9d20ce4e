"""What the poses around a centre allow: both workspaces, the ways out of them, and other centres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stewart_drake.config import Vector6
from stewart_drake.errors import ConfigurationError
from stewart_drake.planning.limits import Limits
from stewart_drake.planning.workspace import (
    COORDINATES,
    LIMIT_NAMES,
    Boundary,
    Grid,
    Kind,
    Survey,
    boundary,
    spanning_grid,
    spread_directions,
    survey,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import LENGTH

KINDS: tuple[Kind, Kind] = ("position", "orientation")
OTHER_CENTERS: tuple[tuple[Kind, str, Vector6], ...] = (
    ("position", "roll 15 deg", (np.pi / 12.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("position", "roll 30 deg", (np.pi / 6.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("position", "pitch 30 deg", (0.0, np.pi / 6.0, 0.0, 0.0, 0.0, 0.0)),
    ("position", "yaw 30 deg", (0.0, 0.0, np.pi / 6.0, 0.0, 0.0, 0.0)),
    ("orientation", "Z {:.3g} mm lower", (0.0, 0.0, 0.0, 0.0, 0.0, -0.05)),
    ("orientation", "Z {:.3g} mm higher", (0.0, 0.0, 0.0, 0.0, 0.0, 0.05)),
    ("orientation", "X {:.3g} mm further", (0.0, 0.0, 0.0, 0.1, 0.0, 0.0)),
)
"""Turned or moved from the centre; lengths are for the paper's robot."""


@dataclass(frozen=True, eq=False)
class PoseStudy:
    """What the poses around `center` (6,) [rad, m] allow.

    Attributes:
        surveys: Grids over both workspaces.
        boundaries: Ways out of them, evenly spread.
        ends: Ways down and up along each of their three coordinates alone.
        others: Name of another centre -> size of the workspace there; None where it is out of reach.
    """

    center: np.ndarray
    surveys: dict[Kind, Survey]
    boundaries: dict[Kind, Boundary]
    ends: dict[Kind, Boundary]
    others: dict[str, float | None]

    @property
    def ranges(self) -> np.ndarray:
        """(2, 6) [rad, m] lowest and highest value of each coordinate alone."""
        return self.center + _both(self.ends, "radius") * [[-1.0], [1.0]]

    def numbers(self) -> dict[str, Any]:
        """All of it as plain numbers; sizes in m^3, or as shares of all orientations."""
        cuts = _both(self.ends, "limit").astype(int).tolist()
        return {
            "poses": sum(len(found.grid.poses) for found in self.surveys.values()),
            "center": self.center.tolist(),
            "ranges": self.ranges.tolist(),
            "range_cuts": [[LIMIT_NAMES[i] if i >= 0 else None for i in row] for row in cuts],
            "workspaces": {kind: _workspace(self.surveys[kind], self.boundaries[kind]) for kind in KINDS},
            "other_centers": self.others,
        }

    def slices(self, robot: RobotParameters, limits: Limits, gravity: float, kind: Kind, pixels: int) -> list[Survey]:
        """Five slices across the third coordinate and one along it, all through what the limits leave."""
        found, middle = self.surveys[kind], self.center[list(COORDINATES[kind])]
        box = found.bounding_box(found.connected)
        if box is None:
            box = np.stack([found.grid.low, found.grid.high])
        room = 0.4 * (box[1] - box[0])
        corners = np.maximum(box[0] - room, found.grid.low), np.minimum(box[1] + room, found.grid.high)
        levels = np.linspace(box[0, 2], box[1, 2], 7)[1:-1]
        levels[np.abs(levels - middle[2]).argmin()] = middle[2]
        along = 1 if kind == "position" else 0

        def cut(axis: int, level: float) -> Survey:
            low, high = (corner.copy() for corner in corners)
            low[axis] = high[axis] = level
            x, y, z = np.maximum(2, np.round(pixels * (high - low) / (high - low).max())).astype(int).tolist()
            counts = (1 if axis == 0 else x, 1 if axis == 1 else y, 1 if axis == 2 else z)
            return survey(robot, limits, Grid(COORDINATES[kind], self.center, low, high, counts), gravity)

        return [*(cut(2, float(level)) for level in levels), cut(along, float(middle[along]))]


def study_poses(
    robot: RobotParameters,
    limits: Limits,
    gravity: float,
    center: np.ndarray,
    samples: int,
    directions: int,
    progress: Callable[[float], None] = lambda _: None,
) -> PoseStudy:
    """Grids of `samples` poses and so many ways out of each workspace; a twentieth of the samples round other centres.

    Raises:
        ConfigurationError: A center that `check_center` refuses; too few samples.
    """
    surveys: dict[Kind, Survey] = {}
    for kind in KINDS:
        start = 0.3 * len(surveys)
        grid = spanning_grid(robot, kind, center, samples)
        surveys[kind] = survey(robot, limits, grid, gravity, lambda share: progress(start + 0.3 * share))  # noqa: B023

    def ways(kind: Kind, along: np.ndarray) -> Boundary:
        return boundary(robot, limits, kind, center, along, gravity)

    boundaries = {kind: ways(kind, spread_directions(directions)) for kind in KINDS}
    progress(0.8)
    ends = {kind: ways(kind, np.concatenate([-np.eye(3), np.eye(3)])) for kind in KINDS}
    others: dict[str, float | None] = {}
    for kind, words, for_paper in OTHER_CENTERS:
        offset = np.array(LENGTH.value(for_paper, robot))
        name = f"{kind}, {words.format(1e3 * np.abs(offset[3:]).max())}"
        try:
            found = survey(robot, limits, spanning_grid(robot, kind, center + offset, max(8, samples // 20)), gravity)
            others[name] = found.size(found.connected)
        except ConfigurationError:
            others[name] = None
    progress(1.0)
    return PoseStudy(np.asarray(center, dtype=float), surveys, boundaries, ends, others)


def _both(ends: dict[Kind, Boundary], name: str) -> np.ndarray:
    """(2, 6) of one quantity of the ways down and up, in the order of a pose."""
    return np.concatenate([getattr(ends[kind], name).reshape(2, 3) for kind in KINDS[::-1]], axis=1)


def _workspace(found: Survey, way_out: Boundary) -> dict[str, Any]:
    box = found.bounding_box(found.connected)
    return {
        "cells": list(found.grid.counts),
        **{mask: found.size(getattr(found, mask)) for mask in ("spanning", "regular", "feasible", "connected")},
        "box": None if box is None else box.tolist(),
        "inscribed_radius": float(way_out.radius.min()),
        "boundary_volume": way_out.volume,
        "first": way_out.first(),
        "smallest": {
            name: float(getattr(found.measures, name)[found.connected].min()) if found.connected.any() else None
            for name in ("force", "moment", "conditioning", "transmission")
        },
    }
