import dataclasses
import json
import resource
import signal
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from made_logs import made_log

from stewart_drake import ConfigurationError, Scenario, build_diagram, load_log, load_scenario, run, run_metrics
from stewart_drake.base.atomic_files import signals_held
from stewart_drake.base.errors import DiskError
from stewart_drake.logs import versions
from stewart_drake.logs.versions import source_digest
from stewart_drake.runs import outputs
from stewart_drake.runs.outputs import draw_run, new_run_folder, prepare_file, save_run

ALWAYS = {"log.parquet", "metrics.json", "scenario.yaml"}
PICTURES = {"states.png", "torques.png", "replay.html"}


def names(folder):
    return {path.name for path in folder.iterdir()}


def write(log, out=None, graph=None, force=False, draw=outputs._draw_graph):
    with new_run_folder(log.scenario, out, force) as place:
        assert save_run(log, place) == (place, None)
        if graph is not None:
            draw(graph, place)
    return place


@contextmanager
def room_for(size):
    # A disk that takes no file of more bytes.
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_a_run_leaves_all_its_files_and_one_without_rows_no_pictures(tmp_path):
    log, folder = run(Scenario.from_dict({"name": "short", "duration": 0.2})), tmp_path / "deep" / "down"
    write(log, folder)
    assert draw_run(log, folder, build_diagram(log.scenario).GetGraphvizString()) is None
    assert names(folder) - {"diagram.svg"} == ALWAYS | PICTURES | {"diagram.dot"}
    assert json.loads((folder / "metrics.json").read_text()) == run_metrics(log)
    assert load_scenario(folder / "scenario.yaml") == log.scenario
    empty = dataclasses.replace(log, signals={name: values[:0] for name, values in log.items()}, figures=None)
    assert draw_run(empty, write(empty, tmp_path / "empty")) is None
    assert json.loads((tmp_path / "empty" / "metrics.json").read_text())["rmse_deg"] is None
    assert names(tmp_path / "empty") == ALWAYS


def test_without_a_place_each_run_gets_the_next_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("made", "made-2", "made-3"):
        assert write(made_log()) == Path("runs", name)
    assert names(tmp_path / "runs") == {"made", "made-2", "made-3"}


def test_a_place_is_taken_before_the_run_and_left_as_it_was_where_nothing_comes_of_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, other = made_log().scenario, made_log(scenario={"gravity": 0.0}).scenario
    with new_run_folder(first, "out"), new_run_folder(first) as one, new_run_folder(first) as two:
        assert (one, two) == (Path("runs/made"), Path("runs/made-2"))
        for force in (False, True):
            with (
                pytest.raises(ConfigurationError, match="no other process is using"),
                new_run_folder(other, "out", force),
            ):
                pass
    assert names(tmp_path) == {"runs"}
    assert names(tmp_path / "runs") == set()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".lock").touch()
    (tmp_path / "out" / ".log.parquet.7.7.part").touch()
    write(made_log(), "out")
    assert names(tmp_path / "out") == ALWAYS


def test_a_place_of_the_same_scenario_is_replaced_and_what_is_the_users_own_stays(tmp_path):
    folder = tmp_path / "out"
    write(made_log(), folder, graph="digraph {}")
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
    for place, words in ((".", mine), ("..", mine), (file, "this is a file"), (file / "x", "Not a directory")):
        with pytest.raises(ConfigurationError, match=f"--out: .*{words}"):
            write(made_log(), place, force=force)
    with pytest.raises(ConfigurationError, match="a file, not a folder"):
        prepare_file(below)
    assert (names(tmp_path), names(below)) == ({"below", "file"}, {"scenario.yaml"})


def test_on_a_full_disk_the_results_of_before_stay_and_the_new_ones_go_elsewhere_or_the_error_is_the_disks(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    write(made_log(), tmp_path / "out")
    log, whole, full = made_log(wall_time=3.0), outputs._write_files, DiskError("log.parquet: No space left on device")

    def full_in_out(files, place):
        if place.name == "out":
            raise full
        whole(files, place)

    monkeypatch.setattr(outputs, "_write_files", full_in_out)
    with new_run_folder(log.scenario, tmp_path / "out") as place:
        other, problem = save_run(log, place)
    assert (load_log(tmp_path / "out").wall_time, load_log(other).wall_time) == (2.0, 3.0)
    assert problem == f"{full}; the results are in {other}"
    monkeypatch.undo()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with room_for(20_000), pytest.raises(DiskError, match=r"log\.parquet: File too large"):
        write(log, tmp_path / "out")
    assert load_log(tmp_path / "out").wall_time == 2.0
    assert names(tmp_path / "out") == ALWAYS
    assert names(tmp_path) == {"out", other.name}
    with room_for(5_000), pytest.raises(ConfigurationError, match=r"--out: .*written to \(File too large\)"):
        write(log, tmp_path / "new")


def test_pictures_that_the_disk_has_no_room_for_are_named(tmp_path):
    log = made_log(plant_state=np.full((101, 9), np.nan))
    folder = write(log, tmp_path / "out")
    with room_for(10_000):
        problem = draw_run(log, folder, "digraph {}")
    missing = "states.png, torques.png, learnt.png, replay.html"
    assert problem == f"pictures: {folder}/states.png: File too large; missing: {missing}"
    assert names(folder) - {"diagram.svg"} == ALWAYS | {"diagram.dot"}


def test_signals_wait_until_what_is_written_is_there(tmp_path):
    log, folder = made_log(), tmp_path / "out"
    for number in (signal.SIGINT, signal.SIGTERM):
        before = signal.signal(number, signal.default_int_handler)
        try:
            with pytest.raises(KeyboardInterrupt), signals_held():  # noqa: PT012 - what is held comes at its end
                signal.raise_signal(number)
                write(log, folder)
            with signals_held() as held:
                signal.raise_signal(number)
                held.clear()
        finally:
            signal.signal(number, before)
    assert load_log(folder).wall_time == log.wall_time


def test_a_controller_of_the_users_is_kept_with_its_results_which_can_be_run_again(tmp_path):
    code = tmp_path / "elsewhere" / "mine.py"
    code.parent.mkdir()
    code.write_text("one = 1\n")
    log = made_log(scenario={"controller": {"kind": f"{code}:Mine"}})
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
