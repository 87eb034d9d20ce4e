import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stewart_drake.mechanics.kinematics import inverse_kinematics, rotation_matrix
from stewart_drake.paper.kinematics import (
    DURATION,
    START,
    TORQUE,
    branch_of_6,
    crank_angles,
    crank_equation,
    exact_motion,
    misprint_effect,
    newton_outcome,
    platform_joints,
    rod_spans,
    rotation_3,
)
from stewart_drake.paper.reproduce import ANNOUNCED, WIDE
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
HOME = ROBOT.home_pose
FREE = json.loads((Path(__file__).parent.parent / "data" / "reference_values.json").read_text())["free_motion"]


def near(count, region=NEAR, robot=ROBOT):
    return sample_poses(robot, region, count, np.random.default_rng(0))


def test_the_motion_is_the_one_that_another_program_computed():
    np.testing.assert_allclose(HOME + START, FREE["pose"], atol=1e-15)
    np.testing.assert_array_equal(TORQUE, FREE["torque"])
    assert FREE["time"] == DURATION
    pose = exact_motion(ROBOT, 9.81)
    np.testing.assert_allclose(pose[3:], FREE["position"], atol=1e-7)
    w, x, y, z = FREE["quaternion_wxyz"]
    turned = Rotation.from_quat([x, y, z, w]) * Rotation.from_euler("xyz", pose[:3]).inv()
    assert turned.magnitude() < 1e-7


def test_the_printed_rotation_differs_from_the_true_one_in_one_entry():
    rpy, at = np.array([0.3, -0.5, 0.8]), np.zeros((3, 3))
    at[2, 0] = np.sin(-0.5) * np.cos(0.8) * (np.cos(-0.5) - np.cos(0.3))
    np.testing.assert_allclose(rotation_3(rpy) - rotation_matrix(rpy).T, at, atol=1e-15)


def test_the_bracket_of_5_turns_the_position_with_the_attitude():
    poses = near(30)
    turned = np.einsum("nij,nj->ni", rotation_matrix(poses[:, :3]), poses[:, 3:])
    shift, _ = misprint_effect(ROBOT, poses, "(5)")
    np.testing.assert_allclose(shift, np.linalg.norm(turned - poses[:, 3:], axis=-1), atol=1e-14)


@pytest.mark.parametrize("branch", [-1, 1])
def test_crank_angles_from_the_equation_are_those_of_the_package(branch):
    poses = near(20)
    a, b, c = crank_equation(ROBOT, platform_joints(ROBOT, poses))
    theta = crank_angles(a, b, c, branch)
    off = np.angle(np.exp(1j * (theta - inverse_kinematics(ROBOT, poses, branch))))
    np.testing.assert_allclose(off, 0.0, atol=1e-13)
    np.testing.assert_allclose(a * np.cos(theta) + b * np.sin(theta), c, atol=1e-14)


@pytest.mark.parametrize(("sense", "branch"), [(1, "1"), (-1, "-1")])
def test_6_is_one_branch_or_the_other_by_the_sense_of_the_angle(sense, branch):
    shares = branch_of_6(ROBOT, near(50), sense)
    assert shares[branch] == 1.0
    assert shares["neither"] == shares["a_positive"] == 0.0
    wide = branch_of_6(ROBOT, near(300, WIDE), sense)
    assert wide["neither"] == wide["a_positive"] > 0.02


@pytest.mark.parametrize(("branch", "region"), [(-1, NEAR), (1, ANNOUNCED)])
def test_drake_sees_the_rod_between_crank_tip_and_platform_joint(branch, region):
    robot = ROBOT.replace(branch=branch, rod_length=0.41)
    np.testing.assert_allclose(rod_spans(robot, near(5, region, robot)), 0.41, rtol=1e-14)


def test_newton_comes_back_on_homes_side_and_finds_another_assembly_beyond_the_singularity():
    turned = HOME + np.radians([[20.0], [70.0], [78.0]]) * np.eye(6)[0]
    outcome = newton_outcome(ROBOT, turned, HOME)
    assert {**outcome, "error": None} == {"same": 2, "other": 1, "other_across": 1, "failed": 0, "error": None}
    assert 0.0 <= outcome["error"] < 1e-9
