"""The closed form as Drake's System: integrators, linearisation, AutoDiff, and LQI by Drake alone."""

import runpy

import numpy as np
import pytest
from conftest import ROOT
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import FirstOrderTaylorApproximation, Linearize
from scipy.linalg import expm
from strategies import ROBOT

from stewart_drake import ClosedFormPlant, Scenario, linearize
from stewart_drake.base.errors import ConfigurationError, SingularPoseError, UnreachablePoseError
from stewart_drake.control.lqi import lqi_gain
from stewart_drake.mechanics.dynamics import forward_dynamics, inverse_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.plant.closed_form import ClosedForm, ClosedFormOptions

POSE = np.array([0.2, -0.1, 0.15, 0.01, -0.02, 0.31])
RATE = np.array([0.3, -0.4, 0.2, 0.1, 0.05, -0.1])
TORQUE = np.array([0.2, 0.3, 0.25, 0.3, 0.2, 0.3])


def at(plant, pose, rate=None, torque=None):
    context = plant.CreateDefaultContext()
    plant.set_state(context, pose, rate)
    plant.torque.FixValue(context, np.zeros(6) if torque is None else torque)
    return context


def rate_of(plant, context):
    return plant.EvalTimeDerivatives(context).CopyToVector()


def test_it_obeys_the_equations_of_motion():
    plant = ClosedFormPlant(ROBOT, gravity=3.7)
    context = at(plant, POSE, RATE, TORQUE)
    expected = np.append(RATE, forward_dynamics(ROBOT, POSE, RATE, TORQUE, 3.7))
    np.testing.assert_allclose(rate_of(plant, context), expected, rtol=1e-10)
    np.testing.assert_array_equal(plant.measurement.Eval(context), np.append(POSE, RATE))
    cranks = plant.crank_state.Eval(context)
    np.testing.assert_allclose(np.cos(cranks[:6] - inverse_kinematics(ROBOT, POSE)), 1.0)
    np.testing.assert_allclose(cranks[6:], pose_jacobian(ROBOT, POSE) @ RATE, rtol=1e-9)
    home = plant.get_output_port(0).Eval(plant.CreateDefaultContext())
    np.testing.assert_array_equal(home, np.append(ROBOT.home_pose, np.zeros(6)))


def test_the_motors_limit():
    plant = ClosedFormPlant(ROBOT)
    much, limit = (rate_of(plant, at(plant, POSE, torque=np.full(6, size))) for size in (50.0, ROBOT.effort_limit))
    np.testing.assert_array_equal(much, limit)


def test_a_push_that_bears_a_payload():
    plant = ClosedFormPlant(ROBOT, ClosedFormOptions(payload_mass=0.2))
    context = at(plant, POSE, torque=static_torque(ROBOT, POSE))
    assert rate_of(plant, context)[11] < -0.1
    plant.wrench.FixValue(context, [0.0, 0.0, 0.0, 0.0, 0.0, 0.2 * 9.81])
    np.testing.assert_allclose(rate_of(plant, context), 0.0, atol=1e-9)


def test_with_a_payload_and_viscous_friction_it_is_the_closed_form_of_a_scenario():
    options = ClosedFormOptions(
        integrator="rk4", motor_damping=0.02, payload_mass=0.5, payload_position=(0.02, 0.01, 0.03)
    )
    stepped, wrench = ClosedForm(ROBOT, options, 9.81), np.array([0.1, -0.2, 0.1, 1.0, -2.0, 3.0])
    stepped.initial(POSE, RATE)
    for _ in range(100):
        expected = stepped.step(TORQUE, wrench)
    plant = ClosedFormPlant(ROBOT, options)
    context = at(plant, POSE, RATE, TORQUE)
    plant.wrench.FixValue(context, wrench)
    simulator = Simulator(plant, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.AdvanceTo(0.1)
    np.testing.assert_allclose(plant.measurement.Eval(context), expected[:12], atol=1e-8)
    np.testing.assert_allclose(plant.crank_state.Eval(context), expected[12:], atol=1e-7)


def test_what_cannot_be_is_one_line():
    with pytest.raises(ConfigurationError, match=r"^friction: expected viscous friction alone"):
        ClosedFormPlant(ROBOT, ClosedFormOptions(motor_friction=0.1))
    with pytest.raises(ConfigurationError, match=r"^gravity"):
        ClosedFormPlant(ROBOT, gravity=(1.0, 2.0))
    plant = ClosedFormPlant(ROBOT)
    for pose, error in (
        ([0.0] * 5, ConfigurationError),
        ([POSE, POSE], ConfigurationError),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 2.0], UnreachablePoseError),
    ):
        with pytest.raises(error):
            plant.set_state(plant.CreateDefaultContext(), pose)
    context = at(plant, POSE)
    context.SetContinuousState([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, *np.zeros(6)])
    with pytest.raises(SingularPoseError, match="dead centre"):
        plant.EvalTimeDerivatives(context)


def test_linearised_by_drake_it_is_the_plant_of_linearize():
    plant, expected = ClosedFormPlant(ROBOT), linearize(Scenario(), POSE)
    context = at(plant, POSE, torque=expected.torque)
    ports = plant.torque.get_index(), plant.measurement.get_index()
    found, whole = Linearize(plant, context, *ports), np.zeros((18, 18))
    whole[:12, :12], whole[:12, 12:] = found.A(), found.B()
    held = expm(expected.plant.period * whole)
    np.testing.assert_allclose(held[:12, :12], expected.plant.a, atol=1e-9)
    np.testing.assert_allclose(held[:12, 12:], expected.plant.b, atol=1e-9)
    np.testing.assert_array_equal(found.C(), np.eye(12))


def test_derivatives_in_motion_with_a_push():
    plant = ClosedFormPlant(ROBOT)
    context = at(plant, POSE, RATE, TORQUE)
    plant.wrench.FixValue(context, np.zeros(6))
    by_wrench = FirstOrderTaylorApproximation(plant, context, plant.wrench.get_index(), plant.crank_state.get_index())
    rate = np.append(RATE, forward_dynamics(ROBOT, POSE, RATE, TORQUE))
    np.testing.assert_allclose(by_wrench.f0() + by_wrench.A() @ np.append(POSE, RATE), rate, atol=1e-7)
    # Torques that act as the force do have the same effect.
    as_force = inverse_dynamics(ROBOT, POSE, RATE, np.zeros(6)) - inverse_dynamics(
        ROBOT, POSE, RATE, by_wrench.B()[6:, 5]
    )
    moved = forward_dynamics(ROBOT, POSE, RATE, TORQUE - as_force) - rate[6:]
    np.testing.assert_allclose(by_wrench.B()[6:, 5], moved, rtol=1e-8)
    np.testing.assert_allclose(by_wrench.C()[:6, :6], pose_jacobian(ROBOT, POSE), rtol=1e-7)
    np.testing.assert_allclose(by_wrench.C()[6:, 6:], pose_jacobian(ROBOT, POSE), rtol=1e-7)


def test_gradients_of_a_user_chain_and_may_be_none():
    plant = ClosedFormPlant(ROBOT).ToAutoDiffXd()
    context, way = plant.CreateDefaultContext(), np.arange(12.0)[:, None]
    for gradient in (way, np.empty((12, 0))):
        context.SetContinuousState(InitializeAutoDiff(np.append(POSE, RATE), gradient))
        plant.torque.FixValue(context, InitializeAutoDiff(TORQUE, np.zeros((6, gradient.shape[1]))))
        found = rate_of(plant, context)
        expected = np.append(RATE, forward_dynamics(ROBOT, POSE, RATE, TORQUE))
        np.testing.assert_allclose(ExtractValue(found).ravel(), expected, rtol=1e-10)
        if gradient.size:
            ahead, behind = (np.append(POSE, RATE) + sign * 1e-6 * way[:, 0] for sign in (1.0, -1.0))
            moved = (
                forward_dynamics(ROBOT, ahead[:6], ahead[6:], TORQUE)
                - forward_dynamics(ROBOT, behind[:6], behind[6:], TORQUE)
            ) / 2e-6
            np.testing.assert_allclose(ExtractGradient(found)[:, 0], np.append(way[6:, 0], moved), rtol=1e-5)


def test_lqi_by_drake_alone():
    script = runpy.run_path(str(ROOT / "diagrams" / "lqi_by_drake.py"))
    gain, options, pose = script["lqi_gain"](), script["OPTIONS"], script["POSE"]
    ours = lqi_gain(pose_acceleration_map(ROBOT, pose), options, script["WEIGHTS"])
    np.testing.assert_allclose(gain, ours[:, [*range(0, 12, 2), *range(1, 12, 2), *range(12, 18)]], atol=1e-9)
    by_drake, by_us = (script["off"](each, (0.0, 0.5)) for each in (gain, None))
    assert by_drake[1] < 0.5 * by_drake[0]
    np.testing.assert_allclose(by_drake, by_us, atol=0.5)
