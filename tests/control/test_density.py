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
def test_density_is_the_last_sample_over_the_mean_of_the_window(window):
    """(35): of magnitudes, or signed and then within the window's length, its sign kept where the sum vanishes."""
    n = len(window)
    for column, magnitude, signed in zip(
        window.T, density(window, "magnitude"), density(window, "signed"), strict=True
    ):
        size, total, last = sum(abs(x) for x in column), sum(column), column[-1]
        assert magnitude == pytest.approx(n * abs(last) / size if size > 0.0 else 1.0, rel=1e-12)
        assert abs(signed) <= n
        if abs(total / n) < MEAN_FLOOR:
            assert signed == 1.0
        elif abs(last) < 0.999 * abs(total):
            # Without a division; where terms cancel, the sum is good to their size only.
            slack = 1e-12 * size * max(1.0, abs(signed))
            assert signed * total == pytest.approx(n * last, abs=n * slack)
    base = np.array([1.0, -2.0, 1.0])
    assert [density((base + [0.0, 0.0, x])[:, None], "signed")[0] for x in (1e-6, -1e-6)] == [3.0, -3.0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_window_at_rest_has_density_one_and_the_floor_is_relative_to_the_scale(kind):
    np.testing.assert_array_equal(density(np.zeros((5, 2)), kind), [1.0, 1.0])
    sample = np.array([[0.0], [0.0], [3e-9]])
    assert density(sample, kind, scale=0.99)[0] == pytest.approx(3.0)  # mean 1e-9 is above the floor
    assert density(sample, kind, scale=1.01)[0] == 1.0  # and below it
    both = density(np.repeat(sample, 2, axis=1), kind, scale=np.array([0.99, 1.01]))
    np.testing.assert_allclose(both, [3.0, 1.0])


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
