"""What the poses around a centre allow: both workspaces, their boundaries, and slices through them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.paper.study import Study
from stewart_drake.planning.workspace import (
    COORDINATES,
    Boundary,
    Grid,
    Kind,
    Survey,
    boundary,
    spanning_grid,
    spread_directions,
    survey,
)
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.scenario import Scenario
from stewart_drake.section import Vector6

KINDS: tuple[Kind, Kind] = ("position", "orientation")
_OTHER_CENTERS: tuple[tuple[Kind, str, Vector6], ...] = (
    ("position", "roll 15 deg", (np.pi / 12.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("position", "roll 30 deg", (np.pi / 6.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("position", "pitch 30 deg", (0.0, np.pi / 6.0, 0.0, 0.0, 0.0, 0.0)),
    ("position", "yaw 30 deg", (0.0, 0.0, np.pi / 6.0, 0.0, 0.0, 0.0)),
    ("orientation", "Z {:.3g} mm lower", (0.0, 0.0, 0.0, 0.0, 0.0, -0.05)),
    ("orientation", "Z {:.3g} mm higher", (0.0, 0.0, 0.0, 0.0, 0.0, 0.05)),
    ("orientation", "X {:.3g} mm further", (0.0, 0.0, 0.0, 0.1, 0.0, 0.0)),
)
"""Turned or moved from the centre; 30 deg of roll and 50 mm of height are the amplitudes of (37), (38). Lengths are for
the paper's robot."""


@dataclass(frozen=True, eq=False)
class PoseStudy:
    """What the poses allow.

    Attributes:
        center: (6,) [rad, m].
        surveys: Of both workspaces.
        boundaries: Of both workspaces.
        ranges: (2, 6) [rad, m] lowest and highest value of each coordinate alone.
        cuts: (2, 6) index in `LIMIT_NAMES` of what ends them; -1 for nothing.
        others: Name, kind and survey around other centres; None where the centre is out of reach.
        rate: [1/s] poses measured.
    """

    center: np.ndarray
    surveys: dict[Kind, Survey]
    boundaries: dict[Kind, Boundary]
    ranges: np.ndarray
    cuts: np.ndarray
    others: list[tuple[str, Kind, Survey | None]]
    rate: float


def survey_poses(study: Study, samples: int, center: np.ndarray) -> PoseStudy:
    """Grids, boundaries and ranges around `center`; and around other centres.

    Args:
        study: For which robot and limits.
        samples: Poses in each of the two workspaces; a twentieth around each other centre.
        center: (6,) [rad, m].

    Raises:
        ConfigurationError: A center that `check_center` refuses; too few samples.
    """
    base = study.base
    robot, limits, gravity = base.robot, base.limits, base.gravity
    surveys: dict[Kind, Survey] = {}
    boundaries: dict[Kind, Boundary] = {}
    grids = {kind: spanning_grid(robot, kind, center, samples) for kind in KINDS}
    start = time.perf_counter()
    for i, (kind, grid) in enumerate(grids.items()):
        surveys[kind] = survey(robot, limits, grid, gravity, study.part(0.17 * i, 0.17))
    rate = sum(len(grid.poses) for grid in grids.values()) / (time.perf_counter() - start)
    for i, kind in enumerate(KINDS):
        directions = spread_directions(study.pick(20_000, 2_000))
        boundaries[kind] = boundary(robot, limits, kind, center, directions, gravity)
        study.progress(0.42 + 0.08 * i)
    ends = np.concatenate([-np.eye(3), np.eye(3)])
    rays = [boundary(robot, limits, kind, center, ends, gravity) for kind in KINDS[::-1]]
    way, cuts = (
        np.concatenate([getattr(each, name).reshape(2, 3) for each in rays], axis=1) for name in ("radius", "limit")
    )
    others: list[tuple[str, Kind, Survey | None]] = []
    for i, (kind, words, for_paper) in enumerate(_OTHER_CENTERS):
        offset = np.array(LENGTH.value(for_paper, robot))
        name = words.format(1e3 * np.abs(offset[3:]).max())
        try:
            grid = spanning_grid(robot, kind, center + offset, max(8, samples // 20))
            others.append((name, kind, survey(robot, limits, grid, gravity)))
        except ConfigurationError:
            others.append((name, kind, None))
        study.progress(0.5 + 0.1 * (i + 1) / len(_OTHER_CENTERS))
    return PoseStudy(center, surveys, boundaries, center + way * [[-1.0], [1.0]], cuts.astype(int), others, rate)


def slice_surveys(study: Study, poses: PoseStudy, kind: Kind) -> list[Survey]:
    """Five slices across the third coordinate and one along it, all through what the limits leave."""
    found = poses.surveys[kind]
    box = found.bounding_box(found.connected)
    if box is None:
        box = np.stack([found.grid.low, found.grid.high])
    room = 0.4 * (box[1] - box[0])
    low, high = np.maximum(box[0] - room, found.grid.low), np.minimum(box[1] + room, found.grid.high)
    middle = poses.center[list(COORDINATES[kind])]
    levels = np.linspace(box[0, 2], box[1, 2], 7)[1:-1]
    levels[np.abs(levels - middle[2]).argmin()] = middle[2]
    pixels = study.pick(220, 90)
    planes = [(2, level) for level in levels] + [(1 if kind == "position" else 0, None)]
    place = (COORDINATES[kind], poses.center, np.stack([low, high]))
    return [_slice(study.base, place, axis, middle[axis] if at is None else at, pixels) for axis, at in planes]


def motion_slice(study: Study, poses: PoseStudy, reference: np.ndarray) -> Survey:
    """The slice over the two coordinates that a motion (n, 6) moves most, the others as at the centre."""
    lever = study.base.robot.characteristic_length
    extent = np.ptp(reference, axis=0) * [lever, lever, lever, 1.0, 1.0, 1.0]
    two = np.argsort(-extent, kind="stable")[:2]
    if not extent.any():
        two = np.array([0, 5])
    third = next(i for i in range(6) if i not in two)
    first, second, third_ = sorted([*two.tolist(), third])
    coordinates = (first, second, third_)
    box = 1.3 * (poses.ranges - poses.center)[:, coordinates] + poses.center[list(coordinates)]
    place, axis = (coordinates, poses.center, box), coordinates.index(third)
    return _slice(study.base, place, axis, float(poses.center[third]), study.pick(260, 90))


Place = tuple[tuple[int, int, int], np.ndarray, np.ndarray]
"""Three coordinates, the centre (6,) and the box (2, 3) around it [rad, m]."""


def _slice(base: Scenario, place: Place, axis: int, level: float, pixels: int) -> Survey:
    """The survey of a box at one level of its axis, `pixels` along its longest side."""
    coordinates, center, box = place
    low, high = box.copy()
    low[axis] = high[axis] = level
    size = (high - low) * np.where(np.array(coordinates) < 3, base.robot.characteristic_length, 1.0)
    counts = np.maximum(2, np.round(pixels * size / size.max())).astype(int)
    counts[axis] = 1
    x, y, z = counts.tolist()
    return survey(base.robot, base.limits, Grid(coordinates, center, low, high, (x, y, z)), base.gravity)
