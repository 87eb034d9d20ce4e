"""What all controllers share: the tracking error of the loop, and the torque limit with anti-windup."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from setups import setup_for
from strategies import ROBOT, vectors
from ticks import REST, standing, ticked

from stewart_drake.control.base import TRACKING_ERROR
from stewart_drake.control.classical import ComputedTorqueOptions
from stewart_drake.control.lqi import LqiOptions

HOME = np.array(ROBOT.home_pose)
LQI = {"period": 0.001, "model": "exact", "weight_length": 0.11, "solver": "split"}
LIMITED = [
    (ComputedTorqueOptions, {"natural_frequency": 300.0}, "clamp"),
    (LqiOptions, LQI, "clamp"),
    (LqiOptions, LQI, "back_calculation"),
]
WEIGHTS = np.array([4.0e7, 300.0, 4.0e9, 1.0])


def test_the_error_is_measured_minus_wanted_and_stays_where_one_is_no_number():
    state, reference = TRACKING_ERROR.initial.copy(), np.concatenate([HOME - 0.01, np.ones(12)])
    TRACKING_ERROR.tick(np.concatenate([HOME, REST]), reference, state)
    np.testing.assert_allclose(state["error"][0], 0.01)
    for bad in (np.nan, np.inf):
        TRACKING_ERROR.tick(np.full(12, bad), reference, state)
        TRACKING_ERROR.tick(np.concatenate([HOME, REST]), np.full(18, bad), state)
        np.testing.assert_allclose(state["error"][0], 0.01)


@settings(max_examples=20)
@given(vectors(6, 0.03), st.sampled_from(LIMITED))
def test_no_torque_exceeds_the_limit_and_an_integral_at_it_grows_less_than_without_a_limit(error, case):
    kind, options, saturation = case

    def tick(saturation):
        (part,) = kind(**options, saturation=saturation).parts(setup_for())
        more = [WEIGHTS] * ("weights" in part.inputs)
        if more:
            part = part._replace(inputs={**part.inputs, "weights": 4})
        return ticked(part, HOME, REST, standing(HOME - error), *more)

    limited, free = tick(saturation), tick("none")
    np.testing.assert_allclose(limited.torque, np.clip(free.torque, -ROBOT.effort_limit, ROBOT.effort_limit))
    if (limited.torque == free.torque).all():
        np.testing.assert_array_equal(limited.integral, free.integral)
    elif saturation == "clamp":
        assert (np.abs(limited.integral) <= np.abs(free.integral)).all()
        assert not np.array_equal(limited.integral, free.integral)
