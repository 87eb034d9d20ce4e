import dataclasses
import json
from pathlib import Path

import pytest
from made_logs import made_log

from stewart_drake.errors import ConfigurationError, DiskError
from stewart_drake.logs import versions
from stewart_drake.logs.log import load_log
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.versions import source_digest
from stewart_drake.runs import outputs
from stewart_drake.runs.outputs import claimed_place, draw_run, prepare_file, save_run
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.systems.diagram import build_diagram

ALWAYS = {"log.parquet", "metrics.json", "scenario.yaml"}
PICTURES = {"states.png", "torques.png", "replay.html"}


def names(folder):
    return {path.name for path in folder.iterdir()}


def write(log, out=None, **options):
    with claimed_place(log.scenario, out, **options) as place:
        return save_run(log, place).folder


@pytest.mark.slow
def test_a_run_leaves_all_its_files_and_one_without_rows_no_pictures(tmp_path):
    log, folder = run(Scenario.from_dict({"name": "short", "duration": 0.2})), tmp_path / "deep" / "down"
    with claimed_place(log.scenario, folder) as place:
        results = save_run(log, place)
        assert names(folder) - {".lock"} >= ALWAYS
        assert draw_run(log, place, build_diagram(log.scenario).GetGraphvizString()) is None
    assert names(folder) - {"diagram.svg"} == ALWAYS | PICTURES | {"diagram.dot"}
    assert results.metrics == json.loads((folder / "metrics.json").read_text()) == run_metrics(log)
    assert load_scenario(folder / "scenario.yaml") == log.scenario
    empty = dataclasses.replace(log, signals={name: values[:0] for name, values in log.items()}, figures=None)
    with claimed_place(log.scenario, tmp_path / "empty") as place:
        assert save_run(empty, place).metrics["rmse_deg"] is None
        assert draw_run(empty, place) is None
    assert names(tmp_path / "empty") == ALWAYS


def test_without_a_place_each_run_gets_the_next_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("made", "made-2", "made-3"):
        assert write(made_log()) == Path("runs", name)
    assert names(tmp_path / "runs") == {"made", "made-2", "made-3"}


def test_a_place_of_the_same_scenario_is_replaced_and_what_is_the_users_own_stays(tmp_path):
    folder = tmp_path / "out"
    write(made_log(), folder)
    for name in (*PICTURES, "my notes.txt"):
        (folder / name).write_text("of the run before")
    write(made_log(wall_time=3.0), folder)
    assert names(folder) == ALWAYS | {"my notes.txt"}
    assert load_log(folder).wall_time == 3.0
    other = made_log(scenario={"gravity": 0.0})
    with pytest.raises(ConfigurationError, match="the results of another scenario, or --force"):
        write(other, folder)
    assert load_log(folder).scenario.gravity != 0.0
    write(other, folder, force=True)
    assert load_log(folder).scenario.gravity == 0.0
    assert names(folder) == ALWAYS | {"my notes.txt"}
    assert names(tmp_path) == {"out"}


def test_what_a_link_points_to_is_replaced_and_not_the_link(tmp_path):
    (tmp_path / "large disk").mkdir()
    (tmp_path / "out").symlink_to("large disk")
    for _ in range(2):
        write(made_log(), tmp_path / "out")
    assert (tmp_path / "out").is_symlink()
    assert names(tmp_path / "large disk") == ALWAYS


@pytest.mark.parametrize("force", [False, True])
def test_a_place_that_cannot_be_is_refused_and_nothing_there_is_touched(tmp_path, monkeypatch, force):
    below, file = tmp_path / "below", tmp_path / "file"
    below.mkdir()
    file.write_text("mine")
    (below / "scenario.yaml").write_text("# mine\n")
    monkeypatch.chdir(below)
    mine = "or one with the results of a run"
    for place, words in ((".", mine), ("..", mine), (file, "this is a file"), (file / "x", "this is a file")):
        with pytest.raises(ConfigurationError, match=f"--out: .*{words}"):
            write(made_log(), place, force=force)
    with pytest.raises(ConfigurationError, match="a file, not a folder"):
        prepare_file(below)
    assert (names(tmp_path), names(below)) == ({"below", "file"}, {"scenario.yaml"})


def test_a_full_disk_leaves_no_half_result(tmp_path, monkeypatch):
    def full(*_):
        raise DiskError("log.parquet: No space left on device")

    monkeypatch.setattr(outputs, "write_together", full)
    with pytest.raises(DiskError, match="No space left"):
        write(made_log(), tmp_path / "out")
    assert names(tmp_path) == set()


def test_where_the_disk_of_a_place_is_full_the_results_go_elsewhere_and_this_is_said(tmp_path, monkeypatch):
    together, log = outputs.write_together, made_log()

    def full_there(files, *more):
        if tmp_path / "out" in {path.parent for path in files}:
            raise DiskError("log.parquet: No space left on device")
        together(files, *more)

    monkeypatch.setattr(outputs, "write_together", full_there)
    with claimed_place(log.scenario, tmp_path / "out") as place:
        results = save_run(log, place)
    assert load_log(results.folder).signals.keys() == log.signals.keys()
    assert "No space left" in results.note
    assert str(results.folder) in results.note


def test_a_picture_that_cannot_be_written_is_named_and_the_log_stays(tmp_path, monkeypatch):
    def full(*_, **__):
        raise DiskError("disk full")

    log = made_log()
    monkeypatch.setattr("stewart_drake.runs.replay.write_replay", full)
    with claimed_place(log.scenario, tmp_path / "out") as place:
        save_run(log, place)
        said = draw_run(log, place)
    assert said == "pictures: disk full; missing: replay.html"
    assert names(tmp_path / "out") >= ALWAYS


def test_a_controller_of_the_users_is_kept_with_its_results_which_can_be_run_again(tmp_path):
    code = tmp_path / "elsewhere" / "mine.py"
    code.parent.mkdir()
    code.write_text("one = 1\n")
    log = made_log(scenario={"controller": {"kind": "python", "system": f"{code}:Mine"}})
    folder = write(log, tmp_path / "out")
    assert names(folder) == ALWAYS | {"code"}
    assert str(load_scenario(folder / "scenario.yaml").controller.kind) == f"{folder / 'code' / 'mine.py'}:Mine"
    assert (folder / "code" / "mine.py").read_text() == "one = 1\n"
    code.unlink()
    assert names(write(log, tmp_path / "without")) == ALWAYS


def test_the_digest_of_the_sources_changes_with_the_code_alone(monkeypatch, tmp_path):
    monkeypatch.setattr(versions, "PACKAGE", tmp_path)
    digests = []
    for name, text in (("versions.py", "a = 1\n"), ("weights.json", "{}"), ("versions.py", "a = 2\n")):
        (tmp_path / name).write_text(text)
        digests.append(source_digest())
    assert digests[0] == digests[1] != digests[2]
