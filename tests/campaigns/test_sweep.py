import dataclasses
import json
import logging
import multiprocessing
import os
import re
import shutil
import signal
import socket
import threading
import warnings
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import code_frozen
from sweep_functions import deadly, faulty, killed_once, number, slow

from stewart_drake.campaigns import engine, executors
from stewart_drake.campaigns.comparison_table import BANDS, table_columns
from stewart_drake.campaigns.executors import DaskCluster, LocalProcesses, SerialExecutor, Workplace
from stewart_drake.campaigns.one_run import simulate
from stewart_drake.campaigns.sweep import run_sweep, summary
from stewart_drake.campaigns.sweep_file import BEFORE, Sweep
from stewart_drake.campaigns.tables import INCIDENTAL, to_parquet
from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.files.code_trust import trusting_code
from stewart_drake.logs import metric_table, versions
from stewart_drake.logs.metric_table import Metric, add_metric
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run

ROOT = Path(__file__).parent.parent.parent
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


def sweep(**changes):
    return Sweep.from_dict({**SPEC, **changes})


def same(result):
    """The part of a table that must not depend on where it was made."""
    return result.table.drop([column.name for column in INCIDENTAL])


def assert_same(one, other):
    assert same(one).equals(same(other), check_metadata=True)


def outcomes(result):
    return {row["index"]: (row["status"], row["reason"]) for row in result.rows}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The tiny sweep in this process, one run after the other."""
    return run_sweep(sweep(), tmp_path_factory.mktemp("reference"), SerialExecutor())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The same, with what is on the disk, and made by the code as it is."""
    folder = tmp_path_factory.mktemp("whole")
    with code_frozen():
        return run_sweep(sweep(), folder, SerialExecutor()), folder


# --- the table -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_row_holds_what_was_drawn_and_the_figures_of_a_direct_run(reference):
    assert outcomes(reference) == dict.fromkeys(range(6), ("completed", None))
    s = sweep()
    for index in (0, 3):
        row = {name: reference.table.column(name)[index].as_py() for name in reference.table.column_names}
        # The log of every tick, whatever log_period says.
        log = run(s.scenario(index).replace({"log_period": None}))
        metrics, drawn = run_metrics(log), s.draw(index)
        assert (row["index"], row["seed"], row["status"]) == (index, s.run_seed(index), "completed")
        assert row["initial_offset[0]"] == log.scenario.initial_offset[0] == drawn["initial_offset[0]"]
        assert row["robot.platform_mass"] == log.scenario.robot.platform_mass
        assert row["robot.platform_mass.factor"] == drawn["robot.platform_mass"]
        assert tuple(json.loads(row["robot.platform_inertia"])) == log.scenario.robot.platform_inertia
        assert (row["tuner.window"], row["controller.solver"]) == (
            drawn["tuner.window"],
            log.scenario.controller.solver,
        )
        assert json.loads(row["limits.clearance"]) == log.scenario.limits.clearance
        assert [row[f"rmse_{a}_deg"] for a in ("roll", "pitch", "yaw")] == metrics["rmse_deg"]
        assert [row[f"peak_{a}_mm"] for a in "xyz"] == metrics["peak_mm"]
        assert row["rmse_norm_mm"] == pytest.approx(np.linalg.norm(metrics["rmse_mm"]))
        assert max(metrics["peak_deg"]) <= row["peak_norm_deg"] <= np.linalg.norm(metrics["peak_deg"]) * (1.0 + 1e-12)
        for name in ("torque_rms", "torque_peak", "saturated_fraction", "loop_gap_max_m", "end_time", "leg"):
            assert row[name] == metrics[name]
        assert row["finite"] is True
        assert row["wall_s"] > row["simulation_s"] > 0.0
        assert (row["host"], row["worker"]) == (os.uname().nodename, os.getpid())
    assert len(set(reference.table.column("rmse_norm_deg").to_pylist())) == 6


def test_the_file_is_the_table_and_says_what_it_is(reference):
    table = pq.read_table(reference.path)
    assert table.equals(reference.table, check_metadata=True)
    about = json.loads(table.schema.metadata[b"stewart_drake.sweep"])
    assert about["sweep"] == sweep().to_dict()
    assert about["versions"]["drake"] == "1.51.1"
    assert all(field.metadata[b"text"] for field in table.schema)
    assert table.schema.field("rmse_norm_mm").metadata[b"unit"] == b"mm"


def test_the_summary_counts_and_ranks(reference):
    lines = dict(summary(reference.rows))
    assert (lines["runs"], lines["completed"]) == ("6", "6")
    values = reference.table.column("rmse_norm_deg").to_pylist()
    shown = lines["RMSE of rotation, percentiles 50 95 99, largest"].split()
    assert [float(text) for text in shown[:4]] == pytest.approx(np.percentile(values, [50, 95, 99, 100]), rel=1e-3)
    assert summary([{**reference.rows[0], "rmse_norm_deg": None, "rmse_norm_mm": None}])[-1] == ("completed", "1")


@pytest.fixture
def _metrics_as_they_were():
    before = list(metric_table.METRICS)
    yield
    metric_table.METRICS[:] = before


@pytest.mark.usefixtures("_metrics_as_they_were")
def test_a_metric_from_outside_is_in_every_table(tmp_path):
    def way(rows):
        return 1e3 * np.linalg.norm(np.diff(rows["pose"][:, 3:], axis=0), axis=1).sum()

    mine = Metric("way_mm", "mm", "way of the platform", way, "steps")
    add_metric(mine)
    add_metric(mine)  # as a cell of a notebook does
    result = run_sweep(sweep(runs=1), tmp_path, SerialExecutor())
    log = run(sweep().scenario(0).replace({"log_period": 0.001}))
    expected = 1e3 * np.linalg.norm(np.diff(log["pose"][:, 3:], axis=0), axis=1).sum()
    assert run_metrics(log)["way_mm"] == pytest.approx(expected)
    assert result.table.column("way_mm").to_pylist() == [pytest.approx(expected)]
    assert result.table.schema.field("way_mm").metadata[b"unit"] == b"mm"
    assert "way_mm" in [column.name for column in table_columns()]
    columns = (*BEFORE, *INCIDENTAL, *BANDS, *table_columns())
    names = set(result.rows[0]) - set(result.table.column_names)
    names |= {*run_metrics(log), *log.scenario.to_dict(), *(column.name for column in columns)}
    for taken in ("rmse_mm", "rmse_x_mm", *sorted(names - {"way_mm"})):
        with pytest.raises(ConfigurationError, match="a name that no metric or column has"):
            add_metric(dataclasses.replace(mine, name=taken))
    # Rows without it are of another version.
    del metric_table.METRICS[-1]
    with pytest.raises(ConfigurationError, match=r"another version \(columns\)"):
        run_sweep(sweep(runs=1), tmp_path, SerialExecutor())


@pytest.mark.usefixtures("_metrics_as_they_were", "code_as_it_is")
def test_a_metric_with_another_body_or_one_that_raises_or_that_workers_lack_is_told(tmp_path, monkeypatch):
    add_metric(Metric("own", "1", "a number", lambda _: 1.0))
    run_sweep(sweep(runs=1), tmp_path / "a", SerialExecutor())
    run_sweep(sweep(runs=1), tmp_path / "a", SerialExecutor(), function=lambda _: pytest.fail("ran"))
    add_metric(Metric("own", "1", "a number", lambda _: 2.0))
    with pytest.raises(ConfigurationError, match="another version"):
        run_sweep(sweep(runs=1), tmp_path / "a", SerialExecutor())
    add_metric(Metric("own", "1", "a number", lambda _: 1 / 0, "steps"))
    (row,) = run_sweep(sweep(runs=1), tmp_path / "b", SerialExecutor()).rows
    assert (row["status"], row["reason"]) == ("raised", "metric_raised")
    assert re.fullmatch(r"metric own: ZeroDivisionError: .* \(test_sweep\.py, line \d+\)", row["message"])
    monkeypatch.setattr(engine, "METRICS", metric_table.METRICS[:-1])
    with pytest.raises(StewartDrakeError, match="a worker does not have the metric own"):
        engine.warm_up("as it is", [metric.name for metric in metric_table.METRICS])


# --- the same table from any executor ------------------------------------------------------------------------------


@pytest.mark.slow
def test_threads_and_processes_give_the_same_table(reference, tmp_path):
    with ThreadPoolExecutor(2) as pool:
        assert_same(run_sweep(sweep(), tmp_path / "threads", pool), reference)
        assert pool.submit(int, "3").result() == 3  # it stays open
    others = set(multiprocessing.active_children())
    two = run_sweep(sweep(), tmp_path / "processes", LocalProcesses(2))
    assert_same(two, reference)
    assert os.getpid() not in two.table.column("worker").to_pylist()
    assert set(multiprocessing.active_children()) == others


@pytest.mark.usefixtures("code_as_it_is")
def test_more_runs_go_on_where_fewer_ended_or_were_interrupted_and_keep_their_rows(tmp_path):
    ran, counts = [], []

    def spy(scenario):
        ran.append(number(scenario))
        return simulate(scenario)

    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep(runs=4), tmp_path, SerialExecutor(), interrupt_at(1), function=spy)
    assert len((tmp_path / "rows.jsonl").read_bytes().splitlines()) == 1
    assert not (tmp_path / "sweep.parquet").exists()
    few = run_sweep(sweep(runs=2), tmp_path, SerialExecutor(), function=spy)
    many = run_sweep(sweep(runs=4), tmp_path, SerialExecutor(), counts.append, function=spy)
    assert ran == [0, 1, 2, 3]
    assert counts == [2.0, 3.0, 4.0]
    assert many.table.slice(0, 2).to_pylist() == few.table.to_pylist()
    fewer = run_sweep(sweep(runs=3), tmp_path, SerialExecutor(), function=spy)
    assert ran == [0, 1, 2, 3]
    assert fewer.table.to_pylist() == many.table.slice(0, 3).to_pylist()


# --- what goes wrong is a row --------------------------------------------------------------------------------------

FAULTS = {
    0: ("completed", None),
    1: ("raised", "ZeroDivisionError"),
    2: ("raised", "SystemExit"),
    3: ("raised", "RecursionError"),
    4: ("raised", "MemoryError"),
    5: ("completed", None),
}


@pytest.mark.slow
def test_what_a_run_raises_is_its_row(reference, tmp_path):
    serial = run_sweep(sweep(), tmp_path / "serial", SerialExecutor(), function=faulty)
    assert outcomes(serial) == FAULTS
    messages = [serial.rows[index]["message"] for index in (1, 2, 4)]
    assert re.fullmatch(r"mine \(sweep_functions\.py, line \d+\)", messages[0])
    assert re.fullmatch(r"7 \(sweep_functions\.py, line \d+\)", messages[1])
    assert messages[2] == "MemoryError"
    assert serial.table.column("rmse_norm_deg").to_pylist()[1:5] == [None] * 4
    assert (
        serial.table.column("initial_offset[0]").to_pylist() == reference.table.column("initial_offset[0]").to_pylist()
    )
    two = run_sweep(sweep(), tmp_path / "two", LocalProcesses(2), function=faulty)
    assert_same(two, serial)


def test_refused_and_broken_runs_are_rows_with_their_reason(tmp_path):
    # Gravity and nothing but (34): after 0.26 s a crank is at its dead centre.
    spec = {"scenario": "paper_fig7_uncompensated", "set": TINY}
    keys = {"duration": [0.4, 0.05, -1.0], "reference.center[5]": [0.3, 0.6]}
    spec["distributions"] = {key: {"kind": "grid", "values": values} for key, values in keys.items()}
    result = run_sweep(Sweep.from_dict(spec), tmp_path, SerialExecutor())
    refused = ("rejected", "configuration")
    far = ("rejected", "infeasible_reference")
    sagging = ("failed", "crank_dead_centre")
    assert outcomes(result) == {0: sagging, 1: ("completed", None), 2: refused, 3: far, 4: far, 5: refused}
    assert "duration: expected " in result.rows[2]["message"]
    sagged = result.rows[0]
    assert 0.1 < sagged["end_time"] < 0.4
    assert sagged["leg"] in range(6)
    assert sagged["torque_peak"] > 0.0
    assert "dead centre" in sagged["message"]
    assert dict(summary(result.rows))["rejected, infeasible_reference"] == "2"


def assert_two_died(result, reference):
    """By `deadly`: runs 1 and 4, and the others are whole."""
    died = ("crashed", "worker_died")
    assert outcomes(result) == {i: died if i in (1, 4) else ("completed", None) for i in range(6)}
    for index in (0, 2, 3, 5):
        assert same(result).slice(index, 1).equals(same(reference).slice(index, 1))


@pytest.mark.slow
def test_a_run_that_kills_its_worker_is_a_row_and_the_runs_beside_it_are_whole(reference, tmp_path):
    result = run_sweep(sweep(), tmp_path, LocalProcesses(2), function=deadly)
    assert_two_died(result, reference)
    assert "alone in it" in result.rows[1]["message"]
    assert result.table.column("initial_offset[0]").equals(reference.table.column("initial_offset[0]"))
    assert result.table.column("worker").to_pylist()[1] is None


@pytest.mark.slow
def test_a_worker_that_somebody_kills_costs_nothing(reference, tmp_path, monkeypatch):
    monkeypatch.setenv("SWEEP_TEST_MARK", str(tmp_path / "mark"))
    result = run_sweep(sweep(), tmp_path / "out", LocalProcesses(2), function=killed_once)
    assert (tmp_path / "mark").exists()
    assert_same(result, reference)


class Broken(Executor):
    """Every task of it meets the same end."""

    def __init__(self, error):
        self.error = error

    def submit(self, function, /, *_args, **_kwargs):
        future = Future()
        if function is engine.warm_up:
            future.set_result(None)
        else:
            future.set_exception(self.error)
        return future


@pytest.mark.slow
def test_workers_are_replaced_once_they_are_worn(reference, tmp_path):
    class Wearing(Workplace):
        worn, opened = 2, 0

        def open(self, most):
            assert most >= 1
            self.opened += 1
            return SerialExecutor()

        def close(self, _, abort):
            assert not abort

    place = Wearing()
    assert_same(run_sweep(sweep(), tmp_path, place), reference)
    assert place.opened == 3
    assert LocalProcesses(2).worn < 1000  # a run of Drake's leaves some tenths of a megabyte behind


def test_an_executor_that_fails_by_itself_is_said_so_and_is_no_row(tmp_path):
    with pytest.raises(StewartDrakeError, match="the executor failed: OSError: no network"):
        run_sweep(sweep(), tmp_path, Broken(OSError("no network")))
    broken = Broken(BrokenProcessPool("gone"))
    broken._broken = "gone"
    with pytest.raises(StewartDrakeError, match="died, and an executor that is handed over"):
        run_sweep(sweep(), tmp_path, broken)
    assert (tmp_path / "rows.jsonl").read_bytes() == b""


@pytest.mark.slow
def test_a_worker_with_another_version_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(versions, "source_digest", lambda: "another")
    with pytest.raises(StewartDrakeError, match="another version of stewart-drake"):
        run_sweep(sweep(), tmp_path, LocalProcesses(1))


def test_a_finite_blow_up_and_a_signal_that_is_not_finite_are_told_apart(tmp_path):
    def broken(scenario):
        log = simulate(scenario)
        what = number(scenario)
        pose = log["pose"].copy()
        pose[-1, 0] = (np.nan, 1e200)[what] if what < 2 else 0.0
        return dataclasses.replace(log, signals={**log.signals, "pose": pose}, figures=None)

    result = run_sweep(sweep(runs=3), tmp_path, SerialExecutor(), function=broken)
    assert result.table.column("finite").to_pylist() == [False, True, True]
    rmse = result.table.column("rmse_norm_deg").to_pylist()
    assert rmse[:2] == [None, None]
    assert np.isfinite(rmse[2])
    first, second, third = result.table.column("not_finite").to_pylist()
    assert third is None
    assert {"rmse_norm_deg nan", "peak_roll_deg nan"} <= set(first.split(", "))
    assert {"rmse_norm_deg inf", "rmse_roll_deg inf"} <= set(second.split(", "))
    # Nothing that the table says depends on whether its rows come from the workers or from the disk.
    again = run_sweep(sweep(runs=3), tmp_path, SerialExecutor(), function=lambda _: pytest.fail("ran"))
    assert again.path.read_bytes() == to_parquet(result.table)
    for line in (tmp_path / "rows.jsonl").read_text().splitlines():
        json.loads(line, parse_constant=lambda name: pytest.fail(name))


# --- interruption and what is on disk ------------------------------------------------------------------------------


def interrupt_at(count):
    def progress(done):
        if done >= count:
            raise KeyboardInterrupt

    return progress


@pytest.mark.slow
@pytest.mark.usefixtures("code_as_it_is")
@pytest.mark.parametrize(
    "tear",
    [
        lambda _: b'{"index": 5, "se',
        lambda _: b"[]\n{}\nnull\n\xff\xfe{}\n" + b"\0" * 40,
        lambda _: b"[" * 100_000 + b'\n{"index": [5]}\n{"index": -1}\n{"index": 1' + b"0" * 5000 + b"}\n",
        lambda line: line.replace(b'"completed"', b'"Completed"'),
        lambda line: line.replace(b'"index": 5', b'"index": 4'),
    ],
)
def test_a_line_that_is_not_whole_is_run_again(whole, tmp_path, tear):
    first, folder = whole
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    rows = tmp_path / "rows.jsonl"
    lines = rows.read_bytes().splitlines(keepends=True)
    assert tear(lines[5]) != lines[5]
    rows.write_bytes(b"".join(lines[:5]) + tear(lines[5]))
    again = run_sweep(sweep(), tmp_path, SerialExecutor())
    assert_same(again, first)
    assert again.table.slice(0, 5).equals(first.table.slice(0, 5))
    assert again.rows[5]["wall_s"] != first.rows[5]["wall_s"]
    third = run_sweep(sweep(), tmp_path, SerialExecutor())
    assert third.table.equals(again.table)


@pytest.mark.usefixtures("code_as_it_is")
def test_another_sweep_is_never_mixed_in(tmp_path, monkeypatch):
    run_sweep(sweep(runs=1), tmp_path, SerialExecutor())
    before = (tmp_path / "rows.jsonl").read_bytes()

    def refused(words, **changes):
        with pytest.raises(ConfigurationError) as caught:
            run_sweep(sweep(runs=1, **changes), tmp_path, SerialExecutor())
        assert [word for word in ("--out", "--restart", words) if word not in str(caught.value)] == []
        assert (tmp_path / "sweep.parquet").exists()
        assert (tmp_path / "rows.jsonl").read_bytes() == before

    refused("seed", seed=6)
    refused("scenario.duration", set={**TINY, "duration": 0.06})
    refused("sampler", sampler="sobol")
    other = {**SPEC["distributions"], "initial_offset[0]": {"kind": "uniform", "low": -0.05, "high": 0.06}}
    refused("distributions.initial_offset[0].high", distributions=other)
    with monkeypatch.context() as patch:
        patch.setattr(versions, "source_digest", lambda: "changed")
        refused("made by another version (versions.source)")
    with monkeypatch.context() as patch:
        patch.setattr(metric_table, "METRICS", metric_table.METRICS[1:])
        refused("made by another version (columns)")
    header = (tmp_path / "sweep.json").read_bytes()
    for broken in (b"{", header.replace(b'"seed": 5', b'"seed": 6'), None):
        (tmp_path / "sweep.json").unlink()
        if broken is not None:
            (tmp_path / "sweep.json").write_bytes(broken)
        # Its rows tell whose they are.
        refused("sweep.json that can be read", seed=6)
    run_sweep(sweep(runs=1), tmp_path, SerialExecutor(), function=lambda _: pytest.fail("ran"))
    assert (tmp_path / "sweep.json").read_bytes() == header
    # A table without its rows is nobody's, so it is not written over unasked.
    for name in ("sweep.json", "rows.jsonl"):
        (tmp_path / name).unlink()
    before = b""
    refused("sweep.parquet is there")
    # Another name is no other sweep; a restart makes room.
    result = run_sweep(sweep(runs=1, seed=6), tmp_path, SerialExecutor(), restart=True)
    assert result.rows[0]["seed"] == sweep(seed=6).run_seed(0)
    assert run_sweep(sweep(runs=1, seed=6, name="other"), tmp_path, SerialExecutor()).rows == result.rows


# --- Dask ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster():
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    # Dask itself tries a task again that lost its worker, three times if left alone; once makes the tests shorter. And
    # on a busy machine a worker may take its time to come back.
    patient = {"distributed.scheduler.allowed-failures": 1, "distributed.deploy.lost-worker-timeout": "120s"}
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with dask.config.set(patient), warnings.catch_warnings():
        # On a busy machine it complains of a slow disk.
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(**options) as cluster:
            yield cluster


@pytest.mark.slow
def test_a_dask_cluster_that_loses_a_worker_gives_the_same_table(cluster, reference, tmp_path):
    killed = []

    def progress(done):
        if done >= 2 and not killed:
            # What Dask has to say about it is not for the terminal.
            assert logging.getLogger("distributed.client").disabled
            killed.append(json.loads((tmp_path / "rows.jsonl").read_bytes().splitlines()[-1])["worker"])
            os.kill(killed[0], signal.SIGKILL)

    result = run_sweep(sweep(), tmp_path, DaskCluster(cluster.scheduler_address), progress, function=slow)
    assert_same(result, reference)
    assert len(killed) == 1
    assert os.getpid() not in result.table.column("worker").to_pylist()


@pytest.mark.slow
def test_on_dask_a_run_that_kills_its_worker_is_the_same_row(cluster, reference, tmp_path):
    result = run_sweep(sweep(), tmp_path, DaskCluster(cluster.scheduler_address), function=deadly)
    assert_two_died(result, reference)


@pytest.mark.slow
def test_the_command_runs_on_a_cluster(cluster, reference, call):
    Path("tiny.yaml").write_text(json.dumps(SPEC))
    status, out, _ = call("sweep", "tiny.yaml", "--scheduler", cluster.scheduler_address, "--out", "dask")
    assert (status, "completed" in out) == (0, True)
    table = pq.read_table("dask/sweep.parquet")
    assert table.drop([column.name for column in INCIDENTAL]).equals(same(reference), check_metadata=True)
    assert os.getpid() not in table.column("worker").to_pylist()


@pytest.mark.slow
def test_the_users_code_runs_on_a_cluster_as_long_as_it_is_what_was_trusted(cluster, tmp_path):
    code = tmp_path / "mine.py"
    code.write_text("class Push:\n    def evaluate(self, t):\n        return [0, 0, 0, 0, 0, t]\n")
    values = [[], [f"{code}:Push"]]
    spec = {**SPEC, "runs": 4, "distributions": {"disturbances": {"kind": "grid", "values": values}}}
    with trusting_code():
        plan = Sweep.from_dict(spec)
    where = DaskCluster(cluster.scheduler_address)
    statuses = [row["status"] for row in run_sweep(plan, tmp_path / "one", where).rows]
    assert statuses == ["completed"] * 4
    code.write_text(code.read_text() + "\n")
    with pytest.raises(ConfigurationError, match="has changed"):
        run_sweep(plan, tmp_path / "two", where)


@pytest.fixture
def listener():
    """A port that talks of something else, hangs up, or takes what it is told and says nothing."""
    with ExitStack() as opened:

        def listener(answer):
            server = opened.enter_context(socket.create_server(("127.0.0.1", 0)))
            opened.callback(server.shutdown, socket.SHUT_RDWR)

            def serve():
                with suppress(OSError):
                    while True:
                        call = opened.enter_context(server.accept()[0])
                        if answer is not None:
                            call.sendall(answer)
                            call.close()

            threading.Thread(target=serve, daemon=True).start()
            return f"tcp://127.0.0.1:{server.getsockname()[1]}"

        yield listener


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_or_is_none_is_bad_input(monkeypatch, listener):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "CONNECT_TIMEOUT", 1.0)
    strange = [listener(answer) for answer in (b"HTTP/1.0 400 Bad Request\r\n\r\n", b"", None)]
    for address in ("tcp://127.0.0.1:1", "nonsense://x", "tcp://127.0.0.1:notaport", *strange):
        with pytest.raises(ConfigurationError, match=r"--scheduler: expected the address of a Dask scheduler"):
            DaskCluster(address).connect()
    assert not logging.getLogger("distributed.client").disabled


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(ConfigurationError, match=r"stewart-drake\[dask\]"):
        DaskCluster("tcp://127.0.0.1:8786")
