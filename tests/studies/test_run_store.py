import dataclasses
import multiprocessing
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import alive, make_network

from stewart_drake.studies.runs import RunStore, run_key
from stewart_drake.errors import ConfigurationError, InfeasibleReferenceError, StewartDrakeError
from stewart_drake.logs import versions
from stewart_drake.runs import simulation
from stewart_drake.scenario import Scenario
from stewart_drake.wording import keys_of

SHORT = Scenario.from_dict(
    {"duration": 0.02, "tuner": {"kind": "fixed"}, "controller": {"solver": "split"}, "limits": {"clearance": None}}
)
OUT_OF_REACH = SHORT.replace({"reference.center": [0, 0, 0, 0, 0, 0.6]})


def several(count):
    return [SHORT.replace({"name": f"run {k}", "tuner.omega_q": 1.0 + k}) for k in range(count)]


@pytest.fixture
def ran(monkeypatch, code_as_it_is):  # noqa: ARG001 - for what it patches
    """Names of the scenarios that were run in this process, in order."""
    names, real = [], simulation.run

    def run(scenario, *args, **options):
        names.append(scenario.name)
        return real(scenario, *args, **options)

    monkeypatch.setattr(simulation, "run", run)
    return names


def one_worker(folder):
    return RunStore(folder / "runs", workers=1)


def modified(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.rglob("*.parquet")}


# --- what comes back -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_logs_come_in_the_order_asked_for_and_are_those_of_a_direct_run(tmp_path):
    scenarios = several(3)
    asked = [scenarios[k] for k in (2, 0, 2, 1)]
    logs = RunStore(tmp_path, 2).run_all(asked)
    assert [log.scenario for log in logs] == asked
    assert len(list(tmp_path.iterdir())) == 3
    direct = simulation.run(scenarios[1])
    assert set(logs[3].signals) == set(direct.signals) - {"plant_state"}
    for name, values in logs[3].signals.items():
        np.testing.assert_array_equal(values, direct[name])
    assert np.abs(logs[0]["torque"] - logs[1]["torque"]).max() > 0.0


def test_what_is_kept_is_read_and_only_the_rest_is_run_under_whatever_name(tmp_path, ran):
    store, scenarios, shares = one_worker(tmp_path), several(3), []
    first = store.run_all(scenarios[:2], shares.append)
    assert ran == ["run 0", "run 1"]
    assert shares == [0.5, 1.0, 1.0]
    shares.clear()
    asked = [scenarios[1], scenarios[2], scenarios[0].replace({"name": "a"}), scenarios[2]]
    again = store.run_all(asked, shares.append)
    assert ran == ["run 0", "run 1", "run 2"]
    assert shares == [1.0, 1.0]
    assert [log.scenario.name for log in again] == ["run 1", "run 2", "a", "run 2"]
    np.testing.assert_array_equal(again[0]["pose"], first[1]["pose"])
    np.testing.assert_array_equal(again[2]["pose"], first[0]["pose"])
    assert again[0].wall_time == first[1].wall_time


def test_a_run_that_breaks_is_kept_as_it_ended(tmp_path, ran):
    # Gravity and nothing but (34): the platform sags until a crank is at its dead centre.
    weak = {"controller.feedforward": "none", "tuner.omega_q": 0.1, "tuner.omega_r": 10.0}
    sagging = SHORT.replace({"duration": 1.0, **weak})
    (first,), (again,) = (one_worker(tmp_path).run_all([sagging]) for _ in range(2))
    assert len(ran) == 1
    assert first.outcome() == again.outcome()
    assert (first.status, first.reason) == ("failed", "crank_dead_centre")
    assert first.time[-1] == pytest.approx(first.end_time, abs=0.006)


# --- files that are not whole --------------------------------------------------------------------------------------


# What else `load_log` refuses, and that it does so by a ConfigurationError, is in tests/logs.
@pytest.mark.parametrize("broken", [lambda whole: whole[: len(whole) // 2], lambda whole: bytes(len(whole))])
def test_a_log_that_cannot_be_read_is_run_again(tmp_path, ran, broken):
    store = one_worker(tmp_path)
    (whole,) = store.run_all([SHORT])
    (path,) = (tmp_path / "runs").iterdir()
    path.write_bytes(broken(path.read_bytes()))
    (again,) = store.run_all([SHORT])
    assert len(ran) == 2
    np.testing.assert_array_equal(again["torque"], whole["torque"])
    store.run_all([SHORT])
    assert len(ran) == 2


# --- keys ----------------------------------------------------------------------------------------------------------


def test_every_section_of_a_scenario_but_its_name_is_in_the_key(monkeypatch):
    first, data = run_key(SHORT), SHORT.to_dict()
    assert set(data) == set(keys_of(Scenario))
    for section in data:
        monkeypatch.setattr(Scenario, "to_dict", lambda _, of=section: {**data, of: "another"})
        assert (run_key(SHORT) == first) is (section == "name"), section


def test_the_content_of_the_weights_file_is_in_the_key(tmp_path):
    path = tmp_path / "tuner.json"
    make_network(seed=0).save(path)
    scenario = SHORT.replace({"tuner": {"kind": "paper", "weights_file": str(path)}})
    first = run_key(scenario)
    make_network(seed=1).save(path)
    second = run_key(scenario)
    make_network(seed=0).save(path)
    assert run_key(scenario) == first != second


@pytest.mark.parametrize("content", [None, b"\xff\xfe"])
def test_a_weights_file_that_cannot_be_read_is_found_before_any_run(tmp_path, ran, content):
    path = tmp_path / "tuner.json"
    if content is not None:
        path.write_bytes(content)
    bad = SHORT.replace({"tuner": {"kind": "paper", "weights_file": str(path)}})
    with pytest.raises(ConfigurationError, match=r"weights file .*tuner\.json"):
        one_worker(tmp_path).run_all([SHORT, bad])
    assert ran == []


def test_other_code_or_another_drake_gives_another_key(monkeypatch):
    keys, real = [run_key(SHORT)], versions.package_version
    for package in ("drake", "numpy", "stewart-drake"):
        with monkeypatch.context() as patch:
            patch.setattr(versions, "package_version", lambda name, of=package: "9" if name == of else real(name))
            keys.append(run_key(SHORT))
    monkeypatch.setattr(versions, "source_digest", lambda: "changed")
    keys.append(run_key(SHORT))
    assert len(set(keys)) == 5


# --- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_scenario_that_a_worker_refuses_comes_back_as_its_own_error(tmp_path):
    with pytest.raises(InfeasibleReferenceError) as caught:
        RunStore(tmp_path, 2).run_all([*several(2), OUT_OF_REACH])
    assert caught.value.limit == "reach"
    assert caught.value.margin < 0.0
    assert "reference: breaks the limit reach at t = 0.000 s" in str(caught.value)
    # Nothing of it is kept, and what was done before is.
    kept = modified(tmp_path)
    assert f"{run_key(OUT_OF_REACH)}.parquet" not in kept
    RunStore(tmp_path, 1).run_all(several(2))
    assert kept.items() <= modified(tmp_path).items()


def test_without_the_check_a_scenario_out_of_its_limits_runs(tmp_path):
    wide = SHORT.replace({"limits.joint_swing": 0.01})
    with pytest.raises(InfeasibleReferenceError):
        one_worker(tmp_path).run_all([wide])
    (log,) = one_worker(tmp_path).run_all([wide], check=False)
    assert log.status == "completed"


# --- interruption --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_is_done_outlives_an_interruption_and_the_next_call_completes_it(tmp_path, workers):
    store, scenarios = RunStore(tmp_path, workers), several(4)

    def interrupt(_):
        raise KeyboardInterrupt

    others = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt):
        store.run_all(scenarios, interrupt)
    assert set(multiprocessing.active_children()) == others
    kept = modified(tmp_path)
    assert 1 <= len(kept) <= 3
    shares = []
    logs = store.run_all(scenarios, shares.append)
    assert [log.scenario for log in logs] == scenarios
    assert shares[0] == (len(kept) + 1) / 4
    assert kept.items() <= modified(tmp_path).items()
    assert len(modified(tmp_path)) == 4


def test_a_run_that_was_stopped_midway_is_not_kept(tmp_path, monkeypatch):
    real = simulation.run
    monkeypatch.setattr(
        simulation, "run", lambda *args, **kw: dataclasses.replace(real(*args, **kw), status="interrupted")
    )
    with pytest.raises(KeyboardInterrupt):
        one_worker(tmp_path).run_all([SHORT])
    assert modified(tmp_path) == {}


SCRIPT = """
import sys
from pathlib import Path
from stewart_drake.studies.runs import RunStore
from stewart_drake.scenario import Scenario

{guard}
    base = Scenario.from_dict({{"duration": {duration}, "tuner": {{"kind": "fixed"}}}})
    scenarios = [base.replace({{"tuner.omega_q": 1.0 + k}}) for k in range(4)]
    RunStore(Path(sys.argv[1]), 2).run_all(scenarios, lambda share: print(share, flush=True), check=False)
"""


@pytest.fixture
def script(start, tmp_path):
    """Starts the script."""

    def script(guard, duration):
        (tmp_path / "script.py").write_text(SCRIPT.format(guard=guard, duration=duration))
        return start(tmp_path / "runs", code=tmp_path / "script.py")

    return script


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="looks for processes in /proc")
def test_ctrl_c_at_a_terminal_ends_all_workers_at_once_and_without_their_tracebacks(tmp_path, script):
    # Each run lasts minutes, so nothing here can end by itself.
    process = script('if __name__ == "__main__":', 2000.0)
    runs = tmp_path / "runs"
    deadline = time.monotonic() + 60.0
    while not runs.is_dir() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(2.0)
    begin = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)  # what a terminal sends: to every process of the group
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - begin < 20.0
    assert process.returncode != 0
    assert err.count("Traceback") == 1, err
    assert err.rstrip().endswith("KeyboardInterrupt")
    while alive(process.pid) and time.monotonic() < begin + 20.0:  # a worker may be a moment behind its caller
        time.sleep(0.1)
    assert alive(process.pid) == []
    assert list(runs.glob("*.parquet")) == []


@pytest.mark.slow
def test_a_script_without_its_guard_is_told_of_it(script):
    process = script("if True:", 0.02)
    _, err = process.communicate(timeout=120)
    assert process.returncode != 0
    name = f"{StewartDrakeError.__module__}.{StewartDrakeError.__name__}"
    (line,) = (line for line in err.splitlines() if line.startswith(name))
    assert "a worker process ended by itself" in line
    assert '`if __name__ == "__main__":`' in line
