import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from setups import setup_for
from strategies import ROBOT, poses, vectors

from stewart_drake.hardware.faults import MotorFault
from stewart_drake.hardware.motors import (
    DeadMotor,
    FrictionCompensation,
    MotorOptions,
)
from stewart_drake.mechanics.kinematics import pose_jacobian

WANTED = np.array([0.123, -0.456, 1.0, 4.9, -4.9, 0.0])
ANGLES = np.linspace(-1.0, 1.0, 6)


def test_steps_ripple_and_a_dead_motor():
    torque = MotorOptions(resolution=0.05).torque(WANTED, ANGLES, 0.0)
    np.testing.assert_allclose(torque / 0.05, np.rint(torque / 0.05), atol=1e-9)
    assert np.abs(torque - WANTED).max() <= 0.025
    motor = MotorOptions(ripple=0.02, ripple_periods=12, dead=DeadMotor(leg=3, time=0.5))
    alive, dead = motor.torque(WANTED, ANGLES, 0.4999), motor.torque(WANTED, ANGLES, 0.5)
    np.testing.assert_allclose(alive - WANTED, 0.02 * np.sin(12 * ANGLES), atol=1e-12)
    np.testing.assert_array_equal(dead, np.where(np.arange(6) == 3, 0.0, alive))


def test_motors_wired_wrong_give_the_torques_asked_for_elsewhere_or_with_the_other_sign():
    faults = (MotorFault(kind="reversed", leg=3, time=0.5), MotorFault(kind="swapped", leg=3, other=1, time=0.6))
    motor = MotorOptions(faults=faults)
    signs = np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
    np.testing.assert_array_equal(motor.torque(WANTED, ANGLES, 0.4999), WANTED)
    np.testing.assert_array_equal(motor.torque(WANTED, ANGLES, 0.5), signs * WANTED)
    np.testing.assert_array_equal(motor.torque(WANTED, ANGLES, 0.6), (signs * WANTED)[[0, 3, 2, 1, 4, 5]])


SIX = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])


def against_friction(pose, rate):
    options = FrictionCompensation(coulomb=tuple(SIX), break_away=0.1, stribeck_velocity=0.05, viscous=0.2)
    part = options.part(setup_for())
    state = part.initial.copy()
    state["against_friction"] = np.nan
    part.tick(np.concatenate([pose, rate, np.zeros(6)]), state)
    return state["against_friction"][0]


@given(poses(0.9), vectors(6), st.sampled_from([1e-8, 0.02, 1.0]))
def test_it_is_friction_of_the_cranks_of_the_reference_and_smooth_at_reversals(pose, rate, size):
    rates = pose_jacobian(ROBOT, pose) @ (size * rate)
    dry = SIX + (0.1 - SIX) * np.exp(-((rates / 0.05) ** 2))
    expected = dry * np.tanh(rates / 0.002) + 0.2 * rates
    np.testing.assert_allclose(against_friction(pose, size * rate), expected, atol=1e-9)
