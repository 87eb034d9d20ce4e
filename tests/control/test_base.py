"""What all controllers share: the tracking error of the loop."""

import numpy as np
from strategies import ROBOT
from ticks import REST

from stewart_drake.control.base import TRACKING_ERROR

HOME = np.array(ROBOT.home_pose)


def test_the_error_is_measured_minus_wanted_and_stays_where_one_is_no_number():
    state, reference = TRACKING_ERROR.initial.copy(), np.concatenate([HOME - 0.01, np.ones(12)])
    TRACKING_ERROR.tick(np.concatenate([HOME, REST]), reference, state)
    np.testing.assert_allclose(state["error"][0], 0.01)
    for bad in (np.nan, np.inf):
        TRACKING_ERROR.tick(np.full(12, bad), reference, state)
        TRACKING_ERROR.tick(np.concatenate([HOME, REST]), np.full(18, bad), state)
        np.testing.assert_allclose(state["error"][0], 0.01)
