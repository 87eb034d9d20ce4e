import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from setups import setup_for
from strategies import ROBOT, poses, vectors

from stewart_drake.control.friction_compensation import FrictionCompensation
from stewart_drake.mechanics.kinematics import pose_jacobian

SIX = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])


def friction_torque(pose, rate):
    options = FrictionCompensation(coulomb=tuple(SIX), break_away=0.1, stribeck_velocity=0.05, viscous=0.2)
    part = options.part(setup_for())
    state = part.initial.copy()
    state["friction_torque"] = np.nan
    part.tick(np.concatenate([pose, rate, np.zeros(6)]), state)
    return state["friction_torque"][0]


@given(poses(0.9), vectors(6), st.sampled_from([1e-8, 0.02, 1.0]))
def test_it_is_friction_of_the_cranks_of_the_reference_and_smooth_at_reversals(pose, rate, size):
    rates = pose_jacobian(ROBOT, pose) @ (size * rate)
    dry = SIX + (0.1 - SIX) * np.exp(-((rates / 0.05) ** 2))
    expected = dry * np.tanh(rates / 0.002) + 0.2 * rates
    np.testing.assert_allclose(friction_torque(pose, size * rate), expected, atol=1e-9)
