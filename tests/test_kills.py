"""kill -9 at any instant costs what was under way: of a study, and of a motion on a machine."""

import os
import random
import subprocess
import sys
import time
import uuid
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import COMMAND, environment

from stewart_drake import load_log, run_metrics
from stewart_drake.logs.journal import JOURNAL
from stewart_drake.machines.machine import open_machine
from stewart_drake.runs.replay import write_replay
from stewart_drake.scenario.scenario import load_driven
from stewart_drake.studies.experiment import INCIDENTAL

KILLS = int(os.environ.get("STEWART_DRAKE_KILLS", "1"))
SWEEP = """
scenario: paper_fig7
runs: 8
set: {duration: 0.3, tuner: {kind: fixed}, limits.clearance: null}
distributions:
  initial_offset[0]: {kind: uniform, low: -0.05, high: 0.05}
  initial_offset[5]: {kind: choice, values: [0.0, 0.0, 0.3]}
"""
ARGS = ["sweep", "sweep.yaml", "--workers", "2"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    return tmp_path


def begin(out, mark):
    driver = out.parent / "driver.py"
    driver.write_text(f'if __name__ == "__main__":\n    {COMMAND}\n')
    command = [sys.executable, str(driver), *ARGS, "--out", str(out), "--quiet"]
    return subprocess.Popen(command, env=environment(KILL_TEST=mark), stderr=subprocess.PIPE, text=True)


def finish(out):
    process = begin(out, "none")
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err


def alive(mark):
    found = []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            found += [environ] if f"KILL_TEST={mark}\0".encode() in environ.read_bytes() else []
    return found


def results(folder):
    table = pq.read_table(folder / "sweep.parquet").drop([column.name for column in INCIDENTAL])
    return {path.name for path in folder.iterdir()}, table.to_pylist(), (folder / "study.json").read_bytes()


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_study_that_is_killed_at_any_instant_ends_as_if_it_had_not_been(here):
    start = time.monotonic()
    finish(here / "whole")
    duration = time.monotonic() - start
    chance = random.Random()
    for _ in range(KILLS):
        mark = uuid.uuid4().hex
        process = begin(here / "killed", mark)
        wait = chance.uniform(0.3, 1.0) * duration
        with suppress(subprocess.TimeoutExpired):
            process.wait(wait)
        process.kill()
        process.communicate()
        # The workers end by themselves: nothing goes on writing.
        limit = time.monotonic() + 20.0
        while alive(mark) and time.monotonic() < limit:
            time.sleep(0.05)
        assert alive(mark) == [], f"killed after {wait:.3f} s"
    finish(here / "killed")
    assert results(here / "killed") == results(here / "whole")


def driver(out, port):
    arguments = ["drive", "reachy_servos", "--machine", f"udp://127.0.0.1:{port}", "--for", "30", "--out", str(out)]
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments, "--quiet"], env=environment(), stderr=subprocess.PIPE, text=True
    )


def robot():
    command = [sys.executable, "-m", "stewart_drake.machines.simulated", "reachy_servos", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment())
    return process, int(process.stdout.readline())


@pytest.mark.slow
def test_a_drive_that_is_killed_leaves_its_log_and_a_robot_that_holds(tmp_path):
    # The driver is killed first, then the robot.
    chance, (side, port) = random.Random(), robot()
    try:
        for number in range(2):
            out = tmp_path / str(number)
            driving = driver(out, port)
            while not (out / JOURNAL).exists() and driving.poll() is None:
                time.sleep(0.02)
            time.sleep(chance.uniform(0.5, 5.0))
            if number % 2:
                side.kill()
                side.communicate()
                driving.communicate(timeout=60)
                assert driving.returncode != 0
                assert load_log(out).reason == "machine"
                assert not (out / JOURNAL).exists()
                side, port = robot()
            else:
                driving.kill()
                driving.communicate()
                log = load_log(out)
                assert (log.status, log.reason) == ("failed", "cut_off")
                assert f"cut off after {log.end_time:.1f} s" in log.message
                assert run_metrics(log)["reason"] == "cut_off"
                write_replay(log, out / "replay.html")
                time.sleep(1.2)  # Then the robot listens to anybody.
                machine = open_machine(f"udp://127.0.0.1:{port}", load_driven("reachy_servos"))
                machine.connect()
                first = machine.read()
                time.sleep(0.2)
                assert first.holding
                np.testing.assert_allclose(machine.read().angles, first.angles, atol=0.005)
                machine.disconnect()
    finally:
        side.kill()
        side.communicate()
