"""The commands `moves check`, `moves fix`, `moves export` and `moves play`, and `drive --dance`."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from lagging_servos import Servos

from stewart_drake import run, run_metrics
from stewart_drake.machines.simulated import SimulatedRobot
from stewart_drake.reachy.commands import scenario_to_play
from stewart_drake.reachy.moves import HEAD_HEIGHT, Move, dances, move_json, read_move
from stewart_drake.runs.drive import Drive, connected
from stewart_drake.scenario.scenario import load_driven

makers = pytest.mark.skipif(
    importlib.util.find_spec("reachy_mini_dances_library") is None,
    reason="pip install --no-deps reachy_mini_dances_library",
)


class SimulatedServos(Servos):
    """The plant of a scenario in this process, without a clock."""

    def __init__(self, scenario):
        self.robot = SimulatedRobot(scenario)
        super().__init__(self.robot.reading())
        self.period = self.robot.period

    def read(self):
        for _ in range(self.robot.steps):
            self.robot.advance(False)
        self.angles = self.robot.reading()
        return super().read()._replace(time=self.period * (self.count + 1))

    def command(self, values):
        self.robot.follow(values)


@pytest.fixture
def folder(tmp_path):
    """A jump that cannot be done, and a nod that can."""
    time, where = 0.01 * np.arange(150), tmp_path / "given"
    where.mkdir()
    for name, pitch in (("nod", 0.2 * np.sin(5.0 * time)), ("jump", np.where(time < 0.7, 0.0, 0.3))):
        pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, HEAD_HEIGHT], (150, 1))
        pose[:, 1] = pitch
        (where / f"{name}.json").write_bytes(move_json(Move(name, time, pose, np.zeros((150, 2)), np.zeros(150))))
    return where


def test_moves_are_checked_fixed_and_shaped(call, folder):
    status, out, err = call("moves", "check", "given", "--json")
    low_passed, wrong = err.splitlines()
    assert low_passed.startswith("jump: low-passed at 20 Hz: moved by ")
    assert (status, wrong) == (2, "stewart-drake: 1 of 2 cannot be done; try: stewart-drake moves fix given")
    found = json.loads(out)
    assert (found["nod"]["feasible"], found["jump"]["feasible"]) == (True, False)
    assert found["jump"]["torque"]["margin"] < 0.0 <= found["nod"]["torque"]["margin"]
    assert found["jump"]["torque"]["time"] == pytest.approx(0.7, abs=0.05)
    assert "broken" in call("moves", "check", folder / "jump.json")[1]
    status, out, err = call("moves", "fix", "given", "--out", "fixed")
    assert (status, err) == (0, "")
    assert "averaged ms" in out
    assert "e-" not in out
    assert out.endswith("2 moves in fixed\n")
    assert call("moves", "check", "fixed")[0] == 0
    assert call("moves", "export", "fixed", "--shaped", "reachy_daemon", "--out", "shaped")[0] == 0
    assert len(read_move("shaped/nod.json").time) == 82  # rows at the controller's 50 Hz, until it rests
    assert call("moves", "export", "given/nod.json", "--out", "same")[0] == 0
    np.testing.assert_allclose(read_move("same/nod.json").pose, read_move("given/nod.json").pose, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("check nowhere.json", "No such file"),
        ("check simple_nod", "or for a dance dance:simple_nod, got"),
        ("check given/nod.json --shaped x", "No such option"),
        ("export given/nod.json --shaped reachy_nod", "motors that take angles"),
        ("fix given/nod.json --out given/nod.json", "is a file"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_what_is_wrong_is_a_line(call, arguments, said):
    status, _, err = call("moves", *arguments.split())
    assert status == 2
    assert said in err
    assert len(err.splitlines()) == 1


def test_a_gap_in_a_recording_is_named(call, folder):
    move = read_move(folder / "nod.json")
    late = move._replace(time=move.time + np.where(move.time > 0.5, 0.7, 0.0))
    (folder / "late.json").write_bytes(move_json(late))
    for name in ("nod", "late"):
        out = call("moves", "check", folder / f"{name}.json")[1]
        assert ("late: no rows for 0.71 s after 0.5 s, where the motion is a guess" in out) == (name == "late")


@pytest.mark.parametrize("what", ["fix", "export"])
def test_what_is_read_is_never_written_over_and_what_is_there_with_force_alone(call, folder, what):
    before = {path: path.read_bytes() for path in folder.iterdir()}
    for source in ("given/nod.json", "given"):
        status, _, err = call("moves", what, source, "--out", "given", "--force")
        assert (status, "which is read" in err, len(err.splitlines())) == (2, True, 1)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    other = folder.parent / "other" / "nod.json"
    other.parent.mkdir()
    other.write_text("mine")
    status, _, err = call("moves", what, "given/nod.json", "--out", "other")
    assert (status, "nod.json, or --force" in err, other.read_text()) == (2, True, "mine")
    assert call("moves", what, "given/nod.json", "--out", "other", "--force")[0] == 0
    assert len(read_move(other).time) == 150


def test_a_file_that_is_no_move_does_not_hide_the_others(call, folder):
    (folder / "jump.json").unlink()
    (folder / "foreign.json").write_text('{"name": 3}')
    status, out, err = call("moves", "check", "given", "--json")
    found = json.loads(out)
    assert (status, found["nod"]["feasible"], found["foreign"]["feasible"]) == (2, True, False)
    assert "set_target_data" in found["foreign"]["no_move"]
    assert err == "stewart-drake: 1 of 2 are no moves: foreign.json\n"
    assert "no move: expected" in call("moves", "check", "given")[1]
    status, out, err = call("moves", "fix", "given", "--out", "fixed")
    assert (status, "foreign.json" in err, len(err.splitlines())) == (2, True, 1)
    assert [path.name for path in (folder.parent / "fixed").iterdir()] == ["nod.json"]


def test_a_move_that_was_not_fixed_is_named_with_the_time_and_what_to_do(call, folder):
    move = read_move(folder / "nod.json")
    pose = move.pose + np.outer(np.where(move.time < 0.5, 0.0, 1.0), [0, 0, 0, 0, 0, 0.1])
    (folder / "wild.json").write_bytes(move_json(move._replace(pose=pose)))
    status, _, err = call("moves", "export", "given/wild.json", "--shaped", "reachy_daemon")
    assert (status, len(err.splitlines())) == (2, 1)
    assert "move wild" in err
    assert re.search(r"at 0\.(4[5-9]|5)", err)  # as soon as the low pass begins to follow the jump
    assert err.endswith("try: stewart-drake moves fix\n")


@pytest.mark.slow
def test_a_move_that_breaks_a_limit_is_played_fixed_and_no_faster_than_the_motors_can(call, folder):
    status, out, err = call("moves", "play", folder / "jump.json", "--dry")
    assert (status, err) == (0, "")
    assert re.search(r"jump: fixed, by up to 0 mm and 6\.\d+ deg, 1\.\d+ times as long, for its motors; 1\.\d+ s", out)
    assert out.endswith("nothing was moved\n")
    scenario = load_driven("reachy_servos").replace({"plant": {"kind": "closed_form"}})
    played = scenario_to_play(scenario, str(folder / "jump.json"), force=False)
    assert Path(played.reference.motion_file) == folder.parent / "runs" / "moves" / "jump.json"
    assert run(played).status == "completed"
    both = played, played.replace({"reference.time_scale": 1.0})
    errors = [run_metrics(run(each, check=False))["error_max_deg"] for each in both]
    assert errors[0] < 0.5 * errors[1]
    nod = scenario_to_play(scenario, str(folder / "nod.json"), force=False)
    assert (nod.reference.motion_file, nod.reference.time_scale) == (str(folder / "nod.json"), 1.0)


@pytest.mark.long
@makers
def test_all_dances_are_played_to_the_end(tmp_path, monkeypatch, capsys):
    """As docs/reachy_mini.md counts them."""
    monkeypatch.chdir(tmp_path)
    scenario = load_driven("reachy_servos").replace({"plant": {"kind": "closed_form"}})
    logs = {name: run(scenario_to_play(scenario, name, force=False), check=False) for name in dances()}
    assert {log.status for log in logs.values()} == {"completed"}
    told = capsys.readouterr().out
    assert (len(logs), told.count(": fixed, "), told.count("as long, for its motors")) == (20, 7, 6)


@pytest.mark.long
@makers
@pytest.mark.parametrize("name", ["headbanger_combo", "jackson_square", "grid_snap"])
def test_a_fixed_dance_is_driven_as_it_is_simulated(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    scenario = load_driven("reachy_servos").replace({"plant": {"kind": "closed_form"}})
    played = scenario_to_play(scenario, name, force=False)
    log = Drive(played, machine := SimulatedServos(played), connected(played, machine)).run()
    assert log.status == "completed"
    assert run_metrics(log)["error_max_deg"] < 5.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("reachy_servos --dance nowhere.json", "move nowhere.json: "),
        ("reachy_nod --dance nod.json", "model.motors: expected motors that take angle"),
        ("hobby_servos --dance nod.json", "a scenario of reachy_mini, home at Z = 0.177 m, not 0.151 m"),
        pytest.param("reachy_servos --dance simple_nodd", "did you mean simple_nod?", marks=makers),
        ("reachy_servos --dance nod.json", "no daemon of Reachy Mini answers there"),
        ("reachy_servos --dance runs/moves/jump.json", "which is read"),
        ("reachy_servos --dance jump.json", "runs/moves"),
    ],
)
def test_a_dance_that_cannot_be_driven_is_a_line(call, folder, arguments, said, monkeypatch):
    theirs = folder.parent / "runs" / "moves" / "jump.json"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes((folder / "jump.json").read_bytes())
    monkeypatch.chdir(folder if "runs/" not in arguments else folder.parent)
    if arguments.endswith(" jump.json"):
        (folder / "runs" / "moves").mkdir(parents=True)
        (folder / "runs" / "moves" / "jump.json").write_text("mine")
    status, _, err = call("drive", *arguments.split(), "--machine", "reachy://127.0.0.1:1", "--out", "there")
    assert status in (2, 3)
    assert said in err
    assert len(err.splitlines()) == 1
