"""A robot as data: its legs, its checks, and where it comes from: names, files, tables."""

import math
import xml.etree.ElementTree as ET

import jsonschema
import numpy as np
import pytest
from conftest import field_of
from setups import setup_for
from strategies import ROBOTS

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.classical import PidOptions
from stewart_drake.control.lqi import lqi_gain
from stewart_drake.control.riccati import POSITION
from stewart_drake.control.tuners import BlockTuner
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.dynamics import pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.model_files import mjcf_text, sdf_text
from stewart_drake.references import HoldReference, SineReference
from stewart_drake.robot import RobotParameters, leg_table
from stewart_drake.robot.leg import LegParameters
from stewart_drake.robot.robot_files import load_robot, save_robot
from stewart_drake.safety import SafetyOptions, safety_part
from stewart_drake.scenario.limits import ReferenceLimits, SuccessCriteria, limit_margins, measure_poses
from stewart_drake.scenario.scenario import Scenario, load_scenario, scenario_schema

ROBOT = RobotParameters()


def test_joints_lie_on_their_circles_in_three_pairs_of_coaxial_shafts_even_legs_clockwise():
    for leg in range(6):
        direction = math.radians(120.0 * (leg // 2)) + (-1.0 if leg % 2 == 0 else 1.0) * np.radians([8.0, 52.0])
        circle = np.stack([np.cos(direction), np.sin(direction)], axis=-1) * [[0.20], [0.11]]
        points = [ROBOT.shaft_positions[leg], ROBOT.platform_joints[leg]]
        np.testing.assert_allclose(points, np.column_stack([circle, [-0.07, 0.0]]), atol=1e-15)
        motor_axis = np.cross([0.0, 0.0, 1.0], ROBOT.crank_zero_directions[leg])
        between = ROBOT.shaft_positions[leg] - ROBOT.shaft_positions[leg - leg % 2]
        np.testing.assert_allclose(np.cross(between, motor_axis), 0.0, atol=1e-16)


def test_a_leg_takes_from_the_symmetric_robot_what_it_has_not_of_its_own():
    robot = RobotParameters(legs=[{"rod_length": 0.41}, None, LegParameters(branch=1), {}, {}, {}], crank_length=0.1)
    np.testing.assert_array_equal(robot.rod_lengths, [0.41, *[0.404] * 5])
    np.testing.assert_array_equal(robot.branches, [-1, -1, 1, -1, -1, -1])
    np.testing.assert_array_equal(robot.crank_lengths, 0.1)
    for name in ("shaft_positions", "platform_joints", "crank_zero_directions", "crank_quarter_directions"):
        np.testing.assert_array_equal(getattr(robot, name), getattr(ROBOT, name))
    assert hash(robot) == hash(robot.replace())
    assert robot.replace(rod_length=0.4).rod_lengths.tolist() == [0.41, *[0.4] * 5]


NO_LEG = [{}] * 5


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        # As the paper prints it; ours is the nearest that a body can have.
        ({"crank_inertia": (1e-6, 5.8e-5, 6.0e-5)}, "crank_inertia"),
        ({"rod_inertia": (0.0016, 0.0015, 0.0002)}, "rod_inertia"),
        ({"platform_products": (0.004, 0.0, 0.0)}, "platform_products"),
        ({"platform_half_angle": math.pi / 3.0}, "platform_half_angle"),
        ({"home_height": 0.6}, "home_height"),
        ({"shaft_height": -1.0}, "home_height"),
        ({"legs": NO_LEG}, "legs"),
        ({"legs": [{"rod": 1.0}, *NO_LEG]}, "legs.0.rod"),
        ({"legs": [{"crank_zero_direction": (1.0, 1.0, 0.0)}, *NO_LEG]}, "legs.0.crank_zero_direction"),
        ({"legs": [{"crank_zero_direction": (0.0, 0.0, 1.0)}, *NO_LEG]}, "legs.0.crank_quarter_direction"),
        ({"legs": [{"crank_angle_range": (1.0, -1.0)}, *NO_LEG]}, "legs.0.crank_angle_range"),
        ({"legs": [{"rod_length": 0.2}, *NO_LEG]}, "home_height"),
        ({"legs": [*NO_LEG, {"crank_angle_range": (0.5, 1.0)}]}, "legs.5.crank_angle_range"),
        ({"branch": 3, "rod_mass": -1.0, "legs": [{"branch": 2}, *NO_LEG]}, "branch legs.0.branch rod_mass"),
    ],
)
def test_robots_that_cannot_be_built_are_refused_by_the_name_of_each_part(changes, key):
    with pytest.raises(ConfigurationError) as caught:
        ROBOT.replace(**changes)
    assert [field_of(each) for each in (caught.value, *caught.value.others)] == [f"robot.{k}" for k in key.split()]


def test_the_shipped_robots_have_the_home_of_their_makers():
    reachy, hexapod = load_robot("reachy_mini"), load_robot("servo_hexapod")
    home = inverse_kinematics(reachy, reachy.home_pose)
    np.testing.assert_allclose(home, 0.6265 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]), atol=1e-4)
    np.testing.assert_allclose(reachy.crank_axis_inertias, 0.0018 + 1.29627e-6 + 0.00366675 * 0.0237505**2, rtol=1e-8)
    assert (hexapod.shaft_half_angle, hexapod.platform_half_angle) == (math.radians(28.0), math.radians(52.0))
    np.testing.assert_allclose(inverse_kinematics(hexapod, hexapod.home_pose), 0.0, atol=2e-3)


def test_a_scenario_takes_a_robot_by_name_by_file_and_as_a_section(tmp_path):
    (tmp_path / "mine.yaml").write_text("about: mine\nrod_length: 0.41\n")
    (tmp_path / "run.yaml").write_text("robot: mine.yaml\nmodel: {robot: reachy_mini}\n")
    scenario = load_scenario(tmp_path / "run.yaml")
    assert scenario.robot == RobotParameters(rod_length=0.41)
    assert scenario.model.robot == load_robot("reachy_mini") == Scenario(robot="reachy_mini").robot
    changed = load_scenario(tmp_path / "run.yaml", ["robot.crank_length=0.1", "model.robot=servo_hexapod"])
    assert changed.robot == RobotParameters(rod_length=0.41, crank_length=0.1)
    assert changed.model.robot == load_robot("servo_hexapod")
    check = jsonschema.Draft202012Validator(scenario_schema())
    assert check.is_valid({"robot": "reachy_mini", "model": {"robot": {"rod_length": 0.41}}})
    assert not check.is_valid({"robot": 3})
    for robot in ROBOTS.values():
        save_robot(robot, tmp_path / "robot.yaml", "one")
        assert load_robot(tmp_path / "robot.yaml") == robot
        assert Scenario.from_dict(Scenario(robot=robot).to_dict()).robot == robot


HEXAPOD = RobotParameters(
    shaft_circle_radius=0.08, shaft_height=0.02, shaft_half_angle=math.radians(28.0), crank_plane_angle=-math.pi / 2.0,
    platform_joint_radius=0.065, platform_half_angle=math.radians(52.0), crank_length=0.025, rod_length=0.14,
    home_height=0.151, characteristic_length=0.065,
)  # fmt: skip
POINTS = np.hstack([HEXAPOD.shaft_positions, HEXAPOD.platform_joints])
NAMED = np.column_stack([POINTS, [0, 0, 1, 1, 2, 2]])
"""With the pairs, which at 56 and 64 deg are not clear from the shafts."""
LEG = {"crank_length": 0.025, "rod_length": 0.14, "cranks": "towards"}
TOWARDS = LEG | {"rod_length": 0.11, "crank_length": 0.015}
HEADER = "shaft_x, shaft_y, shaft_z, joint_x, joint_y, joint_z"


def table(path, rows, header=HEADER):
    path.write_text("# measured\n" + "\n".join([header, *(", ".join(map(repr, map(float, row))) for row in rows)]))
    return path


def test_a_robot_from_a_table_is_the_robot_that_was_measured(tmp_path):
    def in_unit(unit, metres):
        lengths = {"crank_length": 0.025 / metres, "rod_length": 0.14 / metres}
        return RobotParameters.from_table(NAMED / metres, cranks="towards", unit=unit, **lengths)

    for made in (
        RobotParameters.from_table(NAMED, **LEG),
        RobotParameters.from_table(table(tmp_path / "m.csv", NAMED, f"{HEADER}, pair"), **LEG),
        *(in_unit(*unit) for unit in (("mm", 1e-3), ("cm", 0.01), ("in", 0.0254))),
    ):
        for name in ("shaft_positions", "platform_joints", "crank_zero_directions", "rod_lengths", "branches"):
            np.testing.assert_allclose(getattr(made, name), getattr(HEXAPOD, name), rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(inverse_kinematics(made, made.home_pose), 0.0, atol=1e-10)
        assert made.characteristic_length == pytest.approx(0.065)
    with pytest.raises(ConfigurationError, match=r"unit: expected m, mm, cm or in, got 'ft'$"):
        in_unit("ft", 0.3048)


def test_a_table_may_have_lengths_branches_stops_and_directions_of_each_leg(tmp_path):
    header = f"{HEADER}, crank_x, crank_y, crank_z, rod_length, branch, low, high"
    rods = 0.14 + 0.0002 * np.arange(6)
    rows = np.column_stack([POINTS, HEXAPOD.crank_zero_directions, rods, [-1] * 6, [-1.0] * 6, [1.0] * 6])
    made = RobotParameters.from_table(table(tmp_path / "own.csv", rows, header), crank_length=0.025)
    np.testing.assert_allclose(made.rod_lengths, rods)
    np.testing.assert_array_equal(made.crank_angle_ranges, [[-1.0, 1.0]] * 6)


def test_masses_without_inertias_are_uniform_bars_and_a_disc():
    made = RobotParameters.from_table(
        NAMED, **LEG, platform_mass=0.4, rod_mass=0.012, crank_mass=0.006, link_radius=0.003
    )
    assert made.platform_inertia == pytest.approx((0.1 * 0.065**2, 0.1 * 0.065**2, 0.2 * 0.065**2))
    assert made.rod_inertia[0] == pytest.approx(0.012 * (0.14**2 / 12 + 0.003**2 / 4))
    assert made.crank_inertia[0] == pytest.approx(0.006 * 0.003**2 / 2)


def circle(angles, radius, height=0.0):
    angles = np.radians(angles)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(6, height)], axis=-1)


EVEN = np.hstack([circle(60.0 * np.arange(6), 0.07), circle([15, 45, 135, 165, 255, 285], 0.04)])
"""Six shafts at even angles, cranks of a public robot in pairs."""


def plan_angles(robot):
    return np.degrees(np.arctan2(*robot.crank_zero_directions[:, 1::-1].T))


def test_cranks_point_to_the_other_motor_of_the_pair_that_is_named(tmp_path):
    rows = np.column_stack([EVEN, [2, 0, 0, 1, 1, 2]])
    named = table(tmp_path / "named.csv", rows, f"{HEADER}, pair")
    lengths = {"crank_length": 0.03, "rod_length": 0.12}
    made = RobotParameters.from_table(named, cranks="towards", **lengths)
    turned = (plan_angles(made) - [-120, 180, 0, -60, 120, 60] + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    # Tangential cranks are at right angles to the way outwards, and away from the partner.
    made = RobotParameters.from_table(named, cranks="tangential", **lengths)
    turned = plan_angles(made) - 60.0 * np.arange(6) - 90.0 * np.array([1, -1, 1, -1, 1, -1])
    np.testing.assert_allclose((turned + 180.0) % 360.0 - 180.0, 0.0, atol=1e-6)
    # A partner straight across, or nearly, is on neither side.
    nearly = circle(60.0 * np.arange(6) + [1, 2, 1, 0, 0, 0], 0.07)
    across = np.column_stack([nearly, EVEN[:, 3:], [0, 1, 2, 0, 1, 2]])
    with pytest.raises(ConfigurationError, match=r"crank of leg 0: expected a direction"):
        RobotParameters.from_table(across, cranks="tangential", **lengths)
    rows[0, -1] = 1
    with pytest.raises(ConfigurationError, match=r"pair: expected three numbers, each for the two legs"):
        RobotParameters.from_table(table(tmp_path / "odd.csv", rows, f"{HEADER}, pair"), cranks="away", **lengths)


@pytest.mark.parametrize("apart", [60.0, 57.0, 63.0, 50.0])
def test_a_partner_that_is_not_clear_is_asked_for(apart):
    angles = [0, apart, 120, 120 + apart, 240, 240 + apart]
    points = np.hstack([circle(angles, 0.07), EVEN[:, 3:]])
    for cranks in ("towards", "away", "tangential"):
        with pytest.raises(ConfigurationError, match=r"pair: .* which shaft is the partner of shaft \d: \d or \d\?"):
            RobotParameters.from_table(points, cranks=cranks, crank_length=0.03, rod_length=0.12)
    RobotParameters.from_table(points, cranks="outwards", crank_length=0.01, rod_length=0.12)


@pytest.mark.parametrize("first", [0, 1])
def test_pairs_that_are_clear_are_found_whichever_row_is_first(first):
    angles = np.roll([-14, 14, 106, 134, 226, 254], -first)
    points = np.hstack([circle(angles, 0.07), circle(angles, 0.06)])
    pairs = leg_table.from_table(points, "m", "towards", {"crank_length": 0.01, "rod_length": 0.12}).pairs
    assert pairs == (((0, 1), (2, 3), (4, 5)) if first == 0 else ((0, 5), (1, 2), (3, 4)))


def test_a_mirrored_crank_has_a_warning_with_its_leg(tmp_path):
    header = f"{HEADER}, crank_x, crank_y, crank_z"
    lengths = {"crank_length": 0.025, "rod_length": 0.14}
    rows = np.column_stack([POINTS, HEXAPOD.crank_zero_directions])
    assert leg_table.from_table(table(tmp_path / "a.csv", rows, header), "m", "outwards", lengths).warning == ""
    rows[2, 6:] *= -1.0
    with pytest.warns(UserWarning, match=r"^the crank of leg 2 is level at 156\.1 mm, the others at 151 to 151: is it"):
        RobotParameters.from_table(table(tmp_path / "b.csv", rows, header), **lengths)
    rows[1::2, 2] += 0.003
    with pytest.warns(
        UserWarning, match=r"^the crank of leg . is level at 151 mm, of leg 2 at 156\.1: is this meant\? .* leg 2 "
    ):
        RobotParameters.from_table(table(tmp_path / "c.csv", rows, header), **lengths)


def test_polar_points_and_an_angle_of_the_crank_are_the_same_robot(tmp_path):
    parts = []
    for points in (POINTS[:, :3], POINTS[:, 3:]):
        parts += [np.hypot(*points[:, :2].T), np.degrees(np.arctan2(*points[:, 1::-1].T)), points[:, 2]]
    header = "shaft_radius, shaft_deg, shaft_z, joint_radius, joint_deg, joint_z, crank_deg"
    rows = np.column_stack([*parts, plan_angles(HEXAPOD)])
    made = RobotParameters.from_table(table(tmp_path / "p.csv", rows, header), crank_length=0.025, rod_length=0.14)
    for name in ("shaft_positions", "platform_joints", "crank_zero_directions"):
        np.testing.assert_allclose(getattr(made, name), getattr(HEXAPOD, name), rtol=0.0, atol=1e-11)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("a, b\n1, 2", r"header: expected "),
        ("1, 2, 3, 4, 5, 6\n" * 6, r"the first line is numbers: is the header missing\?"),
        ("shaft_radius, shaft_y, shaft_z, joint_x, joint_y, joint_z\n", r"header: .*without shaft_x"),
        (f"{HEADER}, crank_deg, crank_x, crank_y, crank_z\n", r"header: .*with crank_x, crank_y, crank_z"),
        (f"{HEADER}, crank_x\n", r"header.*in groups, crank_x, crank_y, crank_z.*without crank_y, crank_z"),
        (f"{HEADER}\n1, 2, 3, 4, five, 6\n", r"row 1, joint_y: expected a number, got 'five'"),
        (f"{HEADER}\n1, 2, 3, 4, 5, 6\n1, 2, 3, , 5, 6\n", r"row 2, joint_x: expected a number in every cell, got ''"),
        (f'{HEADER}\n1, 2, 3, "4,5", 5, 6\n', r"row 1, joint_x: expected a number, got '4,5'; a decimal comma\?"),
        (f"{HEADER}\n1, 2, 3, 4,5, 5, 6\n", r"row 1: expected 6 cells, got '7 cells'; a decimal comma\?"),
        (f"{HEADER};low".replace(",", ";"), r"header: expected commas .*got 'semicolons'"),
        (f"{HEADER}, low, high\n" + "1, 2, 3, 4, 5, 6, -63, 63\n" * 6, r"row 1, low: .* -63 deg are -1\.1 rad$"),
        (f"{HEADER}\n1, 2, 3, 4, nan, 6\n" * 1, r"6 rows, one per leg.*got \(1, 6\)"),
        (f"leg, {HEADER}\n" + "3, 1, 2, 3, 4, 5, 6\n" * 6, r"leg: expected "),
    ],
)
def test_a_table_that_is_none_is_refused_in_a_line(tmp_path, text, wanted):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(ConfigurationError, match=wanted) as caught:
        RobotParameters.from_table(tmp_path / "bad.csv", **LEG)
    assert "\n" not in str(caught.value)


FAR = np.arange(36).reshape(6, 6) == 18  # shaft_x of leg 3


def swapped(one, other):
    rows = POINTS.copy()
    rows[[one, other], 3:] = rows[[other, one], 3:]
    return rows


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (lambda: RobotParameters.from_table(POINTS[:5], **LEG), r"6 rows, one per leg.*got \(5, 6\)"),
        (lambda: RobotParameters.from_table(1e3 * NAMED, **LEG), r"shaft of leg \d.* is the unit mm\?"),
        (lambda: RobotParameters.from_table(POINTS * [1, 1, 1, 1, -1, 1], **LEG), r"is an axis of P mirrored\?"),
        (lambda: RobotParameters.from_table(POINTS * [-1, 1, 1, 1, 1, 1], **LEG), r"is an axis of P mirrored\?"),
        # Told before the rods are: towards joints on the other side they seem too short.
        (lambda: RobotParameters.from_table(POINTS * [1, 1, 1, -1, 1, 1], **TOWARDS), r"is an axis of P mirrored\?"),
        (lambda: RobotParameters.from_table(swapped(2, 3), **LEG), r"legs\.2\.platform_joint.* legs 2 and 3 swapped\?"),
        (lambda: RobotParameters.from_table(swapped(4, 5), **LEG), r"legs\.4\.platform_joint.* legs 4 and 5 swapped\?"),
        (lambda: RobotParameters.from_table(POINTS * np.where(FAR, 1e6, 1.0), **LEG), r"leg 3.* decimal point right\?"),
        (lambda: RobotParameters(rod_length=404.0), r"robot\.rod_length: expected a length.*in millimetres\?"),
        (lambda: RobotParameters(home_height=300.0), r"robot\.home_height: expected a height.*in millimetres\?"),
        (lambda: RobotParameters(legs=[{"platform_joint": (110, 0, 0)}, *[{}] * 5]), r"legs\.0\..*at most 30"),
        (lambda: RobotParameters(legs=[{"rod_length": 0.2}, *[{}] * 5]), r"leg 0 .* is 0\.3967 m from its shaft"),
        (lambda: RobotParameters(legs=[{"crank_angle_range": (-40, 40)}, *[{}] * 5]), r"\[rad\].*degrees\?"),
        (lambda: RobotParameters(platform_inertia=(1.0, 1.0, 3.0)), r"kg m\^2.*; 3 is"),
    ],
)  # fmt: skip
def test_what_was_perhaps_meant_is_said_with_the_leg_and_the_number(make, wanted):
    with pytest.raises(ConfigurationError, match=wanted) as caught:
        make()
    assert "\n" not in str(caught.value)


WEAK = RobotParameters(legs=[{}, {"effort_limit": 0.95}, {}, {"effort_limit": 8.0}, {}, {}])


def test_what_is_heavier_needs_torques_in_proportion():
    robot = load_robot("reachy_mini")
    pose = robot.home_pose + [0.1, 0.05, 0.0, 0.002, 0.0, 0.003]
    both, links = (robot.replace(**robot.scaled_masses(*shares)) for shares in ((1.3, 1.3), (1.0, 1.3)))
    np.testing.assert_allclose(static_torque(both, pose), 1.3 * static_torque(robot, pose), rtol=1e-12)
    head = static_torque(both, pose) - static_torque(links, pose)
    none = robot.replace(**robot.scaled_masses(0.7, 1.3))
    np.testing.assert_allclose(static_torque(links, pose) - static_torque(none, pose), head, rtol=1e-9)


def test_each_motor_has_its_own_effort_limit_everywhere():
    ask = np.full(6, 9.0)
    assert WEAK.effort_limits.tolist() == [5.0, 0.95, 5.0, 8.0, 5.0, 5.0]
    efforts = [float(effort.text) for effort in ET.fromstring(sdf_text(WEAK)).iterfind(".//axis/limit/effort")]
    assert [effort for effort in efforts if effort > 0.0] == WEAK.effort_limits.tolist()
    forces = [motor.get("forcerange").split() for motor in ET.fromstring(mjcf_text(WEAK)).iter("motor")]
    assert [float(most) for _, most in forces] == WEAK.effort_limits.tolist()
    still = np.zeros((1, 6))
    margins = limit_margins(WEAK, ReferenceLimits(), WEAK.home_pose[None], still, still, 9.81)["torque"][0]
    held = static_torque(WEAK, WEAK.home_pose)
    np.testing.assert_allclose(margins, WEAK.effort_limits - np.abs(held), rtol=1e-12)
    measures = measure_poses(WEAK, WEAK.home_pose[None])
    assert measures.holding_torque[0] == pytest.approx(5.0 * np.max(np.abs(held) / WEAK.effort_limits), rel=1e-9)
    assert measures.force[0] < measure_poses(ROBOT, ROBOT.home_pose[None]).force[0]
    layer = safety_part(SafetyOptions(torque_rate=None), setup_for(WEAK, initial_torque=held))
    state, at_home = layer.initial.copy(), np.concatenate([WEAK.home_pose, np.zeros(12)])
    given = {"command": ask, "measurement": at_home[:12], "reference": at_home}
    layer.tick(*(given[port] if port in given else layer.source(port) for port in layer.inputs), state)
    assert state["torque"][0].tolist() == WEAK.effort_limits.tolist()


SERVO = load_robot("servo_hexapod")
ALL = {"safety": {}, "tuner": {"kind": "block"}, "sensors": {"kind": "encoders"}}


def test_the_papers_robot_has_the_defaults_of_the_classes_to_the_last_bit():
    for scenario in (Scenario.from_dict(ALL), Scenario(robot="paper", **ALL), Scenario(robot=ROBOT, **ALL)):
        assert scenario.reference == SineReference()
        assert (scenario.limits, scenario.bounds, scenario.safety) == (
            ReferenceLimits(),
            SuccessCriteria(),
            SafetyOptions(),
        )
        assert (scenario.tuner, scenario.sensors) == (BlockTuner(), EncoderOptions())
    assert Scenario(controller={"kind": "pid"}).controller == PidOptions()


def test_defaults_scale_with_the_robot():
    scenario = Scenario(robot=SERVO, **ALL)
    length, torque = 0.065 / 0.11, 1.5 / 5.0
    assert scenario.limits.clearance == pytest.approx(0.005 * length)
    assert scenario.bounds.position == pytest.approx(0.03 * length)
    assert scenario.safety.workspace == pytest.approx((1.2, 0.12 * length))
    assert scenario.safety.torque_rate == pytest.approx(4000.0 * torque)
    assert scenario.estimator.max_step == pytest.approx((0.2, 0.05 * length))
    assert scenario.reference.center == (0.0, 0.0, 0.0, 0.0, 0.0, 0.151)
    assert scenario.reference.amplitude[5] == pytest.approx(0.05 * length)
    assert scenario.limits.crank_speed == ReferenceLimits().crank_speed


def test_what_is_given_stays_and_what_is_off_stays_off():
    given = {
        "limits": {"clearance": 0.005},
        "safety": {"workspace": None},
        "reference": {"kind": "hold", "pose": [0] * 6},
    }
    scenario = Scenario(robot=SERVO, **given)
    assert (scenario.limits.clearance, scenario.safety.workspace) == (0.005, None)
    assert scenario.reference.pose == (0.0,) * 6
    assert scenario.replace({"duration": 1.0}).limits.clearance == 0.005
    assert Scenario.from_dict(scenario.to_dict()) == scenario


def test_a_motion_made_in_python_or_inside_a_sum_is_centred_at_the_robots_home():
    home = (0.0, 0.0, 0.0, 0.0, 0.0, 0.151)
    assert Scenario(robot=SERVO, reference=HoldReference()).reference.pose == home
    parts = [{"kind": "breathing"}, {"kind": "heartbeat"}]
    summed = Scenario(robot=SERVO, reference={"kind": "sum", "parts": parts}).reference
    assert [part.center for part in summed.parts] == [home, home]


def test_another_robot_in_place_of_the_first_takes_its_own_defaults_along():
    scenario = Scenario(robot="reachy_mini", controller={"weight_length": None}, **ALL)
    assert scenario.replace({"robot": "paper"}) == Scenario(controller={"weight_length": 0.11}, **ALL)
    changed = scenario.replace({"robot": SERVO, "limits.crank_speed": 3.0})
    assert changed.limits == ReferenceLimits(clearance=0.005 * (0.065 / 0.11), crank_speed=3.0)
    assert changed.controller.weight_length == 0.065
    # What the controller believes in sizes the controller.
    scenario = Scenario(robot=ROBOT, model={"robot": ROBOT.replace(platform_mass=2.0)}, **ALL)
    assert scenario.tuner.q_pose > 4.0e5
    assert scenario.limits == ReferenceLimits()


@pytest.mark.parametrize("name", ["paper", "reachy_mini", "servo_hexapod"])
def test_default_block_weights_make_every_robots_loop_as_fast(name):
    robot = load_robot(name)
    scenario = Scenario(robot=robot, tuner={"kind": "block"}, controller={"weight_length": None, "period": 0.001})
    options, weights = scenario.controller, np.array(scenario.tuner.weights)
    response = pose_acceleration_map(robot, robot.home_pose)
    feedback = response @ lqi_gain(response, options, weights)
    # The closed loop of each direction is s^2 + c s + k = 0 but for the slow integral; these are the k.
    speed = np.sqrt(np.abs(np.linalg.eigvals(feedback[:, POSITION])))
    assert np.exp(np.mean(np.log(speed))) == pytest.approx(93.0, rel=0.25)
