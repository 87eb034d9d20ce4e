"""The commands `list`, `explain`, `init`, `doctor` and `completion`."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from stewart_drake.base.yaml_files import shipped_folder
from stewart_drake.logs.outcomes import OUTCOMES, Status
from stewart_drake.scenario.scenario import load_scenario
from stewart_drake.studies.comparison import load_comparison
from stewart_drake.studies.faults import REACTIONS, Reaction
from stewart_drake.studies.sweep import load_sweep
from stewart_drake.studies.tune import load_tuning

DOCS = Path(__file__).parents[2] / "docs"


def test_what_there_is_to_choose_from_is_listed(call):
    lists = json.loads(call("list", "--json")[1])
    assert set(lists) == {"scenarios", "controllers", "comparisons", "sweeps", "robots", "kinds"}
    for kind in ("scenarios", "controllers", "comparisons", "sweeps", "robots"):
        names = {path.stem for path in shipped_folder(kind).glob("*.yaml")}
        assert {row["name"] for row in lists[kind]} == names
        assert all(row["what it is"] for row in lists[kind])
    assert {"key": "tuner", "kind": "policy"}.items() <= next(
        r for r in lists["kinds"] if r["kind"] == "policy"
    ).items()
    assert list(json.loads(call("list", "robots", "--json")[1])[0]) == ["name", "what it is"]


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("gravity", {"unit": "m/s^2", "default": 9.81}),
        ("command_delay", {"unit": "ticks", "default": 0, "allowed": "a whole number at least 0 and at most 100"}),
        ("payload_mass", {"key": "plant.payload_mass", "unit": "kg", "default": 0.0}),
        ("link.faults.kind", {"allowed": "nan, inf, offset or chatter"}),
        ("tuner.kappa", {"of kind": "policy", "allowed": "a number at least -1 and at most 1"}),
        ("mismatch", {"key": "sweep.mismatch", "default": "false"}),
        ("compare.bands.axes", {"allowed": "a list, each roll, pitch, yaw, X, Y or Z"}),
    ],
)
def test_a_key_is_explained(call, key, expected):
    assert expected.items() <= json.loads(call("explain", key, "--json")[1]).items()


def test_of_a_kind_every_key_is_explained_and_of_a_recorded_motion_its_columns(call):
    rows = json.loads(call("explain", "reference.recorded", "--json")[1])
    assert [row["key"] for row in rows] == [
        f"reference.{name}" for name in ("motion_file", "time_scale", "cutoff", "settle")
    ]
    assert json.loads(call("explain", "recorded", "--json")[1]) == rows
    assert all(name in rows[0]["what it does"] for name in ("time_s", "_ms", "roll_rad", "_deg", "x_m", "_mm"))


def test_of_a_section_every_key_is_explained_and_of_a_typo_what_was_meant(call):
    rows = json.loads(call("explain", "limits", "--json")[1])
    assert [row["key"] for row in rows] == ["limits", *load_scenario("hold").limits.to_dict()]
    periods = {row["of kind"]: row["default"] for row in json.loads(call("explain", "controller.period", "--json")[1])}
    assert periods["lqi"] == 0.005
    assert "did you mean gravity?" in call("explain", "gravty")[2]


def test_a_word_for_how_a_run_ended_is_explained_as_in_the_docs(call):
    glossary = (DOCS / "glossary.md").read_text()
    for word, text in {**OUTCOMES, **REACTIONS}.items():
        assert text in json.loads(call("explain", word, "--json")[1]).values()
        assert f"| `{word}` | {text} |\n" in glossary
    assert {*get_args(Status)} < {*OUTCOMES}
    assert {*get_args(Reaction)} == {*REACTIONS}
    assert "did you mean completed?" in call("explain", "complete")[2]


def test_a_scenario_to_begin_with_has_a_comment_on_each_key_and_runs(call, tmp_path):
    assert call("init", "mine.yaml")[1] == "scenario in mine.yaml; next: stewart-drake run mine.yaml\n"
    assert load_scenario(tmp_path / "mine.yaml").tuner.kind == "policy"
    lines = (tmp_path / "mine.yaml").read_text().splitlines()
    assert next(line for line in lines if line.startswith("duration")) == "duration: 10.0  # [s] simulated time"
    assert call("check", "mine.yaml")[0] == 0
    status, _, err = call("init", "mine.yaml")
    assert (status, err.count("\n")) == (2, 1)


@pytest.mark.parametrize("study", ["sweep", "compare", "tune"])
def test_a_study_to_begin_with_is_one_that_its_command_takes(call, tmp_path, study):
    path = tmp_path / "mine.yaml"
    assert call("init", "own.yaml")[0] == call("init", "of_mine.yaml", "--for", study, "--scenario", "own.yaml")[0] == 0
    assert 'scenario: "own.yaml"' in (tmp_path / "of_mine.yaml").read_text()
    assert call("init", "other.yaml", "--scenario", "own.yaml")[0] == 2
    assert call("init", "mine.yaml", "--for", study)[0] == 0
    loaded = {"sweep": load_sweep, "compare": load_comparison, "tune": load_tuning}[study](path)
    assert loaded.runs > 1


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("run reachy_mini", "the robot reachy_mini'; try: stewart-drake run sway --set robot=reachy_mini"),
        ("run desk.yaml", "the robot desk.yaml'; try: stewart-drake run sway --set robot=desk.yaml"),
        ("robots show mine.yaml", "the scenario mine.yaml'; try: stewart-drake run mine.yaml"),
        ("run hobby_servos", "the controller hobby_servos'; try: stewart-drake drive hobby_servos --machine sim:"),
        ("sweep exact_heart", "the scenario exact_heart'; try: stewart-drake run exact_heart"),
    ],
)
def test_of_a_file_of_another_kind_a_line_says_what_takes_it(call, tmp_path, words, meant):
    (tmp_path / "desk.yaml").write_text("crank_length: 0.05\n")
    (tmp_path / "mine.yaml").write_text("duration: 1.0\n")
    status, _, err = call(*words.split())
    assert (status, err.count("\n")) == (2, 1)
    assert err.endswith(f"got '{meant}\n")


@pytest.mark.slow
def test_the_doctor_knows_versions_speed_and_cache(call):
    facts = json.loads(call("doctor", "--json")[1])
    assert {"python", "drake", "graphviz", "compiled code", "cores", "this folder"} <= set(facts)
    assert facts["a tick of exact_breathing, fast engine"].endswith(" us of 1000 us")


def test_a_shell_completes_commands_and_names(call, monkeypatch):
    assert "_STEWART_DRAKE_COMPLETE" in call("completion", "bash")[1]
    for words, completed in (
        ("stewart-drake expl", "explain"),
        ("stewart-drake run paper_fig7_u", "paper_fig7_uncompensated"),
        ("stewart-drake drive hob", "hobby_servos"),
        ("stewart-drake export reachy_da", "reachy_daemon"),
        ("stewart-drake export reachy_sl", "reachy_slow_bus"),
    ):
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
        monkeypatch.setenv("_STEWART_DRAKE_COMPLETE", "bash_complete")
        assert call()[1].split() == [f"plain,{completed}"]


@pytest.mark.slow
@pytest.mark.parametrize("key", ["gravity", "reference.parts.amplitude"])
def test_where_nobody_reads_any_more_a_command_ends_well(key):
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "stewart_drake", "explain", key]
    ended = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (0, b"")


@pytest.mark.slow
def test_where_standard_output_is_full_a_command_says_so_and_comes_to_its_end():
    command = [sys.executable, "-m", "stewart_drake", "explain", "lost"]
    with Path("/dev/full").open("wb") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    said = b"stewart-drake: disk: standard output: No space left on device\n"
    assert (ended.returncode, ended.stderr) == (3, said)


@pytest.mark.slow
def test_a_command_whose_output_is_closed_comes_to_its_end():
    ended = subprocess.run(["sh", "-c", f"'{sys.executable}' -m stewart_drake explain lost >&- 2>&-"], check=False)
    assert ended.returncode == 0
