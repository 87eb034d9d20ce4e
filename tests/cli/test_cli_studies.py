"""The commands `compare`, `tune` and `tuner`."""

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.policy import Policy

TEXT = """
scenario: paper_fig7
set: {duration: 0.05, controller: {kind: pid}}
controllers: {weak: {controller.kp: 20.0}, strong: {controller.kp: 40.0}}
references: {hold: {reference: {kind: hold}}}
"""


@pytest.mark.slow
def test_a_file_is_run_and_its_tables_are_shown_and_kept(call, tmp_path):
    (tmp_path / "mine.yaml").write_text(TEXT)
    status, out, _ = call("compare", "mine.yaml", "--workers", 1)
    assert status == 0
    assert all(word in out for word in ("weak", "strong", "RMSE", "runs/mine"))
    names = {path.name for path in (tmp_path / "runs" / "mine").iterdir()}
    assert {"comparison.parquet", "comparison.csv", "comparison.md", "rmse.png", "error.png"} <= names
    status, out, _ = call("compare", "mine.yaml", "--quiet", "--quick", "--workers", 1)
    assert (status, out) == (0, "")
    assert (tmp_path / "runs" / "mine-quick").is_dir()


@pytest.mark.slow
def test_a_study_of_which_every_run_is_refused_ends_with_the_reason_and_status_2(call, tmp_path):
    far = '{scenario: paper_fig7, runs: 2, distributions: {"reference.amplitude[0]": {kind: grid, values: [2.0, 2.5]}}}'
    (tmp_path / "far.yaml").write_text(far)
    status, _, err = call("sweep", "far.yaml", "--workers", 1)
    assert status == 2
    assert "every run was refused, the first: reference: breaks the limit " in err
    assert (tmp_path / "runs" / "far" / "sweep.parquet").exists()


TUNE = """
cost: {position: 0.1}
tune: {controllers: {weak: {controller.kp: [1.0, 100.0]}}, population: 4, set: {plant.kind: closed_form}}
"""


@pytest.mark.slow
def test_a_search_is_done_and_what_it_found_is_compared(call, tmp_path):
    (tmp_path / "mine.yaml").write_text(TEXT + TUNE)
    status, out, _ = call("tune", "mine.yaml", "--workers", 1, "--budget", 8)
    assert status == 0
    assert all(word in out for word in ("weak", "weak, tuned", "plant.kind closed_form", "tuned.yaml", "verdict-"))
    made = tmp_path / "runs" / "mine-tune"
    names = {path.name for path in made.iterdir()}
    assert {"tuned.yaml", "tune.parquet", "tune.csv", "tune.md", "tune.png", "tune.pdf"} <= names
    (tmp_path / "mine.yaml").write_text(TEXT + TUNE + f"tuned: {made / 'tuned.yaml'}\n")
    status, out, _ = call("compare", "mine.yaml", "--workers", 1)
    assert status == 0
    assert "cost" in out
    status, out, _ = call("tune", "mine.yaml", "--workers", 1, "--quick", "--quiet")
    assert (status, out) == (0, "")


def test_the_card_of_a_policy_says_box_and_provenance(call):
    status, out, err = call("tuner", "show")
    assert (status, err) == (0, "")
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    policy = Policy.load()
    assert all(list(row) in rows for row in policy.box_rows())
    tables = json.loads(call("tuner", "show", "--json")[1])
    assert list(tables["policy.json"]) == [name for name, _ in policy.facts()]


@pytest.mark.parametrize("command", [("show",), ("judge", "--out", "verdict")])
def test_a_file_that_is_no_policy_is_refused_before_anything_is_written(call, tmp_path, command):
    (tmp_path / "mine.json").write_text("{}")
    status, out, err = call("tuner", *command, "mine.json")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "mine.json" in err
    assert not (tmp_path / "verdict").exists()


CONTENT = Policy.shipped.read_bytes()


@given(st.integers(0, 8 * len(CONTENT) - 1))
def test_every_flipped_bit_is_refused_or_changes_nothing(tmp_path_factory, bit):
    path = tmp_path_factory.getbasetemp() / "flipped.json"
    content = bytearray(CONTENT)
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)
    with suppress(ConfigurationError):
        assert Policy.load(path).to_bytes() == CONTENT
