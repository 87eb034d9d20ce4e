import numpy as np
import pytest
from hypothesis import given, settings
from strategies import ROBOT, poses, vectors
from ticks import GRAVITY, REST, standing, ticked

from stewart_drake.control.base import Setpoint
from stewart_drake.control.computed_torque import ComputedTorqueOptions, computed_torque_part
from stewart_drake.control.lqi import LqiOptions, lqi_gain
from stewart_drake.control.riccati import INTEGRAL, POSITION, RATE
from stewart_drake.errors import NotFiniteError
from stewart_drake.mechanics.dynamics import forward_dynamics, pose_acceleration_map

HOME = np.array(ROBOT.home_pose)


def tick(pose, rate, setpoint, integral=REST, **options):
    part = computed_torque_part(ComputedTorqueOptions(**options), ROBOT, GRAVITY)
    return ticked(part, pose, rate, setpoint, integral=integral)


@settings(max_examples=40)
@given(poses(0.6), vectors(6, 0.3), vectors(6, 0.02), vectors(6, 1.0), vectors(6, 0.01))
def test_the_robot_accelerates_as_the_linear_loop_says(pose, rate, away, wanted_acceleration, integral):
    options = {"natural_frequency": 30.0, "damping": 0.7, "integral_frequency": 4.0, "saturation": "none"}
    got = tick(pose, rate, Setpoint(pose + away, 0.5 * rate, wanted_acceleration), integral, **options)
    expected = wanted_acceleration - 2.0 * 0.7 * 30.0 * 0.5 * rate - 900.0 * (-away + 4.0 * integral)
    np.testing.assert_allclose(forward_dynamics(ROBOT, pose, rate, got.torque, GRAVITY), expected, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(got.error, -away, atol=1e-15)
    np.testing.assert_allclose(got.integral, integral - 0.001 * away, atol=1e-15)


def test_clamped_torque_stops_the_integral():
    at = HOME + [0, 0, 0, 0, 0, -0.02], REST, standing(HOME)
    got = tick(*at, natural_frequency=300.0)
    assert np.abs(got.torque).max() == ROBOT.effort_limit
    np.testing.assert_array_equal(got.integral, REST)
    got = tick(*at, natural_frequency=300.0, saturation="none")
    assert np.abs(got.torque).max() > ROBOT.effort_limit
    assert got.integral[5] == pytest.approx(-2e-5)


def test_the_default_loop_is_that_of_the_exact_lqi_on_heave_at_home():
    options = LqiOptions(period=0.001, model="exact", solver="split", weight_length=0.11)
    gain_map = pose_acceleration_map(ROBOT, HOME)
    feedback = gain_map @ lqi_gain(gain_map, options, np.array([4e5, 30.0, 4e7, 1.0]))
    stiffness, damping, integral = (feedback[5, part][5] for part in (POSITION, RATE, INTEGRAL))
    mine = ComputedTorqueOptions()
    omega = np.sqrt(stiffness)
    np.testing.assert_allclose(
        [mine.natural_frequency, mine.damping, mine.integral_frequency],
        [omega, damping / (2.0 * omega), integral / stiffness],
        rtol=2e-3,
    )


@pytest.mark.parametrize("place", ["pose", "rate", "reference"])
def test_numbers_that_are_not_finite_end_the_run(place):
    bad = np.full(6, np.inf)
    given_ = {"pose": HOME, "rate": REST, "reference": HOME} | {place: bad}
    with pytest.raises(NotFiniteError, match={"reference": "torque"}.get(place, place)), np.errstate(all="ignore"):
        tick(given_["pose"], given_["rate"], standing(given_["reference"]))
