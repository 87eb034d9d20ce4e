"""`Reach.nearest` against a dense search, and docs/results/reach.md: `make results/reach`."""

import sys
import time
from pathlib import Path

import numpy as np

from stewart_drake import Reach, RobotParameters, load_robot
from stewart_drake.base.markdown import markdown_table
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.scenario.limits import limit_margins

OUT = Path(__file__).parents[1] / "results" / "reach.md"
ROBOTS = ("paper", "reachy_mini", "servo_hexapod")
STRANGE = "six cranks in other planes"
TARGETS, CLOUD, STARTS, TURN = 2_500, 8_000, 6, 1.0
"""Targets of a robot; poses drawn for the dense search; starts of other searches; [rad] half width of the box."""
TEXT = """# The nearest pose that a robot can take

How often is the result of `Reach.nearest` not the nearest pose, by how much, and is it ever outside of a limit?
Command: `make results/reach`, two minutes; `python docs/scripts/reach_study.py 25000 40000` takes 100,000 targets.

{table}

- {targets} random targets in all, up to {turn:.0f} deg about each axis and one characteristic length along each axis
  from home, seed 0. Distances have 1 rad as the characteristic length.
- Every result was checked by `limit_margins`, as motions are before a run: {broken} were outside of a limit.
- *Too far*: the distance of the result over the best one that was found, less 1. The best is that of this search, of
  searches from the {starts} nearest poses of a cloud of feasible poses, and of the cloud itself. Where the target can
  be taken and the result is another pose, it counts as *missed*.
- A call was timed three times, the fastest counts; one thread. The legs of the last robot are all different.
"""


def strange_robot() -> RobotParameters:
    """A robot whose legs are all different."""
    rng, size, legs = np.random.default_rng(3), 0.1, []
    for leg in range(6):
        third, side = 2.0 * np.pi / 3.0 * (leg // 2), 1.0 if leg % 2 else -1.0
        low, high = third + side * rng.uniform(0.2, 0.5), third + side * rng.uniform(0.6, 0.9)
        turn, tilt = third + rng.uniform(-0.6, 0.6), rng.uniform(-0.4, 0.4)
        zero, across = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
        legs.append(
            {
                "shaft_position": size * np.array([1.5 * np.cos(low), 1.5 * np.sin(low), rng.uniform(-0.1, 0.1)]),
                "platform_joint": size * np.array([np.cos(high), np.sin(high), rng.uniform(-0.1, 0.1)]),
                "crank_zero_direction": zero,
                "crank_quarter_direction": np.cos(tilt) * np.array([0.0, 0.0, 1.0]) + np.sin(tilt) * across,
                "crank_length": size * rng.uniform(0.5, 0.7),
                "rod_length": size * rng.uniform(2.2, 2.5),
                "branch": -1,
            }
        )
    return RobotParameters(legs=legs, home_height=2.2 * size, characteristic_length=size, link_radius=0.004)


def within(reach: Reach, poses: np.ndarray) -> np.ndarray:
    """Which poses (n, 6) are within all limits."""
    still = np.zeros_like(poses)
    # Home first: it sets the side of the singularities.
    motion = np.concatenate([reach.robot.home_pose[None], poses])
    still = np.zeros_like(motion)
    margins = limit_margins(reach.robot, reach.limits, motion, still, still, STANDARD_GRAVITY)
    return np.all([(values[1:] >= 0.0).all(axis=1) for values in margins.values()], axis=0)


def distances(reach: Reach, poses: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Distances (n,) [m] of poses (n, 6) from a target."""
    turns = rotation_matrix(poses[:, :3]) @ rotation_matrix(target[:3]).T
    return np.hypot(np.linalg.norm(poses[:, 3:] - target[3:], axis=1), reach.weight * rotation_angle(turns))


def study(name: str, robot: RobotParameters, count: int, cloud_size: int) -> tuple[list[str], int]:
    """The row of a robot in the table, and how many results were outside of a limit."""
    from scipy.spatial import cKDTree

    reach, rng = Reach(robot), np.random.default_rng(0)
    box = np.repeat([TURN, robot.characteristic_length], 3)
    cloud = robot.home_pose + rng.uniform(-1.0, 1.0, (cloud_size, 6)) * box
    cloud = np.array([pose for pose in cloud[within(reach, cloud)] if reach.check(pose).possible] or [robot.home_pose])
    scale = np.repeat([reach.weight, 1.0], 3)
    tree, seconds, results, excess, missed = cKDTree(cloud * scale), [], [], [], 0
    for target in robot.home_pose + rng.uniform(-1.0, 1.0, (count, 6)) * box:
        spent = []
        for _ in range(3):
            begun = time.perf_counter()
            found = reach.nearest(target)
            spent.append(time.perf_counter() - begun)
        seconds.append(min(spent))
        results.append(found.pose)
        if found.distance == 0.0:
            continue
        _, near = tree.query(target * scale, k=min(STARTS, len(cloud)))
        starts = cloud[np.atleast_1d(near)]
        others = [reach.nearest(target, start).distance for start in starts]
        best = min(found.distance, *others, *distances(reach, starts, target))
        missed += best == 0.0
        excess += [found.distance / best - 1.0] if best > 0.0 else []
    times, excess = 1e3 * np.array(seconds), 100.0 * np.array(excess)
    broken = int((~within(reach, np.array(results))).sum())
    row = [name, str(count), f"{100.0 * (1.0 - (len(excess) + missed) / count):.1f}", f"{100.0 * missed / count:.2f}"]
    row += [f"{100.0 * np.mean(excess > most):.2f}" for most in (1.0, 10.0)] + [f"{excess.max():.1f}"]
    row += [f"{np.median(times):.2f}", f"{np.quantile(times, 0.99):.2f}", f"{times.max():.2f}"]
    return row, broken


def main(count: int = TARGETS, cloud: int = CLOUD) -> None:
    """Writes the page."""
    robots = {name: load_robot(name) for name in ROBOTS} | {STRANGE: strange_robot()}
    rows, broken = zip(*(study(name, robot, count, cloud) for name, robot in robots.items()), strict=True)
    header = ["robot", "targets", "can be taken [%]", "missed [%]", "1 % too far [%]", "10 % too far [%]"]
    header += ["most too far [%]", "median [ms]", "99 % [ms]", "longest [ms]"]
    words = {"targets": count * len(robots), "turn": np.degrees(TURN), "broken": sum(broken), "starts": STARTS}
    OUT.write_text(TEXT.format(table=markdown_table(header, rows), **words))
    print(OUT.read_text())


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
