import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from conftest import make_network, python, resealed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import vectors

from stewart_drake.control.network import FORMAT, TunerNetwork, default_network_path, load_network
from stewart_drake.errors import ConfigurationError

ARRAYS = {
    "input_mean": (12,),
    "input_scale": (12,),
    "hidden_weights": (10, 12),
    "hidden_bias": (10,),
    "output_weights": (2, 10),
    "output_bias": (2,),
    "omega_min": (2,),
    "omega_max": (2,),
}
finite = st.floats(allow_nan=False, allow_infinity=False)
reuse_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(network, path):
    network.save(path)
    return json.loads(path.read_text())


# --- forward -------------------------------------------------------------------------------------------------------


@given(vectors(12, 50.0), st.integers(0, 20))
def test_inference_is_torchs_forward_of_the_same_weights(densities, seed):
    network = make_network(seed)
    model = torch.nn.Sequential(torch.nn.Linear(12, 10), torch.nn.Tanh(), torch.nn.Linear(10, 2)).double()
    names = ("hidden_weights", "hidden_bias", "output_weights", "output_bias")
    with torch.no_grad():
        for parameter, name in zip(model.parameters(), names, strict=True):
            parameter.copy_(torch.from_numpy(getattr(network, name)))
        scaled = (torch.from_numpy(densities) - torch.from_numpy(network.input_mean)) / torch.from_numpy(
            network.input_scale
        )
        expected = model(scaled).numpy()
    np.testing.assert_allclose(network.log_weights(densities), expected, rtol=1e-12, atol=1e-12)
    inside = np.clip(10.0**expected, 0.1, 10.0)
    np.testing.assert_allclose(network.weights(densities), inside, rtol=1e-12)


def test_a_batch_gives_what_its_rows_give(network):
    batch = np.random.default_rng(1).uniform(0.0, 5.0, (3, 4, 12))
    together = network.weights(batch)
    assert together.shape == (3, 4, 2)
    for index in np.ndindex(3, 4):
        np.testing.assert_allclose(together[index], network.weights(batch[index]), rtol=1e-13)


def test_limits_bind_on_both_sides_and_are_met_exactly():
    network = make_network(gain=50.0)
    answers = network.weights(np.random.default_rng(2).uniform(-3.0, 3.0, (400, 12)))
    assert (answers == 0.1).any()
    assert (answers == 10.0).any()
    assert ((answers > 0.1) & (answers < 10.0)).any()


@given(arrays(float, 12, elements=finite), st.floats(0.0, 1e40), st.sampled_from([1e-90, 1e-9, 0.5, 1e90]))
def test_weights_never_leave_the_trained_range_whatever_comes_in(densities, gain, scale):
    base = make_network(3)
    names = ("hidden_weights", "hidden_bias", "output_weights", "output_bias")
    network = TunerNetwork(
        **{name: getattr(base, name) for name in ARRAYS if name not in (*names, "input_scale")},
        **{name: gain * getattr(base, name) for name in names},
        input_scale=np.full(12, scale),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer = network.weights(densities)
    assert np.all((answer >= network.omega_min) & (answer <= network.omega_max))


@pytest.mark.parametrize("value", [0.0, 1e300, -1e300, 1.7e308, np.inf, -np.inf, 5e-324])
def test_weights_stay_in_range_on_absurd_inputs(network, value):
    alternating = np.where(np.arange(12) % 2, value, -value)
    for densities in (np.full(12, value), alternating):
        answer = network.weights(densities)
        assert np.all((answer >= 0.1) & (answer <= 10.0))


@given(st.floats(1e-99, 1e99), st.floats(1.0, 1e6))
def test_a_range_of_any_size_is_kept(smallest, width):
    base = make_network(4, gain=1e3)
    network = TunerNetwork(
        **{name: getattr(base, name) for name in ARRAYS if not name.startswith("omega")},
        omega_min=np.full(2, smallest),
        omega_max=np.full(2, min(smallest * width, 9e99)),
    )
    for value in (-1e300, -3.0, 0.0, 3.0, 1e300):
        answer = network.weights(np.full(12, value))
        assert np.all((answer >= network.omega_min) & (answer <= network.omega_max))


# --- file ----------------------------------------------------------------------------------------------------------


def test_a_saved_network_comes_back_whole(tmp_path, network):
    network.save(tmp_path / "net.json")
    twin = load_network(tmp_path / "net.json")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(twin, name), getattr(network, name))
        assert getattr(twin, name).dtype == float
    assert (twin.density, twin.window, twin.provenance) == (network.density, network.window, network.provenance)


@pytest.mark.slow
def test_the_file_is_byte_stable(tmp_path, network):
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    network.save(first)
    load_network(first).save(second)
    assert first.read_bytes() == second.read_bytes()
    second.unlink()
    python("-c", "import sys; from conftest import make_network; make_network().save(sys.argv[1])", second)
    assert first.read_bytes() == second.read_bytes()


def test_whole_numbers_in_the_file_are_numbers(tmp_path, network):
    document = written(network, tmp_path / "net.json")
    document["omega_min"], document["omega_max"] = [1, 1], [10, 10]
    (tmp_path / "net.json").write_bytes(resealed(document))
    assert load_network(tmp_path / "net.json").omega_max.dtype == float


NOT_JSON = {
    "empty": b"",
    "half of a file": b'{"format": "stewart-drake tuner", "ver',
    "binary": bytes(range(256)),
    "not UTF-8": b'{"format": "\xff"}',
    "nested without end": b"[" * 100_000,
    "a huge integer": b"[" + b"9" * 5000 + b"]",
}
NO_TUNER = {"a list": b"[1, 2]", "a text": b'"tuner"', "null": b"null", "another format": b'{"format": "onnx"}'}


@pytest.mark.parametrize("content", [*NOT_JSON.values(), *NO_TUNER.values()], ids=[*NOT_JSON, *NO_TUNER])
def test_a_file_that_is_no_tuner_is_refused_by_name(tmp_path, content):
    path = tmp_path / "net.json"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        load_network(path)
    assert str(path) in caught.value.key


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "nowhere.json", tmp_path, tmp_path / "no" / "folder.json"):
        with pytest.raises(ConfigurationError, match=r"readable file|regular file"):
            load_network(path)


KEYS = [
    ("version", 1),
    ("version", "2"),
    ("version", None),
    ("density", "relative"),
    ("density", None),
    ("density", ["magnitude"]),
    ("window", 0),
    ("window", -49),
    ("window", 49.0),
    ("window", True),
    ("window", "49"),
    ("window", None),
    ("provenance", ["a", "list"]),
    ("provenance", None),
    ("input_scale", [0.0] + [1.0] * 11),
    ("input_scale", [-1.0] + [1.0] * 11),
    ("input_scale", [1e-200] + [1.0] * 11),
    ("omega_min", [0.0, 0.1]),
    ("omega_min", [-0.1, 0.1]),
    ("omega_max", [10.0, 0.0]),
    ("omega_max", [10.0, 0.05]),
]


@pytest.mark.parametrize(("name", "value"), KEYS)
def test_a_wrong_value_is_refused_under_its_key(tmp_path, network, name, value):
    path = tmp_path / "net.json"
    document = written(network, path)
    document[name] = value
    path.write_bytes(resealed(document))
    with pytest.raises(ConfigurationError) as caught:
        load_network(path)
    # A range upside down is reported under its lower end.
    assert caught.value.key.endswith("omega_min" if value == [10.0, 0.05] else name)


CORRUPTIONS = {
    "missing": lambda _: None,
    "scalar": lambda _: 1.0,
    "too short": lambda a: a[:-1],
    "too long": lambda a: [*a, a[0]],
    "nested": lambda a: [a],
    "ragged": lambda a: [a[0], [a[1]], *a[2:]],
    "NaN": lambda a: _set(a, float("nan")),
    "infinite": lambda a: _set(a, float("inf")),
    "beyond 1e100": lambda a: _set(a, 1e101),
    "text": lambda a: _set(a, "1.0"),
    "null inside": lambda a: _set(a, None),
    "beyond 64 bits": lambda a: _set(a, 10**400),
    "mapping": lambda _: {"0": 1.0},
    "truth values": lambda a: np.ones(np.shape(a), dtype=bool).tolist(),
}


def _set(values, value):
    values = json.loads(json.dumps(values))
    inner = values
    while isinstance(inner[0], list):
        inner = inner[0]
    inner[0] = value
    return values


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("corruption", CORRUPTIONS)
def test_every_array_is_checked_for_shape_kind_and_finiteness(tmp_path, network, name, corruption):
    path = tmp_path / "net.json"
    document = written(network, path)
    value = CORRUPTIONS[corruption](document[name])
    if corruption == "missing":
        del document[name]
    else:
        document[name] = value
    path.write_bytes(resealed(document))
    with pytest.raises(ConfigurationError) as caught:
        load_network(path)
    # What is no number in JSON has no checksum either.
    assert caught.value.key.endswith(name) or corruption in ("NaN", "infinite")


@reuse_folder
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_every_torn_file_is_refused(tmp_path, network, share):
    path = tmp_path / "net.json"
    network.save(path)
    content = path.read_bytes().rstrip()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ConfigurationError):
        load_network(path)


def test_a_flipped_bit_changes_no_number(tmp_path, network):
    """It is refused by one line; but for another way to write the same, such as `1E-5`."""
    path = tmp_path / "net.json"
    content = network.to_bytes()
    rng = np.random.default_rng(5)
    refused = []
    for place in rng.integers(0, 8 * len(content), 400):
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << (place % 8)
        path.write_bytes(flipped)
        try:
            loaded = load_network(path)
        except ConfigurationError as error:
            refused.append(str(error))
        else:
            assert loaded.to_bytes() == content
    assert len(refused) > 390
    assert all(line.isprintable() for line in refused)


def test_a_file_of_the_first_version_is_to_be_made_anew(tmp_path, network):
    path = tmp_path / "net.json"
    document = written(network, path)
    path.write_text(json.dumps({**document, "version": 1}))
    with pytest.raises(ConfigurationError, match=r"got 1; allowed: 2; `stewart-drake train` makes"):
        load_network(path)


def test_a_score_that_is_no_number_can_be_saved(tmp_path, network):
    replace(network, provenance={"scores": {"r": float("nan")}}).save(tmp_path / "net.json")
    assert load_network(tmp_path / "net.json").provenance == {"scores": {"r": None}, "not_finite": {"scores.r": "nan"}}


def test_the_package_carries_a_tuner_and_says_where_it_comes_from():
    network = load_network(default_network_path())
    assert json.loads(default_network_path().read_text(), parse_constant=pytest.fail)["format"] == FORMAT
    assert network.provenance["dataset_sha256"]
    assert network.provenance["data"]["density"] == network.density
    assert network.provenance["data"]["window"] == network.window
    np.testing.assert_array_equal([network.omega_min, network.omega_max], [[0.1, 0.1], [10.0, 10.0]])


@pytest.mark.slow
def test_inference_needs_neither_torch_nor_drake():
    code = (
        "import sys; sys.modules.update(torch=None, pydrake=None)\n"
        "from stewart_drake.control.network import load_network, default_network_path\n"
        "print(load_network(default_network_path()).weights([1.5] * 12).tolist())"
    )
    expected = load_network(default_network_path()).weights(np.full(12, 1.5))
    np.testing.assert_array_equal(json.loads(python("-c", code)), expected)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"omega_min": np.zeros(2)}, "omega_min.*positive"),
        ({"omega_min": np.full(2, 1e3)}, "at most omega_max"),
        ({"input_scale": np.full(12, np.nan)}, "input_scale"),
        ({"hidden_bias": np.zeros(9)}, r"hidden_bias.*\(10,\)"),
        ({"omega_min": [0.0, 0.0]}, "omega_min.*positive"),
        ({"input_mean": np.array(["a"] * 12)}, "input_mean.*finite numbers"),
        ({"window": 0}, "window"),
        ({"density": "loud"}, "magnitude or signed"),
    ],
)
def test_a_network_made_in_python_is_checked_as_one_of_a_file_is(changes, words):
    with pytest.raises(ConfigurationError, match=words):
        replace(load_network(), **changes)
