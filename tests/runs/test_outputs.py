import contextlib
import dataclasses
import json
import os
import re
import shutil
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code_trust import trusting_code
from stewart_drake.files.named_files import file_digests
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.versions import collect_versions, git_revision, source_digest
from stewart_drake.runs import outputs
from stewart_drake.runs.outputs import prepare_folder, write_run
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.systems.diagram import build_diagram

ALWAYS = {"log.parquet", "metrics.json", "scenario.yaml"}
PICTURES = {"states.png", "torques.png", "replay.html"}


def names(folder):
    return {path.name for path in folder.iterdir()}


@pytest.fixture(scope="module")
def short_run():
    return run(Scenario.from_dict({"name": "short", "duration": 0.2}))


@pytest.mark.slow
def test_a_run_leaves_all_its_files(short_run, tmp_path):
    folder = tmp_path / "deep" / "down"
    metrics = write_run(short_run, folder, build_diagram(short_run.scenario).GetGraphvizString())
    graph = {"diagram.dot"} | ({"diagram.svg"} if shutil.which("dot") else set())
    assert names(folder) == ALWAYS | PICTURES | graph

    assert metrics == json.loads((folder / "metrics.json").read_text()) == run_metrics(short_run)
    assert load_scenario(folder / "scenario.yaml") == short_run.scenario
    np.testing.assert_array_equal(load_log(folder)["plant_state"], short_run["plant_state"])
    for name in ("states.png", "torques.png"):
        picture = matplotlib.image.imread(folder / name)
        assert min(picture.shape[:2]) > 500
        assert picture[..., :3].std() > 0.01
    page = (folder / "replay.html").read_text()
    assert page.lower().startswith("<!doctype html>")
    assert "<script src=" not in page, "the page must open offline"
    assert (folder / "diagram.dot").read_text().startswith("digraph")


@pytest.mark.slow
@pytest.mark.parametrize("rows", [0, 1])
def test_a_run_that_broke_at_once_keeps_what_it_has(short_run, tmp_path, rows):
    signals = {name: values[:rows] for name, values in short_run.signals.items()}
    outcome = {"status": "failed", "reason": "unreachable_pose", "message": "m", "leg": 0}
    log = SimulationLog(short_run.scenario, signals, short_run.state_names, **outcome)
    metrics = write_run(log, tmp_path)
    assert names(tmp_path) >= ALWAYS
    assert metrics["reason"] == "unreachable_pose"
    assert metrics["rmse_deg"] is None
    assert len(load_log(tmp_path).time) == rows


def test_results_of_the_same_scenario_are_replaced_as_a_whole(tmp_path):
    folder = tmp_path / "out"
    write_run(made_log(), folder, "digraph {}", pictures=False)
    for name in PICTURES:
        (folder / name).write_text("of the run before")
    write_run(made_log(wall_time=3.0), folder, pictures=False)
    assert names(folder) == ALWAYS
    assert load_log(folder).wall_time == 3.0
    assert names(tmp_path) == {"out"}


def test_results_of_another_scenario_are_replaced_only_when_asked_for(tmp_path):
    folder, other = tmp_path / "out", made_log(scenario={"gravity": 0.0})
    write_run(made_log(), folder, pictures=False)
    with pytest.raises(ConfigurationError, match="the results of another scenario, or --force"):
        write_run(other, folder, pictures=False)
    assert load_log(folder).scenario.gravity != 0.0
    write_run(other, folder, pictures=False, force=True)
    assert load_log(folder).scenario.gravity == 0.0


def test_what_a_link_points_to_is_replaced_and_not_the_link(tmp_path):
    (tmp_path / "large disk").mkdir()
    (tmp_path / "out").symlink_to("large disk")
    write_run(made_log(), tmp_path / "out", pictures=False)
    assert (tmp_path / "out").is_symlink()
    assert names(tmp_path / "large disk") == ALWAYS


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("name", ["my notes.txt", ".hidden", "scenario.yaml", "metrics.json"])
def test_nothing_of_the_users_own_is_ever_lost(tmp_path, name, before):
    folder = tmp_path / "out"
    if before:
        write_run(made_log(), folder, pictures=False)
        name = name.replace("metrics", "other")
    folder.mkdir(exist_ok=True)
    (folder / name).write_text("# mine\n")
    for force in (False, True):
        with pytest.raises(ConfigurationError, match="would be lost"):
            write_run(made_log(), folder, pictures=False, force=force)
    assert (folder / name).read_text() == "# mine\n"
    assert names(folder) == (ALWAYS if before else set()) | {name}
    assert names(tmp_path) == {"out"}


def test_the_current_folder_and_those_above_it_are_not_replaced(tmp_path, monkeypatch):
    below = tmp_path / "below"
    below.mkdir()
    monkeypatch.chdir(below)
    for place in (".", "..", below, tmp_path, "/"):
        with pytest.raises(ConfigurationError, match="a folder of its own"):
            write_run(made_log(), place, pictures=False)
    assert names(tmp_path) == {"below"}


def test_a_folder_under_construction_is_locked_and_its_leftovers_are_cleared(tmp_path):
    place, log = tmp_path / "out", made_log()
    with outputs.ResultsFolder(place, log.scenario) as first:
        (first.folder / "half a file").write_text("x")
        with pytest.raises(ConfigurationError, match="a folder that no other process is writing"):
            write_run(log, place, pictures=False)
        assert not place.exists()
        # As if the process had been killed: nobody tidies up.
        copy = tmp_path / "copy"
        shutil.copytree(first.folder, copy)
    assert names(tmp_path) == {"copy"}
    copy.rename(first.folder)
    write_run(log, place, pictures=False)
    assert names(tmp_path) == {"out"}
    assert names(place) == ALWAYS


@pytest.mark.slow
@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("step", ["mkdir", "rename", "unlink"])
def test_a_kill_at_any_step_of_the_folder_loses_nothing_and_blocks_nothing(tmp_path, monkeypatch, before, step):
    place = tmp_path / "out"
    if before:
        write_run(made_log(wall_time=7.0), place, pictures=False)
    real, calls = getattr(Path, step), []

    class Killed(BaseException):
        pass

    for kill_at in range(6):
        calls.clear()

        def dies(path, *args, kill_at=kill_at, **keys):
            if path.parent == tmp_path or path.name == ".stewart-drake":
                calls.append(path)
                if len(calls) == kill_at + 1:
                    raise Killed
            return real(path, *args, **keys)

        with monkeypatch.context() as patch:
            patch.setattr(Path, step, dies)
            # As after SIGKILL nobody tidies up.
            patch.setattr(outputs.ResultsFolder, "__exit__", lambda self, *_: self._lock and self._lock.release())
            with contextlib.suppress(Killed):
                write_run(made_log(wall_time=8.0 + kill_at), place, pictures=False)
        # The next run puts its own in their place, whatever it finds.
        write_run(made_log(wall_time=100.0 + kill_at), place, pictures=False)
        assert load_log(place).wall_time == 100.0 + kill_at
        assert names(tmp_path) == {"out"}
        assert names(place) == ALWAYS


def test_what_the_user_puts_there_during_a_run_is_not_lost(tmp_path):
    log = made_log()
    with outputs.ResultsFolder(tmp_path / "out", log.scenario) as results:
        log.save(results.folder / "log.parquet")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "notes").write_text("mine")
        with pytest.raises(ConfigurationError, match="notes would be lost"):
            results.finish(log, pictures=False)
    assert (tmp_path / "out" / "notes").read_text() == "mine"
    assert len(load_log(tmp_path / ".out.unfinished").time) == 101


def test_old_results_come_back_where_the_new_ones_did_not_arrive(tmp_path):
    place = tmp_path / "out"
    write_run(made_log(wall_time=7.0), place, pictures=False)
    place.rename(tmp_path / ".out.before")
    with outputs.ResultsFolder(place, made_log().scenario):
        assert load_log(place).wall_time == 7.0


@pytest.mark.parametrize("name", [".out.unfinished", ".out.before"])
def test_a_users_folder_is_not_taken_for_one_under_construction(tmp_path, name):
    mine = tmp_path / name
    mine.mkdir()
    (mine / "work").write_text("mine")
    with pytest.raises(ConfigurationError, match=re.escape(f"{name} of your own")):
        write_run(made_log(), tmp_path / "out", pictures=False)
    assert (mine / "work").read_text() == "mine"


def test_a_controller_of_the_users_is_kept_with_its_results_which_can_be_run_again(tmp_path):
    code, other = (tmp_path / place / "mine.py" for place in ("elsewhere", "other"))
    logs, folder = [], tmp_path / "out"
    for path in (code, other):
        path.parent.mkdir()
        path.write_text(f"one = '{path.parent.name}'\n")
        with trusting_code():
            log = made_log(scenario={"controller": {"kind": "python", "system": f"{path}:Mine"}})
        logs.append(dataclasses.replace(log, files=file_digests(log.scenario.to_dict())))
    for _ in range(2):
        write_run(logs[0], folder, pictures=False)
    assert names(folder) == ALWAYS | {"code"}
    assert str(load_scenario(folder / "scenario.yaml").controller.system) == f"{folder / 'code' / 'mine.py'}:Mine"
    # Another file of the same name is another scenario.
    with pytest.raises(ConfigurationError, match="--force"):
        write_run(logs[1], folder, pictures=False)
    assert (folder / "code" / "mine.py").read_text() == "one = 'elsewhere'\n"
    (folder / "code" / "notes.py").write_text("mine")
    with pytest.raises(ConfigurationError, match=r"code/notes\.py would be lost"):
        write_run(logs[0], folder, pictures=False, force=True)
    code.unlink()
    write_run(logs[0], tmp_path / "without", pictures=False)
    assert names(tmp_path / "without") == ALWAYS


def test_numbers_that_are_not_finite_are_null_with_a_reason(tmp_path):
    pose = np.zeros((101, 6))
    pose[80:, 2], pose[90:, 4] = np.inf, np.nan
    write_run(made_log(pose=pose), tmp_path / "out", pictures=False)

    def refuse(text):
        raise AssertionError(f"{text} is no JSON")

    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text(), parse_constant=refuse)
    assert metrics["rmse_deg"][2] is None
    assert metrics["not_finite"]["rmse_deg.2"] == "inf"
    assert metrics["not_finite"]["peak_mm.1"] == "nan"
    assert metrics["finite"] is False
    assert metrics["rmse_deg"][0] == 0.0


@pytest.mark.parametrize("script", ['echo "<svg>$(cat)</svg>"', "exit 1"])
def test_the_graph_is_rendered_where_graphviz_is_installed_and_works(tmp_path, monkeypatch, script):
    dot = tmp_path / "dot"
    dot.write_text(f"#!/bin/sh\n{script}\n")
    dot.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    write_run(made_log(), tmp_path / "out", "digraph {}", pictures=False)
    assert (tmp_path / "out" / "diagram.dot").read_text() == "digraph {}"
    svg = tmp_path / "out" / "diagram.svg"
    assert not svg.exists() if script == "exit 1" else svg.read_text() == "<svg>digraph {}</svg>\n"


@pytest.mark.parametrize("file", ["metrics.json", "scenario.yaml"])
def test_a_disk_that_fills_up_midway_leaves_the_log_and_no_half_result(tmp_path, monkeypatch, file):
    real = outputs.write_atomically

    def full(path, content):
        if path.name == file:
            raise ConfigurationError(str(path), "No space left on device", "a file in a writable folder")
        real(path, content)

    monkeypatch.setattr(outputs, "write_atomically", full)
    with pytest.raises(ConfigurationError, match="No space left"):
        write_run(made_log(), tmp_path / "out", pictures=False)
    assert names(tmp_path) == {".out.unfinished"}
    assert len(load_log(tmp_path / ".out.unfinished").time) == 101


def test_a_folder_that_cannot_be_is_named_and_one_that_can_is_left_as_it_is(tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    for path, why in ((file, "this is a file"), (file / "below", "Not a directory|this is a file")):
        for write in (prepare_folder, lambda path: write_run(made_log(), path, pictures=False)):
            with pytest.raises(ConfigurationError, match=f"--out: got .*file.*({why})"):
                write(path)
    assert prepare_folder(str(tmp_path)) == tmp_path
    assert names(tmp_path) == {"file"}
    assert file.read_text() == "mine"


def test_versions_name_what_computed():
    versions = collect_versions()
    assert versions["drake"].startswith("1.")
    assert versions["numpy"] == np.__version__
    assert versions["python"].startswith("3.")
    assert versions["git_revision"] is None or re.fullmatch(r"[0-9a-f]{40}(-dirty)?", versions["git_revision"])
    assert json.loads(json.dumps(versions)) == versions


def test_the_digest_changes_with_the_code_and_only_with_it(monkeypatch, tmp_path):
    from stewart_drake.logs import versions

    package = tmp_path / "package"
    package.mkdir()
    (package / "versions.py").write_text("a = 1\n")
    monkeypatch.setattr(versions, "PACKAGE", package)
    first = source_digest()
    (package / "weights.json").write_text("{}")
    assert source_digest() == first
    (package / "versions.py").write_text("a = 2\n")
    assert source_digest() != first
    assert git_revision() is None


def test_a_full_disk_is_found_before_the_run(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(outputs.shutil, "disk_usage", lambda _: usage._replace(free=1_000_000))
    with pytest.raises(ConfigurationError, match="50 MB free, not 1 MB"):
        prepare_folder(tmp_path, outputs.SPACE)
    # Results that exist are written as long as they fit.
    assert prepare_folder(tmp_path) == tmp_path
