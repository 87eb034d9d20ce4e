import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors
from ticks import GRAVITY, REST, ticked

from stewart_drake.control.base import Setpoint
from stewart_drake.control.joint_pid import PidOptions, pid_part
from stewart_drake.control.lqi import LqiOptions, lqi_gain
from stewart_drake.control.riccati import INTEGRAL, POSITION, RATE
from stewart_drake.errors import NotFiniteError, SingularPoseError, UnreachablePoseError
from stewart_drake.mechanics.dynamics import pose_acceleration_map, static_torque, task_inertia
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian

HOME = np.array(ROBOT.home_pose)


def tick(options, pose, rate=REST, wanted=HOME, wanted_rate=REST, integral=REST):
    part = pid_part(options, ROBOT, GRAVITY)
    return ticked(part, pose, rate, Setpoint(wanted, wanted_rate, REST), crank_integral=integral)


@settings(max_examples=40)
@given(poses(0.6), vectors(6, 0.3), vectors(6, 0.02), vectors(6, 0.05), st.sampled_from(["gravity", "none"]))
def test_the_torque_is_that_of_the_hand_formula(pose, rate, away, integral, feedforward):
    options = PidOptions(kp=20.0, ki=7.0, kd=0.5, saturation="none", feedforward=feedforward)
    wanted = pose + away
    got = tick(options, pose, rate, wanted, 2.0 * rate, integral)
    error = inverse_kinematics(ROBOT, pose) - inverse_kinematics(ROBOT, wanted)
    rates = pose_jacobian(ROBOT, pose) @ rate - pose_jacobian(ROBOT, wanted) @ (2.0 * rate)
    weight = static_torque(ROBOT, pose, GRAVITY if feedforward == "gravity" else 0.0)
    expected = weight - 20.0 * error - 0.5 * rates - 7.0 * integral
    np.testing.assert_allclose(got.torque, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.crank_integral, integral + 0.001 * error, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal([got.error, got.integral], [pose - wanted, REST])


@pytest.mark.parametrize(("limit", "expected"), [(None, ROBOT.effort_limit), (2.0, 2.0), (9.0, ROBOT.effort_limit)])
def test_clamped_torque_and_integral(limit, expected):
    options = PidOptions(kp=1e4, ki=1.0, feedforward="none", torque_limit=limit)
    away = HOME + [0, 0, 0, 0, 0, -0.005]
    got = tick(options, away)
    np.testing.assert_array_equal(np.abs(got.torque), np.full(6, expected))
    np.testing.assert_array_equal(got.crank_integral, np.zeros(6))


def test_only_the_motor_at_its_limit_stops_integrating():
    options = PidOptions(kp=0.0, kd=0.0, ki=1.0, feedforward="none", torque_limit=1.0)
    before = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    got = tick(options, HOME + [0, 0, 0, 0, 0, -0.005], integral=before)
    grown = got.crank_integral - before
    assert grown[0] == 0.0
    assert (grown[1:] != 0.0).all()
    assert got.torque[0] == -1.0


def test_back_calculation_gives_back_what_was_cut():
    options = PidOptions(
        kp=0.0, kd=0.0, ki=2.0, feedforward="none", torque_limit=1.0, saturation="back_calculation", reset_time=0.01
    )
    got = tick(options, HOME, integral=np.full(6, 3.0))
    # Asked for -6, given -1: a tenth of the 5 that were cut comes off, divided by ki.
    np.testing.assert_allclose(got.crank_integral, 3.0 - 0.1 * 5.0 / 2.0)


def test_the_default_gains_are_those_of_the_exact_lqi_on_heave_at_home():
    options = LqiOptions(period=0.001, model="exact", solver="split", weight_length=0.11)
    gain_map = pose_acceleration_map(ROBOT, HOME)
    feedback = gain_map @ lqi_gain(gain_map, options, np.array([4e5, 30.0, 4e7, 1.0]))
    heave, cranks = task_inertia(ROBOT, HOME)[5, 5], np.sum(pose_jacobian(ROBOT, HOME)[:, 5] ** 2)
    pid = PidOptions()
    wanted = [feedback[5, part][5] * heave / cranks for part in (POSITION, INTEGRAL, RATE)]
    np.testing.assert_allclose([pid.kp, pid.ki, pid.kd], wanted, rtol=2e-3)


@pytest.mark.parametrize(
    ("pose", "rate", "least", "error"),
    [
        (HOME, np.full(6, np.nan), 0.02, NotFiniteError),
        (np.full(6, np.inf), REST, 0.02, NotFiniteError),
        (HOME + [0, 0, 0, 0, 0, 0.5], REST, 0.02, UnreachablePoseError),
        (HOME, REST, 0.999, SingularPoseError),
    ],
)
def test_measurements_that_cannot_be_end_the_run(pose, rate, least, error):
    with pytest.raises(error):
        tick(PidOptions(min_transmission=least), pose, rate)
