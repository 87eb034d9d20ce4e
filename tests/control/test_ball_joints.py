"""Friction and inertia of the rods' ball joints, against virtual work by numerical differentiation."""

import importlib.util

import numpy as np
import pytest

from stewart_drake import RobotParameters, load_controller, load_robot, load_scenario
from stewart_drake.control.ball_joints import (
    BallJoints,
    ball_joint_parts,
    ball_joint_torques,
    joint_rates,
    joints_record,
)
from stewart_drake.mechanics.kinematics import leg_geometry, pose_jacobian, pose_rate_to_twist, rotation_matrix
from stewart_drake.mechanics.kinematics_laws import Legs, legs_at, robot_record

ROBOTS = [RobotParameters(), load_robot("reachy_mini")]
RATE = np.array([0.3, -0.2, 0.4, 0.02, -0.01, 0.03])


def record_of(robot, pose):
    legs = Legs.empty()
    assert legs_at(robot_record(robot)[0], pose, legs[0]) == -1
    return legs[0]


def rates_at(robot, joints, pose, rate):
    made, twist = np.empty((2, 6, 3)), pose_rate_to_twist(pose, rate)
    joint_rates(robot_record(robot)[0], joints_record(joints)[0], record_of(robot, pose), twist, made[0], made[1])
    return made


def torques(robot, joints, pose, rate, acceleration):
    out = np.zeros(6)
    motion = np.concatenate([pose, rate])
    ball_joint_torques(
        robot_record(robot)[0], joints_record(joints)[0], motion, acceleration, record_of(robot, pose), out
    )
    return out


def rod_axes(legs):
    """(leg, component, axis): across the rod in and out of the plane of its crank, and along it."""
    across = np.cross(np.cross(legs.crank, legs.e_n), legs.e_l)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([np.cross(legs.e_l, across), -across, legs.e_l], axis=2)


@pytest.mark.parametrize("robot", ROBOTS, ids=["paper", "reachy"])
def test_rates_are_those_of_the_bodies(robot):
    pose, h = robot.home_pose + [0.05, 0.02, -0.03, 0.002, 0.001, 0.003], 1e-6
    joints = BallJoints(platform=(1, 1, 1, 1, 0, 3))
    at_crank, at_platform = rates_at(robot, joints, pose, RATE)
    legs, after, before = (leg_geometry(robot, pose + shift * RATE) for shift in (0.0, h, -h))
    rod_change = (after.e_l - before.e_l) / (2.0 * h)
    crank_rates = pose_jacobian(robot, pose) @ RATE
    of_crank = crank_rates[:, None] * np.cross(legs.crank, legs.e_n)
    of_platform = pose_rate_to_twist(pose, RATE)[:3]
    for i in range(6):
        e = legs.e_l[i]
        of_rod = at_crank[i] + of_crank[i]
        # Whatever a rod turns about itself, this is how its direction changes.
        np.testing.assert_allclose(np.cross(of_rod, e), rod_change[i], atol=1e-6)
        np.testing.assert_allclose(at_platform[i], of_platform - of_rod, atol=1e-12)
        assert at_crank[i] @ e == pytest.approx(joints.platform[i] * (at_platform[i] @ e), abs=1e-12)


@pytest.mark.parametrize("robot", ROBOTS, ids=["paper", "reachy"])
def test_power_of_the_motors_is_what_the_joints_take(robot):
    pose = robot.home_pose + [0.05, 0.02, -0.03, 0.002, 0.001, 0.003]
    joints = BallJoints(viscous=0.15, coulomb=0.1, width=0.1, platform=(0, 0, 0, 0, 0, 1))
    rates, legs = rates_at(robot, joints, pose, RATE), leg_geometry(robot, pose)
    about = np.einsum("ska,sab->skb", rates.transpose(1, 0, 2), rod_axes(legs))  # Leg, joint, axis.
    dry = joints.coulomb * np.abs(about) * np.minimum(1.0, np.abs(about) / joints.width)
    lost = joints.viscous * np.sum(rates**2, axis=2) + dry.sum(axis=2).T
    lost = lost[0].sum() + lost[1, 5]
    made = torques(robot, joints, pose, RATE, np.zeros(6)) @ (pose_jacobian(robot, pose) @ RATE)
    assert made == pytest.approx(lost, rel=1e-9)


def test_dry_friction_acts_about_the_given_axes():
    robot, pose = ROBOTS[1], ROBOTS[1].home_pose + [0.05, 0.02, -0.03, 0.002, 0.001, 0.003]
    turned = ((0.0, 0.0, 0.0),) * 5 + ((0.4, -0.2, 0.7),)
    joints = BallJoints(coulomb=0.1, width=1e-6, platform=(0, 0, 0, 0, 0, 1), crank_axes=turned, platform_axes=turned)
    rates, legs = rates_at(robot, joints, pose, RATE), leg_geometry(robot, pose)
    axes = rod_axes(legs)
    axes[5] = axes[5] @ rotation_matrix(turned[5])
    of_cranks = np.abs(np.einsum("ik,ika->ia", rates[0], axes)).sum()
    of_platform = np.abs(rates[1, 5] @ rotation_matrix(pose[:3]) @ rotation_matrix(turned[5])).sum()
    made = torques(robot, joints, pose, RATE, np.zeros(6)) @ (pose_jacobian(robot, pose) @ RATE)
    assert made == pytest.approx(0.1 * (of_cranks + of_platform), rel=1e-9)


def test_torques_are_linear_in_friction_and_inertia():
    robot, pose = ROBOTS[1], ROBOTS[1].home_pose
    legs, parts, motion = record_of(robot, pose), np.zeros((3, 6)), np.concatenate([pose, RATE])
    joints, acceleration = BallJoints(viscous=0.15, coulomb=0.1, inertia=0.001), 5.0 * RATE[::-1]
    ball_joint_parts(robot_record(robot)[0], joints_record(joints)[0], motion, acceleration, legs, parts)
    for k, one in enumerate(({"viscous": 1.0}, {"coulomb": 1.0}, {"inertia": 1.0})):
        np.testing.assert_allclose(parts[k], torques(robot, BallJoints(**one), pose, RATE, acceleration), rtol=1e-9)


def test_the_axes_of_reachy_daemon_are_those_of_the_makers_file():
    pytest.importorskip("mujoco")
    if importlib.util.find_spec("reachy_mini") is None:
        pytest.skip("pip install --no-deps reachy_mini")
    robot, joints = ROBOTS[1], load_controller("reachy_daemon").controller_model.friction.joints
    options = {"kind": "mujoco", "model_file": "reachy_mini", "motor_class": "perfect_actuator"}
    plant = load_scenario("reachy_nod").replace({"plant": options}).plant.make(robot, 9.81)
    plant.initial(robot.home_pose, np.zeros(6))

    def axes_of(joint):
        body = plant._model.jnt_bodyid[plant._model.joint(joint).id]
        return plant._base.T @ plant._data.xmat[body].reshape(3, 3)

    def apart(some, others):
        """[rad] between axes, whatever their order and signs."""
        return np.arccos(np.clip(np.abs(some.T @ others).max(axis=0), 0.0, 1.0)).max()

    rods = rod_axes(leg_geometry(robot, robot.home_pose))
    for leg in range(6):
        # The rods may turn about themselves: here they are as they come, and in the daemon as they rose from sleep.
        told, there = rotation_matrix(np.array(joints.crank_axes[leg])), axes_of(f"passive_{leg + 1}")
        assert apart(rods[leg] @ told, there) < 0.15
        along = (np.sort(np.abs(row)) for row in (told[2], (rods[leg].T @ there)[2]))
        np.testing.assert_allclose(*along, atol=0.01)
    assert apart(rotation_matrix(np.array(joints.platform_axes[5])), axes_of("passive_7")) < 0.01


@pytest.mark.parametrize("robot", ROBOTS, ids=["paper", "reachy"])
def test_power_of_the_motors_is_what_the_joints_inertia_gains(robot):
    pose, acceleration, h = robot.home_pose + [0.05, 0.02, -0.03, 0.0, 0.0, 0.003], 5.0 * RATE[::-1], 1e-4
    joints = BallJoints(inertia=0.001)

    def energy(shift):
        there = pose + shift * RATE + 0.5 * shift**2 * acceleration
        return 0.5 * joints.inertia * np.sum(rates_at(robot, joints, there, RATE + shift * acceleration) ** 2)

    made = torques(robot, joints, pose, RATE, acceleration) @ (pose_jacobian(robot, pose) @ RATE)
    assert made == pytest.approx((energy(h) - energy(-h)) / (2.0 * h), rel=2e-3)
