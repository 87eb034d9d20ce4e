import numpy as np
from conftest import make_network
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import vectors

from stewart_drake.compiled.tuner import density_tick
from stewart_drake.control.density import density, push


@settings(max_examples=40)
@given(
    st.integers(1, 6), st.integers(1, 12), st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([1.0, 1e-12, 0.0])
)
def test_densities_of_a_window_that_fills_and_slides(window, ticks, seed, signed, scale):
    rng = np.random.default_rng(seed)
    memory = np.concatenate([np.ones(12), [0.0], np.zeros((window + 1) * 12)])
    rows, filled = np.zeros((window + 1, 12)), 0
    for _ in range(ticks):
        sample = scale * rng.normal(size=12)
        rows, filled = push(rows, filled, sample)
        result = np.empty_like(memory)
        density_tick(memory, sample[:6], sample[6:], signed, result)
        expected = density(rows[-filled:], "signed" if signed else "magnitude")
        np.testing.assert_allclose(result[:12], expected, rtol=1e-9, atol=1e-12)
        assert result[12] == filled
        np.testing.assert_array_equal(result[13:].reshape(-1, 12)[-filled:], rows[-filled:])
        memory = result


@settings(max_examples=60)
@given(vectors(12, 60.0), st.integers(0, 5), st.sampled_from([1.0, 20.0]))
def test_the_networks_weights(features, seed, gain):
    network = make_network(seed, gain=gain)
    fast, expected = network.compiled_weights()(features), network.weights(features)
    np.testing.assert_allclose(fast, expected, rtol=1e-10)
    assert (fast >= network.omega_min).all()
    assert (fast <= network.omega_max).all()
