import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from references.laws import bursts, check_smooth, ends, moves, splines

from stewart_drake.references import MinimumJerkReference, SplineReference


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


def test_dwell_is_the_rest_before_a_move():
    poses = ((0.0,) * 6, (1.0,) * 6, (0.0,) * 6)
    reference = MinimumJerkReference(poses=poses, durations=(1.0, 2.0), dwell=(0.5, 0.25))
    moving = np.abs(reference.evaluate(np.array([0.2, 0.49, 1.0, 1.6, 2.0, 3.7, 3.8]))[1]).max(axis=-1) > 0.0
    assert moving.tolist() == [False, False, True, False, True, True, False]


@given(splines)
@settings(max_examples=50)
def test_a_spline_goes_through_its_poses(reference):
    np.testing.assert_allclose(reference.evaluate(np.array(reference.times))[0], reference.poses, atol=1e-8)


def test_a_spline_of_two_poses_is_the_minimum_jerk_move():
    poses = ((0.0,) * 6, (0.3, -0.2, 0.1, 0.05, 0.0, 0.31))
    times = np.linspace(-0.5, 3.0, 60)
    spline = SplineReference(times=(0.0, 2.0), poses=poses).evaluate(times)
    move = MinimumJerkReference(poses=poses, durations=(2.0,)).evaluate(times)
    for one, other in zip(spline, move, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
