import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from strategies import ROBOT, poses, robots_and_poses, vectors

from stewart_drake.errors import ConfigurationError, ForwardKinematicsError, UnreachablePoseError
from stewart_drake.mechanics.kinematics import (
    conditioning,
    crank_rates,
    cross,
    euler_rate_matrix,
    euler_rate_matrix_dot,
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    pose_jacobian,
    pose_rate_to_twist,
    reach_margin,
    rod_lines,
    roll_pitch_yaw,
    rotation_matrix,
    twist_jacobian,
    twist_to_pose_rate,
)

CASES = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())["cases"]
AXES = np.eye(6)
angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1)).map(np.array)


def crank_tips(theta):
    """Crank tips in B, from the table of the geometry and nothing else."""
    tips = []
    for leg in range(6):
        c = np.radians(120.0 * (leg // 2))
        h = np.array([np.cos(c), np.sin(c), 0.0])
        at = c + np.radians(-8.0 if leg % 2 == 0 else 8.0)
        shaft = np.array([0.20 * np.cos(at), 0.20 * np.sin(at), -0.07])
        tips.append(shaft + 0.11 * (np.cos(theta[leg]) * h + np.sin(theta[leg]) * np.array([0.0, 0.0, 1.0])))
    return np.array(tips)


def platform_joints(pose):
    """Platform joints in B, by Drake's rotation."""
    rotation = RollPitchYaw(pose[:3]).ToRotationMatrix().matrix()
    at = [np.radians(120.0 * (leg // 2) + (-52.0 if leg % 2 == 0 else 52.0)) for leg in range(6)]
    return np.array([rotation @ [0.11 * np.cos(a), 0.11 * np.sin(a), 0.0] + pose[3:] for a in at])


def central_difference(function, x, step=1e-6):
    return np.stack([(function(x + step * e) - function(x - step * e)) / (2.0 * step) for e in np.eye(x.size)], axis=-1)


def move(pose, twist, time):
    """The pose after `time` of constant twist: exponential of the angular velocity, straight line of the origin."""
    rotation = Rotation.from_rotvec(time * twist[:3]).as_matrix() @ rotation_matrix(pose[:3])
    return np.concatenate([roll_pitch_yaw(rotation), pose[3:] + time * twist[3:]])


@given(rpy=angles)
def test_rotation_matrix_is_a_product_of_elementary_rotations_and_not_the_passive_matrix_of_the_print(rpy):
    x, y, z = (Rotation.from_euler(axis, angle).as_matrix() for axis, angle in zip("xyz", rpy, strict=True))
    np.testing.assert_allclose(rotation_matrix(rpy), z @ y @ x, atol=1e-15)


@pytest.mark.slow
@given(rpy=angles)
def test_roll_pitch_yaw_inverts_rotation_matrix(rpy):
    np.testing.assert_allclose(roll_pitch_yaw(rotation_matrix(rpy)), rpy, atol=1e-13)


@given(rpy=angles, rate=vectors(3, 5.0))
def test_euler_rate_matrix_is_drakes(rpy, rate):
    expected = RollPitchYaw(rpy).CalcAngularVelocityInParentFromRpyDt(rate)
    np.testing.assert_allclose(euler_rate_matrix(rpy) @ rate, expected, atol=1e-13)


@given(rpy=angles, rate=vectors(3, 5.0))
def test_euler_rate_matrix_dot_is_the_derivative_along_the_rate(rpy, rate):
    step = 1e-6
    numerical = (euler_rate_matrix(rpy + step * rate) - euler_rate_matrix(rpy - step * rate)) / (2.0 * step)
    np.testing.assert_allclose(euler_rate_matrix_dot(rpy, rate), numerical, atol=1e-8)


@pytest.mark.slow
@given(pose=poses(), rate=vectors(6, 5.0))
def test_twist_and_pose_rate_are_inverse(pose, rate):
    np.testing.assert_allclose(twist_to_pose_rate(pose, pose_rate_to_twist(pose, rate)), rate, atol=1e-13)


@given(pose=poses(), branch=st.sampled_from([-1, 1]))
def test_every_rod_has_its_length_on_both_branches(pose, branch):
    theta = inverse_kinematics(ROBOT, pose, branch)
    rods = platform_joints(pose) - crank_tips(theta)
    np.testing.assert_allclose(np.linalg.norm(rods, axis=-1), 0.404, rtol=1e-14)
    assert np.all((-np.pi < theta) & (theta <= np.pi))


@given(pose=poses())
def test_the_branches_mirror_each_other_about_the_direction_of_the_span(pose):
    lower, upper = (inverse_kinematics(ROBOT, pose, branch) for branch in (-1, 1))
    span = platform_joints(pose) - ROBOT.shaft_positions
    direction = np.arctan2(span[:, 2], np.sum(span * ROBOT.crank_zero_directions, axis=-1))
    np.testing.assert_allclose(np.sin(0.5 * (lower + upper) - direction), 0.0, atol=1e-13)
    assert np.all(leg_geometry(ROBOT, pose, -1).transmission > 0.0)
    assert np.all(leg_geometry(ROBOT, pose, 1).transmission < 0.0)


@pytest.mark.parametrize("case", CASES)
def test_crank_angles_of_an_independent_implementation(case):
    np.testing.assert_allclose(inverse_kinematics(ROBOT, case["pose"]), case["crank_angles_rad"], atol=1e-13)


@given(pose=poses())
def test_turning_the_pose_by_120_degrees_permutes_the_legs(pose):
    third = Rotation.from_euler("z", 120.0, degrees=True).as_matrix()
    turned = np.concatenate([roll_pitch_yaw(third @ rotation_matrix(pose[:3]) @ third.T), third @ pose[3:]])
    np.testing.assert_allclose(
        inverse_kinematics(ROBOT, turned), np.roll(inverse_kinematics(ROBOT, pose), 2), atol=1e-12
    )


@settings(max_examples=200)
@given(pose=poses())
def test_forward_kinematics_from_home_inverts_inverse_kinematics(pose):
    theta = inverse_kinematics(ROBOT, pose)
    found = forward_kinematics(ROBOT, theta)
    np.testing.assert_allclose(found, pose, atol=1e-10)
    np.testing.assert_allclose(inverse_kinematics(ROBOT, found), theta, atol=1e-10)


@given(pose=poses(0.8), offset=vectors(6, 0.02))
def test_forward_kinematics_from_a_guess_nearby_keeps_the_assembly(pose, offset):
    theta = inverse_kinematics(ROBOT, pose)
    np.testing.assert_allclose(forward_kinematics(ROBOT, theta, pose + offset), pose, atol=1e-10)


def test_forward_kinematics_says_when_the_angles_cannot_be_assembled():
    # Shafts so far out that no rod comes back to the platform, once the cranks point outwards.
    wide = ROBOT.replace(shaft_circle_radius=0.48, home_height=0.02, branch=1)
    with pytest.raises(ForwardKinematicsError, match="rod-length error") as caught:
        forward_kinematics(wide, np.zeros(6))
    assert caught.value.residual > 0.01
    assert caught.value.iterations == 30


def test_forward_kinematics_stops_after_the_iterations_it_was_given():
    theta = inverse_kinematics(ROBOT, ROBOT.home_pose + 0.05)
    with pytest.raises(ForwardKinematicsError) as caught:
        forward_kinematics(ROBOT, theta, max_iterations=1)
    assert caught.value.iterations == 1
    assert 0.0 < caught.value.residual < 0.01


def test_forward_kinematics_from_a_singular_guess_raises_instead_of_dividing_by_zero():
    flat = ROBOT.replace(shaft_height=-1e-3)
    # Cranks and platform in one plane: all rods lie in it, and no first-order step leaves it.
    with pytest.raises(ForwardKinematicsError) as caught:
        forward_kinematics(flat, np.zeros(6), guess=[0, 0, 0, 0, 0, -1e-3])
    assert caught.value.iterations == 0


@pytest.mark.parametrize("theta", [np.zeros(5), np.full(6, np.nan), 0.0])
def test_forward_kinematics_refuses_what_is_not_six_angles(theta):
    with pytest.raises(ConfigurationError, match="crank_angles"):
        forward_kinematics(ROBOT, theta)


def test_forward_kinematics_refuses_a_bad_guess():
    with pytest.raises(ConfigurationError, match="guess"):
        forward_kinematics(ROBOT, np.zeros(6), guess=np.full(6, np.inf))


@pytest.mark.parametrize("shape", [(3, 6), (2, 1, 6)])
def test_forward_kinematics_refuses_a_guess_of_another_shape(shape):
    with pytest.raises(ConfigurationError, match=r"guess.*\(6,\)"):
        forward_kinematics(ROBOT, np.zeros(6), guess=np.tile(ROBOT.home_pose, (*shape[:-1], 1)))


@given(at=robots_and_poses())
def test_pose_jacobian_against_central_differences(at):
    robot, pose = at
    theta = inverse_kinematics(robot, pose)
    numerical = central_difference(
        lambda x: np.remainder(inverse_kinematics(robot, x) - theta + np.pi, 2.0 * np.pi), pose
    )
    np.testing.assert_allclose(pose_jacobian(robot, pose), numerical, atol=1e-6, rtol=1e-6)


@given(pose=poses(0.8), rate=vectors(6, 1.0))
def test_crank_rates_are_the_jacobian_times_the_pose_rate(pose, rate):
    stacked = np.stack([pose, ROBOT.home_pose]), np.stack([rate, -rate])
    found = crank_rates(ROBOT, leg_geometry(ROBOT, stacked[0]), *stacked)
    for k in range(2):
        expected = pose_jacobian(ROBOT, stacked[0][k]) @ stacked[1][k]
        np.testing.assert_allclose(found[k], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@given(pose=poses(0.8))
def test_twist_jacobian_against_central_differences_along_screws(pose):
    step = 1e-6
    numerical = np.stack(
        [
            (inverse_kinematics(ROBOT, move(pose, e, step)) - inverse_kinematics(ROBOT, move(pose, e, -step)))
            / (2.0 * step)
            for e in AXES
        ],
        axis=-1,
    )
    np.testing.assert_allclose(twist_jacobian(ROBOT, pose), numerical, atol=1e-6, rtol=1e-6)


@given(pose=poses(), twist=vectors(6))
def test_rod_lines_give_the_speed_of_the_platform_joints_along_the_rods(pose, twist):
    legs = leg_geometry(ROBOT, pose)
    speed = twist[3:] + np.cross(twist[:3], platform_joints(pose) - pose[3:])
    np.testing.assert_allclose(rod_lines(legs) @ twist, np.sum(legs.e_l * speed, axis=-1), atol=1e-14)


@pytest.mark.slow
@given(at=robots_and_poses())
def test_leg_vectors_are_unit_and_close_the_loop_of_any_robot(at):
    robot, pose = at
    legs = leg_geometry(robot, pose)
    for unit in (legs.crank, legs.e_n, legs.e_l):
        np.testing.assert_allclose(np.linalg.norm(unit, axis=-1), 1.0, rtol=1e-12)
    tips = robot.shaft_positions + robot.crank_lengths[:, None] * legs.crank
    joints = tips + robot.rod_lengths[:, None] * legs.e_l
    np.testing.assert_allclose(joints, robot.platform_joints @ rotation_matrix(pose[:3]).T + pose[3:], atol=1e-13)
    np.testing.assert_array_equal(np.sign(legs.transmission), -robot.branches)
    found = forward_kinematics(robot, legs.crank_angles, pose + 0.01)
    np.testing.assert_allclose(found, pose, atol=1e-9)


@given(pose=poses())
def test_leg_vectors_are_unit_and_close_the_loop(pose):
    legs = leg_geometry(ROBOT, pose)
    for unit in (legs.crank, legs.e_n, legs.e_l):
        np.testing.assert_allclose(np.linalg.norm(unit, axis=-1), 1.0, rtol=1e-13)
    np.testing.assert_allclose(np.sum(legs.crank * legs.e_n, axis=-1), 0.0, atol=1e-15)
    joints = ROBOT.shaft_positions + 0.11 * legs.crank + 0.404 * legs.e_l
    np.testing.assert_allclose(joints, platform_joints(pose), atol=1e-14)
    tip_speed = (crank_tips(legs.crank_angles + 1e-6) - crank_tips(legs.crank_angles - 1e-6)) / 2e-6
    np.testing.assert_allclose(0.11 * legs.e_n, tip_speed, atol=1e-10)


def test_cross_is_numpys():
    a, b = np.random.default_rng(1).normal(size=(2, 4, 3))
    np.testing.assert_array_equal(cross(a, b[0]), np.cross(a, b[0]))


def test_an_unreachable_pose_among_many_is_named_with_leg_and_margin():
    many = np.tile(ROBOT.home_pose, (4, 1))
    many[2, 3] = 0.5
    margins = reach_margin(ROBOT, many)
    with pytest.raises(UnreachablePoseError) as caught:
        inverse_kinematics(ROBOT, many)
    np.testing.assert_array_equal(caught.value.pose, many[2])
    assert caught.value.leg == margins[2].argmin()
    assert caught.value.margin == pytest.approx(margins[2].min(), rel=1e-12)
    assert caught.value.margin < 0.0


@pytest.mark.parametrize("direction", [*np.vstack([AXES[3:], -AXES[3:]])])
def test_reach_ends_where_a_crank_is_at_its_dead_centre(direction):
    def worst(distance):
        return reach_margin(ROBOT, ROBOT.home_pose + distance * direction).min()

    edge = brentq(worst, 0.0, 0.5, xtol=1e-15)
    inside = ROBOT.home_pose + (edge - 1e-9) * direction
    leg = reach_margin(ROBOT, inside).argmin()
    assert abs(leg_geometry(ROBOT, inside).transmission[leg]) < 1e-3
    with pytest.raises(UnreachablePoseError):
        inverse_kinematics(ROBOT, ROBOT.home_pose + (edge + 1e-9) * direction)


def test_a_platform_joint_on_the_motor_axis_is_out_of_reach_without_a_division_by_zero():
    pose = np.zeros(6)
    pose[3:] = ROBOT.shaft_positions[0] - ROBOT.platform_joints[0]
    pose[4] -= 0.3
    assert reach_margin(ROBOT, pose)[0] == -np.inf
    with pytest.raises(UnreachablePoseError):
        inverse_kinematics(ROBOT, pose)


@pytest.mark.parametrize("pose", [np.zeros(5), 0.3, [0, 0, 0, 0, 0, np.nan], [[0, 0, 0, 0, 0, np.inf]]])
def test_poses_that_are_not_six_finite_numbers_are_refused(pose):
    with pytest.raises(ConfigurationError, match="pose"):
        inverse_kinematics(ROBOT, pose)


@pytest.mark.parametrize("branch", [0, 2])
def test_a_branch_is_a_sign(branch):
    with pytest.raises(ConfigurationError, match="branch"):
        inverse_kinematics(ROBOT, ROBOT.home_pose, branch)


@pytest.mark.parametrize(("axis", "beyond"), [(0, 1.4), (1, -1.3), (2, 1.56)])
def test_conditioning_vanishes_exactly_where_the_rods_lines_lose_rank(axis, beyond):
    def determinant(angle):
        return np.linalg.det(rod_lines(leg_geometry(ROBOT, ROBOT.home_pose + angle * AXES[axis])))

    angle = brentq(determinant, 0.0, beyond, xtol=1e-15)
    pose = ROBOT.home_pose + angle * AXES[axis]
    assert conditioning(ROBOT, pose) < 1e-14
    assert np.linalg.matrix_rank(rod_lines(leg_geometry(ROBOT, pose))) == 5
    assert abs(leg_geometry(ROBOT, pose).transmission).min() > 0.2


@given(pose=poses())
def test_conditioning_is_a_ratio_of_singular_values_free_of_units(pose):
    ratio = conditioning(ROBOT, pose)
    assert 0.0 < ratio <= 1.0
    scale = 3.0
    lengths = (
        "shaft_circle_radius",
        "shaft_height",
        "platform_joint_radius",
        "crank_length",
        "rod_length",
        "home_height",
        "characteristic_length",
    )
    larger = ROBOT.replace(**{name: scale * getattr(ROBOT, name) for name in lengths})
    assert conditioning(larger, np.concatenate([pose[:3], scale * pose[3:]])) == pytest.approx(ratio, rel=1e-9)


@pytest.mark.parametrize("shape", [(0, 6), (3, 0, 6), (0, 3, 6)])
def test_no_poses_and_no_angles_give_none(shape):
    assert inverse_kinematics(ROBOT, np.zeros(shape)).shape == shape
    assert forward_kinematics(ROBOT, np.zeros(shape)).shape == shape
