"""kill -9 at any instant of a study costs what was under way; two processes never share a folder."""

import os
import random
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from conftest import environment

from stewart_drake.cli.app import main
from stewart_drake.files.whole import locked_folder
from stewart_drake.studies.study import INCIDENTAL

KILLS = int(os.environ.get("STEWART_DRAKE_KILLS", "1"))
SWEEP = """
scenario: paper_fig7
runs: 8
set: {duration: 0.3, tuner: {kind: fixed}, limits.clearance: null}
distributions:
  initial_offset[0]: {kind: uniform, low: -0.05, high: 0.05}
  initial_offset[5]: {kind: choice, values: [0.0, 0.0, 0.3]}
"""
MAIN = """
if __name__ == "__main__":
    from stewart_drake.cli.app import main
    main()
"""
ARGS = ["sweep", "sweep.yaml", "--workers", "2"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    return tmp_path


def begin(out, mark):
    driver = out.parent / "driver.py"
    driver.write_text(MAIN)
    command = [sys.executable, str(driver), *ARGS, "--out", str(out), "--quiet"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=environment(KILL_TEST=mark), **pipes)


def finish(out):
    process = begin(out, "none")
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err


def alive(mark):
    found = []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"KILL_TEST={mark}\0".encode() in environ.read_bytes():
                found.append(int(environ.parent.name))
        except OSError:
            continue
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
        try:
            process.wait(wait)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
        process.communicate()
        # The workers end by themselves: nothing goes on writing.
        limit = time.monotonic() + 20.0
        while alive(mark) and time.monotonic() < limit:
            time.sleep(0.05)
        assert alive(mark) == [], f"killed after {wait:.3f} s"
    finish(here / "killed")
    assert results(here / "killed") == results(here / "whole")


def test_the_second_of_two_processes_in_one_folder_is_refused(here, monkeypatch, capsys):
    (here / "out").mkdir()
    monkeypatch.setattr(sys, "argv", ["stewart-drake", *ARGS, "--out", "out", "--quiet"])
    with locked_folder(here / "out"), pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    expected = "a folder that no other process is using, got 'out'"
    assert capsys.readouterr().err == f"stewart-drake: --out: expected {expected}\n"
    assert list((here / "out").iterdir()) == []
