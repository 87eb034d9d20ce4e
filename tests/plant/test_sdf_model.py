import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from strategies import ROBOT

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant import sdf_model
from stewart_drake.plant.sdf_model import home_frames, sdf_path, sdf_text, write_sdf
from stewart_drake.robot import RobotParameters

FOLDER = Path(__file__).parents[2] / "sdf"
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?")


def parsed(text):
    plant = MultibodyPlant(0.001)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.Finalize()
    return plant


def numbers(text):
    return np.array([float(number) for number in NUMBER.findall(text)])


def test_file_in_the_repository_is_the_generated_one():
    on_disk, generated = (FOLDER / "stewart.sdf").read_text(), sdf_text(ROBOT)
    # Sines of another machine's library may differ in the last bits: words must agree exactly, numbers to 1e-14.
    assert NUMBER.sub("#", on_disk) == NUMBER.sub("#", generated)
    np.testing.assert_allclose(numbers(on_disk), numbers(generated), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("rod_joint", ["universal", "ball"])
def test_links_joints_and_closures(rod_joint):
    model = ET.fromstring(sdf_text(ROBOT, rod_joint=rod_joint)).find("model")
    legs = range(6)
    assert model.get("name") == "stewart"
    links = ["base", *(f"crank_{leg}" for leg in legs), *(f"rod_{leg}" for leg in legs), "platform"]
    assert [link.get("name") for link in model.findall("link")] == links
    joints = {joint.get("name"): joint for joint in model.findall("joint")}
    assert set(joints) == {"base_weld", *(f"motor_{leg}" for leg in legs), *(f"{rod_joint}_{leg}" for leg in legs)}
    assert all(joints[f"motor_{leg}"].findtext("axis/xyz") == "0.0 -1.0 0.0" for leg in legs)
    closures = model.findall("{http://drake.mit.edu}ball_constraint")
    ends = [closure.findtext("{http://drake.mit.edu}ball_constraint_body_A") for closure in closures]
    assert ends == [f"rod_{leg}" for leg in legs]


@pytest.mark.parametrize("rod_joint", ["universal", "ball"])
@pytest.mark.parametrize("radius", [None, 7e-7, 3e-5])
def test_parsing_prints_nothing_and_would_if_a_passive_joint_had_no_effort(rod_joint, radius, capfd, caplog):
    robot = ROBOT if radius is None else RobotParameters(link_radius=radius)
    text = sdf_text(robot, rod_joint=rod_joint)
    for each in (text, sdf_text(robot, rod_joint=rod_joint, collision=False)):
        parsed(each)
    assert capfd.readouterr() == ("", "")
    assert caplog.records == []
    assert radius is None or f"<radius>{radius}</radius>" in text
    if rod_joint == "universal":
        parsed(text.replace("<limit><effort>0.0</effort></limit>", ""))
        assert "universal_0" in caplog.text


def test_collision_shapes_are_those_with_an_exact_depth_and_can_be_left_out():
    model = ET.fromstring(sdf_text(ROBOT)).find("model")
    kinds = {shape.tag for link in model.findall("link") for shape in link.findall("collision/geometry/*")}
    assert kinds == {"box", "sphere"}
    text = sdf_text(ROBOT, collision=False)
    assert "collision" not in text
    assert "<visual" in text


def test_home_frames_follow_the_documented_axes():
    frames, h = home_frames(ROBOT), ROBOT.crank_zero_directions
    np.testing.assert_allclose(frames.crank_angles, inverse_kinematics(ROBOT, ROBOT.home_pose))
    for rotation in (*frames.crank_rotation, *frames.rod_rotation, *frames.rod_in_crank):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
    tips = ROBOT.shaft_positions + ROBOT.crank_length * frames.crank_rotation[:, :, 0]
    np.testing.assert_allclose(frames.crank_tips, tips, atol=1e-16)
    ends = frames.crank_tips + ROBOT.rod_length * frames.rod_rotation[:, :, 2]
    np.testing.assert_allclose(ends, ROBOT.platform_joints + ROBOT.home_pose[3:], atol=1e-15)
    motor_axes = -np.cross([0.0, 0.0, 1.0], h)
    np.testing.assert_allclose(frames.crank_rotation[:, :, 1], -motor_axes, atol=1e-16)
    # The first universal axis: no vector square to the rod lies nearer to the motor axis.
    along = np.sum(frames.rod_rotation[:, :, 0] * motor_axes, axis=-1)
    off = np.sum(frames.rod_rotation[:, :, 2] * motor_axes, axis=-1)
    np.testing.assert_allclose(along, np.sqrt(1.0 - off**2), atol=1e-15)


def test_unknown_rod_joint_is_refused_by_name():
    with pytest.raises(ConfigurationError, match=r"rod_joint: expected universal or ball"):
        sdf_text(ROBOT, rod_joint="hinge")


def test_written_file_holds_the_text_and_replaces_an_old_one(tmp_path):
    path = tmp_path / "robot.sdf"
    path.write_text("old")
    write_sdf(ROBOT, path, rod_joint="ball", collision=False)
    assert path.read_text() == sdf_text(ROBOT, rod_joint="ball", collision=False)
    with pytest.raises(ConfigurationError, match="nowhere"):
        write_sdf(ROBOT, tmp_path / "nowhere" / "robot.sdf")
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_is_found_in_a_checkout_and_in_an_installed_package(tmp_path, monkeypatch):
    assert sdf_path() == FOLDER / "stewart.sdf"
    monkeypatch.setattr(sdf_model, "PACKAGE", tmp_path / "package")
    with pytest.raises(ConfigurationError, match=r"sdf/stewart\.sdf"):
        sdf_path()
    (tmp_path / "sdf").mkdir()
    (tmp_path / "sdf" / "stewart.sdf").touch()
    monkeypatch.setattr(sdf_model, "PACKAGE", tmp_path)
    assert sdf_path() == tmp_path / "sdf" / "stewart.sdf"


def test_drake_finds_the_package():
    packages = PackageMap()
    packages.AddPackageXml(str(FOLDER / "package.xml"))
    assert Path(packages.ResolveUrl("package://stewart_drake/stewart.sdf")) == FOLDER / "stewart.sdf"


def test_python_of_the_readme_runs(monkeypatch):
    monkeypatch.chdir(FOLDER.parent)
    (code,) = re.findall(r"```python\n(.*?)```", (FOLDER / "README.md").read_text(), flags=re.DOTALL)
    names = {}
    exec(code, names)
    assert names["plant"].num_positions() == 25


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_stops_hold_home_whatever_the_turn_that_their_angles_are_of(turns):
    """The same range a turn on is the same range; an angle within it stays within it where it leaves (-pi, pi]."""
    given = np.array([2.0, 8.0]) - 2.0 * np.pi
    robot, other = (
        RobotParameters(branch=1, legs=[{"crank_angle_range": tuple(given + shift)}] * 6)
        for shift in (0.0, 2.0 * np.pi * turns)
    )
    frames = home_frames(other)
    np.testing.assert_allclose(frames.stops, home_frames(robot).stops, atol=1e-14)
    assert (frames.stops[:, 0] < 0.0).all()
    assert (frames.stops[:, 1] > 0.0).all()
    theta = given[0] + np.linspace(0.01, 5.99, 7)[:, None] + np.zeros(6)
    motor = frames.motor_angles(np.arctan2(np.sin(theta), np.cos(theta)))
    np.testing.assert_allclose(motor, theta - given[0] + frames.stops[:, 0], atol=1e-14)
    model = ET.fromstring(sdf_text(other)).find("model")
    limits = [model.find(f"joint[@name='motor_{leg}']/axis/limit") for leg in range(6)]
    written = [[float(limit.findtext(end)) for end in ("lower", "upper")] for limit in limits]
    np.testing.assert_array_equal(written, frames.stops)
    # Motors without stops turn freely.
    assert np.isinf(home_frames(ROBOT).stops).all()
    assert "<lower>" not in sdf_text(ROBOT)
