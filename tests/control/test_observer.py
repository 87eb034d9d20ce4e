import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are
from setups import setup_for
from strategies import ROBOT, poses, vectors

from stewart_drake.base.errors import RunFailure
from stewart_drake.control.friction_compensation import FrictionCompensation
from stewart_drake.control.observer import WHITE_SHARE, ObserverOptions, bandwidth, kalman_gains
from stewart_drake.mechanics.dynamics import forward_dynamics, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.scenario.control_side import control_side
from stewart_drake.scenario.scenario import load_scenario

GRAVITY, PERIOD, NOISE = 9.81, 0.001, 2.5e-5
HOME, STILL = ROBOT.home_pose, np.zeros(6)
OPTIONS = ObserverOptions(disturbance=20.0)
ENCODERS = {"reading": 6}
EXPECTED = np.array([ObserverOptions().disturbance])
AWAY = np.concatenate([HOME + 0.01, np.zeros(12)])


def begun(pose=HOME, rate=STILL, delay=0, torque=None, age=0, **more):
    """`tick(reading, net_torque, reference=AWAY, **changes)` of an observer after its first tick; its last state."""
    torque = static_torque(ROBOT, pose, GRAVITY) if torque is None else torque
    place = {"pose": pose, "pose_rate": rate, "initial_torque": torque}
    (part,) = OPTIONS.parts(setup_for(noise=NOISE, delay=delay, reading_age=age * PERIOD, **(ENCODERS | place | more)))
    state = part.initial.copy()

    def tick(reading, net_torque=torque, reference=AWAY, **changes):
        for name, value in changes.items():
            state[name] = value
        part.tick(reading, net_torque, reference, EXPECTED, state)
        return {name: state[name][0] for name in state.dtype.names}

    angles = inverse_kinematics(ROBOT, pose)
    return tick, tick(angles if part.inputs["reading"] == 6 else np.concatenate([pose, rate]))


def moved(pose, rate, torque, seconds):
    # The exact model under constant torques, by an integrator of its own.
    def change(_, state):
        return np.concatenate([state[6:], forward_dynamics(ROBOT, state[:6], state[6:], torque, GRAVITY)])

    found = solve_ivp(change, (0.0, seconds), np.concatenate([pose, rate]), rtol=1e-11, atol=1e-13).y[:, -1]
    return found[:6], found[6:]


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
    q = q + (WHITE_SHARE * (bandwidth(noise, disturbance, period) * h) ** 2) ** 2 * np.outer(push, push)
    p = solve_discrete_are(a.T, c.T, q, np.eye(1))
    expected = (p @ c.T / (p[0, 0] + 1.0)).ravel() / [1.0, h, h * h]
    np.testing.assert_allclose(kalman_gains(noise, disturbance, period), expected, rtol=1e-6)


@settings(max_examples=25, deadline=None)
@given(poses(0.3), vectors(6, 0.2), st.integers(0, 2), st.integers(0, 2), st.sampled_from([6, 12]))
def test_it_sees_where_the_robot_will_be_when_the_command_acts(pose, rate, delay, age, size):
    torque = static_torque(ROBOT, pose, GRAVITY) + 0.2
    tick, _ = begun(pose, rate, delay, torque, age, reading=size)
    read = moved(pose, rate, torque, PERIOD)
    seen = tick(inverse_kinematics(ROBOT, read[0]) if size == 6 else np.concatenate(read))
    now, ahead = (moved(pose, rate, torque, PERIOD * (1 + ticks)) for ticks in (age, age + delay))
    np.testing.assert_allclose(seen["measurement"][:6], now[0], atol=1e-6 if age else 1e-7)
    np.testing.assert_allclose(seen["predicted"][:6], ahead[0], atol=1e-6)
    np.testing.assert_allclose(seen["predicted"][6:], ahead[1], atol=2e-3)


@pytest.mark.parametrize("delay", [1, 2])
def test_what_a_delay_makes_it_predict_is_what_it_expects_of_the_next_reading(delay):
    rate, missing = np.array([0.3, -0.2, 0.1, 0.05, 0.02, -0.04]), np.full(6, np.nan)
    (tick, first), (tick_at_once, _) = begun(rate=rate, delay=delay), begun(rate=rate)
    expected = first["next"].copy()
    found = tick(missing)["read"]
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found, tick_at_once(missing)["read"])


def test_a_load_that_nobody_knows_is_found_and_made_up_for():
    load = np.array([0.05, -0.1, 0.02, 0.0, 0.08, -0.03])
    still = static_torque(ROBOT, HOME, GRAVITY)
    pose, rate, command, (tick, _) = HOME, STILL, still, begun()
    for _ in range(400):
        acceleration = forward_dynamics(ROBOT, pose, rate, command + load, GRAVITY)
        pose, rate = pose + PERIOD * (rate + 0.5 * PERIOD * acceleration), rate + PERIOD * acceleration
        seen = tick(inverse_kinematics(ROBOT, pose), command)
        # Held by nothing but what the observer asks for, and some damping.
        command = still + seen["disturbance_torque"] - 0.05 * pose_jacobian(ROBOT, pose) @ seen["measurement"][6:]
    np.testing.assert_allclose(seen["disturbance_torque"], -load, atol=2e-3)
    np.testing.assert_allclose(seen["measurement"][:6], pose, atol=1e-6)
    assert np.abs(seen["innovation"]).max() < 1e-6


@pytest.mark.parametrize(("friction", "off", "turning", "grows"), [
    (0.05, 0.0, 0.0, False), (0.05, 0.1, 0.0, True), (0.05, 0.0, 0.1, True), (0.0, 0.0, 0.0, True),
])  # fmt: skip
def test_the_disturbance_stays_while_a_robot_with_friction_rests_where_it_is_wanted(friction, off, turning, grows):
    tick, _ = begun(friction=FrictionCompensation(coulomb=friction))
    reference = np.concatenate([HOME + off, np.full(6, turning), STILL])
    seen = tick(inverse_kinematics(ROBOT, HOME) + 1e-5, reference=reference)
    assert (seen["disturbance"] != 0.0).all() == grows


def test_friction_that_is_learnt_reaches_the_observer():
    learning = load_scenario("exact_breathing").replace({"adaptation": "regression"})
    (observer,) = (part for part in control_side(learning).parts if part.name == "observer")
    assert observer.connections["friction"] == "friction"


def test_missing_readings_are_bridged_by_the_model_and_then_end_the_run():
    rate, torque = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.05]), static_torque(ROBOT, HOME, GRAVITY)
    (tick, _), pose = begun(rate=rate, torque=torque), (HOME, rate)
    for missed in range(1, OPTIONS.hold_ticks + 1):
        pose = moved(*pose, torque, PERIOD)
        angles = inverse_kinematics(ROBOT, pose[0])
        angles[4] = np.nan if missed % 2 else 9.0
        seen = tick(angles)
        assert seen["missed"].tolist() == [0.0] * 4 + [float(missed), 0.0]
        assert seen["innovation"][4] == 0.0
        np.testing.assert_allclose(seen["measurement"][:6], pose[0], atol=1e-7)
    with pytest.raises(RunFailure, match="4 is missing or rejected") as caught:
        tick(angles)
    assert (caught.value.reason, caught.value.leg) == ("encoder", 4)
