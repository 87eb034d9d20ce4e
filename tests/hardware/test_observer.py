import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are
from strategies import ROBOT, poses, vectors

from stewart_drake.errors import RunFailure, SingularPoseError
from stewart_drake.hardware.observer import (
    SHARE,
    SMALLEST_NOISE,
    Observer,
    ObserverMemory,
    ObserverOptions,
    advance,
    bandwidth,
    flat_observer,
    kalman_gains,
    start,
)
from stewart_drake.mechanics.dynamics import forward_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian

GRAVITY, PERIOD, NOISE = 9.81, 0.001, 2.5e-5
HOME = ROBOT.home_pose
OBSERVER = Observer(ROBOT, ObserverOptions(disturbance=20.0), GRAVITY, PERIOD, NOISE)
EXPECTED = np.array([ObserverOptions().disturbance])
AWAY = np.concatenate([HOME + 0.01, np.zeros(12)])
few = settings(max_examples=25, deadline=None)
both = pytest.mark.parametrize("compiled", [False, True], ids=["numpy", "compiled"])


def no_first_pose(angles, guess):  # noqa: ARG001
    raise AssertionError


def begun(observer=OBSERVER, pose=HOME, rate=None, delay=0, torque=None):
    """Memory after the first tick of a robot at a pose."""
    rate = np.zeros(6) if rate is None else rate
    torque = static_torque(ROBOT, pose, GRAVITY) if torque is None else torque
    memory = ObserverMemory.from_flat(observer.initial(pose, rate, torque, delay))
    return start(observer, pose, memory)


def moved(pose, rate, torque, seconds):
    """Pose and rate of the exact model under constant torques, by an integrator of its own."""

    def change(_, state):
        return np.concatenate([state[6:], forward_dynamics(ROBOT, state[:6], state[6:], torque, GRAVITY)])

    found = solve_ivp(change, (0.0, seconds), np.concatenate([pose, rate]), rtol=1e-11, atol=1e-13).y[:, -1]
    return found[:6], found[6:]


# --- the filter ------------------------------------------------------------------------------------------------------


@given(
    st.floats(-6.0, -2.0).map(lambda x: 10.0**x),
    st.floats(-1.0, 4.0).map(lambda x: 10.0**x),
    st.floats(-4.0, -1.5).map(lambda x: 10.0**x),
)
def test_the_gains_are_those_of_the_riccati_equation(noise, disturbance, period):
    h = period
    a = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]]) / [[1.0], [1.0 / h], [1.0 / h**2]]
    # Rates and accelerations in ticks, noise as the unit: the equation itself is then well scaled.
    a = a * [1.0, 1.0 / h, 1.0 / h**2]
    c, q = np.array([[1.0, 0.0, 0.0]]), np.diag([0.0, 0.0, (disturbance * h**2.5 / noise) ** 2])
    push = np.array([0.5, 1.0, 0.0])
    q = q + (SHARE * (bandwidth(noise, disturbance, period) * h) ** 2) ** 2 * np.outer(push, push)
    p = solve_discrete_are(a.T, c.T, q, np.eye(1))
    expected = (p @ c.T / (p[0, 0] + 1.0)).ravel() / [1.0, h, h * h]
    np.testing.assert_allclose(kalman_gains(noise, disturbance, period), expected, rtol=1e-6)


def test_the_bandwidth_is_the_geometric_mean_of_slow_poles():
    noise, disturbance, period = 1e-4, 5.0, 1e-4
    gains, h = kalman_gains(noise, disturbance, period), period
    transition = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    poles = np.linalg.eigvals(transition @ (np.eye(3) - np.outer(gains, [1.0, 0.0, 0.0])))
    mean = np.exp(np.log(np.abs(np.log(poles)) / h).mean())
    assert mean == pytest.approx(bandwidth(noise, disturbance, period), rel=1e-3)


def test_readings_without_noise_count_as_little_noisy():
    exact = Observer(ROBOT, ObserverOptions(), GRAVITY, PERIOD, 0.0)
    assert exact.gains(3.0) == kalman_gains(SMALLEST_NOISE, 3.0, PERIOD)


# --- prediction ------------------------------------------------------------------------------------------------------


@few
@given(poses(0.5), vectors(6, 0.3), vectors(6, 0.5))
def test_a_step_is_the_exact_model_to_second_order(pose, rate, push):
    torque = static_torque(ROBOT, pose, GRAVITY) + push
    errors = []
    for period in (4e-3, 5e-4):
        found = advance(OBSERVER._replace(period=period), pose, rate, torque, np.zeros(6))
        errors.append([np.abs(a - b).max() for a, b in zip(found, moved(pose, rate, torque, period), strict=True)])
    (pose_error, rate_error), (finer_pose, finer_rate) = errors
    # An eighth of the step: 512 and 64 times less where no terms of the long one cancel.
    assert finer_pose < pose_error / 20.0 + 1e-11
    assert finer_rate < rate_error / 5.0 + 1e-9


@few
@given(poses(0.4), vectors(6, 0.2), vectors(6, 5.0))
def test_a_surplus_is_an_acceleration_of_the_cranks(pose, rate, surplus):
    torque = static_torque(ROBOT, pose, GRAVITY)
    with_it, without = (advance(OBSERVER, pose, rate, torque, each)[1] for each in (surplus, np.zeros(6)))
    np.testing.assert_allclose(pose_jacobian(ROBOT, pose) @ (with_it - without) / PERIOD, surplus, atol=1e-9)


@few
@given(poses(0.3), vectors(6, 0.2), st.integers(0, 4), st.booleans())
def test_it_sees_where_the_robot_will_be_when_the_command_acts(pose, rate, delay, compiled):
    torque = static_torque(ROBOT, pose, GRAVITY) + 0.2
    memory = begun(pose=pose, rate=rate, delay=delay, torque=torque)
    now = moved(pose, rate, torque, PERIOD)
    tick = flat_observer(OBSERVER, no_first_pose, compiled)
    seen = ObserverMemory.from_flat(tick(inverse_kinematics(ROBOT, now[0]), torque, AWAY, EXPECTED, memory.flat()))
    ahead = moved(pose, rate, torque, PERIOD * (1 + delay)) if delay else now
    np.testing.assert_allclose(seen.pose, now[0], atol=1e-7)
    np.testing.assert_allclose(seen.pose_ahead, ahead[0], atol=1e-6)
    np.testing.assert_allclose(seen.rate_ahead, ahead[1], atol=2e-3)


# --- correction ------------------------------------------------------------------------------------------------------


@few
@given(
    poses(0.4), vectors(6, 0.3), vectors(6, 1e-3), vectors(6, 3.0), st.integers(0, 3), st.sampled_from([0.0, 1e-7, 1.0])
)
def test_the_compiled_tick_is_that_of_the_arrays(pose, rate, off, surplus, delay, apart):
    reference = np.concatenate([pose + apart * off, apart * off, off])
    sticky = OBSERVER._replace(friction=0.01)
    memory = begun(pose=pose, rate=rate, delay=delay)._replace(surplus=surplus).flat()
    angles, sent = inverse_kinematics(ROBOT, pose) + off, static_torque(ROBOT, pose, GRAVITY) + off
    angles[2] = np.nan if delay == 3 else angles[2] + 2.0 * np.pi
    fast, slow = (
        flat_observer(sticky, no_first_pose, compiled)(angles, sent, reference, EXPECTED, memory)
        for compiled in (True, False)
    )
    np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-10)


@both
def test_a_load_that_nobody_knows_is_found_and_made_up_for(compiled):
    load = np.array([0.05, -0.1, 0.02, 0.0, 0.08, -0.03])
    still, tick = static_torque(ROBOT, HOME, GRAVITY), flat_observer(OBSERVER, no_first_pose, compiled)
    pose, rate, memory, command = HOME, np.zeros(6), begun().flat(), still
    for _ in range(400):
        acceleration = forward_dynamics(ROBOT, pose, rate, command + load, GRAVITY)
        pose, rate = pose + PERIOD * (rate + 0.5 * PERIOD * acceleration), rate + PERIOD * acceleration
        memory = tick(inverse_kinematics(ROBOT, pose), command, AWAY, EXPECTED, memory)
        seen = ObserverMemory.from_flat(memory)
        # Held by nothing but what the observer asks for, and some damping.
        command = still + seen.compensation - 0.05 * pose_jacobian(ROBOT, pose) @ seen.rate
    np.testing.assert_allclose(seen.compensation, -load, atol=2e-3)
    np.testing.assert_allclose(seen.pose, pose, atol=1e-6)
    assert np.abs(seen.innovation).max() < 1e-6


@both
def test_missing_readings_are_bridged_by_the_model_and_then_end_the_run(compiled):
    tick, rate = flat_observer(OBSERVER, no_first_pose, compiled), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.05])
    torque = static_torque(ROBOT, HOME, GRAVITY)
    memory, pose = begun(rate=rate, torque=torque).flat(), (HOME, rate)
    for missed in range(1, OBSERVER.options.hold_ticks + 1):
        pose = moved(*pose, torque, PERIOD)
        angles = inverse_kinematics(ROBOT, pose[0])
        angles[4] = np.nan if missed % 2 else 9.0
        memory = tick(angles, torque, AWAY, EXPECTED, memory)
        seen = ObserverMemory.from_flat(memory)
        assert seen.missed.tolist() == [0.0] * 4 + [float(missed), 0.0]
        assert seen.innovation[4] == 0.0
        np.testing.assert_allclose(seen.pose, pose[0], atol=1e-7)
    with pytest.raises(RunFailure, match="4 is missing or not believed") as caught:
        tick(angles, torque, AWAY, EXPECTED, memory)
    assert (caught.value.reason, caught.value.leg) == ("encoder", 4)


@both
def test_a_robot_in_motion_starts_without_a_kick(compiled):
    rate = np.array([0.3, -0.2, 0.1, 0.05, -0.04, 0.06])
    seen = begun(rate=rate)
    np.testing.assert_array_equal(seen.rate, rate)
    np.testing.assert_array_equal(seen.compensation, np.zeros(6))
    torque = static_torque(ROBOT, HOME, GRAVITY)
    after = moved(HOME, rate, torque, PERIOD)
    tick = flat_observer(OBSERVER, no_first_pose, compiled)
    seen = ObserverMemory.from_flat(tick(inverse_kinematics(ROBOT, after[0]), torque, AWAY, EXPECTED, seen.flat()))
    np.testing.assert_allclose(seen.rate, after[1], atol=1e-3)
    assert np.abs(seen.compensation).max() < 1e-3


@both
def test_a_singularity_has_a_name(compiled):
    tick, memory = flat_observer(OBSERVER, no_first_pose, compiled), begun()
    angles, torque = inverse_kinematics(ROBOT, HOME), static_torque(ROBOT, HOME, GRAVITY)
    up = memory._replace(rate=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 400.0]))
    with pytest.raises(SingularPoseError, match="dead centre"):
        tick(angles, torque, AWAY, EXPECTED, up.flat())
    with pytest.raises(SingularPoseError, match="parallel"):
        tick(angles, torque, AWAY, EXPECTED, memory._replace(side=-memory.side).flat())


def test_the_bandwidth_falls_with_the_noise_and_grows_with_the_disturbance():
    assert bandwidth(8e-5, 20.0, PERIOD) == pytest.approx(0.5 * bandwidth(1e-5, 20.0, PERIOD))
    assert bandwidth(1e-5, 160.0, PERIOD) == pytest.approx(2.0 * bandwidth(1e-5, 20.0, PERIOD))
    assert math.isclose(bandwidth(NOISE, 20.0, PERIOD), 293.6, rel_tol=1e-3)
