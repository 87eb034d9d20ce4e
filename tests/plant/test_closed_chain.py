"""The closed chain in six coordinates: mechanics' equation of motion, energy, and Drake's plant."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import UNEQUAL

from stewart_drake.errors import ConfigurationError, SingularPoseError
from stewart_drake.mechanics.dynamics import forward_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.plant.closed_chain import CHAIN_STATE, ClosedChain
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot import RobotParameters

GRAVITY = 9.81
PAPER = RobotParameters()
OFF = RobotParameters(
    platform_center_of_mass=(0.01, -0.02, 0.03),
    platform_inertia=(0.003, 0.004, 0.006),
    platform_products=(1e-4, -2e-4, 1e-4),
)
STILL, NO_PUSH = np.zeros(6), np.zeros(6)
MOVING = np.array([0.3, -0.2, 0.4, 0.03, -0.02, 0.05])


def stepped(chain, start, torque, count, push=NO_PUSH):
    """States (count + 1,)."""
    rows, state = np.empty(count + 1, CHAIN_STATE), start.copy()
    rows[0] = state[0]
    for row in range(count):
        chain.step(torque, push, state)
        rows[row + 1] = state[0]
    return rows


def exact(robot, pose, rate, torque, seconds):
    """Pose and rate after so long, by a fine integration of the model's own equation."""

    def change(_, y):
        return np.concatenate([y[6:], forward_dynamics(robot, y[:6], y[6:], torque, GRAVITY)])

    return solve_ivp(change, (0.0, seconds), np.concatenate([pose, rate]), rtol=1e-10, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("robot", [PAPER, OFF, UNEQUAL], ids=["paper", "centre off", "unequal legs"])
def test_it_converges_to_the_equation_of_motion_with_order_one(robot):
    torque = 1.1 * static_torque(robot, robot.home_pose) + 0.02
    wanted = exact(robot, robot.home_pose, MOVING, torque, 0.08)
    errors = []
    for step in (1e-3, 5e-4, 2.5e-4):
        chain = ClosedChain(robot, PlantOptions(time_step=step), GRAVITY)
        end = stepped(chain, chain.initial(robot.home_pose, MOVING), torque, round(0.08 / step))[-1]
        errors.append(np.abs(np.concatenate([end["pose"], end["pose_rate"]]) - wanted).max())
        np.testing.assert_allclose(end["crank_rate"], pose_jacobian(robot, end["pose"]) @ end["pose_rate"], atol=1e-9)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.15)


def test_a_crank_at_its_dead_centre_ends_it_and_angles_go_on_beyond_half_a_turn():
    chain = ClosedChain(PAPER, PlantOptions(), GRAVITY)
    start = chain.initial(PAPER.home_pose, STILL)
    with pytest.raises(SingularPoseError, match="dead centre") as caught:
        stepped(chain, start, STILL, 1000)
    assert caught.value.reason == "crank_dead_centre"
    start["angles"] += 2.0 * np.pi
    start["anchor"] += 2.0 * np.pi
    there = stepped(chain, start, static_torque(PAPER, PAPER.home_pose), 5)
    expected = inverse_kinematics(PAPER, PAPER.home_pose) + 2.0 * np.pi
    np.testing.assert_allclose(there["angles"][-1], expected, atol=1e-6)


@pytest.mark.parametrize("changes", [{"rod_joint": "ball"}, {"broken_rod": {"leg": 1, "time": 0.5}}])
def test_what_it_cannot_have_is_refused_by_name(changes):
    assert PlantOptions.from_dict(changes).engine == "drake"
    with pytest.raises(ConfigurationError) as caught:
        PlantOptions.from_dict({"engine": "reduced", **changes})
    assert str(caught.value) == f"plant.engine: expected drake, because {next(iter(changes))} is given, got 'reduced'"
