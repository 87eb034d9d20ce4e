"""Robots out of model files of others: URDF, SDF and MJCF."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from strategies import ROBOTS

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.cli.robot_commands import from_model
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.foreign_robot import read_model
from stewart_drake.plant.model_files import home_frames, mjcf_text, sdf_text
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg_table import from_table
from stewart_drake.robot.robot_files import load_robot

PUBLIC = json.loads((Path(__file__).parents[1] / "data" / "public_robots.json").read_text())["robots"]
WRITERS = {"robot.sdf": sdf_text, "robot.xml": mjcf_text}
SHIPPED = ("reachy_mini", "servo_hexapod")
MOVES = np.array([[0, 0, 0, 0, 0, 0], [0.03, -0.02, 0.04, 0.02, -0.01, 0.02]])


def public(number):
    robot = PUBLIC[number - 1]
    metres, legs = {"mm": 1e-3, "cm": 1e-2}[robot["unit"]], np.array(robot["legs"])
    crank = np.stack([np.cos(np.radians(legs[:, 6])), np.sin(np.radians(legs[:, 6])), np.zeros(6)], axis=-1)
    columns = {
        f"{end}_{axis}": metres * legs[:, 3 * i + j]
        for i, end in enumerate(("shaft", "joint"))
        for j, axis in enumerate("xyz")
    }
    columns |= {f"crank_{axis}": crank[:, j] for j, axis in enumerate("xyz")}
    lengths = {name: metres * robot[name] for name in ("crank_length", "rod_length")}
    if not isinstance(robot["home"], str):
        lengths["home_height"] = metres * robot["home"]
    home = robot["home"] if robot["home"] == "perpendicular" else "level"
    return RobotParameters(**from_table(columns, "m", "outwards", lengths, home).parameters)


def tips(robot, length):
    """(2, 6, 3) [m] of the cranks, at home and away."""
    size = [1, 1, 1, *[length] * 3]
    angles = inverse_kinematics(robot, robot.home_pose + size * MOVES)[..., None]
    arms = np.cos(angles) * robot.crank_zero_directions + np.sin(angles) * robot.crank_quarter_directions
    return robot.shaft_positions + robot.crank_lengths[:, None] * arms


def check_same(again, robot, atol=1e-6):
    for name in ("shaft_positions", "joints_in_platform", "crank_lengths", "rod_lengths", "home_pose"):
        np.testing.assert_allclose(getattr(again, name), getattr(robot, name), rtol=0.0, atol=atol, err_msg=name)
    np.testing.assert_allclose(
        *(tips(made, robot.characteristic_length) for made in (again, robot)), rtol=0.0, atol=atol
    )
    axes = (np.cross(made.crank_zero_directions, made.crank_quarter_directions) for made in (again, robot))
    np.testing.assert_allclose(*axes, atol=1e-6)


def check_masses(again, robot):
    for name in ("platform_mass", "platform_inertia", "platform_products", "platform_center_of_mass", "rod_mass",
                 "rod_inertia", "crank_mass", "crank_inertia", "rotor_inertia"):  # fmt: skip
        np.testing.assert_allclose(getattr(again, name), getattr(robot, name), rtol=1e-6, atol=1e-10, err_msg=name)
    np.testing.assert_allclose(again.effort_limits, robot.effort_limits)


@pytest.mark.parametrize("file", WRITERS)
@pytest.mark.parametrize("name", [*SHIPPED, *ROBOTS, 1, 6, 9, 14, 15, 18])
def test_what_this_package_writes_comes_back(name, file, tmp_path):
    robot = public(name) if isinstance(name, int) else ROBOTS[name] if name in ROBOTS else load_robot(name)
    if robot.tool is not None:
        robot = robot.replace(tool=None)
    (tmp_path / file).write_text(WRITERS[file](robot))
    result = read_model(tmp_path / file, (), {})
    again = RobotParameters(**result.read.parameters)
    check_same(again, robot)
    check_masses(again, robot)
    assert [motor for _, motor, _ in result.motors] == [f"motor_{leg}" for leg in range(6)]
    assert any(note.startswith("not read: ") for note in result.notes)


URDF_LINK = """<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>
<inertia ixx="{i[0]}" iyy="{i[1]}" izz="{i[2]}" ixy="{i[3]}" ixz="{i[4]}" iyz="{i[5]}"/></inertial>
<visual><geometry><mesh filename="package://a/{name}.stl"/></geometry></visual></link>"""
URDF_JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
<limit effort="1.5" velocity="9" lower="-1" upper="1.2"/></joint>"""
STILL = np.zeros(6)
WORLD = RigidTransform(RollPitchYaw(0.3, -0.2, 0.7), [0.1, 0.2, 0.3])
"""Of the base in the file."""


def text(numbers):
    return " ".join(f"{x:.17g}" for x in np.ravel(numbers))


def urdf(robot, turn=STILL, hanging=False, base_pose=WORLD):
    """A URDF as CAD exports are: links named by parts, cut loops, and dummy links where they close.

    The cranks are at home turned by `turn`, so that the loops are open there; the platform floats, or hangs on rod 5.
    """
    frames, parts, spherical = home_frames(robot), [], "spherical"

    def link(name, mass=0.0, centre=(0, 0, 0), inertia=STILL):
        six = [*np.diag(inertia), *inertia[np.triu_indices(3, 1)]] if mass else []
        parts.append(
            f'<link name="{name}"/>'
            if mass == 0
            else URDF_LINK.format(name=name, mass=mass, centre=text(centre), i=six)
        )

    def joint(name, kind, parent, child, pose, axis=(0, 0, 1)):
        rpy = RollPitchYaw(pose.rotation()).vector()
        values = {"xyz": text(pose.translation()), "rpy": text(rpy), "axis": text(axis)}
        parts.append(URDF_JOINT.format(name=name, kind=kind, parent=parent, child=child, **values))

    plate_home = RigidTransform(RotationMatrix(), robot.home_pose[3:])
    link("ground")
    link("chassis", 2.0, (0, 0, 0.01), 0.01 * np.eye(3))
    joint("mount", "fixed", "ground", "chassis", base_pose)
    link("top_plate_v2", robot.platform_mass, robot.platform_center_of_mass, robot.central_inertia)
    for leg, word in enumerate(("ada", "bob", "cid", "dan", "eve", "fay")):
        crank_pose = RigidTransform(RotationMatrix(frames.crank_rotation[leg]), robot.shaft_positions[leg])
        link(f"servo_{word}")
        joint(f"glue_{word}", "fixed", "chassis", f"servo_{word}", RigidTransform(crank_pose.translation()))
        link(f"horn_{word}", robot.crank_mass, (0.5 * robot.crank_lengths[leg], 0, 0), np.diag(robot.crank_inertia))
        turned = RigidTransform(RotationMatrix(crank_pose.rotation()) @ RotationMatrix.MakeYRotation(-turn[leg]))
        joint(f"servo_axis_{word}", "revolute", f"servo_{word}", f"horn_{word}", turned, (0, -1, 0))
        link(f"pushrod_{word}", robot.rod_mass, (0, 0, 0.5 * robot.rod_lengths[leg]), np.diag(robot.rod_inertia))
        rod = RigidTransform(RotationMatrix(frames.rod_in_crank[leg]), [robot.crank_lengths[leg], 0, 0])
        joint(f"ball_{word}", spherical, f"horn_{word}", f"pushrod_{word}", rod)
        if hanging and leg == 5:
            rod_pose = crank_pose @ rod
            end = RigidTransform(RotationMatrix(), [0, 0, robot.rod_lengths[leg]])
            flange = RigidTransform((rod_pose @ end).rotation().inverse())
            link("socket")
            joint("socket_ball", spherical, f"pushrod_{word}", "socket", end)
            joint(
                "socket_glue",
                "fixed",
                "socket",
                "top_plate_v2",
                flange @ RigidTransform(-robot.joints_in_platform[leg]),
            )
            continue
        link(f"end_{word}")
        joint(
            f"end_glue_{word}",
            "fixed",
            f"pushrod_{word}",
            f"end_{word}",
            RigidTransform([0, 0, robot.rod_lengths[leg]]),
        )
        link(f"seat_{word}")
        joint(
            f"seat_glue_{word}", "fixed", "top_plate_v2", f"seat_{word}", RigidTransform(robot.joints_in_platform[leg])
        )
    if not hanging:
        joint("free", "floating", "chassis", "top_plate_v2", plate_home)
    return f'<robot name="desk">{"".join(parts)}</robot>'


@pytest.mark.parametrize("hanging", [False, True])
@pytest.mark.parametrize("name", ["servo_hexapod", "reachy_mini"])
def test_a_urdf_with_other_names_cut_loops_and_a_turned_base(name, hanging, tmp_path):
    robot = load_robot(name)
    (tmp_path / "desk.urdf").write_text(urdf(robot, hanging=hanging))
    result = read_model(tmp_path / "desk.urdf", (), {"rotor_inertia": robot.rotor_inertia})
    again = RobotParameters(**result.read.parameters)
    check_same(again, robot)
    check_masses(again, robot.replace(legs=again.legs, effort_limit=1.5))
    assert [motor for _, motor, _ in result.motors] == [
        f"servo_axis_{w}" for w in ("ada", "bob", "cid", "dan", "eve", "fay")
    ]
    at_home = np.degrees(home_frames(robot).crank_angles)
    np.testing.assert_allclose([float(angle) for *_, angle in result.motors], at_home, atol=0.01)
    np.testing.assert_allclose(
        again.crank_angle_ranges - home_frames(robot).crank_angles[:, None], [[-1.0, 1.2]] * 6, atol=1e-5
    )
    tilt = np.degrees(np.arccos(WORLD.rotation().matrix()[2, 2]))
    assert any(note.startswith(f"z of B is {tilt:.4g} deg from the vertical") for note in result.notes)


def test_a_robot_that_hangs_has_z_downwards(tmp_path):
    robot = load_robot("servo_hexapod")
    (tmp_path / "desk.urdf").write_text(urdf(robot, base_pose=RigidTransform(RollPitchYaw(np.pi, 0.0, 0.0), [0, 0, 1])))
    result = read_model(tmp_path / "desk.urdf", (), {})
    check_same(RobotParameters(**result.read.parameters), robot)
    assert any(note.startswith("z of B is 180 deg from the vertical of the file") for note in result.notes)


def test_a_urdf_whose_loops_are_open_has_its_home_where_cranks_are_level(tmp_path):
    robot = load_robot("servo_hexapod")
    (tmp_path / "desk.urdf").write_text(urdf(robot, turn=np.full(6, 0.3)))
    result = read_model(tmp_path / "desk.urdf", (), {})
    again = RobotParameters(**result.read.parameters)
    check_same(again, robot.replace(home_height=again.home_height))
    assert again.home_height == pytest.approx(robot.home_height, abs=1e-4)
    assert result.notes[0].startswith("the loops are open by up to ")


def test_motors_that_are_named_are_the_legs_in_this_order(tmp_path, capsys):
    robot, names = load_robot("servo_hexapod"), [f"motor_{leg}" for leg in (2, 3, 4, 5, 0, 1)]
    (tmp_path / "robot.sdf").write_text(sdf_text(robot))
    from_model(tmp_path / "robot.sdf", tuple(names), ("platform_mass=0.5",), "turned", tmp_path / "made.yaml")
    again = load_robot(tmp_path / "made.yaml")
    np.testing.assert_allclose(again.shaft_positions, np.roll(robot.shaft_positions, -2, axis=0), atol=1e-9)
    assert again.platform_mass == 0.5
    assert again.rod_mass == pytest.approx(robot.rod_mass)
    out = capsys.readouterr().out
    assert "taken from the paper's robot" not in out
    assert "motor_2" in out


GOOD = urdf(load_robot("servo_hexapod"))
PAPER = sdf_text(load_robot("paper"))


def test_links_without_masses_have_the_default_ones(tmp_path, capsys):
    text = PAPER.replace("<mass>0.08</mass>", "<mass>-1</mass>")
    text = re.sub(r'(<link name="platform">.*?)<inertial>.*?</inertial>', r"\1", text, flags=re.DOTALL)
    (tmp_path / "robot.sdf").write_text(text)
    from_model(tmp_path / "robot.sdf", (), (), "", tmp_path / "made.yaml")
    missing = capsys.readouterr().out.split("because not given [kg, kg m^2, N m]: ")[1].splitlines()[0]
    assert missing == "platform_mass = 1, rod_mass = 0.08, rotor_inertia = 0"


def test_loops_that_joints_close_and_a_mjcf_without_actuators(tmp_path):
    robot = load_robot("reachy_mini")
    sdf = sdf_text(robot)
    joints = [
        f'<joint name="top_{leg}" type="ball"><pose>0 0 {length!r} 0 0 0</pose><parent>platform</parent>'
        f"<child>rod_{leg}</child></joint>"
        for leg, length in enumerate(robot.rod_lengths.tolist())
    ]
    closed = re.sub(r"<drake:ball_constraint>.*?</drake:ball_constraint>", "", sdf, flags=re.DOTALL)
    (tmp_path / "loops.sdf").write_text(closed.replace("</model>", f"{''.join(joints)}</model>"))
    mjcf = re.sub(r"<actuator>.*?</actuator>", "", mjcf_text(robot), flags=re.DOTALL)
    (tmp_path / "bare.xml").write_text(mjcf)
    for file in ("loops.sdf", "bare.xml"):
        check_same(RobotParameters(**read_model(tmp_path / file, (), {}).read.parameters), robot)


def test_a_mjcf_whose_rods_end_in_welded_sockets(tmp_path):
    robot = load_robot("servo_hexapod")
    text = mjcf_text(robot)
    for leg in range(6):
        socket = f'<site name="end_{leg}"'
        ball = '<joint type="ball"/><geom size="0.001"/>'
        body = f'<body name="socket_{leg}" pos="0 0 {float(robot.rod_lengths[leg])!r}">{ball}</body>'
        text = text.replace(socket, f"{body}{socket}")
        text = re.sub(rf'<connect site1="end_{leg}"[^>]*/>', f'<weld body1="socket_{leg}" body2="platform"/>', text)
    (tmp_path / "welded.xml").write_text(text)
    check_same(RobotParameters(**read_model(tmp_path / "welded.xml", (), {}).read.parameters), robot)


IN_MM = re.sub(
    r'<origin xyz="([^"]*)"', lambda m: f'<origin xyz="{" ".join(str(1e3 * float(x)) for x in m[1].split())}"', GOOD
)
NAMED_TWICE = GOOD.replace('child link="end_bob"', 'child link="nobody"')
TURNING_END = GOOD.replace('name="end_glue_bob" type="fixed"', 'name="end_glue_bob" type="revolute"')
NO_TABLE = PAPER.replace("constraint_body_B>platform", "constraint_body_B>table", 1)
NO_POINT = PAPER.replace("p_AP>0.0 0.0 0.404", "p_AP>0.0 0.0 x", 1)
FIVE = mjcf_text(load_robot("paper")).replace('<connect site1="end_2"', '<connect active="false" site1="end_2"')
NO_MASS = "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>"
READS = "a file that Drake's parser reads, .*; "


@pytest.mark.parametrize(
    ("name", "content", "motors", "wanted"),
    [
        ("a.urdf", "no xml", (), r"expected a file of URDF, SDF, MJCF"),
        ("a.urdf", "<html></html>", (), r"expected a file of URDF, SDF, MJCF, got '?<html>"),
        ("a.urdf", '<robot xmlns:xacro="x"></robot>', (), r"; run xacro first"),
        ("a.urdf", '<robot name="a"><link name="b"/></robot>', (), r"six motors each turn a crank .* not 0"),
        ("a.urdf", '<robot name="a"><joint name="b" type="x"/></robot>', (), READS),
        ("a.urdf", NAMED_TWICE, (), f"{READS}.*nobody"),
        ("a.urdf", TURNING_END, (), r"turn a crank with a rod to one platform, not 5"),
        ("a.urdf", IN_MM, (), r"^model .*a.urdf: (shaft|joint) of leg \d.* is the file in mm\? it has to be in m$"),
        ("a.urdf", GOOD, ("servo_axis_ada",), r"--motor: expected six joints, or none"),
        ("a.urdf", GOOD, tuple("abcdef"), r"six joints of .*"),
        ("a.sdf", "<sdf/>", (), READS),
        ("a.sdf", NO_TABLE, (), READS),
        ("a.sdf", NO_POINT, (), r"p_AP of rod_0: three numbers, not 0.0 0.0 x"),
        ("a.xml", NO_MASS, (), r"an MJCF that MuJoCo reads"),
        ("a.xml", FIVE, (), r"not 5"),
    ],
)  # fmt: skip
def test_a_model_that_is_none_is_refused_in_one_line(name, content, motors, wanted, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(ConfigurationError, match=wanted) as caught:
        read_model(tmp_path / name, motors, {})
    assert "\n" not in str(caught.value)


MAKER = Path("descriptions/reachy_mini")


@pytest.mark.skipif(importlib.util.find_spec("reachy_mini") is None, reason="needs the package reachy_mini")
@pytest.mark.parametrize("file", ["mjcf/reachy_mini.xml", "urdf/robot.urdf"])
def test_the_maker_s_files_of_reachy_mini_are_the_robot_of_the_package(file):
    folder = Path(importlib.util.find_spec("reachy_mini").submodule_search_locations[0])
    again = RobotParameters(**read_model(folder / MAKER / file, (), {}).read.parameters)
    robot = load_robot("reachy_mini")
    for name in ("shaft_positions", "joints_in_platform"):
        apart = (
            np.linalg.norm(points[:, None] - points, axis=-1) for points in (getattr(again, name), getattr(robot, name))
        )
        np.testing.assert_allclose(*apart, atol=2e-6)
    np.testing.assert_allclose(again.rod_lengths, 0.085, atol=2e-6)
    np.testing.assert_allclose(again.crank_lengths, 0.04, atol=2e-6)
    np.testing.assert_allclose(again.crank_angle_ranges, robot.crank_angle_ranges, atol=1e-4)
    assert again.platform_mass == pytest.approx(robot.platform_mass)
    np.testing.assert_allclose(*(np.linalg.eigvalsh(made.central_inertia) for made in (again, robot)), rtol=1e-3)
