import math

import jsonschema
import numpy as np
import pytest
from conftest import field_of

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import conditioning, inverse_kinematics
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_files import load_robot, robot_about, robot_names
from stewart_drake.scenario import Scenario, load_scenario, scenario_schema

NAMES = ["paper", "reachy_mini", "servo_hexapod"]


def test_three_robots_are_shipped_and_say_what_they_are():
    assert robot_names() == NAMES
    assert all(robot_about(name) for name in NAMES)
    assert load_robot("paper") == RobotParameters()


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_robot_is_well_conditioned_at_home(name):
    assert conditioning(load_robot(name), load_robot(name).home_pose) > 0.1


def test_the_heads_cranks_alternate_at_home_as_its_makers_software_has_them():
    reachy = load_robot("reachy_mini")
    home = inverse_kinematics(reachy, reachy.home_pose)
    np.testing.assert_allclose(home, 0.6265 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]), atol=1e-4)
    np.testing.assert_allclose(reachy.crank_axis_inertias, 0.0018 + 1.29627e-6 + 0.00366675 * 0.0237505**2, rtol=1e-8)


def test_a_scenario_takes_a_robot_by_name_by_file_and_as_a_section(tmp_path):
    (tmp_path / "mine.yaml").write_text("about: mine\nrod_length: 0.41\n")
    (tmp_path / "run.yaml").write_text("robot: mine.yaml\nmodel_robot: reachy_mini\n")
    scenario = load_scenario(tmp_path / "run.yaml")
    assert scenario.robot == RobotParameters(rod_length=0.41)
    assert scenario.model_robot == load_robot("reachy_mini") == Scenario(robot="reachy_mini").robot
    changed = load_scenario(tmp_path / "run.yaml", ["robot.crank_length=0.1", "model_robot=servo_hexapod"])
    assert changed.robot == RobotParameters(rod_length=0.41, crank_length=0.1)
    assert changed.model_robot == load_robot("servo_hexapod")
    assert Scenario.from_dict(scenario.to_dict()) == scenario


def test_the_schema_takes_a_robot_by_name():
    check = jsonschema.Draft202012Validator(scenario_schema())
    assert check.is_valid({"robot": "reachy_mini", "model_robot": {"rod_length": 0.41}})
    assert not check.is_valid({"robot": 3})
    assert not check.is_valid({"model_robot": {"rod_length": "reachy_mini"}})


@pytest.mark.parametrize(
    ("text", "key"),
    [("rod_length: -1", "robot.rod_length"), ("rod: 1", "robot.rod"), ("[1]", "robot file"), (None, "robot")],
)
def test_a_file_of_no_robot_is_refused_by_name(tmp_path, text, key):
    path = tmp_path / "mine.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        Scenario(robot=str(path))
    assert field_of(caught.value).startswith(key)


def test_numbers_of_the_hobby_hexapod_are_those_that_its_remarks_say():
    robot = load_robot("servo_hexapod")
    assert robot.shaft_half_angle == math.radians(28.0)
    assert robot.platform_half_angle == math.radians(52.0)
    np.testing.assert_allclose(inverse_kinematics(robot, robot.home_pose), 0.0, atol=2e-3)
