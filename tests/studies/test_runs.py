"""The one mechanism: runs become rows, on processes, on Dask or here, and are kept as they come."""

import json
import os
import re
import warnings

import numpy as np
import pyarrow.parquet as pq
import pytest
from joblib.externals.loky import get_reusable_executor
from sweep_functions import deadly, faulty, killed_once, number, with_function

from stewart_drake.base.errors import ConfigurationError, StewartDrakeError
from stewart_drake.logs import versions
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run
from stewart_drake.studies.experiment import COMPARED_FIGURES, INCIDENTAL, run_experiment
from stewart_drake.studies.runs import simulate
from stewart_drake.studies.sweep import make_sweep, summary
from stewart_drake.studies.workers import WORKER_ENDED, Workers, run_jobs

HERE = Workers(0)
# In so short a time nothing is followed.
TINY = {"duration": 0.05, "tuner": {"kind": "fixed"}, "log_period": 0.01, "bounds": {"error_ratio": None}}
SPEC = {
    "name": "tiny",
    "scenario": "paper_fig7",
    "runs": 6,
    "seed": 5,
    "set": TINY,
    "mismatch": True,
    "distributions": {
        "initial_offset[0]": {"kind": "uniform", "low": -0.05, "high": 0.05},
        "robot.platform_mass": {"kind": "uniform", "low": 0.8, "high": 1.2, "factor": True},
        "robot.platform_inertia": {"kind": "uniform", "low": 0.8, "high": 1.2, "factor": True},
        "tuner.omega_q": {"kind": "loguniform", "low": 0.1, "high": 10.0},
        "tuner.window": {"kind": "integers", "low": 1, "high": 49},
        "controller.solver": {"kind": "grid", "values": ["split", "drake"]},
        "limits.clearance": {"kind": "choice", "values": [None, 0.0001]},
    },
}


def sweep(function=simulate, **changes):
    return with_function(make_sweep({**SPEC, **changes}), function)


def outcomes(result):
    return {row["index"]: (row["status"], row["reason"]) for row in result.rows["sweep"]}


def same(result):
    # What must not depend on where it was made.
    return result.tables["sweep"].drop([column.name for column in INCIDENTAL])


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return run_experiment(sweep(), tmp_path_factory.mktemp("reference"), HERE)


@pytest.mark.slow
def test_a_row_holds_what_was_drawn_and_the_figures_of_a_direct_run(reference):
    assert outcomes(reference) == dict.fromkeys(range(6), ("completed", None))
    study, table = sweep(), pq.read_table(reference.folder / "sweep.parquet")
    assert table.equals(reference.tables["sweep"], check_metadata=True)
    row, drawn = table.to_pylist()[3], make_sweep(SPEC).trials.draw(3)
    # The log of every tick, whatever log_period says.
    log = run(study.scenario(3))
    metrics = run_metrics(log)
    assert (row["index"], row["seed"], row["status"]) == (3, study.trials[3].labels["seed"], "completed")
    assert row["initial_offset[0]"] == log.scenario.initial_offset[0] == drawn["initial_offset[0]"]
    assert row["robot.platform_mass.factor"] == drawn["robot.platform_mass"]
    assert tuple(json.loads(row["robot.platform_inertia"])) == log.scenario.robot.platform_inertia
    assert [row[f"rmse_{a}_deg"] for a in ("roll", "pitch", "yaw")] == metrics["rmse_deg"]
    assert [row[name] for name in ("torque_rms", "leg")] == [metrics[name] for name in ("torque_rms", "leg")]
    values = table.column("rmse_norm_deg").to_pylist()
    shown = dict(summary(reference.rows["sweep"]))["RMSE of rotation, percentiles 50 95 99, largest"].split()
    assert [float(text) for text in shown[:4]] == pytest.approx(np.percentile(values, [50, 95, 99, 100]), rel=1e-3)


@pytest.mark.slow
def test_what_a_run_raises_is_its_row(tmp_path):
    result = run_experiment(sweep(faulty, runs=4), tmp_path, HERE)
    completed = ("completed", None)
    raised = [("raised", name) for name in ("ZeroDivisionError", "SystemExit")]
    assert list(outcomes(result).values()) == [completed, *raised, completed]
    assert re.fullmatch(r"mine \(sweep_functions\.py, line \d+\)", result.rows["sweep"][1]["message"])


def test_refused_and_broken_runs_are_rows_with_their_reason(tmp_path):
    # Gravity and nothing but (34): after 0.26 s a crank is at its dead centre.
    grids = {"duration": {"kind": "grid", "values": [0.4, 0.05, -1.0]}}
    spec = {"scenario": "paper_fig7_uncompensated", "set": TINY, "distributions": grids}
    result = run_experiment(make_sweep(spec), tmp_path, HERE)
    ends = ("failed", "crank_dead_centre"), ("completed", None), ("rejected", "configuration")
    assert tuple(outcomes(result).values()) == ends
    assert "duration: expected " in result.rows["sweep"][2]["message"]
    assert 0.1 < result.rows["sweep"][0]["end_time"] < 0.4


@pytest.mark.slow
def test_a_sweep_on_the_closed_form_says_how_far_its_first_run_is_from_drakes(tmp_path):
    offset = {"initial_offset[0]": SPEC["distributions"]["initial_offset[0]"]}
    fast = {**TINY, "plant.kind": "closed_form", "controller.solver": "split"}
    study = sweep(runs=2, set=fast, distributions=offset)
    made = run_experiment(study, tmp_path, HERE)
    assert json.loads(made.tables["sweep"].schema.metadata[b"stewart_drake.sweep"])["compared"] == made.compared
    drake = run_metrics(run(study.scenario(0).replace({"plant.kind": "drake"})))
    for name in COMPARED_FIGURES[:2]:
        other, off = map(float, re.search(rf"{name} (\S+) \(here (\S+) %\)", made.compared).groups())
        assert other == pytest.approx(drake[name], rel=0.01)
        assert off == pytest.approx(100.0 * (made.rows["sweep"][0][name] / drake[name] - 1.0), abs=0.06, rel=0.06)


@pytest.mark.slow
def test_processes_give_the_same_table_also_if_one_is_killed_or_they_are_replaced(reference, tmp_path, monkeypatch):
    monkeypatch.setenv("SWEEP_TEST_MARK", str(tmp_path / "mark"))
    # Processes that an earlier study has left know nothing of it.
    get_reusable_executor().shutdown(wait=True)
    two = run_experiment(sweep(killed_once), tmp_path / "out", Workers(2, runs_per_process=2))
    assert (tmp_path / "mark").exists()
    assert same(two).equals(same(reference), check_metadata=True)
    processes = two.tables["sweep"].column("worker").to_pylist()
    assert os.getpid() not in processes
    # Two of two runs each, and another as one was killed.
    assert len(set(processes)) >= 3


def assert_two_died(result, reference):
    died = ("failed", "worker_died")
    assert outcomes(result) == {i: died if i in (1, 4) else ("completed", None) for i in range(6)}
    assert same(result).take([0, 2, 3, 5]).equals(same(reference).take([0, 2, 3, 5]))


@pytest.mark.long
def test_a_run_that_kills_its_worker_twice_is_a_row_and_the_runs_beside_it_are_whole(reference, tmp_path):
    assert_two_died(run_experiment(sweep(deadly), tmp_path, Workers(2)), reference)


@pytest.mark.slow
def test_a_worker_with_another_version_and_one_that_cannot_start_are_told(monkeypatch, tmp_path):
    # Files of the current folder are no code that was trusted.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "argparse.py").write_text("raise SystemExit", encoding="utf-8")
    Workers(2).replace()
    monkeypatch.setattr(versions, "source_digest", lambda: "another")
    with pytest.raises(StewartDrakeError, match="another version of stewart-drake"):
        run_jobs([0], lambda _: (int, ()), lambda *_: None, Workers(2))
    monkeypatch.undo()
    with pytest.raises(StewartDrakeError, match=re.escape(WORKER_ENDED[:40])):
        run_jobs([0], lambda _: (os._exit, (1,)), lambda *_: None, Workers(2))


@pytest.fixture(scope="module")
def cluster():
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    # Dask itself tries a task again that lost its worker, three times if left alone; once makes the tests shorter.
    patient = {"distributed.scheduler.allowed-failures": 1, "distributed.deploy.lost-worker-timeout": "120s"}
    with dask.config.set(patient), warnings.catch_warnings():
        # On a busy machine it complains of a slow disk.
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            yield cluster


@pytest.mark.long
def test_on_dask_the_table_is_the_same_and_a_run_that_kills_its_worker_the_same_row(cluster, reference, tmp_path):
    with Workers(scheduler=cluster.scheduler_address) as where:
        result = run_experiment(sweep(deadly), tmp_path, where)
    assert_two_died(result, reference)
    assert os.getpid() not in result.tables["sweep"].column("worker").to_pylist()


@pytest.mark.usefixtures("code_as_it_is")
def test_more_runs_go_on_where_fewer_ended_or_were_interrupted_and_an_unfinished_line_is_dropped(tmp_path):
    ran, counts, rows = [], [], tmp_path / "rows.jsonl"

    def spy(scenario):
        ran.append(number(scenario))
        return simulate(scenario)

    def interrupt(done):
        if done >= 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_experiment(sweep(spy, runs=4), tmp_path, HERE, interrupt)
    assert rows.read_bytes().count(b"\n") == 1
    rows.write_bytes(rows.read_bytes() + b'{"key": "5, "se')
    few = run_experiment(sweep(spy, runs=2), tmp_path, HERE).tables["sweep"]
    many = run_experiment(sweep(spy, runs=4), tmp_path, HERE, counts.append).tables["sweep"]
    assert ran == [0, 1, 2, 3]
    assert counts == [2.0, 3.0, 4.0]
    assert many.slice(0, 2).to_pylist() == few.to_pylist()
    assert all(json.loads(line) for line in rows.read_text().splitlines())


@pytest.mark.usefixtures("code_as_it_is")
@pytest.mark.parametrize("header", ["", "{", "[1]", '{"seed": 7}'])
def test_a_damaged_row_is_run_again_and_no_more_whatever_became_of_the_header(tmp_path, header, caplog):
    ran, rows = [], tmp_path / "rows.jsonl"

    def spy(scenario):
        ran.append(number(scenario))
        return simulate(scenario)

    whole = run_experiment(sweep(spy, runs=5), tmp_path, HERE).tables["sweep"]
    good = rows.read_bytes()
    lines = good.splitlines()
    # A figure that is another, no row, no JSON, no text.
    lines[0] = re.sub(rb'("rmse_norm_mm": )', rb"\g<1>9", lines[0])
    lines[1], lines[2], lines[4] = b"5", lines[2][:-20], b"\xff\xfe"
    rows.write_bytes(b"\n".join(lines) + b"\n")
    (tmp_path / "study.json").write_text(header)
    again = run_experiment(sweep(spy, runs=5), tmp_path, HERE).tables["sweep"]
    assert ran == [0, 1, 2, 3, 4, 0, 1, 2, 4]
    assert "4 of 5 rows are damaged and run again" in caplog.text
    incidental = [column.name for column in INCIDENTAL]
    assert again.drop(incidental).equals(whole.drop(incidental))
    caplog.clear()
    run_experiment(sweep(spy, runs=5), tmp_path, HERE)
    assert (len(ran), caplog.text) == (9, "")


@pytest.mark.usefixtures("code_as_it_is")
def test_another_sweep_is_never_mixed_in(tmp_path, monkeypatch):
    run_experiment(sweep(runs=1), tmp_path, HERE)
    before = (tmp_path / "rows.jsonl").read_bytes()

    def refused(words, **changes):
        with pytest.raises(ConfigurationError) as caught:
            run_experiment(sweep(runs=1, **changes), tmp_path, HERE)
        assert [word for word in ("--out", "--restart", words) if word not in str(caught.value)] == []
        assert (tmp_path / "rows.jsonl").read_bytes() == before

    refused("seed", seed=6)
    refused("differs in scenario", set={**TINY, "duration": 0.06})
    with monkeypatch.context() as patch:
        patch.setattr(versions, "source_digest", lambda: "changed")
        refused("differs in versions")
    (tmp_path / "study.json").unlink()
    refused("study.json, which cannot be read", seed=6)
    (tmp_path / "own.csv").touch()
    result = run_experiment(sweep(runs=1, seed=6), tmp_path, HERE, restart=True)
    assert result.rows["sweep"][0]["seed"] == sweep(seed=6).trials[0].labels["seed"]
    assert (tmp_path / "own.csv").exists()
    # Another name is no other sweep.
    assert run_experiment(sweep(runs=1, seed=6, name="other"), tmp_path, HERE).rows == result.rows
