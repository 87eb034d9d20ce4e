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


@settings(max_examples=50)
@given(windows)
def test_density_is_the_last_sample_over_the_mean_of_the_window(window):
    # (35): of magnitudes, or signed and then within the window's length.
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
            assert signed * total == pytest.approx(n * last, abs=1e-12 * n * size * max(1.0, abs(signed)))


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


@pytest.mark.parametrize(("window", "kind", "words"), [(4, "loud", "magnitude or signed"), (0, "signed", "at least 1")])
def test_another_kind_and_no_window_are_refused(window, kind, words):
    with pytest.raises(ConfigurationError, match=words):
        density_part(window, kind)
