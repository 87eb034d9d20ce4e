"""The same physical motion, told of another point and axes of the platform, has the same crank angles and torques."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import UNEQUAL, poses, vectors

from stewart_drake import RobotParameters, Scenario, load_robot, run
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation import geometry, torques
from stewart_drake.hardware.motors import TorqueMotors
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics, static_torque
from stewart_drake.mechanics.kinematics import (
    conditioning,
    crank_rates,
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
)
from stewart_drake.plant.model_files import home_frames
from stewart_drake.runs.scene import link_poses
from stewart_drake.scenario.controller import Controller
from stewart_drake.scenario.limits import ReferenceLimits, limit_margins

TOOLS = st.tuples(vectors(3, 0.3), vectors(3, 1.2))
REACHY = load_robot("reachy_mini")


def with_tool(robot, position, orientation):
    return robot.replace(tool={"position": position.tolist(), "orientation": orientation.tolist()})


def turn(angles):
    return Rotation.from_euler("xyz", angles).as_matrix()


def euler_map(angles, rates=None):
    """w = E (roll', pitch', yaw') in B; with rates its derivative."""
    (cp, cy), (sp, sy) = np.cos(angles[1:]), np.sin(angles[1:])
    if rates is None:
        return np.array([[cy * cp, -sy, 0.0], [sy * cp, cy, 0.0], [-sp, 0.0, 1.0]])
    _, dp, dy = rates
    return np.array(
        [
            [-sy * cp * dy - cy * sp * dp, -cy * dy, 0.0],
            [cy * cp * dy - sy * sp * dp, -sy * dy, 0.0],
            [-cp * dp, 0.0, 0.0],
        ]
    )


def told_of(tool, pose, rate, acceleration):
    """A motion (6,) of P, told of the tool: by the transformation of rigid bodies."""
    position, orientation = tool
    body = turn(pose[:3])
    w = euler_map(pose[:3]) @ rate[:3]
    alpha = euler_map(pose[:3]) @ acceleration[:3] + euler_map(pose[:3], rate[:3]) @ rate[:3]
    arm = body @ position
    angles = Rotation.from_matrix(body @ turn(orientation)).as_euler("xyz")
    rates = np.linalg.solve(euler_map(angles), w)
    second = np.linalg.solve(euler_map(angles), alpha - euler_map(angles, rates) @ rates)
    return (
        np.concatenate([angles, pose[3:] + arm]),
        np.concatenate([rates, rate[3:] + np.cross(w, arm)]),
        np.concatenate([second, acceleration[3:] + np.cross(alpha, arm) + np.cross(w, np.cross(w, arm))]),
    )


@given(st.sampled_from([UNEQUAL, REACHY]), TOOLS, st.data())
def test_angles_and_torques_are_those_of_the_platform(robot, tool, data):
    pose = data.draw(poses(0.4, robot)) if robot is UNEQUAL else robot.home_pose + 0.05 * data.draw(vectors(6, 0.1))
    rate, acceleration = data.draw(vectors(6)), data.draw(vectors(6, 5.0))
    told = told_of(tool, pose, rate, acceleration)
    assume(abs(told[0][1]) < 1.3)
    other = with_tool(robot, *tool)
    np.testing.assert_allclose(inverse_kinematics(other, told[0]), inverse_kinematics(robot, pose), atol=1e-9)
    speeds = [crank_rates(r, leg_geometry(r, m[0]), *m[:2]) for r, m in ((robot, (pose, rate)), (other, told))]
    np.testing.assert_allclose(speeds[1], speeds[0], atol=1e-9 * max(1.0, np.abs(speeds[0]).max()))
    torque = inverse_dynamics(robot, pose, rate, acceleration)
    np.testing.assert_allclose(inverse_dynamics(other, *told), torque, atol=1e-9 * max(1.0, np.abs(torque).max()))


@given(st.sampled_from([UNEQUAL, REACHY]), TOOLS, st.data())
def test_conditioning_is_that_of_the_platform_wherever_the_tool_is(robot, tool, data):
    pose, still = robot.home_pose + 0.05 * data.draw(vectors(6, 0.1)), np.zeros((1, 6))
    told = told_of(tool, pose, *np.zeros((2, 6)))[0]
    assume(abs(told[1]) < 1.3)
    other = with_tool(robot, *tool)
    np.testing.assert_allclose(conditioning(other, told), conditioning(robot, pose), rtol=1e-9)
    margins = [
        limit_margins(r, ReferenceLimits(), at[None], still, still, STANDARD_GRAVITY)["conditioning"]
        for r, at in ((robot, pose), (other, told))
    ]
    np.testing.assert_allclose(margins[1], margins[0], atol=1e-9)


@given(TOOLS)
def test_home_is_the_same_pose_of_the_platform(tool):
    other = with_tool(UNEQUAL, *tool)
    home = told_of(tool, UNEQUAL.home_pose, np.zeros(6), np.zeros(6))[0]
    np.testing.assert_allclose(turn(other.home_pose[:3]), turn(home[:3]), atol=1e-12)
    np.testing.assert_allclose(other.home_pose[3:], home[3:], atol=1e-12)
    np.testing.assert_allclose(
        static_torque(other, other.home_pose), static_torque(UNEQUAL, UNEQUAL.home_pose), atol=1e-9
    )
    angles = inverse_kinematics(UNEQUAL, UNEQUAL.home_pose)
    np.testing.assert_allclose(forward_kinematics(other, angles), other.home_pose, atol=1e-9)
    np.testing.assert_allclose(home_frames(other).rod_rotation, home_frames(UNEQUAL).rod_rotation, atol=1e-9)


@given(TOOLS)
def test_what_is_measured_goes_back_into_the_platforms_frame(tool):
    robot = with_tool(UNEQUAL, *tool)
    for same in (torques.as_robot(robot, torques.values_of(robot)), geometry.as_robot(robot, np.zeros(geometry.SIZE))):
        assert same.tool == robot.tool
        np.testing.assert_allclose(same.joints_in_platform, UNEQUAL.joints_in_platform, atol=1e-12)
        for name in ("platform_center_of_mass", "platform_inertia", "platform_products"):
            np.testing.assert_allclose(getattr(same, name), getattr(UNEQUAL, name), atol=1e-12)
    np.testing.assert_allclose([leg["platform_joint"] for leg in robot.each_leg()], UNEQUAL.joints_in_platform)


TOOL = (np.array([0.03, -0.02, 0.12]), np.array([0.3, -0.2, 0.5]))
STILL = {"duration": 0.12, "reference": {"kind": "hold"}, "controller": {"kind": "feedforward"}, "tuner": "fixed"}
PUSH = {"kind": "step", "time": 0.05}


def falling(robot, plant, wrench):
    """Poses of a robot whose motors hold its weight at home, and which is pushed."""
    scenario = Scenario(robot=robot, plant=plant, **STILL, disturbances=[PUSH | {"wrench": wrench.tolist()}])
    return run(scenario, check=False)["pose"]


@pytest.mark.parametrize(
    "plant", [{"kind": "closed_form"}, {"kind": "drake"}, {"kind": "mujoco"}], ids=lambda plant: plant["kind"]
)
def test_a_push_at_the_tool_moves_the_platform_as_the_same_push_at_p(plant):
    if plant["kind"] == "mujoco":
        pytest.importorskip("mujoco")
    at_tool = np.array([0.05, -0.1, 0.02, 1.0, 0.5, -1.0])
    arm = turn(UNEQUAL.home_pose[:3]) @ TOOL[0]
    at_p = at_tool + np.concatenate([np.cross(arm, at_tool[3:]), np.zeros(3)])
    told, plain = falling(with_tool(UNEQUAL, *TOOL), plant, at_tool), falling(UNEQUAL, plant, at_p)
    again = np.array([told_of(TOOL, pose, np.zeros(6), np.zeros(6))[0] for pose in plain])
    assert np.abs(plain - plain[0]).max() > 1e-4
    # The arm turns with the platform, a little.
    np.testing.assert_allclose(told, again, atol=0.03 * np.abs(plain - plain[0]).max())


def test_a_controller_and_pictures_know_the_tool():
    robot = with_tool(UNEQUAL, *TOOL)
    scenario = Scenario(robot=robot, sensors="encoders", motors=TorqueMotors(), reference="hold")
    np.testing.assert_allclose(scenario.reference.evaluate(0.0)[0], robot.home_pose)
    controller, torque = Controller(scenario), np.empty(6)
    controller.step(inverse_kinematics(robot, robot.home_pose), 0.0, torque)
    np.testing.assert_allclose(controller.signal("measurement")[:6], robot.home_pose, atol=1e-9)
    angles = inverse_kinematics(robot, robot.home_pose)
    links = [link_poses(r, r.home_pose, angles, r.home_pose) for r in (robot, UNEQUAL)]
    np.testing.assert_allclose(links[0][:12, :3], links[1][:12, :3], atol=1e-12)


def test_a_tool_that_points_along_the_singularity_of_euler_angles_is_one_line():
    with pytest.raises(ConfigurationError, match=r"robot\.tool\.orientation.*a pitch below 85 deg"):
        RobotParameters(tool={"orientation": [0.0, 1.55, 0.0]})
