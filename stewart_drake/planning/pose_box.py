"""Boxes of poses around home, drawn at random, those in reach kept."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import reach_margin
from stewart_drake.planning.limits import Limits, limit_margins
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import PAPER

_DRAWN, _MOST = 4096, 500  # Poses at a time, and times at most.


class Region(NamedTuple):
    """A box of poses: a name for tables, (6,) [rad, m] to either side of home, and the box in words."""

    name: str
    half_width: tuple[float, ...]
    words: str

    def around(self, robot: RobotParameters) -> Region:
        """The box of a robot, whose shifts grow with its size."""
        size = robot.characteristic_length / PAPER.characteristic_length
        if size == 1.0:
            return self
        shifts = tuple(size * each for each in self.half_width[3:])
        return Region(self.name, (*self.half_width[:3], *shifts), f"{self.words}; shifts times {size:.3g}, by its size")


NEAR = Region(
    "near",
    (math.pi / 6.0,) * 3 + (0.06, 0.06, 0.05),
    "turns up to 30 deg about each axis, 60 mm in X and Y and 50 mm in Z to either side of home, all at once",
)
"""Where the controlled motions are: the paper's largest angle, the Z of (38), and room to the sides."""


def sample_poses(
    robot: RobotParameters,
    region: Region,
    count: int,
    rng: np.random.Generator,
    least_margin: float = 1e-6,
    limits: Limits | None = None,
    gravity: float = STANDARD_GRAVITY,
) -> np.ndarray:
    """Poses (count, 6) uniform over a box, in reach by `least_margin` and within `limits`; fewer where few are."""
    kept, drawn = np.empty((0, 6)), 0
    while len(kept) < count and drawn < _MOST * _DRAWN:
        poses = robot.home_pose + rng.uniform(-1.0, 1.0, (_DRAWN, 6)) * region.half_width
        poses = poses[reach_margin(robot, poses).min(axis=-1) > least_margin]
        if limits is not None:
            still = np.zeros_like(poses)
            margins = limit_margins(robot, limits, poses, still, still, gravity)
            poses = poses[np.all([(each >= 0.0).all(axis=-1) for each in margins.values()], axis=0)]
        kept, drawn = np.concatenate([kept, poses]), drawn + _DRAWN
    if not len(kept):
        within = "" if limits is None else ", within its limits"
        raise ConfigurationError("robot", robot, f"a robot that reaches a pose of this box{within}: {region.words}")
    return kept[:count]
