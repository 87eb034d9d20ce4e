import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from strategies import ROBOT, robots_and_poses, vectors

from stewart_drake import ConfigurationError, forward_dynamics, inverse_dynamics, leg_geometry
from stewart_drake.base.errors import UnreachablePoseError
from stewart_drake.mechanics import dynamics, kinematics
from stewart_drake.mechanics.dynamics import (
    crank_map,
    force_map,
    force_map_of_legs,
    static_torque,
    task_bias,
    task_inertia,
)
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, twist_jacobian
from stewart_drake.mechanics.kinematics_laws import robot_record, with_payload

DATA = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())


@pytest.mark.parametrize("case", DATA["cases"])
def test_inertia_and_bias_of_an_independent_implementation(case):
    twist = np.concatenate([case["angular_velocity_W"], case["linear_velocity_W"]])
    np.testing.assert_allclose(task_inertia(ROBOT, case["pose"]), case["task_inertia"], rtol=1e-9, atol=1e-12)
    bias = task_bias(ROBOT, case["pose"], twist)
    np.testing.assert_allclose(bias, case["task_bias_with_gravity"], rtol=1e-9, atol=1e-11)


@given(at=robots_and_poses(), rate=vectors(6, 2.0), acceleration=vectors(6, 5.0))
def test_torques_satisfy_the_equation_of_motion(at, rate, acceleration):
    # M d(twist)/dt + h = J' T; inertia and bias are held against Drake's in tests/plant/test_multibody_model.py.
    robot, pose = at
    step, twist = 1e-6, pose_rate_to_twist(pose, rate)
    ahead, behind = (pose_rate_to_twist(pose + dt * rate, rate + dt * acceleration) for dt in (step, -step))
    load = task_inertia(robot, pose) @ (ahead - behind) / (2.0 * step) + task_bias(robot, pose, twist)
    torque = inverse_dynamics(robot, pose, rate, acceleration)
    np.testing.assert_allclose(twist_jacobian(robot, pose).T @ torque, load, rtol=1e-6, atol=1e-6)


@given(at=robots_and_poses(), rate=vectors(6, 2.0), acceleration=vectors(6, 10.0))
def test_forward_dynamics_undoes_inverse_dynamics(at, rate, acceleration):
    robot, pose = at
    torque = inverse_dynamics(robot, pose, rate, acceleration, 5.0)
    found = forward_dynamics(robot, pose, rate, torque, 5.0)
    np.testing.assert_allclose(found, acceleration, rtol=1e-8, atol=1e-8)


def test_a_pose_out_of_reach_raises_and_a_torque_of_another_size_is_refused():
    zero = np.zeros(6)
    for function, more in {static_torque: (), inverse_dynamics: (zero, zero), task_bias: (zero,)}.items():
        with pytest.raises(UnreachablePoseError):
            function(ROBOT, np.array([0, 0, 0, 0, 0, 0.6]), *more)
    with pytest.raises(ConfigurationError, match="torque"):
        forward_dynamics(ROBOT, ROBOT.home_pose, zero, np.zeros(5))


@pytest.mark.parametrize("case", DATA["cases"])
@pytest.mark.parametrize("kind", ["printed", "statics"])
def test_both_maps_of_an_independent_implementation(case, kind):
    np.testing.assert_allclose(force_map(ROBOT, case["pose"], kind), case[f"force_map_{kind}"], rtol=1e-11, atol=1e-12)


def test_at_a_dead_centre_printed_is_zero_and_statics_infinite_without_a_warning():
    legs = leg_geometry(ROBOT, ROBOT.home_pose)
    dead = dataclasses.replace(legs, transmission=legs.transmission * [1, 1, 0, 1, 1, 1])
    assert crank_map(ROBOT, dead, "printed")[2] == 0.0
    assert crank_map(ROBOT, dead, "statics")[2] == np.inf
    assert np.linalg.matrix_rank(force_map_of_legs(ROBOT, dead, "printed")) == 5


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


def test_of_all_chunks_the_worst_leg_is_named(monkeypatch):
    monkeypatch.setattr(kinematics, "CHUNK", 5)
    pose = some_poses(40)
    pose[3, 5], pose[33, 5] = 0.5, 0.6
    with pytest.raises(UnreachablePoseError) as caught:
        dynamics.static_torque(ROBOT, pose)
    np.testing.assert_array_equal(caught.value.pose, pose[33])
    margins = kinematics.reach_margin(ROBOT, pose[33])
    assert (caught.value.leg, caught.value.margin) == (margins.argmin(), margins.min())


def test_a_record_replaces_a_robot_and_a_payload_adds_its_weight_and_inertia():
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
