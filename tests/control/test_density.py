import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stewart_drake.control.network import MEAN_FLOOR, density, density_part
from stewart_drake.errors import ConfigurationError

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


@pytest.mark.parametrize("kind", ["magnitude", "signed"])
def test_a_window_at_rest_has_density_one_from_the_floor_down(kind):
    np.testing.assert_array_equal(density(np.zeros((5, 2)), kind), [1.0, 1.0])
    samples = np.array([[0.0, 0.0], [0.0, 0.0], [3.03e-9, 2.97e-9]])
    np.testing.assert_allclose(density(samples, kind), [3.0, 1.0])


@given(
    st.integers(1, 6), st.lists(st.floats(-10, 10), min_size=1, max_size=20), st.sampled_from(["magnitude", "signed"])
)
def test_a_part_has_the_density_of_the_latest_samples(window, history, kind):
    part = density_part(window, kind)
    state = part.initial.copy()
    np.testing.assert_array_equal(state["density"][0], np.ones(12))
    for value in history:
        part.tick(np.full(6, value), np.full(6, 1.0 - value), state)
    latest = np.array(history[-(window + 1) :])[:, None]
    expected = density(np.hstack([np.tile(latest, 6), np.tile(1.0 - latest, 6)]), kind)
    np.testing.assert_allclose(state["density"][0], expected, rtol=1e-12)


def test_another_kind_and_no_window_are_refused():
    for refused in (lambda: density(np.ones((3, 2)), "loud"), lambda: density_part(4, "loud")):
        with pytest.raises(ConfigurationError, match="magnitude or signed"):
            refused()
    with pytest.raises(ConfigurationError, match="at least 1"):
        density_part(0, "signed")
