import numpy as np
import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import inverse_kinematics, leg_geometry, reach_margin, rotation_matrix
from stewart_drake.paper import as_printed
from stewart_drake.paper.kinematics_checks import (
    branch_of_6,
    misprint_effect,
    newton_each,
    newton_outcome,
    rod_spans,
    turn_between,
)
from stewart_drake.paper.region import ANNOUNCED, WIDE
from stewart_drake.planning.pose_box import NEAR, Region, sample_poses
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
HOME = ROBOT.home_pose
both_branches = pytest.mark.parametrize("branch", [-1, 1])


def near(count, seed=0):
    return sample_poses(ROBOT, NEAR, count, np.random.default_rng(seed)).poses


# --- where the poses come from ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("region", [NEAR, ANNOUNCED, WIDE])
def test_samples_lie_in_their_box_and_within_reach(region):
    sample = sample_poses(ROBOT, region, 500, np.random.default_rng(1))
    assert sample.poses.shape == (500, 6)
    assert np.all(np.abs(sample.poses - HOME) <= region.half_width)
    assert reach_margin(ROBOT, sample.poses).min() > 0.0
    drawn = HOME + np.random.default_rng(2).uniform(-1.0, 1.0, (20000, 6)) * region.half_width
    assert sample.share == pytest.approx((reach_margin(ROBOT, drawn).min(axis=-1) > 0.0).mean(), abs=0.02)


def test_a_box_without_a_pose_in_reach_is_refused(monkeypatch):
    monkeypatch.setattr("stewart_drake.planning.pose_box._MOST_BLOCKS", 2)
    with pytest.raises(ConfigurationError, match="nowhere"):
        sample_poses(ROBOT, Region("none", (0.0,) * 6, "nowhere"), 5, np.random.default_rng(0), least_margin=1.0)


# --- the print -------------------------------------------------------------------------------------------------------


def test_the_printed_rotation_differs_from_the_true_one_in_one_entry():
    rpy = np.array([0.3, -0.5, 0.8])
    difference = as_printed.rotation_3(rpy) - rotation_matrix(rpy).T
    at = np.zeros((3, 3))
    at[2, 0] = np.sin(-0.5) * np.cos(0.8) * (np.cos(-0.5) - np.cos(0.3))
    np.testing.assert_allclose(difference, at, atol=1e-15)


@pytest.mark.parametrize("rpy", [(0.4, 0.0, 0.3), (0.4, 0.4, 0.2), (0.4, -0.4, 0.2), (0.5, 0.2, np.pi / 2.0)])
def test_where_the_report_says_so_the_printed_matrix_is_a_rotation(rpy):
    np.testing.assert_allclose(as_printed.rotation_3(np.array(rpy)), rotation_matrix(rpy).T, atol=1e-15)


def test_the_bracket_of_5_turns_the_position_with_the_attitude():
    poses = near(5)
    elsewhere = poses.copy()
    elsewhere[:, 3:] = np.einsum("nij,nj->ni", rotation_matrix(poses[:, :3]), poses[:, 3:])
    expected = as_printed.platform_joints(ROBOT, elsewhere)
    np.testing.assert_allclose(as_printed.platform_joints_5(ROBOT, poses), expected, atol=1e-15)


@both_branches
def test_crank_angles_from_the_equation_are_those_of_the_package(branch):
    poses = near(20)
    equation = as_printed.crank_equation(ROBOT, as_printed.platform_joints(ROBOT, poses))
    theta = as_printed.crank_angles(equation, branch)
    apart = np.angle(np.exp(1j * (theta - inverse_kinematics(ROBOT, poses, branch))))
    np.testing.assert_allclose(apart, 0.0, atol=1e-13)
    np.testing.assert_allclose(equation.residual(theta), 0.0, atol=1e-14)


def test_out_of_reach_is_nan_and_said_so():
    pose = HOME + [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
    equation = as_printed.crank_equation(ROBOT, as_printed.platform_joints(ROBOT, pose))
    assert not equation.in_reach
    assert np.isnan(as_printed.crank_angles(equation, 1)).all()
    assert np.isnan(as_printed.crank_angles_6(equation)).all()


def test_6_solves_its_equation_where_a_is_not_positive_and_only_there():
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    equation = as_printed.CrankEquation(np.cos(angle), np.sin(angle), np.full(200, 0.3))
    solved = np.abs(equation.residual(as_printed.crank_angles_6(equation))) < 1e-12
    np.testing.assert_array_equal(solved, np.cos(angle) <= 1e-15)


@pytest.mark.parametrize(("sense", "branch"), [(1, "1"), (-1, "-1")])
def test_6_is_one_branch_or_the_other_by_the_sense_of_the_angle(sense, branch):
    shares = branch_of_6(ROBOT, near(50), sense)
    assert shares[branch] == 1.0
    assert shares["neither"] == shares["a_positive"] == 0.0
    wide = branch_of_6(ROBOT, sample_poses(ROBOT, WIDE, 300, np.random.default_rng(5)).poses, sense)
    assert wide["neither"] == wide["a_positive"] > 0.02


def test_the_rod_map_of_11_leaves_the_platform_joints_unrotated():
    for pose, same in ((HOME, True), (near(1)[0], False)):
        legs = leg_geometry(ROBOT, pose)
        printed = as_printed.rod_map_11(ROBOT, legs)
        for leg in range(6):
            np.testing.assert_allclose(printed[:3, leg], np.cross(ROBOT.platform_joints[leg], legs.e_l[leg]))
            assert np.allclose(printed[:3, leg], np.cross(legs.arm[leg], legs.e_l[leg])) is same


# --- Drake -----------------------------------------------------------------------------------------------------------


@both_branches
def test_drake_sees_the_rod_between_crank_tip_and_platform_joint(branch):
    robot, poses = ROBOT.replace(branch=branch), near(5)
    theta = inverse_kinematics(robot, poses)
    np.testing.assert_allclose(rod_spans(robot, poses, theta), 0.404, rtol=1e-14)
    step = 1e-6
    stretched = (rod_spans(robot, poses, theta + step) - 0.404) / step
    np.testing.assert_allclose(stretched, -0.11 * leg_geometry(robot, poses).transmission, atol=1e-6)


# --- forward ---------------------------------------------------------------------------------------------------------


def test_the_angle_between_attitudes_keeps_its_digits_when_small():
    rpy = np.array([0.4, 0.2, -0.3])
    for angle in (1e-9, 1e-3, 1.0, 3.0):
        assert turn_between(rpy, rpy + [0.0, 0.0, angle]) == pytest.approx(angle, rel=1e-6)


def test_newton_comes_back_on_homes_side_and_finds_another_assembly_beyond_the_singularity():
    turned = HOME + np.radians([[20.0], [70.0], [78.0]]) * np.eye(6)[0]
    outcome = newton_outcome(ROBOT, turned, HOME)
    assert {**outcome, "error": None} == {"same": 2, "other": 1, "other_across": 1, "failed": 0, "error": None}
    assert 0.0 <= outcome["error"] < 1e-9
    angles = inverse_kinematics(ROBOT, turned[2])
    found = newton_each(ROBOT, angles[None], HOME)
    np.testing.assert_allclose(inverse_kinematics(ROBOT, found)[0], angles, atol=1e-9)


def test_a_search_without_end_is_a_row_of_nan():
    theta = np.vstack([inverse_kinematics(ROBOT, HOME), np.full(6, np.nan), np.pi * np.array([1, 0, 1, 0, 1, 0])])
    found = newton_each(ROBOT, theta, HOME)
    np.testing.assert_allclose(found[0], HOME, atol=1e-12)
    assert np.isnan(found[1:]).all()


# --- misprints -------------------------------------------------------------------------------------------------------


def test_a_robot_that_follows_5_goes_where_the_bracket_sends_it():
    poses = near(30)
    effect = misprint_effect(ROBOT, poses, as_printed.platform_joints_5(ROBOT, poses))
    sent = np.einsum("nij,nj->ni", rotation_matrix(poses[:, :3]), poses[:, 3:]) - poses[:, 3:]
    np.testing.assert_allclose(effect["joint_shift"], np.linalg.norm(sent, axis=-1), atol=1e-14)
    there = ~np.isnan(effect["position_error"])
    assert there.any()
    assert np.isnan(effect["crank_error"]).any()
    np.testing.assert_allclose(effect["position_error"][there], effect["joint_shift"][there], atol=1e-9)
    np.testing.assert_allclose(effect["turn_error"][there], 0.0, atol=1e-9)


def test_without_a_misprint_nothing_is_off():
    poses = near(10)
    effect = misprint_effect(ROBOT, poses, as_printed.platform_joints(ROBOT, poses))
    assert all(np.allclose(values, 0.0, atol=1e-10) for values in effect.values())
