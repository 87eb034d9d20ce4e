import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stewart_drake.compiled.constants import MEAN_FLOOR
from stewart_drake.control.density import density, push
from stewart_drake.errors import ConfigurationError

KINDS = ["magnitude", "signed"]
# Away from the floor: zero itself, or a size at which a mean of one sample in fifty is still far above it.
sizes = st.one_of(st.just(0.0), st.floats(1e-3, 1e6))
signals = st.builds(lambda size, sign: size * sign, sizes, st.sampled_from([-1.0, 1.0]))
windows = st.integers(1, 30).flatmap(lambda n: arrays(float, (n, 2), elements=signals))
some = settings(max_examples=50)


@some
@given(windows)
def test_magnitude_is_the_last_sample_over_the_mean_of_magnitudes(window):
    n = len(window)
    result = density(window, "magnitude")
    for column, value in zip(window.T, result, strict=True):
        total = sum(abs(x) for x in column)
        expected = n * abs(column[-1]) / total if total > 0.0 else 1.0
        assert value == pytest.approx(expected, rel=1e-12)


@some
@given(windows)
def test_signed_is_the_print_35_wherever_that_stays_within_the_window_length(window):
    n = len(window)
    result = density(window, "signed")
    for column, value in zip(window.T, result, strict=True):
        total = sum(column)
        if abs(total / n) < MEAN_FLOOR:
            assert value == 1.0
        elif abs(n * column[-1]) < 0.999 * n * abs(total):
            # (m + 1) x(t) = rho(t) * sum, without a division; where terms cancel, the sum is good to their size only.
            slack = 1e-12 * sum(abs(x) for x in column) * max(1.0, abs(value))
            assert value * total == pytest.approx(n * column[-1], abs=slack)


@some
@given(windows, st.sampled_from(KINDS))
def test_density_never_leaves_its_bounds(window, kind):
    result = density(window, kind)
    assert np.all(np.abs(result) <= len(window))
    if kind == "magnitude":
        assert np.all(result >= 0.0)


@some
@given(windows, st.integers(-4, 20), st.sampled_from(KINDS))
def test_density_has_no_unit(window, power, kind):
    # A power of two scales without rounding, so the law holds to the bit; the smallest sample stays above the floor.
    np.testing.assert_array_equal(density(2.0**power * window, kind), density(window, kind))


@some
@given(windows)
def test_kinds_agree_on_a_signal_that_never_changes_sign(window):
    np.testing.assert_array_equal(density(np.abs(window), "signed"), density(np.abs(window), "magnitude"))


@some
@given(windows, st.randoms(use_true_random=False), st.sampled_from(KINDS))
def test_order_of_the_past_does_not_matter(window, random, kind):
    past = list(window[:-1])
    random.shuffle(past)
    shuffled = np.array([*past, window[-1]])
    scale = np.abs(window).sum(axis=0) / np.maximum(np.abs(window.sum(axis=0)), 1e-300)
    well = scale < 1e6  # where the signed sum cancels, its last digits depend on the order
    np.testing.assert_allclose(density(shuffled, kind)[well], density(window, kind)[well], rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [1, 2, 50])
def test_a_constant_stands_out_by_one_and_a_spike_by_the_window_length(kind, n):
    np.testing.assert_allclose(density(np.full((n, 1), -0.3), kind), [1.0])
    spike = np.zeros((n, 1))
    spike[-1] = 7.0
    np.testing.assert_allclose(density(spike, kind), [n])


@pytest.mark.parametrize("kind", KINDS)
def test_a_window_at_rest_has_density_one_and_the_floor_is_relative_to_the_scale(kind):
    np.testing.assert_array_equal(density(np.zeros((5, 2)), kind), [1.0, 1.0])
    sample = np.array([[0.0], [0.0], [3e-9]])
    assert density(sample, kind, scale=0.99)[0] == pytest.approx(3.0)  # mean 1e-9 is above the floor
    assert density(sample, kind, scale=1.01)[0] == 1.0  # and below it
    both = density(np.repeat(sample, 2, axis=1), kind, scale=np.array([0.99, 1.01]))
    np.testing.assert_allclose(both, [3.0, 1.0])


def test_signed_is_held_where_its_sum_crosses_zero_and_keeps_its_sign():
    base = np.array([1.0, -2.0, 1.0])
    above = density((base + [0.0, 0.0, 1e-6])[:, None], "signed")
    below = density((base - [0.0, 0.0, 1e-6])[:, None], "signed")
    assert (above[0], below[0]) == (3.0, -3.0)


@given(st.integers(1, 6), st.lists(st.floats(-10, 10), min_size=0, max_size=20))
def test_a_window_holds_the_latest_samples_oldest_first(length, history):
    window, count = np.zeros((length, 2)), 0
    for value in history:
        before = window.copy()
        new, count = push(window, count, np.array([value, -value]))
        np.testing.assert_array_equal(window, before)  # the caller's window is not written to
        window = new
    latest = history[-length:]
    assert count == len(latest)
    np.testing.assert_array_equal(window[length - count :, 0], latest)
    np.testing.assert_array_equal(window[length - count :, 1], [-v for v in latest])


def test_another_kind_is_refused():
    with pytest.raises(ConfigurationError, match="magnitude or signed"):
        density(np.ones((3, 2)), "loud")
