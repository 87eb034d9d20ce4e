"""A scenario near a pose as linear systems."""

import numpy as np
import pytest

from stewart_drake import Scenario, linearize
from stewart_drake.errors import ConfigurationError
from stewart_drake.plant.closed_chain import ClosedChain
from stewart_drake.scenario import load_scenario

POSE = np.array([0.1, -0.05, 0.08, 0.01, -0.02, 0.31])
SCENARIO = load_scenario("exact_fig7").replace({"plant.engine": "reduced", "plant.time_step": 1e-4})


def test_the_plant_moves_as_the_robot_does_under_a_small_torque():
    near = linearize(SCENARIO, POSE)
    torque = 1e-3 * np.array([1.0, -0.5, 0.3, 0.7, -0.2, 0.4])
    robot = ClosedChain(SCENARIO.robot, SCENARIO.plant, SCENARIO.gravity)
    state, x = robot.initial(POSE, np.zeros(6)), np.zeros(12)
    for _ in range(20):
        for _ in range(10):
            robot.step(near.torque + torque, np.zeros(6), state)
        x = near.plant.a @ x + near.plant.b @ torque
    np.testing.assert_allclose(state["pose"][0] - POSE, x[:6], atol=0.01 * np.abs(x[:6]).max())
    np.testing.assert_allclose(state["pose_rate"][0], x[6:], atol=0.01 * np.abs(x[6:]).max())


def test_the_loop_is_stable_when_it_is_closed_and_python_control_agrees():
    near = linearize(SCENARIO, POSE)
    closed = np.linalg.eigvals(near.loop.a + near.loop.b @ near.loop.c)
    assert np.abs(closed).max() < 1.0
    system = near.loop.to_control()
    assert system.dt == SCENARIO.controller.period
    np.testing.assert_allclose(np.sort(np.abs(system.feedback(np.eye(6), sign=1).poles())), np.sort(np.abs(closed)))


def test_what_is_no_pose_is_refused():
    with pytest.raises(ConfigurationError, match="pose"):
        linearize(Scenario(), [0.0, 0.0])
