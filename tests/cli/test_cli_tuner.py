import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.control.features import FEATURES
from stewart_drake.control.policy import Layers, Policy, load_policy
from stewart_drake.errors import ConfigurationError

COUNT = len(FEATURES)
PROVENANCE = {
    "date": "2026-11-22",
    "seeds": [3, 4],
    "figures": {"J over best fixed": 0.791},
    "limits": ["[none] known"],
}


def made(hidden=3):
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(hidden, COUNT))
    weights[:, 2] = 0.0
    layers = Layers(
        mean=np.zeros(COUNT),
        scale=np.ones(COUNT),
        hidden=weights,
        hidden_bias=np.zeros(hidden),
        output=rng.normal(size=(4, hidden)),
        output_bias=np.zeros(4),
        centre=np.array([0.0, 0.1, -0.3, -0.5]),
        below=np.array([0.3, 0.35, 0.6, 1.1]),
        above=np.array([0.3, 0.35, 0.6, 1.0]),
        low=-np.ones(COUNT),
        high=np.ones(COUNT),
    )
    return Policy(layers, PROVENANCE)


@pytest.fixture
def show(call):
    return functools.partial(call, "tuner", "show")


def test_the_card_says_box_inputs_and_provenance(show, tmp_path):
    made().save(tmp_path / "mine.json")
    status, out, err = show("mine.json")
    assert (status, err) == (0, "")
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    assert ["disturbance", "-1.6", "-0.5", "0.5"] in rows
    told = {row[0]: row[1] for row in rows if len(row) == 2}
    assert told["figures.J over best fixed"] == "0.791"
    assert (told["seeds"], told["date"], told["limits"]) == ("3, 4", "2026-11-22", "[none] known")
    heard = told["hears"].split(", ")
    assert heard == [name for name in FEATURES if name != FEATURES[2]]


def test_a_file_with_a_flipped_bit_is_refused_in_one_line(show, tmp_path):
    path = tmp_path / "mine.json"
    made().save(path)
    content = bytearray(path.read_bytes())
    content[content.index(b'"output"') + 30] ^= 1
    path.write_bytes(content)
    status, out, err = show("mine.json")
    assert (status, out) == (2, "")
    assert "mine.json" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("arguments", [("none.json",), (".",), ("a", "b")])
def test_what_is_no_policy_is_refused(show, arguments):
    status, out, err = show(*arguments)
    assert (status, out) == (2, "")
    assert err


CONTENT = made(1).to_bytes()


@given(st.integers(0, 8 * len(CONTENT) - 1))
def test_every_flipped_bit_is_refused_or_changes_nothing(tmp_path_factory, bit):
    path = tmp_path_factory.getbasetemp() / "flipped.json"
    content = bytearray(CONTENT)
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)
    said = ""
    try:
        found = load_policy(path).to_bytes()
    except ConfigurationError as error:
        found, said = CONTENT, str(error)
    assert found == CONTENT
    assert "\n" not in said
