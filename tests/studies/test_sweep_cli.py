import functools
import os
import signal
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from conftest import alive

TINY = """
scenario: paper_fig7
runs: {runs}
set: {{duration: {duration}, tuner: {{kind: fixed}}, limits.clearance: null}}
distributions:
  initial_offset[0]: {{kind: uniform, low: -0.05, high: 0.05}}
  initial_offset[5]: {{kind: choice, values: [0.0, 0.0, 0.3]}}
"""


def write(folder, name="tiny", runs=4, duration=0.05):
    (folder / f"{name}.yaml").write_text(TINY.format(runs=runs, duration=duration))


@pytest.fixture
def call(call):
    """The subcommand."""
    return functools.partial(call, "sweep")


@pytest.mark.slow
def test_a_sweep_from_the_shell_leaves_its_table_prints_its_summary_and_goes_on(start, tmp_path):
    write(tmp_path)
    process = start("sweep", "tiny.yaml", "--workers", 2)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert {path.name for path in (tmp_path / "runs" / "tiny").iterdir()} == {
        "sweep.parquet",
        "sweep.csv",
        "study.json",
        "rows.jsonl",
    }
    table = pq.read_table(tmp_path / "runs" / "tiny" / "sweep.parquet")
    rejected = table.column("status").to_pylist().count("rejected")
    assert table.num_rows == 4
    assert 1 <= rejected <= 3
    lines = {line.split("│")[1].strip(): line.split("│")[2].strip() for line in out.splitlines() if "│" in line}
    assert lines["completed"] == str(4 - rejected)
    assert lines["rejected, configuration"] == str(rejected)
    assert lines["RMSE of rotation, percentiles 50 95 99, largest"].endswith("deg")
    assert lines["table in"] == "runs/tiny/sweep.parquet"
    assert "4 / 4 runs" in err
    # Two more: the first four are not run again.
    process = start("sweep", "tiny.yaml", "--runs", 6, "--quiet", "--workers", 1)
    assert process.communicate(timeout=120) == ("", "")
    more = pq.read_table(tmp_path / "runs" / "tiny" / "sweep.parquet")
    assert more.num_rows == 6
    assert more.slice(0, 4).to_pylist() == table.to_pylist()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="looks for processes in /proc")
def test_ctrl_c_keeps_what_is_done_and_the_same_command_goes_on(start, tmp_path):
    write(tmp_path, runs=12, duration=0.3)
    process = start("sweep", "tiny.yaml", "--workers", 2, "--out", "out")
    rows = tmp_path / "out" / "rows.jsonl"
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and (not rows.exists() or rows.read_bytes().count(b"\n") < 2):
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # what a terminal sends: to every process of the group
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert out == ""
    assert "Traceback" not in err
    kept = rows.read_bytes().splitlines()
    assert 2 <= len(kept) < 12
    assert "interrupted; finished runs are kept in out; the same command goes on from there" in err
    while time.monotonic() < deadline and alive(process.pid):  # a worker may be a moment behind its caller
        time.sleep(0.1)
    assert alive(process.pid) == []
    process = start("sweep", "tiny.yaml", "--workers", 2, "--out", "out", "--quiet")
    assert process.communicate(timeout=120) == ("", "")
    assert process.returncode == 0
    assert rows.read_bytes().splitlines()[: len(kept)] == kept
    assert pq.read_table(tmp_path / "out" / "sweep.parquet").column("index").to_pylist() == list(range(12))
