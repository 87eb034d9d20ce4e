import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import numpy as np
import psutil
import pytest
from conftest import python

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.logs import log_rows
from stewart_drake.logs.log import load_log
from stewart_drake.logs.log_rows import RowsInFile
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario


def scenario(**changes):
    base = {"name": "rows", "duration": 0.3, "tuner": {"kind": "fixed"}, "log_period": 0.001, "gravity": 0.0}
    return Scenario.from_dict(base | changes)


def same(one, other):
    assert list(one.signals) == list(other.signals)
    for name in one.signals:
        np.testing.assert_array_equal(one[name], other[name])
    for field in fields(one):
        if field.name not in ("signals", "wall_time"):
            assert getattr(one, field.name) == getattr(other, field.name), field.name


def in_small_parts(monkeypatch, rows=64):
    """Some rows to a part, so that a short run has many."""
    monkeypatch.setattr("stewart_drake.runs.simulation.ROWS_AT_ONCE", 1)
    monkeypatch.setattr("stewart_drake.runs.simulation.CHUNK", 0.02)
    monkeypatch.setattr(log_rows, "ROW_GROUP", rows)
    monkeypatch.setattr(log_rows, "_FLUSH_TIME", float("inf"))


def test_rows_that_went_to_a_file_are_those_that_stayed_in_memory(tmp_path, monkeypatch):
    in_small_parts(monkeypatch)
    kept = run(scenario())
    written = run(scenario(), rows=RowsInFile(tmp_path))
    same(written, kept)
    same(load_log(tmp_path), kept)
    assert [path.name for path in tmp_path.iterdir()] == ["log.parquet"]


def test_of_a_long_log_only_some_rows_come_back_but_the_file_has_all(tmp_path, monkeypatch):
    monkeypatch.setattr(log_rows, "PICTURE_ROWS", 100)
    log = run(scenario(), rows=RowsInFile(tmp_path))
    assert len(log.time) == 76
    assert len(load_log(tmp_path).time) == 301
    assert run_metrics(log)["rmse_mm"] == run_metrics(load_log(tmp_path))["rmse_mm"]


@pytest.mark.parametrize("when", [0, 2])
def test_a_full_disk_ends_the_run_and_what_was_written_is_readable(tmp_path, monkeypatch, when):
    in_small_parts(monkeypatch)
    real, calls = log_rows.write_log, []

    def full(log, tables, stream):
        calls.append(stream)
        if len(calls) > when:
            stream.write(b"half")
            raise OSError(28, "No space left on device")
        real(log, tables, stream)

    monkeypatch.setattr(log_rows, "write_log", full)
    with pytest.raises(RunFailure, match=r"No space left on device.*those before are in"):
        run(scenario(), rows=RowsInFile(tmp_path))
    if when:
        log = load_log(tmp_path)
        assert len(log.time) >= 64 * when
        assert (log.status, log.reason) == ("interrupted", "killed")


@pytest.mark.parametrize("name", ["log.part", "rows/000007.part"])
def test_what_a_kill_left_half_written_does_not_hide_the_rows_before_it(tmp_path, monkeypatch, name):
    in_small_parts(monkeypatch)
    rows = RowsInFile(tmp_path)
    monkeypatch.setattr(rows, "end", lambda log: log)
    run(scenario(), rows=rows)
    (tmp_path / name).write_bytes(b"PAR1 half")
    assert len(load_log(tmp_path).time) > 200


@pytest.mark.parametrize(
    ("error", "reason"),
    [(MemoryError(), "out_of_memory"), (np.linalg.LinAlgError("Singular matrix"), "singular_matrix")],
)
def test_what_stops_a_tick_ends_the_run_with_its_log(monkeypatch, error, reason):
    from stewart_drake.systems.part_system import PartSystem

    tick, calls = PartSystem._ticked, []

    def hungry(self, *arguments):
        calls.append(self.part.name == "controller")
        if sum(calls) > 20:
            raise error
        return tick(self, *arguments)

    monkeypatch.setattr(PartSystem, "_ticked", hungry)
    log = run(scenario())
    assert (log.status, log.reason) == ("failed", reason)
    assert len(log.time) > 10


def test_a_log_that_cannot_fit_into_memory_is_refused_before_the_run(monkeypatch):
    free = psutil.virtual_memory()._replace(available=int(1e9))
    monkeypatch.setattr(psutil, "virtual_memory", lambda: free)
    long = scenario(duration=3000.0, log_period=0.001)
    with pytest.raises(ConfigurationError, match=r"log_period: got 0.001; .* it takes 7.02 GB, and 1 are free"):
        run(long)
    RowsInFile(Path()).check(long)


MEMORY = """
import sys
from pathlib import Path
from stewart_drake.logs.log_rows import RowsInFile
from stewart_drake.scenario import Scenario
from stewart_drake.runs.simulation import run
import stewart_drake.runs.simulation as simulation
import stewart_drake.logs.log as log_module
import stewart_drake.logs.log_rows as log_rows
log_module.ROW_GROUP = log_rows.ROW_GROUP = 2000
duration, folder = float(sys.argv[1]), Path(sys.argv[2])
scenario = Scenario.from_dict({"duration": duration, "tuner": {"kind": "fixed"}, "log_period": 0.001,
    "reference": {"kind": "hold"}, "plant": {"time_step": 0.001}})
log_rows.PICTURE_ROWS = 1000
log = run(scenario, check=False, rows=RowsInFile(folder))
# Not ru_maxrss: a new process inherits it from the one that started it.
peak = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
print(log.status, peak)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from Linux")
def test_memory_does_not_grow_with_the_length_of_a_run(tmp_path):
    peaks = []
    for duration in (4.0, 16.0):
        folder = tmp_path / f"{duration}"
        folder.mkdir()
        status, peak = python("-c", MEMORY, duration, folder).split()
        assert status == "completed"
        peaks.append(int(peak) * 1024)
    # 12,000 rows more are 10 MB; in memory they would be there twice.
    assert peaks[1] - peaks[0] < 9e6
    assert peaks[1] < 600e6


DRIVER = """
import functools
import stewart_drake.logs.log_rows as rows
from stewart_drake.cli.app import main
from stewart_drake.runs import outputs
rows._FLUSH_TIME = 0.05
outputs.ResultsFolder.finish = functools.partialmethod(outputs.ResultsFolder.finish, pictures=False)
main()
"""


def arguments(duration):
    changes = ["tuner={kind: fixed}", "log_period=0.001", "reference={kind: hold}", f"duration={duration}"]
    return ["run", "paper_fig7", "--out", "out", "--quiet", *(word for each in changes for word in ("--set", each))]


@pytest.fixture
def long_run(start, tmp_path):
    """Starts a long run that has written its first rows."""

    def rows_since(begin):
        with suppress(FileNotFoundError):
            return any(path.stat().st_mtime > begin for path in tmp_path.glob(".out.unfinished/rows/*.parquet"))

    def long_run():
        begin = time.time()
        process = start(*arguments(600), code=DRIVER, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not rows_since(begin):
            assert process.poll() is None
            assert time.time() < begin + 120.0
            time.sleep(0.01)
        return process

    return long_run


@pytest.mark.slow
def test_a_run_that_is_killed_keeps_its_rows_and_a_second_one_beside_it_is_refused(long_run, shell, tmp_path):
    first = long_run()
    status, _, err = shell(*arguments(0.5))
    assert (status, err) == (
        2,
        "stewart-drake: --out: got 'out'; allowed: a folder that no other process is writing\n",
    )
    assert first.poll() is None
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert not (tmp_path / "out").exists()
    rows = load_log(tmp_path / ".out.unfinished")
    assert (rows.status, rows.reason) == ("interrupted", "killed")
    np.testing.assert_allclose(rows.time, 0.001 * np.arange(len(rows.time)), atol=1e-12)
    # The next one clears them, and what it wrote until Ctrl-C is the same run.
    third = long_run()
    third.send_signal(signal.SIGINT)
    assert third.wait() == 130
    assert {path.name for path in tmp_path.iterdir()} == {"out"}
    log = load_log(tmp_path / "out")
    assert log.status == "interrupted"
    least = min(len(log.time), len(rows.time))
    np.testing.assert_array_equal(log["plant_state"][:least], rows["plant_state"][:least])
