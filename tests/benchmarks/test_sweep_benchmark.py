"""What a sweep costs beyond its runs, as ratios measured in one run: `make bench`."""

import json
import time

from stewart_drake.studies.study import run_study
from stewart_drake.studies.sweep import Sweep
from stewart_drake.studies.workers import Workers

RUNS, WARM = 40, 6
"""Runs of a sweep, and how many of them pass before the clock starts."""
SPEC = {
    "scenario": "paper_fig7",
    "runs": RUNS,
    "set": {"duration": 0.2, "tuner": {"kind": "fixed"}},
    "distributions": {"initial_offset[0]": {"kind": "uniform", "low": -0.05, "high": 0.05}},
}


def measure(folder, workers):
    """Time [s] of the runs after the first few, and their own time [s] in the workers."""
    ends = {}
    result = run_study(
        Sweep.from_dict(SPEC), folder, Workers(workers), lambda done: ends.setdefault(done, time.perf_counter())
    )
    rows = [row for line, row in enumerate(by_completion(folder, result.rows["sweep"])) if line >= WARM]
    return ends[float(RUNS)] - ends[float(WARM)], sum(row["wall_s"] for row in rows)


def by_completion(folder, rows):
    order = [json.loads(line)["index"] for line in (folder / "rows.jsonl").read_text().splitlines()]
    return [rows[index] for index in order]


def test_efficiency_and_overhead(benchmark, tmp_path):
    walls, overheads, shares = {1: [], 2: []}, [], []

    def both():
        for workers in (1, 2):
            wall, own = measure(tmp_path / f"{workers} {len(walls[workers])}", workers)
            walls[workers].append(wall)
            overheads.append((wall * workers - own) / (RUNS - WARM))
            shares.append(own / (wall * workers))

    benchmark.pedantic(both, rounds=3)
    figures = {
        # Both workers busy with runs, as a share of the time: what the sweep itself answers for.
        "share of the workers' time spent in runs": min(shares),
        # Against one worker: what the machine gives besides, other programs on it included.
        "efficiency on two cores": min(walls[1]) / (2.0 * min(walls[2])),
        "overhead per run [ms]": 1e3 * max(overheads),
    }
    benchmark.extra_info |= figures
    print("\n" + "\n".join(f"{name}: {value:.3f}" for name, value in figures.items()))
    assert max(overheads) < 0.050
    assert min(shares) > 0.9
