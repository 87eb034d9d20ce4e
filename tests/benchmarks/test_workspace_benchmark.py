"""Poses measured a second, all measures of each: `make bench`."""

import numpy as np
import pytest

from stewart_drake.mechanics.kinematics import reach_margin
from stewart_drake.planning.limits import Limits, limit_margins, measure_poses
from stewart_drake.planning.workspace import spanning_grid
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()


@pytest.fixture
def per_second(benchmark):
    """Runs a benchmark and reports how many poses a second it did."""

    def run(name, function, poses, rounds):
        benchmark.pedantic(function, rounds=rounds, warmup_rounds=0)
        rate = poses / benchmark.stats.stats.min
        benchmark.extra_info["poses per second"] = round(rate)
        print(f"\n{name}: {poses:,} poses, {rate:,.0f} a second")

    return run


def within_reach(count):
    """Poses of which every rod can span, so that none is spared the costly measures."""
    spread = np.array([0.4, 0.4, 0.4, 0.06, 0.06, 0.05])
    pose = ROBOT.home_pose + np.random.default_rng(0).uniform(-1.0, 1.0, (2 * count, 6)) * spread
    pose = pose[reach_margin(ROBOT, pose).min(axis=1) >= 0.0][:count]
    assert len(pose) == count
    return pose


def test_a_million_poses_within_reach(per_second):
    pose = within_reach(1_000_000)
    per_second("all within reach", lambda: measure_poses(ROBOT, pose), len(pose), rounds=2)


@pytest.mark.parametrize("kind", ["position", "orientation"])
def test_a_million_poses_of_a_workspace(per_second, kind):
    pose = spanning_grid(ROBOT, kind, ROBOT.home_pose, 1_000_000).poses
    per_second(f"{kind} workspace", lambda: measure_poses(ROBOT, pose), len(pose), rounds=2)


def test_margins_of_a_motion(per_second):
    pose, still = within_reach(100_000), np.zeros((100_000, 6))
    per_second("limit_margins", lambda: limit_margins(ROBOT, Limits(), pose, still, still, 9.81), len(pose), rounds=3)
