"""What a sweep draws, what it refuses, and the command."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from stewart_drake import load_scenario
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.studies.sweep import SweepFile, make_sweep

UNIFORM = {"kind": "uniform", "low": -1.0, "high": 1.0}
PLAIN = {"scenario": "paper_fig7", "runs": 4, "distributions": {"initial_offset[0]": UNIFORM}}
QUANTILES = np.linspace(0.0, 1.0, 1000, endpoint=False)


def sweep(**changes):
    return make_sweep({**PLAIN, **changes})


def drawn_from(**data):
    distribution = SweepFile.from_dict({**PLAIN, "distributions": {"here": data}}).distributions["here"]
    return np.array([distribution.at(q) for q in QUANTILES])


def test_each_distribution_is_even_in_its_number_its_logarithm_or_its_values():
    values, counts = np.unique(drawn_from(kind="integers", low=-1, high=3), return_counts=True)
    assert (values.tolist(), np.ptp(counts)) == ([-1, 0, 1, 2, 3], 0)
    np.testing.assert_allclose(drawn_from(kind="uniform", low=-1.0, high=3.0), 4.0 * QUANTILES - 1.0, atol=1e-12)
    np.testing.assert_allclose(drawn_from(kind="loguniform", low=0.1, high=10.0), 10.0 ** (2.0 * QUANTILES - 1.0))


SEVERAL = {
    "initial_offset[0]": UNIFORM,
    "initial_offset[5]": {"kind": "normal", "mean": 0.0, "std": 0.001},
    "robot.platform_mass": {"kind": "uniform", "low": 0.8, "high": 1.2, "factor": True},
    "tuner.omega_q": {"kind": "grid", "values": [0.5, 1.0, 2.0]},
}


def draws(s):
    return [s.trials.draw(index) for index in range(s.runs)]


def test_a_run_is_the_same_whatever_the_number_of_runs():
    few, many = (sweep(runs=runs, distributions=SEVERAL) for runs in (5, 77))
    assert draws(few) == draws(many)[:5]
    assert len({str(draw) for draw in draws(many)}) == 77
    assert [few.trials.run_seed(i) for i in range(5)] == [many.trials.run_seed(i) for i in range(5)]


def test_keys_and_runs_are_independent_and_the_seed_changes_all():
    two = {"initial_offset[0]": UNIFORM, "initial_offset[1]": UNIFORM}
    values = np.array([list(d.values()) for d in draws(sweep(runs=2000, distributions=two))])
    assert abs(np.corrcoef(values.T)[0, 1]) < 0.08  # 3.6 standard deviations
    assert abs(np.corrcoef(values[:-1, 0], values[1:, 0])[0, 1]) < 0.08
    np.testing.assert_allclose(values.mean(axis=0), 0.0, atol=0.05)
    other = np.array([list(d.values()) for d in draws(sweep(runs=2000, distributions=two, seed=1))])
    assert not np.isin(values, other).any()


def test_grids_run_through_all_their_combinations_the_first_key_fastest():
    grids = {
        "tuner.omega_q": {"kind": "grid", "values": [1.0, 2.0]},
        "controller.solver": {"kind": "grid", "values": ["split", "drake"]},
    }
    s = make_sweep({"scenario": "paper_fig7", "distributions": grids})
    assert s.runs == 4
    assert [tuple(d.values()) for d in draws(s)] == [(1.0, "split"), (2.0, "split"), (1.0, "drake"), (2.0, "drake")]
    assert s.trials.draw(4) == s.trials.draw(0)


def test_a_scenario_gets_what_was_drawn():
    s = sweep(distributions={**SEVERAL, "robot.platform_inertia": {"kind": "choice", "values": [2.0], "factor": True}})
    drawn, scenario = s.trials.draw(1), s.scenario(1)
    assert scenario.initial_offset == (drawn["initial_offset[0]"], 0.0, 0.0, 0.0, 0.0, drawn["initial_offset[5]"])
    assert scenario.robot.platform_mass == s.base.robot.platform_mass * drawn["robot.platform_mass"]
    assert scenario.robot.platform_inertia == tuple(2.0 * x for x in s.base.robot.platform_inertia)
    assert scenario.tuner.omega_q == 1.0
    assert scenario.model.robot is None
    masses = {"robot.platform_mass": {"kind": "uniform", "low": 2.0, "high": 3.0}}
    s = sweep(mismatch=True, distributions=masses, set={"robot.rod_length": 0.41})
    assert s.scenario(0).robot.platform_mass == s.trials.draw(0)["robot.platform_mass"]
    assert s.scenario(0).model.robot == s.base.robot


def test_with_a_mismatch_a_controller_goes_on_believing_in_the_servos_of_the_scenario():
    stiffness = {"motors.stiffness": {"kind": "uniform", "low": 20.0, "high": 30.0}}
    servos = {"motors": {"kind": "position", "stiffness": 25.0}, "safety": None}
    right, wrong = (sweep(mismatch=each, distributions=stiffness, set=servos).scenario(0) for each in (False, True))
    assert right.controller_model.motors == right.motors == wrong.motors
    assert wrong.controller_model.motors.stiffness == 25.0 != wrong.motors.stiffness
    assert wrong.controller_model.motors.delay == wrong.motors.delay


ANY = {"kind": "uniform", "low": 1, "high": 2}


def only(key, **distribution):
    return {"distributions": {key: distribution}}


BAD = [
    # changes, words that the line must have
    ({"scenario": "paper_fig8"}, ["scenario", "'paper_fig8'", "paper_fig7"]),
    ({"set": {"initial_offset[6]": 3}}, ["set.initial_offset[6]", "0 to 5"]),
    (only("gravity", kind="unifrom"), ["distributions.gravity.kind", "'unifrom'", "uniform"]),
    (only("gravity", kind="uniform", low=2, high=1), ["distributions.gravity.high", "more than low, 2"]),
    (only("initial_offset", **ANY), ["distributions.initial_offset", "initial_offset[0]"]),
    (only("model.robot.rod_mass", **ANY), ["model.robot.rod_mass", "mismatch: true"]),
    (only("tuner.window", **ANY), ["tuner.window", "whole number", "1.5"]),
    (only("name", **ANY, factor=True), ["distributions.name", "to multiply"]),
    (only("plant", **ANY), ["distributions.plant", "1.5"]),
]


@pytest.mark.parametrize(("changes", "words"), BAD, ids=[str(words[:2]) for _, words in BAD])
def test_bad_input_is_one_line_that_names_the_key(changes, words):
    with pytest.raises(ConfigurationError) as caught:
        sweep(**changes)
    text = str(caught.value)
    assert [word for word in words if word not in text] == [], text
    assert "\n" not in text
    assert len(text) < 700


TINY = """
scenario: paper_fig7
runs: 12
set: {duration: 0.05, tuner: {kind: fixed}, limits.clearance: null}
distributions:
  initial_offset[0]: {kind: uniform, low: -0.05, high: 0.05}
  initial_offset[5]: {kind: choice, values: [0.0, 0.0, 0.3]}
"""


@pytest.mark.slow
def test_a_sweep_leaves_its_table_prints_its_summary_and_goes_on(call, tmp_path):
    (tmp_path / "tiny.yaml").write_text(TINY)
    status, out, err = call("sweep", "tiny.yaml", "--runs", 4, "--workers", 2)
    assert status == 0, err
    files = {path.name for path in (tmp_path / "runs" / "tiny").iterdir()}
    assert files == {"sweep.parquet", "sweep.csv", "study.json", "rows.jsonl", "sweep.png", "sweep.pdf"}
    table = pq.read_table(tmp_path / "runs" / "tiny" / "sweep.parquet")
    rejected = table.column("status").to_pylist().count("rejected")
    assert table.num_rows == 4
    assert 1 <= rejected <= 3
    lines = {line.split("│")[1].strip(): line.split("│")[2].strip() for line in out.splitlines() if "│" in line}
    assert lines["completed"] == str(4 - rejected)
    assert lines["rejected, configuration"] == str(rejected)
    assert "table and picture in runs/tiny" in out
    # Two more: the first four are not run again.
    assert call("sweep", "tiny.yaml", "--runs", 6, "--quiet", "--workers", 1) == (0, "", "")
    more = pq.read_table(tmp_path / "runs" / "tiny" / "sweep.parquet")
    assert more.num_rows == 6
    assert more.slice(0, 4).to_pylist() == table.to_pylist()


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="looks for processes in /proc")
def test_ctrl_c_keeps_what_is_done_and_the_same_command_goes_on(start, tmp_path):
    (tmp_path / "tiny.yaml").write_text(TINY.replace("0.05, tuner", "0.3, tuner"))
    process = start("sweep", "tiny.yaml", "--workers", 2, "--out", "out")
    rows = tmp_path / "out" / "rows.jsonl"
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and (not rows.exists() or rows.read_bytes().count(b"\n") < 2):
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # what a terminal sends: to every process of the group
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, "Traceback" in err) == (130, "", False)
    kept = rows.read_bytes().splitlines()
    assert 2 <= len(kept) < 12
    assert "interrupted; finished runs are kept in out; the same command continues" in err
    process = start("sweep", "tiny.yaml", "--workers", 2, "--out", "out", "--quiet")
    assert process.communicate(timeout=120) == ("", "")
    assert process.returncode == 0
    assert rows.read_bytes().splitlines()[: len(kept)] == kept
    assert pq.read_table(tmp_path / "out" / "sweep.parquet").column("index").to_pylist() == list(range(12))


def test_units_in_a_grid_are_numbers_and_names_stay_names():
    grids = {
        "plant.payload_mass": {"kind": "grid", "values": ["100 g", 0.2]},
        "robot": {"kind": "grid", "values": ["paper", "reachy_mini"]},
    }
    s = sweep(distributions=grids, runs=None, scenario="exact_breathing", set={"duration": 0.1})
    rows = [trial.labels for trial in s.trials]
    assert [row["plant.payload_mass"] for row in rows] == [0.1, 0.2, 0.1, 0.2]
    assert [row["robot"] for row in rows] == ["paper", "paper", "reachy_mini", "reachy_mini"]
    # What follows from the robot still follows from it.
    assert s.trials[3].scenario().tuner.q_pose != s.trials[1].scenario().tuner.q_pose


def test_with_a_mismatch_delay_and_noise_are_believed_as_they_were():
    delays = {
        "command_delay": {"kind": "grid", "values": [1, 4]},
        "sensors.noise": {"kind": "grid", "values": [0.0, 1e-4]},
    }
    right, wrong = (
        sweep(distributions=delays, runs=None, scenario="exact_breathing", set={}, mismatch=each).trials[3].scenario()
        for each in (False, True)
    )
    base = load_scenario("exact_breathing")
    assert (right.controller_model.delay, wrong.controller_model.delay) == (4, base.controller_model.delay)
    assert right.controller_model.noise > wrong.controller_model.noise == base.controller_model.noise
