import json
import re
import shlex
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import resealed

from stewart_drake.base.config import to_plain
from stewart_drake.base.errors import ConfigurationError, DiskError
from stewart_drake.base.yaml_files import shipped_folder
from stewart_drake.cli import run_commands
from stewart_drake.cli.options import COMMANDS
from stewart_drake.cli.terminal import print_table
from stewart_drake.control.network import TunerNetwork
from stewart_drake.logs.log import load_log
from stewart_drake.runs import outputs
from stewart_drake.scenario.scenario import load_driven, load_scenario, scenario_schema
from stewart_drake.studies import workers

QUICK = ("--set", "duration=0.05", "--set", "tuner.kind=fixed")
FAST = ("--set", "plant.kind=closed_form")


WITHOUT_PICTURES = """
from stewart_drake.runs import outputs
from stewart_drake.cli.app import main
outputs._draw = lambda *_: None
main()
"""


@pytest.fixture
def without_pictures(monkeypatch):
    monkeypatch.setattr(outputs, "_draw", lambda *_: None)


@pytest.mark.slow
def test_a_run_from_the_shell_leaves_its_files_and_prints_its_table(shell, tmp_path):
    status, out, err = shell("run", "exact_fig7", "--plots", *QUICK)
    assert status == 0, err
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
    folder = tmp_path / "runs" / "exact_fig7"
    files = {"diagram.dot", "log.parquet", "metrics.json", "replay.html", "scenario.yaml", "states.png", "torques.png"}
    assert {path.name for path in folder.iterdir()} - {"diagram.svg"} == files
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["status"] == "completed"
    for words in ("completed", "0.050 s", "RMSE", "torque", "loop gap", "runs/exact_fig7"):
        assert words in out
    assert f"{metrics['loop_gap_max_m']:.2e}" in out
    assert "0.05 / 0.05 s" in err
    assert "Traceback" not in err
    assert load_log(folder).scenario == load_scenario("exact_fig7", ["duration=0.05", "tuner.kind=fixed"])


@pytest.mark.usefixtures("without_pictures")
def test_the_scenario_as_run_runs_again_the_same_elsewhere_and_in_its_place(call):
    own, out = "deep/[a] b/scenario.yaml", ("--out", "deep/[a] b")
    status, said, _ = call("run", "paper_fig7", *QUICK, *FAST, "--set", "name=mine", *out)
    assert status == 0
    assert "deep/[a] b" in said
    assert call("run", own, "--out", "second", "--quiet") == (0, "", "")
    first, second = load_log("deep/[a] b"), load_log("second")
    assert (first["torque"] == second["torque"]).all()
    assert first.scenario == second.scenario
    assert (first.scenario.name, first.scenario.tuner.kind) == ("mine", "fixed")
    assert call("run", own, *out)[0] == 0
    assert call("run", own, "--set", "duration=0.01", *out)[0] == 2
    assert call("run", own, "--set", "duration=0.01", "--force", *out)[0] == 0
    assert load_scenario(own).duration == 0.01


@pytest.mark.usefixtures("without_pictures")
def test_what_a_run_learns_is_printed_kept_and_where_the_next_one_begins(call):
    learning = ("--set", "adaptation=regression", "--set", "plant.motor_friction=0.05", "--set", "duration=2", *FAST)
    first = call("run", "exact_breathing", *learning, "--keep-model", "kept.yaml", "--out", "first")
    assert first[0] == 0
    assert "learnt: Coulomb friction" in first[1]
    second = call("run", "exact_breathing", *learning, "--keep-model", "kept.yaml", "--out", "second")
    assert second[0] == 0
    believed = load_log("second").scenario.controller_model
    np.testing.assert_allclose(believed.friction.coulomb, 0.05, atol=0.005)
    assert believed.robot.platform_mass == load_log("first")["learnt"][-1, 0]
    kept = Path("kept.yaml").read_bytes()
    broken = "--set=sensors.faults=[{kind: nan, time: 1.0, leg: 1}]"
    status, _, said = call("run", "exact_breathing", *learning, broken, "--keep-model", "kept.yaml", "--out", "failed")
    assert status == 3
    assert "nothing saved in" in said
    assert Path("kept.yaml").read_bytes() == kept
    status, _, said = call("run", "exact_breathing", *learning, "--keep-model", "kept.yaml/more", "--out", "none")
    assert status == 2
    assert "--keep-model: expected a folder that can be written to" in said
    assert not Path("none").exists()
    status, _, said = call("run", "exact_breathing", *FAST, "--keep-model", "kept.yaml")
    assert status == 2
    assert "adaptation.kind: expected regression, for --keep-model" in said
    status, _, said = call("run", "exact_breathing", *learning, "--keep-model", "first/scenario.yaml")
    assert status == 2
    assert "expected a file with `model` alone" in said
    frozen = ("--set", "adaptation={kind: regression, frozen: true}", "--set", "duration=0.1")
    status, _, said = call("run", "exact_breathing", *learning, *frozen, "--keep-model", "new.yaml", "--out", "frozen")
    assert (status, Path("new.yaml").exists()) == (0, False)
    assert "nothing saved in new.yaml: nothing was learnt" in said
    for other, links in (
        ("robot={crank_length: 0.12}", "cranks 0.12 m, rods 0.404 m"),
        ("robot={crank_plane_angle: 0.01}", "cranks 0.11 m, rods 0.404 m"),
    ):
        status, _, said = call("run", "exact_breathing", *learning, "--set", other, "--keep-model", "kept.yaml")
        assert status == 2
        assert f"expected what was learnt of this robot and its motors, {links}, torque motors, " in said
    assert Path("kept.yaml").read_bytes() == kept


def test_what_was_kept_changes_what_a_simulated_machine_is_believed_to_be_and_not_what_it_is(tmp_path):
    first = load_driven("reachy_servos", ["adaptation=regression"])
    kept = tmp_path / "kept.yaml"
    heavier = first.controller_model.robot.given() | first.controller_model.robot.scaled_masses(1.5)
    kept.write_text(json.dumps(to_plain({"model": first.model.given() | {"robot": heavier}})))
    again = run_commands.load_learnt(load_driven, "reachy_servos", ["adaptation=regression"], kept)
    assert again.controller_model.robot.platform_mass == 1.5 * first.controller_model.robot.platform_mass
    assert (again.robot, again.motors) == (first.robot, first.motors)


def test_every_help_begins_with_an_example_and_ends_no_summary_in_dots(call):
    status, out, err = call("--help")
    assert (status, err) == (0, "")
    assert call() == (0, out, "")
    for name, about in COMMANDS.items():
        status, text, err = call(*name.split(), "--help")
        assert (status, err) == (0, "")
        first = f"Example: stewart-drake {name} {about.example}".strip()
        assert text.splitlines()[:3] == [first, "", text.splitlines()[2]]
        assert text.splitlines()[2].startswith("Usage: ")
        assert " " in name or f"  {name} " in out
        assert about.summary in " ".join(text.split())
    assert "..." not in out.partition("Commands:")[2]


def test_the_schema_command_writes_what_the_checkout_holds(call):
    status, out, err = call("schema")
    assert (status, err) == (0, "")
    assert json.loads(out) == scenario_schema()
    shipped = shipped_folder("scenarios") / "schema.json"
    assert shipped.read_text() == out, "made with `stewart-drake schema > diagrams/scenarios/schema.json`"


def test_tables_are_json_on_request_and_choose_columns_by_the_terminals_width(call, monkeypatch):
    status, out, err = call("check", "paper_fig7", "--json")
    assert (status, err) == (0, "to explain the limits: stewart-drake explain limits\n")
    limits, machine = json.loads(out).values()
    assert limits["reach"]["bound"] == 0.98
    assert {"": "delay of a command [ticks]", "simulated": 0.0, "model": 0.0} in machine
    for width, shown, left_out in ((200, "where", ""), (50, "allowed", "more columns")):
        monkeypatch.setenv("COLUMNS", str(width))
        out = call("check", "paper_fig7")[1]
        assert shown in out
        assert left_out in out
        # No number is broken.
        assert "<= 1.484 rad" in out


# What a scenario refuses is in test_scenario.py, what a check before the run finds in runs/test_simulation.py.
BAD = [
    # arguments, words that the line must have
    ("run hold --video film.avi", ["film", ".gif or .mp4", "film.avi"]),
    ("rum", ["rum", "Did you mean 'run'?"]),
    ("run", ["SCENARIO"]),
    ("run paper_fig7 --ot x", ["--ot", "--out"]),
    ("run paper_fig7 --set reference.phase=90", ["reference.phase", "6.28319", "did you mean 90 deg?"]),
    ("run paper_fig7 --set plant.time_step=0.1", ["plant.time_step", "at most 0.01"]),
    ("run hexadecimal.yaml", ["duration: expected a positive number [s]"]),
    (f"run paper_fig7 --set duration=0x{5000 * 'f'}", ["duration: expected a positive number [s]"]),
    ("run paper_fig8", ["'paper_fig8'", "paper_fig7"]),
    ("run twice.yaml", ["twice.yaml", "line 2", 'duplicate key "duration"']),
    ("run paper_fig7 --set duration", ["--set", "'duration'", "key=value"]),
    ("run paper_fig7 --set reference.center=[0,0,0,0,0,0.6]", ["reach", "t = 0.000 s", "leg 0", "0.98"]),
    ("run paper_fig7 --set tuner.weights_file=short.json", ["short.json", "hidden_weights", "(10, 12)"]),
    ("run paper_fig7 --out twice.yaml/x", ["--out", "'twice.yaml/x'", "Not a directory"]),
    ("write-sdf x.sdf --set robot.rod_lenght=1", ["robot.rod_lenght", "did you mean rod_length?"]),
    pytest.param("train none.parquet", ["none.parquet", "collect"], marks=pytest.mark.torch),
    ("margins --poses 0", ["--poses"]),
    ("check paper_fig7 --out fit.yaml", ["--out needs either --scale or --retime"]),
    ("compare compare.yaml", ["weak, hold, nominal: controller.kpp"]),
    ("sweep initial_ofset", ["sweep file", "'initial_ofset'", "initial_offset"]),
    ("calibrate --robot paper --out x.yaml", ["either POSES or --plan N"]),
    ("calibrate poses.csv --robot paper --out x.yaml", ["poses.csv", "No such file"]),
    ("calibrate --plan 5 --robot paper --out x.yaml", ["--plan", "a number of poses from 13"]),
    ("identify --robot paper --out x.yaml", ["LOGS"]),
    (
        "excite --robot paper --hold coulomb --hold viscous --set limits.torque_fraction=1e-4",
        ["limits: expected "],
    ),
    ("excite --robot paper --duration 10m", ["--duration", "10m"]),
    ("excite --robot paper --duration 500ms", ["--duration", "0.5 is not in the range x>=5.0"]),
    ("excite --robot paper --out twice.yaml/x/excite.yaml", ["--out", "Not a directory"]),
    ("robots show paper --picture robot.txt", ["--picture", "robot.txt", "ends in .png"]),
    ("robots show reachy_max", ["'reachy_max'", "paper, reachy_mini, servo_hexapod"]),
    ("sweep tiny.yaml --scheduler tcp://127.0.0.1:1", ["--scheduler", "tcp://127.0.0.1:1", "answers"]),
]


@pytest.fixture
def bad_files(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_TIMEOUT", 1.0)
    weights = json.loads(TunerNetwork.shipped.read_text())
    files = {
        "twice.yaml": b"duration: 1\nduration: 2\n",
        "hexadecimal.yaml": b"duration: 0x" + 5000 * b"f",
        "tiny.yaml": b"{scenario: paper_fig7, runs: 4, distributions: {gravity: {kind: uniform, low: 9, high: 10}}}",
        "compare.yaml": b"{scenario: paper_fig7, set: {controller: {kind: pid}}, "
        b"controllers: {weak: {controller.kpp: 20.0}}, references: {hold: {reference: {kind: hold}}}}",
        "short.json": resealed(weights | {"hidden_weights": weights["hidden_weights"][:9]}),
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    return contents(tmp_path)


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.slow
@pytest.mark.parametrize(("args", "words"), BAD, ids=lambda v: v[:60] if isinstance(v, str) else "")
def test_bad_input_ends_in_one_line_and_status_2_and_writes_nothing(call, bad_files, tmp_path, args, words):
    status, out, err = call(*shlex.split(args))
    assert (status, out) == (2, "")
    assert err.startswith("stewart-drake: ")
    assert err.count("\n") == 1
    assert len(err) < 800
    assert [word for word in words if word not in err] == [], err
    assert contents(tmp_path) == bad_files


@pytest.mark.usefixtures("without_pictures")
def test_a_run_that_breaks_keeps_everything_and_ends_with_status_3(call, tmp_path):
    status, out, err = call("run", "paper_fig7_uncompensated", *FAST, "--out", "out")
    assert status == 3
    log, metrics = load_log(tmp_path / "out"), json.loads((tmp_path / "out" / "metrics.json").read_text())
    for key, value in (("status", "failed"), ("reason", "crank_dead_centre"), ("leg", log.leg)):
        assert getattr(log, key) == metrics[key] == value
    assert "failed, crank_dead_centre" in out
    last = err.splitlines()[-1]
    assert last.startswith(f"stewart-drake: failed, crank_dead_centre at t = {log.end_time:.3f} s: ")
    assert f"leg {log.leg}" in last
    assert "Traceback" not in err


@pytest.mark.long
def test_ctrl_c_keeps_the_log_and_ends_with_status_130(start, tmp_path):
    code = (
        "from rich.progress import Progress\n"
        "real = Progress.update\n"
        "Progress.update = lambda *args, **options: (\n"
        "    options.get('completed') and open('ticking', 'w').close(), real(*args, **options))\n"
    )
    args = ("run", "paper_fig7", "--set", "duration=100", "--out", "out")
    process = start(*args, code=code + WITHOUT_PICTURES)
    deadline = time.monotonic() + 60
    while not (tmp_path / "ticking").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    log = load_log(tmp_path / "out")
    assert log.status == "interrupted"
    assert 0.0 < log.time[-1] <= log.end_time < 100.0
    assert len({len(values) for values in log.signals.values()}) == 1
    assert "interrupted" in out
    assert f"interrupted at t = {log.end_time:.3f} s: stopped by the user" in err.splitlines()[-1]
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["status"] == "interrupted"


def test_ctrl_c_while_pictures_are_drawn_costs_them_alone(call, monkeypatch, tmp_path):
    monkeypatch.setattr(outputs, "_draw", lambda *_: signal.raise_signal(signal.SIGINT))
    status, out, err = call("run", "exact_fig7", *QUICK, *FAST, "--out", "out")
    assert status == 130
    assert "completed" in out
    assert err.split("\n")[-4:] == ["stewart-drake: pictures: interrupted", "", "stewart-drake: interrupted", ""]
    assert load_log(tmp_path / "out").status == "completed"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"log.parquet", "metrics.json", "scenario.yaml"}


def test_ctrl_c_before_the_run_leaves_nothing_and_ends_with_status_130(call, monkeypatch, tmp_path):
    def interrupted_import(*_args):
        # What pybind11 makes of Ctrl-C while a compiled module loads.
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr(run_commands, "load_scenario", interrupted_import)
    status, out, err = call("run", "paper_fig7")
    assert (status, out) == (130, "")
    assert err.strip() == "stewart-drake: interrupted"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (MemoryError(), 3, "out of memory"),
        (DiskError("x: No space left on device"), 3, "disk: x: No space left on device"),
        (EOFError("Ran out of input"), 4, "internal error: EOFError: Ran out of input"),
        (np.linalg.LinAlgError("Singular"), 4, r"internal error: LinAlgError: Singular \(test_cli\.py, line"),
        (SystemExit("Failure at plant.cc:1"), 4, "internal error: SystemExit: Failure at plant.cc:1"),
        (ConfigurationError("a", 1, "b"), 2, "a: expected b, got 1"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("arguments", [("run", "paper_fig7"), ("--debug", "run", "x"), ("run", "x", "--debug")])
def test_what_goes_wrong_is_one_line_and_on_request_a_traceback(call, monkeypatch, error, status, words, arguments):
    def fail(*_):
        raise error

    monkeypatch.setattr(run_commands, "load_scenario", fail)
    result, out, err = call(*arguments)
    assert (result, out) == (status, "")
    assert re.match(f"stewart-drake: {words}", err.splitlines()[-1])
    assert ("Traceback" in err) == ("--debug" in arguments)
    # click ends the line that Ctrl-C is on, and does so where a file has ended too.
    assert "--debug" in arguments or len(err.strip().splitlines()) == 1


def test_a_long_line_of_a_table_folds_and_the_others_do_not(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    facts = [("a name of some length", "1.0 mm")] * 5 + [("warning", "words and more of them " * 10)]
    print_table("facts", facts)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) == 80
    assert sum("a name of some length" in line for line in lines) == 5
