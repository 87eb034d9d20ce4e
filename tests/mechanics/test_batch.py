"""Leading axes, chunks for threads, records in place of robots, and which pose of many is named."""

import itertools

import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake.errors import ConfigurationError, UnreachablePoseError
from stewart_drake.mechanics import dynamics, kinematics
from stewart_drake.mechanics.kinematics_laws import robot_record, with_payload

SIZE = [0.2, 0.2, 0.2, 0.03, 0.03, 0.01]


def some_poses(*shape, seed=0):
    return ROBOT.home_pose + np.random.default_rng(seed).uniform(-1.0, 1.0, (*shape, 6)) * SIZE


@pytest.mark.parametrize("function", [kinematics.inverse_kinematics, dynamics.static_torque])
@pytest.mark.parametrize("chunk", [kinematics.CHUNK, 2])
def test_leading_axes_stay_and_values_are_those_of_each_pose_alone(function, chunk, monkeypatch):
    pose = some_poses(2, 3)
    monkeypatch.setattr(kinematics, "CHUNK", chunk)
    monkeypatch.setattr(kinematics.os, "cpu_count", lambda: 4)
    found = function(ROBOT, pose)
    for at in itertools.product(range(2), range(3)):
        np.testing.assert_array_equal(found[at], function(ROBOT, pose[at]))
    np.testing.assert_array_equal(found[:, 1], function(ROBOT, pose[:, 1]))
    assert function(ROBOT, pose[:0]).shape == (0, *found.shape[1:])


def test_poses_rates_and_accelerations_broadcast():
    pose, rate, acceleration = some_poses(2, 1), np.random.default_rng(1).normal(size=(3, 6)), np.ones(6)
    found = dynamics.inverse_dynamics(ROBOT, pose, rate, acceleration)
    assert found.shape == (2, 3, 6)
    np.testing.assert_array_equal(found[1, 2], dynamics.inverse_dynamics(ROBOT, pose[1, 0], rate[2], acceleration))
    with pytest.raises(ConfigurationError, match="pose_rate"):
        dynamics.inverse_dynamics(ROBOT, pose, rate[:, :5], acceleration)


def test_of_all_chunks_the_worst_leg_is_named(monkeypatch):
    monkeypatch.setattr(kinematics, "CHUNK", 5)
    pose = some_poses(40)
    pose[3, 5], pose[33, 5] = 0.5, 0.6
    with pytest.raises(UnreachablePoseError) as caught:
        dynamics.static_torque(ROBOT, pose)
    np.testing.assert_array_equal(caught.value.pose, pose[33])
    margins = kinematics.reach_margin(ROBOT, pose[33])
    assert (caught.value.leg, caught.value.margin) == (margins.argmin(), margins.min())


def test_a_record_stands_for_a_robot_and_a_payload_adds_its_weight_and_inertia():
    pose, motion = some_poses(5), (0.3 * np.ones(6), np.ones(6))
    longer = robot_record(ROBOT).copy()
    longer["rod_length"] = 0.41
    expected = dynamics.inverse_dynamics(ROBOT.replace(rod_length=0.41), pose, *motion)
    np.testing.assert_array_equal(dynamics.inverse_dynamics(longer, pose, *motion), expected)
    mass, place = 0.4, np.array([0.02, -0.03, 0.05])
    loaded = dynamics.task_inertia(with_payload(robot_record(ROBOT), mass, place), pose[0])
    twist = np.array([0.3, -0.2, 0.5, 0.1, 0.2, -0.4])
    speed = twist[3:] + np.cross(twist[:3], kinematics.rotation_matrix(pose[0, :3]) @ place)
    added = twist @ (loaded - dynamics.task_inertia(ROBOT, pose[0])) @ twist
    assert added == pytest.approx(mass * speed @ speed, rel=1e-12)
