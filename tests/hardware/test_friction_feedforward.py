import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors

from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.friction_feedforward import FrictionCompensation, friction_part
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.scenario import Scenario

SIX = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
OPTIONS = FrictionCompensation(coulomb=tuple(SIX), break_away=0.1, stribeck_velocity=0.05, viscous=0.2)


def torque(pose, rate, options=OPTIONS):
    part = friction_part(ROBOT, options)
    state = part.initial.copy()
    state["against_friction"] = np.nan
    part.tick(np.concatenate([pose, rate, np.zeros(6)]), state)
    return state["against_friction"][0]


@given(poses(0.9), vectors(6), st.sampled_from([1e-8, 0.02, 1.0]))
def test_it_is_friction_of_the_cranks_of_the_reference_turned_round_and_smooth_at_reversals(pose, rate, size):
    rates = pose_jacobian(ROBOT, pose) @ (size * rate)
    dry = SIX + (0.1 - SIX) * np.exp(-((rates / 0.05) ** 2))
    np.testing.assert_allclose(torque(pose, size * rate), dry * np.tanh(rates / 0.002) + 0.2 * rates, atol=1e-9)
    np.testing.assert_allclose(torque(pose, -size * rate), -torque(pose, size * rate))


def test_a_reference_out_of_reach_asks_for_nothing():
    np.testing.assert_array_equal(torque(ROBOT.home_pose + [0, 0, 0, 0, 0, 1.0], np.ones(6)), np.zeros(6))


def test_break_away_below_coulomb_is_refused():
    with pytest.raises(ConfigurationError, match=r"friction_compensation\.break_away"):
        Scenario(friction_compensation={"coulomb": 0.1, "break_away": 0.05})
