"""Poses measured a second, all measures of each: `make bench`."""

import numpy as np
import pytest

from stewart_drake.mechanics.kinematics import reach_margin
from stewart_drake.planning.limits import measure_poses
from stewart_drake.planning.workspace import spanning_grid
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()


def within_reach(count):
    spread = np.array([0.4, 0.4, 0.4, 0.06, 0.06, 0.05])
    pose = ROBOT.home_pose + np.random.default_rng(0).uniform(-1.0, 1.0, (2 * count, 6)) * spread
    return pose[reach_margin(ROBOT, pose).min(axis=1) >= 0.0][:count]


@pytest.mark.parametrize("kind", ["within reach", "position", "orientation"])
def test_a_million_poses(benchmark, kind):
    # Of those within reach none is spared the costly measures.
    count = 1_000_000
    pose = within_reach(count) if kind == "within reach" else spanning_grid(ROBOT, kind, ROBOT.home_pose, count).poses
    benchmark.pedantic(lambda: measure_poses(ROBOT, pose), rounds=2, warmup_rounds=0)
    rate = len(pose) / benchmark.stats.stats.min
    benchmark.extra_info["poses per second"] = round(rate)
    print(f"\n{kind}: {len(pose):,} poses, {rate:,.0f} a second")
