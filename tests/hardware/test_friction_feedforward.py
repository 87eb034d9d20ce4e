import numpy as np
import pytest
from hypothesis import given
from strategies import ROBOT, poses, vectors

from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.friction_feedforward import FrictionCompensation, feedforward, flat_feedforward
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.scenario import Scenario

SIX = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
OPTIONS = FrictionCompensation(coulomb=SIX, break_away=0.1, stribeck_velocity=0.05, viscous=0.2)


@given(vectors(6, 3.0))
def test_it_is_friction_turned_round_and_smooth_at_reversals(rates):
    torque = OPTIONS.torque(rates)
    np.testing.assert_allclose(OPTIONS.torque(-rates), -torque)
    fast = np.abs(rates) > 0.3
    np.testing.assert_allclose(torque[fast], (np.sign(rates) * SIX + 0.2 * rates)[fast], atol=1e-9)
    near = 1e-7 * rates
    np.testing.assert_allclose(OPTIONS.torque(near), (0.1 / OPTIONS.width + 0.2) * near, rtol=1e-6, atol=1e-18)


@given(poses(0.9), vectors(6, 0.5))
def test_it_follows_the_cranks_of_the_reference(pose, rate):
    reference = np.concatenate([pose, rate, np.zeros(6)])
    torque = feedforward(ROBOT, OPTIONS, reference)
    np.testing.assert_allclose(torque, OPTIONS.torque(pose_jacobian(ROBOT, pose) @ rate), atol=1e-9)
    np.testing.assert_allclose(flat_feedforward(ROBOT, OPTIONS, True)(reference), torque, atol=1e-12)


@pytest.mark.parametrize("compiled", [False, True])
def test_a_reference_out_of_reach_asks_for_nothing(compiled):
    reference = np.concatenate([ROBOT.home_pose + [0, 0, 0, 0, 0, 1.0], np.ones(12)])
    np.testing.assert_array_equal(flat_feedforward(ROBOT, OPTIONS, compiled)(reference), np.zeros(6))


def test_break_away_below_coulomb_is_refused():
    with pytest.raises(ConfigurationError, match=r"friction_compensation\.break_away"):
        Scenario(friction_compensation={"coulomb": 0.1, "break_away": 0.05})
