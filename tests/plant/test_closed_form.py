"""The closed chain in six coordinates: mechanics' equation of motion, energy, and Drake's plant."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import UNEQUAL

from stewart_drake import ConfigurationError, RobotParameters, Scenario, forward_dynamics, inverse_kinematics
from stewart_drake.base.errors import SingularPoseError
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.plant.closed_form import ClosedForm, ClosedFormOptions, ClosedFormState

GRAVITY = 9.81
PAPER = RobotParameters()
OFF = RobotParameters(
    platform_center_of_mass=(0.01, -0.02, 0.03),
    platform_inertia=(0.003, 0.004, 0.006),
    platform_products=(1e-4, -2e-4, 1e-4),
)
STILL, NO_PUSH = np.zeros(6), np.zeros(6)
MOVING = np.array([0.3, -0.2, 0.4, 0.03, -0.02, 0.05])


def stepped(chain, torque, count, push=NO_PUSH):
    """States (count,)."""
    rows = np.empty(count, ClosedFormState.layout)
    for row in range(count):
        chain.step(torque, push)
        rows[row] = chain.save()[0]
    return rows


def exact(robot, pose, rate, torque, seconds):
    """Pose and rate after so long, by a fine integration of the model's own equation."""

    def change(_, y):
        return np.concatenate([y[6:], forward_dynamics(robot, y[:6], y[6:], torque, GRAVITY)])

    return solve_ivp(change, (0.0, seconds), np.concatenate([pose, rate]), rtol=1e-10, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(("integrator", "order", "steps"), [("semi_implicit", 1, (1, 0.5)), ("rk4", 4, (4, 2))])
@pytest.mark.parametrize("robot", [PAPER, OFF, UNEQUAL], ids=["paper", "centre off", "unequal legs"])
def test_it_converges_to_the_equation_of_motion_with_its_order(robot, integrator, order, steps):
    torque = 1.1 * static_torque(robot, robot.home_pose) + 0.02
    wanted = exact(robot, robot.home_pose, MOVING, torque, 0.08)
    errors = []
    for step in 1e-3 * np.array(steps):
        chain = ClosedForm(robot, ClosedFormOptions(time_step=step, integrator=integrator), GRAVITY)
        chain.initial(robot.home_pose, MOVING)
        end = stepped(chain, torque, round(0.08 / step))[-1]
        errors.append(np.abs(np.concatenate([end["pose"], end["pose_rate"]]) - wanted).max())
        np.testing.assert_allclose(end["crank_rate"], pose_jacobian(robot, end["pose"]) @ end["pose_rate"], atol=1e-9)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15 * order)


def test_with_friction_both_integrators_come_to_the_same_motion_though_motors_turn_and_stick():
    ends, torque = {}, static_torque(PAPER, PAPER.home_pose)
    torque -= 0.1 * np.sign(pose_jacobian(PAPER, PAPER.home_pose) @ MOVING)
    for integrator, step in (("rk4", 1e-5), ("rk4", 1e-3), ("semi_implicit", 1e-3)):
        options = ClosedFormOptions(time_step=step, integrator=integrator, motor_friction=0.05, motor_damping=0.02)
        chain = ClosedForm(PAPER, options, GRAVITY)
        chain.initial(PAPER.home_pose, MOVING)
        ends[integrator, step] = stepped(chain, torque, round(0.08 / step))[-1]["pose"]
    fine, *coarse = ends.values()
    fourth, first = (np.abs(pose - fine).max() for pose in coarse)
    assert fourth < 0.2 * first


def test_a_crank_at_its_dead_centre_ends_it_and_angles_go_on_beyond_half_a_turn():
    chain = ClosedForm(PAPER, ClosedFormOptions(), GRAVITY)
    chain.initial(PAPER.home_pose, STILL)
    start = chain.save()
    with pytest.raises(SingularPoseError, match="dead centre") as caught:
        stepped(chain, STILL, 1000)
    assert caught.value.reason == "crank_dead_centre"
    start["angles"] += 2.0 * np.pi
    start["bristles"]["anchor"] += 2.0 * np.pi
    chain.restore(start)
    there = stepped(chain, static_torque(PAPER, PAPER.home_pose), 5)
    expected = inverse_kinematics(PAPER, PAPER.home_pose) + 2.0 * np.pi
    np.testing.assert_allclose(there["angles"][-1], expected, atol=1e-6)


@pytest.mark.parametrize(("key", "value"), [("rod_joint", "ball"), ("broken_rod", {"leg": 1, "time": 0.5})])
def test_what_it_cannot_have_is_an_error_that_names_the_kind_which_has_it(key, value):
    with pytest.raises(ConfigurationError, match=rf"^plant.{key}: no such key, got .*; kind drake has it\. The keys"):
        Scenario(plant={"kind": "closed_form", key: value})
    # A default that was written out is nothing that could be lost.
    full = Scenario.from_dict(Scenario().to_dict())
    assert full.replace({"plant.kind": "closed_form"}).plant == ClosedFormOptions()


def test_the_old_key_names_the_new_one():
    with pytest.raises(ConfigurationError) as caught:
        Scenario(plant={"engine": "reduced"})
    told = "no such key, got 'reduced'; it is now plant.kind: drake, closed_form or module:Class"
    assert str(caught.value) == f"plant.engine: {told}"
