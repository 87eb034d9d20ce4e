"""Robots of public projects from their own numbers: by one command, and spoilt in many ways."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.cli.robot_commands import from_table as command
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.geometry import from_table
from stewart_drake.robot.robot_files import load_robot

DATA = json.loads((Path(__file__).parent / "data" / "public_robots.json").read_text())
ROBOTS = {robot["name"]: robot for robot in DATA["robots"]}
HEADER = DATA["columns"]
METRES = {"mm": 1e-3, "cm": 1e-2}


def write(path, rows, header=HEADER):
    path.write_text("\n".join([header, *(", ".join(f"{x:.17g}" for x in row) for row in rows)]))
    return path


def run(robot, path, out):
    """The function of `robots from-table`, as its options give the robot."""
    lengths = (f"crank_length={robot['crank_length']}", f"rod_length={robot['rod_length']}")
    command.callback(path, robot["unit"], "outwards", str(robot["home"]), lengths, "", out)
    return load_robot(out)


def angles_at(robot, pose_offset):
    """Angles (6,) [rad] of the cranks that are nearest to level, by the law of cosines; the pose is a translation."""
    metres, legs = METRES[robot["unit"]], np.array(robot["legs"])
    shaft, joint = metres * legs[:, :3], metres * legs[:, 3:6]
    crank, rod = metres * robot["crank_length"], metres * robot["rod_length"]
    direction = np.stack([np.cos(np.radians(legs[:, 6])), np.sin(np.radians(legs[:, 6])), np.zeros(6)], axis=-1)
    result = []
    for leg in range(6):
        x, y, z = joint[leg] + pose_offset - shaft[leg]
        along = x * direction[leg, 0] + y * direction[leg, 1]
        across = x * direction[leg, 1] - y * direction[leg, 0]
        in_plane, reach = math.hypot(along, z), rod**2 - across**2
        turn = math.acos((crank**2 + in_plane**2 - reach) / (2.0 * crank * in_plane))
        both = [math.remainder(math.atan2(z, along) + side * turn, math.tau) for side in (-1.0, 1.0)]
        result.append(min(both, key=abs))
    return np.array(result)


def home_of(robot):
    """Height [m] at which the legs are at home on average, by triangles."""
    metres, heights = METRES[robot["unit"]], []
    for x, y, z, u, v, w, yaw in robot["legs"]:
        crank, rod, yaw = robot["crank_length"], robot["rod_length"], math.radians(yaw)
        level = math.sqrt(rod**2 - (x + crank * math.cos(yaw) - u) ** 2 - (y + crank * math.sin(yaw) - v) ** 2)
        upright = math.sqrt(rod**2 + crank**2 - (x - u) ** 2 - (y - v) ** 2)
        heights.append(z - w + {"level": level, "perpendicular": upright}.get(robot["home"], 0.0))
    return metres * (np.mean(heights) if isinstance(robot["home"], str) else robot["home"])


@pytest.mark.parametrize("name", ROBOTS)
def test_a_public_robot_is_described_by_one_command(name, tmp_path, capsys):
    robot = ROBOTS[name]
    made = run(robot, write(tmp_path / "points.csv", robot["legs"]), tmp_path / "robot.yaml")
    plan = np.degrees(np.arctan2(*made.crank_zero_directions[:, 1::-1].T))
    np.testing.assert_allclose(np.cos(np.radians(plan - np.array(robot["legs"])[:, 6])), 1.0, atol=1e-12)
    assert made.home_height == pytest.approx(home_of(robot), abs=1e-9)
    home = np.array([0.0, 0.0, made.home_height])
    for move in ([0.0, 0.0, 0.0], [0.003, -0.002, 0.002]):
        pose = np.concatenate([np.zeros(3), home + move])
        np.testing.assert_allclose(inverse_kinematics(made, pose), angles_at(robot, home + move), atol=1e-7)
    if robot["home"] == "perpendicular":
        angle = inverse_kinematics(made, made.home_pose)
        zero, quarter = made.crank_zero_directions, made.crank_quarter_directions
        crank = np.cos(angle)[:, None] * zero + np.sin(angle)[:, None] * quarter
        rod = made.joints_in_platform + home - made.shaft_positions - made.crank_lengths[:, None] * crank
        np.testing.assert_allclose(np.sum(crank * rod, axis=-1), 0.0, atol=1e-6)
    warned = capsys.readouterr().err
    # Its author mirrored one crank.
    assert ("leg 0 is level" in warned and "mirrored" in warned) if name == "public-19" else warned == ""
