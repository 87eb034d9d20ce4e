import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from references.laws import check_smooth, simple, six, sums

from stewart_drake.references import (
    AdjustedReference,
    BreathingReference,
    HeartbeatReference,
    HoldReference,
    MinimumJerkReference,
    SumReference,
    center_of,
)

PATH = MinimumJerkReference(poses=((0.0, 0.0, 0.0, 0.0, 0.0, 0.3), (0.1, 0.0, 0.0, 0.02, 0.0, 0.3)), durations=(1.0,))


@given(st.lists(simple, min_size=1, max_size=3), six, st.floats(0.0, 10.0))
def test_a_sum_adds_what_its_parts_are_away_from_their_centres(parts, center, time):
    total = SumReference(parts=tuple(parts), center=center).evaluate(time)
    each = [part.evaluate(time) for part in parts]
    expected = np.array(center) + sum(one[0] - np.array(p.center) for one, p in zip(each, parts, strict=True))
    np.testing.assert_allclose(total[0], expected, atol=1e-12)
    np.testing.assert_allclose(total[1], sum(one[1] for one in each), atol=1e-12)
    np.testing.assert_allclose(total[2], sum(one[2] for one in each), atol=1e-12)


@given(simple | sums, st.floats(0.25, 8.0), st.floats(0.0, 10.0))
def test_slowed_by_k_rates_are_one_kth_and_accelerations_one_k_squared(motion, slowdown, time):
    slow = AdjustedReference(motion=motion, slowdown=slowdown).evaluate(slowdown * time)
    for power, (values, given_values) in enumerate(zip(slow, motion.evaluate(time), strict=True)):
        np.testing.assert_allclose(values, given_values / slowdown**power, atol=1e-9 * 150.0)


@given(simple | sums, st.floats(0.0, 3.0), st.none() | six, st.floats(0.0, 10.0))
def test_scaled_by_s_it_is_s_times_as_far_from_the_centre(motion, scale, center, time):
    reference = AdjustedReference(motion=motion, scale=scale, center=center)
    middle = center_of(motion) if center is None else np.array(center)
    pose, rate, acceleration = reference.evaluate(time)
    given_pose, given_rate, given_acceleration = motion.evaluate(time)
    np.testing.assert_allclose(pose - middle, scale * (given_pose - middle), atol=1e-12)
    np.testing.assert_allclose(rate, scale * given_rate, atol=1e-12)
    np.testing.assert_allclose(acceleration, scale * given_acceleration, atol=1e-12)


@given(simple | sums, st.floats(0.3, 2.0), st.floats(0.5, 2.0))
@settings(max_examples=50)
def test_faded_in_it_starts_at_rest_in_the_centre_and_ends_as_the_motion(motion, fade_in, slowdown):
    reference = AdjustedReference(motion=motion, fade_in=fade_in, slowdown=slowdown)
    pose, rate, acceleration = reference.evaluate(0.0)
    np.testing.assert_allclose(pose, center_of(motion), atol=1e-12)
    np.testing.assert_allclose([rate, acceleration], 0.0, atol=1e-9)
    whole = AdjustedReference(motion=motion, slowdown=slowdown)
    later = fade_in * slowdown + np.array([1e-9, 0.5, 3.0])
    for values, given_values in zip(reference.evaluate(later), whole.evaluate(later), strict=True):
        np.testing.assert_allclose(values, given_values, rtol=1e-9, atol=1e-6)
    check_smooth(reference, [0.0, fade_in * slowdown], jerk=1e5)


def test_the_centre_is_the_motions_own_unless_given():
    breathing = BreathingReference(center=(0.1, 0.0, 0.0, 0.0, 0.0, 0.31))
    whole = SumReference(parts=(breathing, HeartbeatReference()))
    for motion, center in (
        (breathing, breathing.center),
        (whole, breathing.center),
        (SumReference(parts=(breathing,), center=(0.0,) * 6), (0.0,) * 6),
        (AdjustedReference(motion=whole), breathing.center),
        (AdjustedReference(motion=whole, center=(1.0,) * 6), (1.0,) * 6),
        (PATH, PATH.poses[0]),
        (HoldReference(), HoldReference().pose),
    ):
        np.testing.assert_array_equal(center_of(motion), center)
