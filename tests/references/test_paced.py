"""A motion for a machine: from rest, along the path, to rest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.references import SineReference
from stewart_drake.references.paced import RAMP, PacedMotion

MOTION = SineReference(center=(0.0, 0.0, 0.0, 0.0, 0.0, 0.3))
START = MOTION.evaluate(0.0)[0] + [0.1, -0.05, 0.02, 0.01, -0.01, 0.02]


def paced(approach=2.0, stop=None):
    made = PacedMotion(MOTION, START, approach)
    if stop is not None:
        made.stop(stop)
    return made


@given(stop=st.one_of(st.none(), st.floats(0.0, 8.0)), approach=st.floats(0.5, 3.0))
def test_rates_and_accelerations_are_derivatives(stop, approach):
    h, made = 1e-6, paced(approach, stop)
    times = np.linspace(0.013, 9.0, 173)
    _, rate, acceleration = made.evaluate(times)
    before, after = made.evaluate(times - h), made.evaluate(times + h)
    np.testing.assert_allclose((after[0] - before[0]) / (2.0 * h), rate, atol=2e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2.0 * h), acceleration, atol=2e-4)


def test_it_begins_at_rest_at_the_pose_of_the_robot_and_goes_on_as_the_motion():
    made = paced()
    pose, rate, acceleration = made.evaluate(0.0)
    np.testing.assert_allclose(pose, START)
    assert not rate.any()
    assert not acceleration.any()
    np.testing.assert_allclose(made.evaluate(2.0)[0], MOTION.evaluate(0.0)[0], atol=1e-12)
    late = np.linspace(2.0 + RAMP, 9.0, 50)
    for mine, its in zip(made.evaluate(late), MOTION.evaluate(late - 2.0 - 0.5 * RAMP), strict=True):
        np.testing.assert_allclose(mine, its, atol=1e-12)


@pytest.mark.parametrize("stop", [0.7, 2.3, 5.0])
def test_a_stop_leaves_what_was_before_it_and_rests_on_the_path(stop):
    free, made = paced(), paced(stop=stop)
    before = np.linspace(0.0, stop, 40)
    np.testing.assert_array_equal(made.evaluate(before)[0], free.evaluate(before)[0])
    pose, rate, acceleration = made.evaluate(np.array([stop + RAMP, stop + RAMP + 5.0]))
    assert np.abs([rate, acceleration]).max() < 1e-12
    np.testing.assert_allclose(pose[0], pose[1])
    np.testing.assert_allclose(pose[0], free.evaluate(stop + 0.5 * RAMP)[0], atol=1e-12)
    assert made.rests == pytest.approx(stop + RAMP)
    made.stop(stop + 1.0)
    assert made.rests == pytest.approx(stop + RAMP)


def test_it_follows_the_motion_for_as_long_as_was_asked():
    made = paced()
    end = made.duration(3.0)
    made.stop(end - RAMP)
    np.testing.assert_allclose(made.evaluate(end)[0], MOTION.evaluate(3.0)[0], atol=1e-12)
