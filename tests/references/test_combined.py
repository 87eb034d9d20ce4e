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


@given(st.lists(simple, min_size=1, max_size=3), six, st.floats(0.0, 10.0))
def test_a_sum_adds_what_its_parts_are_away_from_their_centres(parts, center, time):
    total = SumReference(parts=tuple(parts), center=center).evaluate(time)
    expected = sum(np.array(part.evaluate(time)) for part in parts)
    expected[0] += np.array(center) - sum(np.array(part.center) for part in parts)
    np.testing.assert_allclose(total, expected, atol=1e-12)


@given(simple | sums, st.floats(0.0, 3.0), st.none() | six, st.floats(0.0, 10.0))
def test_scaled_by_s_it_is_s_times_as_far_from_the_centre(motion, scale, center, time):
    found = AdjustedReference(motion=motion, scale=scale, center=center).evaluate(time)
    middle = center_of(motion) if center is None else np.array(center)
    pose, rate, acceleration = motion.evaluate(time)
    expected = middle + scale * (pose - middle), scale * rate, scale * acceleration
    np.testing.assert_allclose(found, expected, atol=1e-12)


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
    path = MinimumJerkReference(poses=((0.0,) * 6, (0.1,) * 6), durations=(1.0,))
    for motion, center in (
        (whole, breathing.center),
        (AdjustedReference(motion=whole), breathing.center),
        (AdjustedReference(motion=whole, center=(1.0,) * 6), (1.0,) * 6),
        (path, path.poses[0]),
        (HoldReference(), HoldReference().pose),
    ):
        np.testing.assert_array_equal(center_of(motion), center)
