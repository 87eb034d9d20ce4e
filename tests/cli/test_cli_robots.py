from pathlib import Path

import mujoco
import pytest

from stewart_drake.robot.robot_files import load_robot

DOCS = Path(__file__).parents[2] / "docs"


def test_robots_are_listed_with_what_they_are(call):
    status, out, _ = call("robots")
    assert status == 0
    for name in ("paper", "reachy_mini", "servo_hexapod"):
        assert name in out
    assert "Pollen Robotics" in out


def test_the_numbers_of_a_robot_have_units_and_say_what_follows_at_home(call):
    status, out, _ = call("robots", "show", "reachy_mini")
    assert status == 0
    for text in ("rotor_inertia", "kg m^2", "0.0018", "-48.0 to 80.0", "35.90", "conditioning of the rods' lines"):
        assert text in out


@pytest.mark.parametrize("command", [("robots", "show"), ("write-sdf", "x.sdf", "--robot"), ("faults", "--robot")])
def test_a_robot_that_is_not_there_is_refused_in_a_line(call, command):
    status, _, error = call(*command, "reachy_max")
    assert (status, error.count("\n")) == (2, 1)
    assert "reachy_max" in error
    assert "paper, reachy_mini, servo_hexapod" in error


def test_a_robot_from_a_table_is_kept_and_comes_back(call, tmp_path):
    header, *rows = (DOCS / "your_robot.csv").read_text().splitlines()[1:]
    (tmp_path / "points.csv").write_text("\n".join([header, *rows]))
    arguments = ["from-table", "points.csv", "--unit", "mm", "--cranks", "towards", "--set", "crank_length=30"]
    status, out, _ = call("robots", *arguments, "--set", "rod_length=180", "--about", "mine", "--out", "mine.yaml")
    assert status == 0
    assert out.splitlines()[0] == "robot in mine.yaml: home at Z = 0.2002 m"
    assert "taken from the paper's robot [kg, kg m^2, N m]: platform_mass = 1" in out
    assert load_robot("mine.yaml").rod_lengths.tolist() == [0.18] * 6
    assert (tmp_path / "mine.yaml").read_text().startswith("about: mine\n")
    (tmp_path / "points.csv").write_text("\n".join([header, *rows[:4]]))
    status, _, error = call("robots", *arguments, "--set", "rod_length=180")
    assert (status, error.count("\n"), "table: expected 6 rows, one a leg" in error) == (2, 1, True)


@pytest.mark.parametrize("name", ["paper", "reachy_mini", "servo_hexapod"])
def test_a_robot_goes_into_files_for_other_programs(call, tmp_path, name):
    assert call("write-sdf", "robot.sdf", "--robot", name)[0] == 0
    assert call("write-mjcf", "robot.xml", "--robot", name, "--set", "plant.motor_damping=0.1")[0] == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert (model.nu, model.neq, model.nv) == (6, 6, 24)
    assert model.joint("motor_3").damping == 0.1
    assert "<model name=" in (tmp_path / "robot.sdf").read_text()
