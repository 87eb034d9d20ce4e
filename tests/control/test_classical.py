import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from setups import setup_for
from strategies import ROBOT, poses, vectors
from ticks import GRAVITY, REST, standing, ticked

from stewart_drake.base.errors import NotFiniteError, SingularPoseError, UnreachablePoseError
from stewart_drake.control.base import Setpoint
from stewart_drake.control.classical import ComputedTorqueOptions, PidOptions
from stewart_drake.mechanics.dynamics import forward_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian

HOME = np.array(ROBOT.home_pose)
WEAK = ROBOT.replace(effort_limit=1.0)
LIMITS = -ROBOT.effort_limit, ROBOT.effort_limit


def pid(options, pose, rate=REST, wanted=HOME, wanted_rate=REST, integral=REST, robot=ROBOT):
    (part,) = options.parts(setup_for(robot))
    setpoint = Setpoint(wanted, wanted_rate, REST)
    return ticked(part, pose, rate, setpoint, np.concatenate(setpoint), crank_integral=integral)


@settings(max_examples=40)
@given(poses(0.6), vectors(6, 0.3), vectors(6, 0.02), vectors(6, 0.05), st.sampled_from(["gravity", "none"]))
def test_the_torque_is_that_of_the_hand_formula(pose, rate, away, integral, feedforward):
    options = PidOptions(kp=20.0, ki=7.0, kd=0.5, feedforward=feedforward)
    wanted = pose + away
    got = pid(options, pose, rate, wanted, 2.0 * rate, integral)
    error = inverse_kinematics(ROBOT, pose) - inverse_kinematics(ROBOT, wanted)
    rates = pose_jacobian(ROBOT, pose) @ rate - pose_jacobian(ROBOT, wanted) @ (2.0 * rate)
    weight = static_torque(ROBOT, pose, GRAVITY if feedforward == "gravity" else 0.0)
    expected = weight - 20.0 * error - 0.5 * rates - 7.0 * integral
    np.testing.assert_allclose(got.torque, np.clip(expected, *LIMITS), rtol=1e-9, atol=1e-9)
    grows = expected == np.clip(expected, *LIMITS)
    np.testing.assert_allclose(got.crank_integral, integral + 0.001 * grows * error, rtol=1e-9, atol=1e-12)


def test_only_the_motor_at_its_limit_stops_integrating():
    options = PidOptions(kp=0.0, kd=0.0, ki=1.0, feedforward="none")
    before = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    got = pid(options, HOME + [0, 0, 0, 0, 0, -0.005], integral=before, robot=WEAK)
    assert got.torque[0] == -1.0
    np.testing.assert_array_equal(got.crank_integral == before, [True] + [False] * 5)


@pytest.mark.parametrize(
    ("pose", "error"),
    [
        (np.full(6, np.nan), NotFiniteError),
        (HOME + [0, 0, 0, 0, 0, 0.5], UnreachablePoseError),
        (HOME + [0, 0, 0.3, 0, 0, 0.115], SingularPoseError),
    ],
)
def test_measurements_that_cannot_be_end_the_run(pose, error):
    for options in (PidOptions(), ComputedTorqueOptions()):
        (part,) = options.parts(setup_for())
        now = [np.concatenate(standing(HOME))] * ("reference_now" in part.inputs)
        with pytest.raises(error):
            ticked(part, pose, REST, standing(HOME), *now)


def computed(pose, rate, setpoint, integral=REST, **options):
    (part,) = ComputedTorqueOptions(**options).parts(setup_for())
    return ticked(part, pose, rate, setpoint, integral=integral)


@settings(max_examples=40)
@given(poses(0.6), vectors(6, 0.3), vectors(6, 0.02), vectors(6, 1.0), vectors(6, 0.01))
def test_the_robot_accelerates_as_the_linear_loop(pose, rate, away, wanted_acceleration, integral):
    options = {"natural_frequency": 30.0, "damping": 0.7, "integral_frequency": 4.0, "saturation": "none"}
    got = computed(pose, rate, Setpoint(pose + away, 0.5 * rate, wanted_acceleration), integral, **options)
    expected = wanted_acceleration - 2.0 * 0.7 * 30.0 * 0.5 * rate - 900.0 * (-away + 4.0 * integral)
    np.testing.assert_allclose(forward_dynamics(ROBOT, pose, rate, got.torque, GRAVITY), expected, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(got.integral, integral - 0.001 * away, atol=1e-15)


def test_clamped_torque_stops_the_integral():
    at = HOME + [0, 0, 0, 0, 0, -0.02], REST, standing(HOME)
    got = computed(*at, natural_frequency=300.0)
    assert np.abs(got.torque).max() == ROBOT.effort_limit
    np.testing.assert_array_equal(got.integral, REST)
    got = computed(*at, natural_frequency=300.0, saturation="none")
    assert np.abs(got.torque).max() > ROBOT.effort_limit
    assert got.integral[5] == pytest.approx(-2e-5)
