import math

import numpy as np
import pytest
from conftest import field_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from references.laws import KINDS, bursts, check_derivatives, check_smooth, ends, moves, simple, six, splines, sums

from stewart_drake import ConfigurationError, Scenario, paper_reference
from stewart_drake.references import (
    AdjustedReference,
    HeartbeatReference,
    MinimumJerkReference,
    SineBurstsReference,
    SplineReference,
    SumReference,
    TremorReference,
    center_of,
)

CENTER = (0.1, -0.05, 0.2, 0.01, -0.02, 0.3)


@pytest.mark.parametrize("motions", KINDS.values(), ids=KINDS.keys())
@settings(max_examples=30)
@given(st.data(), st.floats(-0.1, 1.1))
def test_rates_and_accelerations_are_the_derivatives_of_the_pose(motions, data, share):
    reference = data.draw(motions)
    end = ends(reference).max()
    time = share * (end if 0.0 < end < math.inf else 20.0)
    assume(np.abs(ends(reference) - time).min() > 3e-4)
    check_derivatives(reference, time)


@given(st.floats(0.0, 20.0))
def test_the_papers_reference_is_37_and_38(time):
    pose, rate, _ = paper_reference().evaluate(time)
    np.testing.assert_allclose(pose[0], math.pi / 6.0 * math.sin(2.0 * time), atol=1e-15)
    np.testing.assert_allclose(pose[5], 0.05 * math.sin(2.0 * time) + 0.3, atol=1e-15)
    assert not pose[1:5].any()
    _, start, _ = paper_reference().evaluate(0.0)
    np.testing.assert_allclose(start, [math.pi / 3.0, 0, 0, 0, 0, 0.1])
    assert np.all(np.abs(rate) <= np.abs(start))


# What a field alone takes is asked of every section by tests/base/test_config.py; here are rules between fields.
TWO = ((0.0,) * 6, (1.0,) * 6)
BURSTS = {"frequency": (1.0, 2.0), "amplitude": (CENTER, CENTER)}
REFUSED = [
    (SineBurstsReference, BURSTS | {"frequency": (1.0,)}, "amplitude"),
    (SineBurstsReference, BURSTS | {"fade": 0.81}, "burst_duration"),
    (MinimumJerkReference, {"poses": TWO, "durations": (1.0, 1.0)}, "durations"),
    (SplineReference, {"poses": TWO, "times": (0.0, 0.0)}, "times"),
    (HeartbeatReference, {"harmonics": (1.0, 0.5)}, "harmonic_phase"),
    (HeartbeatReference, {"slow_variation": 0.5, "respiratory_variation": 0.5}, "slow_variation"),
    (TremorReference, {"high": 6.0}, "high"),
]


@pytest.mark.parametrize(("kind", "keys", "key"), REFUSED)
def test_what_makes_no_sense_is_refused_by_name(kind, keys, key):
    with pytest.raises(ConfigurationError) as caught:
        kind(**keys)
    assert field_of(caught.value) == f"reference.{key}"


def test_a_function_of_the_pose_alone_is_a_motion_with_rates_by_differences():
    def wave(t):
        return np.array(CENTER) + [0.1 * np.sin(2.0 * t), 0.0, 0.0, 0.0, 0.0, 0.01 * np.cos(3.0 * t)]

    times = np.linspace(0.0, 1.0, 7)
    reference = Scenario(reference=wave).reference
    pose, rate, acceleration = reference.evaluate(times)
    assert "differences" in reference.note
    np.testing.assert_allclose(pose[:, 0], 0.1 + 0.1 * np.sin(2.0 * times), atol=1e-15)
    np.testing.assert_allclose(rate[:, 0], 0.2 * np.cos(2.0 * times), atol=1e-7)
    np.testing.assert_allclose(acceleration[:, 5], -0.09 * np.cos(3.0 * times), atol=1e-5)


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


@given(bursts | moves | splines)
@settings(max_examples=50)
def test_pose_rate_and_acceleration_are_continuous_where_pieces_end(reference):
    # 60 / T^3 times the largest step for a move; a spline through random poses may be some times as jerky.
    jerk = 2.0 * 60.0 / 0.3**3
    # By the product rule, with the largest derivatives of the fade: 1.875, 5.774 and 60.
    burst = 60.0 / 0.1**3 + 3.0 * 31.5 * 5.774 / 0.1**2 + 3.0 * 31.5**2 * 1.875 / 0.1 + 31.5**3
    bounds = {"minimum_jerk": jerk, "spline": 20.0 * jerk, "sine_bursts": burst}
    check_smooth(reference, ends(reference), bounds[reference.kind])


@given(moves | splines, st.floats(0.0, 1e6))
@settings(max_examples=50)
def test_it_rests_at_the_first_pose_before_and_at_the_last_after(reference, away):
    first = 0.0 if isinstance(reference, MinimumJerkReference) else reference.times[0]
    for time, pose in ((first - away, reference.poses[0]), (ends(reference)[-1] + away, reference.poses[-1])):
        here, rate, acceleration = reference.evaluate(time)
        np.testing.assert_allclose(here, pose, atol=1e-9)
        np.testing.assert_allclose(rate, 0.0, atol=1e-7)
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-5)


@given(moves)
@settings(max_examples=50)
def test_moves_start_and_end_at_rest_in_their_poses_and_go_straight(reference):
    times = ends(reference)
    for index, last in enumerate(reference.durations):
        end = times[2 * index + 1]
        start = end - last
        (begun, halfway, done), rates, _ = reference.evaluate(np.array([start, start + 0.5 * last, end]))
        first, second = np.array(reference.poses[index]), np.array(reference.poses[index + 1])
        np.testing.assert_allclose(begun, first, atol=1e-9)
        np.testing.assert_allclose(halfway, 0.5 * (first + second), atol=1e-9)
        np.testing.assert_allclose(done, second, atol=1e-9)
        # The peak of a minimum-jerk speed is 15/8 of its mean.
        np.testing.assert_allclose(rates[1], 1.875 * (second - first) / last, atol=1e-9)
        np.testing.assert_allclose(rates[[0, 2]], 0.0, atol=1e-9)


@given(splines)
@settings(max_examples=50)
def test_a_spline_goes_through_its_poses(reference):
    np.testing.assert_allclose(reference.evaluate(np.array(reference.times))[0], reference.poses, atol=1e-8)
