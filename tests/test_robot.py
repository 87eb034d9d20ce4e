import dataclasses
import math

import numpy as np
import pydantic
import pytest
from conftest import field_of
from strategies import ROBOTS, TANGENTIAL, UNEQUAL

from stewart_drake.errors import ConfigurationError
from stewart_drake.leg import LegParameters
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario

ROBOT = RobotParameters()
NUMBERS = [f.name for f in dataclasses.fields(RobotParameters) if f.name not in ("branch", "legs")]
ANY_SIGN = {"crank_plane_angle", "platform_products", "platform_center_of_mass"}


def turn(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_joints_lie_on_their_circles():
    np.testing.assert_allclose(np.hypot(*ROBOT.shaft_positions[:, :2].T), 0.20, rtol=1e-15)
    np.testing.assert_allclose(np.hypot(*ROBOT.platform_joints[:, :2].T), 0.11, rtol=1e-15)
    np.testing.assert_array_equal(ROBOT.shaft_positions[:, 2], -0.07)
    np.testing.assert_array_equal(ROBOT.platform_joints[:, 2], 0.0)


def test_even_legs_stand_clockwise_of_their_pair_and_odd_legs_counter_clockwise():
    for leg in range(6):
        direction = math.radians(120.0 * (leg // 2))
        side = -1.0 if leg % 2 == 0 else 1.0
        for point, half_angle in ((ROBOT.shaft_positions[leg], 8.0), (ROBOT.platform_joints[leg], 52.0)):
            angle = math.atan2(point[1], point[0]) - direction
            expected = side * math.radians(half_angle)
            assert math.remainder(angle - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("array", ["shaft_positions", "platform_joints", "crank_zero_directions"])
def test_three_pairs_are_120_degrees_apart(array):
    points = getattr(ROBOT, array)
    np.testing.assert_allclose(points[:4] @ turn(2.0 * math.pi / 3.0).T, points[2:], atol=1e-15)


def test_the_two_shafts_of_a_pair_are_coaxial():
    for leg in (0, 2, 4):
        between = ROBOT.shaft_positions[leg + 1] - ROBOT.shaft_positions[leg]
        motor_axis = np.cross([0.0, 0.0, 1.0], ROBOT.crank_zero_directions[leg])
        np.testing.assert_allclose(np.cross(between, motor_axis), 0.0, atol=1e-16)


def test_home_is_the_stated_pose():
    np.testing.assert_array_equal(ROBOT.home_pose, [0, 0, 0, 0, 0, 0.3])
    np.testing.assert_allclose(np.degrees(inverse_kinematics(ROBOT, ROBOT.home_pose)), 23.546289, atol=5e-7)


def test_crank_inertia_about_the_motor_axis_by_the_parallel_axis_theorem():
    assert ROBOT.crank_axis_inertias == pytest.approx(5.8e-5 + 0.04 * 0.055**2, rel=1e-15)


def test_robots_are_values():
    assert RobotParameters() == ROBOT
    assert hash(RobotParameters()) == hash(ROBOT)
    with pytest.raises(dataclasses.FrozenInstanceError):
        ROBOT.rod_mass = 1.0
    with pytest.raises(ValueError, match="read-only"):
        ROBOT.home_pose[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        ROBOT.platform_joints[0, 0] = 1.0


def test_replace_gives_another_robot_with_its_own_geometry():
    longer = ROBOT.replace(platform_joint_radius=0.12)
    assert longer.platform_joints[0] == pytest.approx(ROBOT.platform_joints[0] * 0.12 / 0.11)
    assert ROBOT.platform_joint_radius == 0.11


def test_replace_validates_and_names_a_typo():
    with pytest.raises(ConfigurationError, match=r"robot\.rod_lenght.*rod_length"):
        ROBOT.replace(rod_lenght=0.5)
    with pytest.raises(ConfigurationError, match=r"robot\.rod_mass"):
        ROBOT.replace(rod_mass=0.0)


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_unusable_numbers_are_refused_by_name(name, bad):
    bad = 1e7 if bad == -1.0 and name in ANY_SIGN else bad
    value = getattr(ROBOT, name)
    changed = (bad, *value[1:]) if isinstance(value, tuple) else bad
    with pytest.raises(ConfigurationError) as caught:
        ROBOT.replace(**{name: changed})
    # A shaft height of -1 m is a number like any other; what fails is the assembly.
    assert field_of(caught.value) == ("robot.home_height" if (name, bad) == ("shaft_height", -1.0) else f"robot.{name}")


@pytest.mark.parametrize("branch", [0, 2, math.nan])
def test_branch_is_a_sign(branch):
    with pytest.raises(ConfigurationError, match=r"robot\.branch"):
        ROBOT.replace(branch=branch)


def test_the_printed_crank_inertia_is_refused_and_ours_is_the_nearest_that_is_not():
    with pytest.raises(ConfigurationError, match=r"robot\.crank_inertia"):
        ROBOT.replace(crank_inertia=(1e-6, 5.8e-5, 6.0e-5))
    assert ROBOT.crank_inertia[2] == pytest.approx(ROBOT.crank_inertia[0] + ROBOT.crank_inertia[1])


@pytest.mark.parametrize(
    "changes",
    [
        {"platform_inertia": (0.003, 0.003)},
        {"rod_inertia": (0.0016, 0.0015, 0.0002)},
        {"platform_half_angle": math.pi / 3.0},
        {"home_height": 0.6},
        {"rod_length": 0.1},
    ],
)
def test_robots_that_cannot_be_built_are_refused(changes):
    with pytest.raises(ConfigurationError):
        ROBOT.replace(**changes)


def test_pydantic_reads_it_and_refuses_unknown_keys_and_infinities():
    adapter = pydantic.TypeAdapter(RobotParameters)
    assert adapter.validate_python({"rod_mass": 0.09}).rod_mass == 0.09
    with pytest.raises(pydantic.ValidationError, match="rod_mas"):
        adapter.validate_python({"rod_mas": 0.09})
    with pytest.raises(pydantic.ValidationError, match="finite"):
        adapter.validate_python({"rod_mass": math.inf})


def test_numbers_of_numpy_and_lists_are_as_good_as_pythons():
    robot = RobotParameters(
        rod_length=np.float32(0.4),
        branch=np.int64(-1),
        rod_inertia=[0.0016, 0.0016, 1e-6],
        platform_inertia=np.full(3, 0.003),
    )
    assert (type(robot.rod_length), type(robot.branch)) == (float, int)
    assert robot.rod_inertia == (0.0016, 0.0016, 1e-6)
    assert robot.platform_inertia == (0.003, 0.003, 0.003)
    assert isinstance(hash(robot), int)


# --- legs of their own -----------------------------------------------------------------------------------------------


def test_cranks_in_tangential_planes_are_a_mirrored_robot_of_three_alike_pairs():
    for leg in range(6):
        across = TANGENTIAL.crank_zero_directions[leg] @ TANGENTIAL.crank_zero_directions[leg - leg % 2]
        assert across == pytest.approx(1.0 if leg % 2 == 0 else -1.0)
        pair = [np.cos(TANGENTIAL.pair_angles[leg]), np.sin(TANGENTIAL.pair_angles[leg]), 0.0]
        assert TANGENTIAL.crank_zero_directions[leg] @ pair == pytest.approx(0.0, abs=1e-15)


def test_a_leg_takes_from_the_symmetric_robot_what_it_has_not_of_its_own():
    robot = RobotParameters(legs=[{"rod_length": 0.41}, None, LegParameters(branch=1), {}, {}, {}], crank_length=0.1)
    np.testing.assert_array_equal(robot.rod_lengths, [0.41, *[0.404] * 5])
    np.testing.assert_array_equal(robot.branches, [-1, -1, 1, -1, -1, -1])
    np.testing.assert_array_equal(robot.crank_lengths, 0.1)
    for name in ("shaft_positions", "platform_joints", "crank_zero_directions", "crank_quarter_directions"):
        np.testing.assert_array_equal(getattr(robot, name), getattr(ROBOT, name))
    assert hash(robot) == hash(robot.replace())
    assert robot.replace(rod_length=0.4).rod_lengths.tolist() == [0.41, *[0.4] * 5]


def test_legs_are_read_from_plain_values_and_written_back():
    for robot in ROBOTS.values():
        adapter = pydantic.TypeAdapter(RobotParameters)
        again = adapter.validate_json(adapter.dump_json(robot))
        assert again == robot
        assert Scenario.from_dict(Scenario(robot=robot).to_dict()).robot == robot


def test_directions_are_made_perpendicular_to_the_last_bit():
    h, q = UNEQUAL.crank_zero_directions, UNEQUAL.crank_quarter_directions
    np.testing.assert_allclose(np.sum(h * q, axis=-1), 0.0, atol=1e-16)
    np.testing.assert_allclose([np.linalg.norm(h, axis=-1), np.linalg.norm(q, axis=-1)], 1.0, rtol=1e-15)


def test_inertia_about_the_origin_of_the_platforms_frame_is_that_of_a_body_of_points():
    robot = RobotParameters(
        platform_inertia=(0.003, 0.004, 0.005), platform_products=(2e-4, 3e-4, -1e-4),
        platform_center_of_mass=(0.1, -0.2, 0.3), platform_mass=2.0,
    )  # fmt: skip
    # Points at +-x along the principal axes have the central inertia; shifted, all of it about the origin.
    central = np.array([[0.003, 2e-4, 3e-4], [2e-4, 0.004, -1e-4], [3e-4, -1e-4, 0.005]])
    moments, axes = np.linalg.eigh(central)
    squares = 0.5 * moments.sum() - moments
    at = [
        np.array([0.1, -0.2, 0.3]) + side * math.sqrt(3.0 * square / 2.0) * axis
        for square, axis in zip(squares, axes.T, strict=True)
        for side in (-1.0, 1.0)
    ]
    inertia = sum(2.0 / 6.0 * (p @ p * np.eye(3) - np.outer(p, p)) for p in at)
    np.testing.assert_allclose(robot.platform_inertia_about_origin, inertia, rtol=1e-12)
    np.testing.assert_allclose(robot.platform_moment, [0.2, -0.4, 0.6])


@pytest.mark.parametrize(
    ("legs", "key"),
    [
        ([{}] * 5, "robot.legs"),
        (3, "robot.legs"),
        ([{"rod": 1.0}] + [{}] * 5, "robot.legs.0.rod"),
        ([{}] * 5 + [{"rod_length": -1.0}], "robot.legs.5.rod_length"),
        ([{"branch": 2}] + [{}] * 5, "robot.legs.0.branch"),
        ([{"crank_zero_direction": (1.0, 1.0, 0.0)}] + [{}] * 5, "robot.legs.0.crank_zero_direction"),
        ([{"crank_zero_direction": (0.0, 0.0, 1.0)}] + [{}] * 5, "robot.legs.0.crank_quarter_direction"),
        ([{"platform_joint": (1.0, 1.0)}] + [{}] * 5, "robot.legs.0.platform_joint"),
        ([{"crank_angle_range": (1.0, -1.0)}] + [{}] * 5, "robot.legs.0.crank_angle_range"),
        ([{"rod_length": 0.2}] + [{}] * 5, "robot.home_height"),
        ([{}] * 5 + [{"crank_angle_range": (0.5, 1.0)}], "robot.legs.5.crank_angle_range"),
    ],
)
def test_legs_that_cannot_be_built_are_refused_by_name(legs, key):
    with pytest.raises(ConfigurationError) as caught:
        RobotParameters(legs=legs)
    assert field_of(caught.value) == key


def test_products_of_no_body_are_refused():
    with pytest.raises(ConfigurationError, match=r"robot\.platform_products"):
        RobotParameters(platform_products=(0.004, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match=r"robot\.legs"):
        RobotParameters.symmetric(legs=[{}] * 6)


def test_all_problems_are_listed_a_wrong_branch_among_them():
    with pytest.raises(ConfigurationError) as caught:
        RobotParameters(branch=3, rod_mass=-1.0, legs=[{"branch": 2}] + [{}] * 5)
    keys = [each.key for each in (caught.value, *caught.value.others)]
    assert keys == ["robot.branch", "robot.rod_mass", "robot.legs.0.branch"]


def test_what_is_refused_is_shown_in_plain_numbers_and_a_mistyped_name_has_a_suggestion():
    with pytest.raises(ConfigurationError, match=r"crank_angle_range: got \(1\.0, 1\.1\); allowed"):
        RobotParameters(legs=[{"crank_angle_range": [1.0, 1.1]}] + [{}] * 5)
    with pytest.raises(ConfigurationError, match=r"^robot\.rod_lenght: .*did you mean rod_length\?"):
        ROBOT.replace(rod_lenght=1)
