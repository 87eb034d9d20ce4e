import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from strategies import ROBOT, robots_and_poses, vectors

from stewart_drake import ConfigurationError, forward_kinematics, inverse_kinematics, leg_geometry
from stewart_drake.base.errors import ForwardKinematicsError
from stewart_drake.mechanics.kinematics import (
    conditioning,
    crank_rates,
    euler_rate_matrix,
    newton,
    pose_jacobian,
    pose_rate_to_twist,
    rod_length_errors,
    rod_lines,
    roll_pitch_yaw,
    rotation_angle,
    rotation_matrix,
    twist_jacobian,
    twist_to_pose_rate,
)
from stewart_drake.mechanics.kinematics_laws import euler_drift, robot_record

CASES = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())["cases"]
AXES = np.eye(6)
angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1)).map(np.array)


@given(rpy=angles)
def test_rotation_matrix_is_a_product_of_elementary_rotations_and_not_the_passive_matrix_of_the_print(rpy):
    x, y, z = (Rotation.from_euler(axis, angle).as_matrix() for axis, angle in zip("xyz", rpy, strict=True))
    np.testing.assert_allclose(rotation_matrix(rpy), z @ y @ x, atol=1e-15)
    np.testing.assert_allclose(roll_pitch_yaw(rotation_matrix(rpy)), rpy, atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 0.3, np.pi / 2.0, np.pi - 1e-8, np.pi])
def test_angle_of_a_rotation_has_all_its_digits(angle):
    turned = Rotation.from_rotvec(angle * np.array([1.0, 2.0, -2.0]) / 3.0).as_matrix()
    assert rotation_angle(turned) == pytest.approx(angle, rel=1e-14, abs=1e-15)


@given(rpy=angles, rate=vectors(3, 5.0))
def test_euler_rate_matrix_is_drakes(rpy, rate):
    expected = RollPitchYaw(rpy).CalcAngularVelocityInParentFromRpyDt(rate)
    np.testing.assert_allclose(euler_rate_matrix(rpy) @ rate, expected, atol=1e-13)


@given(rpy=angles, rate=vectors(3, 5.0))
def test_euler_drift_is_the_derivative_of_the_angular_velocity_along_the_rate(rpy, rate):
    step, drift = 1e-6, np.empty(3)
    ahead, behind = (euler_rate_matrix(rpy + sign * step * rate) for sign in (1.0, -1.0))
    euler_drift(rpy, rate, drift)
    np.testing.assert_allclose(drift, (ahead - behind) @ rate / (2.0 * step), atol=1e-7)


@pytest.mark.parametrize("case", CASES)
def test_crank_angles_of_an_independent_implementation(case):
    np.testing.assert_allclose(inverse_kinematics(ROBOT, case["pose"]), case["crank_angles_rad"], atol=1e-13)


@pytest.mark.parametrize("leg", range(6))
def test_an_angle_that_is_no_number_never_counts_as_convergence(leg):
    angles = inverse_kinematics(ROBOT, ROBOT.home_pose)[None]
    angles[0, leg] = np.nan
    _, (error,), _ = newton(ROBOT, angles, ROBOT.home_pose[None], 1e-9, 30)
    assert not error <= 1e-9


def test_forward_kinematics_reports_angles_that_cannot_be_assembled():
    # Shafts so far out that no rod comes back to the platform, once the cranks point outwards.
    wide = ROBOT.replace(shaft_circle_radius=0.48, home_height=0.02, branch=1)
    with pytest.raises(ForwardKinematicsError, match="rod-length error") as caught:
        forward_kinematics(wide, np.zeros(6))
    assert caught.value.residual > 0.01
    assert caught.value.iterations == 30


@given(at=robots_and_poses(), rate=vectors(6))
def test_pose_jacobian_against_central_differences_and_what_follows_from_it(at, rate):
    robot, pose = at
    theta = inverse_kinematics(robot, pose)
    turned = [inverse_kinematics(robot, pose + step * AXES) - theta for step in (1e-6, -1e-6)]
    numerical = np.angle(np.exp(1j * (turned[0] - turned[1]))).T / 2e-6
    jacobian, twist = pose_jacobian(robot, pose), pose_rate_to_twist(pose, rate)
    np.testing.assert_allclose(jacobian, numerical, atol=1e-6, rtol=1e-6)
    np.testing.assert_allclose(twist_jacobian(robot, pose) @ twist, jacobian @ rate, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(twist_to_pose_rate(pose, twist), rate, atol=1e-13)
    rates = crank_rates(robot, leg_geometry(robot, pose), pose, rate)
    np.testing.assert_allclose(rates, jacobian @ rate, rtol=1e-9, atol=1e-9)


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


@given(robots_and_poses(), vectors(6, 1e-3))
def test_rod_length_errors_are_those_of_the_rods_and_vanish_where_the_legs_close(at, error):
    robot, pose = at
    angles = inverse_kinematics(robot, pose)
    assert rod_length_errors(robot, angles, pose) == pytest.approx(np.zeros(6), abs=1e-12)
    short = robot_record(robot).copy()
    short["rod_length"] -= error
    assert rod_length_errors(short, angles, pose) == pytest.approx(error, abs=1e-12)


@pytest.mark.parametrize(("axis", "beyond"), [(0, 1.4), (1, -1.3), (2, 1.56)])
def test_conditioning_vanishes_exactly_where_the_rods_lines_lose_rank(axis, beyond):
    def determinant(angle):
        return np.linalg.det(rod_lines(leg_geometry(ROBOT, ROBOT.home_pose + angle * AXES[axis])))

    angle = brentq(determinant, 0.0, beyond, xtol=1e-15)
    pose = ROBOT.home_pose + angle * AXES[axis]
    assert conditioning(ROBOT, pose) < 1e-14
    assert np.linalg.matrix_rank(rod_lines(leg_geometry(ROBOT, pose))) == 5
    assert abs(leg_geometry(ROBOT, pose).transmission).min() > 0.2


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: inverse_kinematics(ROBOT, np.zeros(5)), "pose"),
        (lambda: forward_kinematics(ROBOT, np.full(6, np.nan)), "crank_angles"),
        (lambda: forward_kinematics(ROBOT, np.zeros(5)), "crank_angles"),
        (lambda: forward_kinematics(ROBOT, np.zeros(6), guess=np.full(6, np.inf)), r"guess.*\(\.\.\., 6\)"),
        (lambda: forward_kinematics(ROBOT, np.zeros(6), guess=np.zeros(7)), r"guess.*\(\.\.\., 6\)"),
        (lambda: forward_kinematics(ROBOT, np.zeros(6), guess=np.tile(ROBOT.home_pose, (3, 1))), r"guess.*\(6,\)"),
    ],
)
def test_what_is_not_six_finite_numbers_is_refused_by_name(call, words):
    with pytest.raises(ConfigurationError, match=words):
        call()
