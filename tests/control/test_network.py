import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import make_network, resealed
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import vectors

from stewart_drake.base.errors import ConfigurationError, NotFiniteError
from stewart_drake.control.features import MEAN_FLOOR, density, density_part
from stewart_drake.control.network import TunerNetwork, load_network, network_part

finite = st.floats(allow_nan=False, allow_infinity=False)


@given(vectors(12, 50.0), st.integers(0, 20))
def test_the_answer_is_ten_to_the_output_of_two_layers(densities, seed):
    network = make_network(seed)
    scaled = (densities - network.input_mean) / network.input_scale
    hidden = np.tanh(network.hidden_weights @ scaled + network.hidden_bias)
    log = network.output_weights @ hidden + network.output_bias
    np.testing.assert_allclose(network.log_weights(densities), log, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(network.weights(densities), np.clip(10.0**log, 0.1, 10.0), rtol=1e-12)
    batch = np.stack([densities, -densities])[:, None]
    np.testing.assert_array_equal(network.weights(batch)[0, 0], network.weights(densities))


def test_what_a_part_finds_is_within_range_and_a_density_that_is_none_ends_the_run(network):
    part = network_part(network, (99.0, 1e-6))
    state = part.initial.copy()
    np.testing.assert_array_equal(state["weights"][0], [10.0, 0.1])
    part.tick(np.full(12, 1.5), state)
    np.testing.assert_array_equal(state["weights"][0], network.weights(np.full(12, 1.5)))
    for bad in (np.nan, np.inf):
        with pytest.raises(NotFiniteError, match="density"):
            part.tick(np.where(np.arange(12) == 3, bad, 1.0), state)


@given(
    arrays(float, 12, elements=finite | st.sampled_from([np.inf, -np.inf])),
    st.floats(0.0, 1e40),
    st.sampled_from([1e-90, 1e-9, 0.5, 1e90]),
    st.floats(1e-99, 1e99),
    st.floats(1.0, 1e6),
)
def test_weights_never_leave_the_trained_range_whatever_comes_in(densities, gain, scale, smallest, width):
    base = make_network(3)
    layers = ("hidden_weights", "hidden_bias", "output_weights", "output_bias")
    network = TunerNetwork(
        input_mean=base.input_mean,
        input_scale=np.full(12, scale),
        **{name: gain * getattr(base, name) for name in layers},
        omega_min=np.full(2, smallest),
        omega_max=np.full(2, min(smallest * width, 9e99)),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer = network.weights(densities)
    assert np.all((answer >= network.omega_min) & (answer <= network.omega_max))


def test_a_saved_network_comes_back_whole_or_is_refused(tmp_path, network):
    path = tmp_path / "net.json"
    network.save(path)
    twin = load_network(path)
    assert twin.to_bytes() == network.to_bytes() == path.read_bytes()
    assert (twin.density, twin.window, twin.provenance) == (network.density, network.window, network.provenance)
    path.write_text(json.dumps(json.loads(network.to_bytes()) | {"window": 48}))
    with pytest.raises(ConfigurationError, match="checksum"):
        load_network(path)


BAD = [
    ("version", "2"),
    ("density", "relative"),
    ("window", 0),
    ("provenance", None),
    ("input_scale", [0.0] + [1.0] * 11),
    ("omega_min", [0.1, 10.5]),
    ("hidden_bias", [0.0] * 9),
    ("output_weights", [[1e101] * 10] * 2),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_a_wrong_value_is_refused_under_its_key_in_a_file_and_in_python(tmp_path, network, name, value):
    path = tmp_path / "net.json"
    path.write_bytes(resealed(json.loads(network.to_bytes()) | {name: value}))
    with pytest.raises(ConfigurationError) as caught:
        load_network(path)
    assert caught.value.key.endswith(name)
    if name not in ("version", "provenance"):
        with pytest.raises(ConfigurationError, match=name):
            replace(network, **{name: value})


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
