"""What a sweep costs beyond its runs, as ratios measured in one run: `make bench`."""

import json
import time

from stewart_drake.studies.experiment import run_experiment
from stewart_drake.studies.sweep import make_sweep
from stewart_drake.studies.workers import Workers

RUNS, WARM = 40, 6  # of a sweep, and how many pass before the clock starts
SPEC = {
    "scenario": "paper_fig7",
    "runs": RUNS,
    "set": {"duration": 0.2, "tuner": {"kind": "fixed"}},
    "distributions": {"initial_offset[0]": {"kind": "uniform", "low": -0.05, "high": 0.05}},
}


def measured(folder, workers):
    ends = {}
    sweep = make_sweep(SPEC)
    made = run_experiment(sweep, folder, Workers(workers), lambda done: ends.setdefault(done, time.perf_counter()))
    rows = made.rows["sweep"]
    keys = [json.loads(line)["key"] for line in (folder / "rows.jsonl").read_text().splitlines()]
    order = [int(key.rpartition("/")[2]) for key in keys]
    return ends[float(RUNS)] - ends[float(WARM)], sum(rows[index]["wall_s"] for index in order[WARM:])


def test_efficiency_and_overhead(benchmark, tmp_path):
    found = {1: [], 2: []}

    def both():
        for workers, each in found.items():
            # The first starts processes that are not there yet.
            each += [measured(tmp_path / f"{workers} {number}", workers) for number in range(4)][1:]

    benchmark.pedantic(both, rounds=1)
    every = [(workers * wall, own) for workers, each in found.items() for wall, own in each]
    figures = {
        # Both workers busy with runs, as a share of the time: what the sweep itself answers for.
        "share of the workers' time spent in runs": min(own / wall for wall, own in every),
        # Against one worker: what the machine gives besides, other programs on it included.
        "efficiency on two cores": min(found[1])[0] / (2.0 * min(found[2])[0]),
        "overhead per run [ms]": 1e3 * max((wall - own) / (RUNS - WARM) for wall, own in every),
    }
    benchmark.extra_info |= figures
    print("\n" + "\n".join(f"{name}: {value:.3f}" for name, value in figures.items()))
    assert figures["overhead per run [ms]"] < 50.0
    assert figures["share of the workers' time spent in runs"] > 0.9
