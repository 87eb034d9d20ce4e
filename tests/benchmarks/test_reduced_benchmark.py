"""Whole runs on the closed form over those on Drake's plant, in turns in one process: `make bench`."""

import time

import numpy as np
import pytest

from stewart_drake import load_scenario, run

ENCODERS = (
    "sensors={kind: encoders, resolution_bits: 17, noise: 2.0e-5, rate_cutoff: 150}",
    "command_delay=1",
    "plant.motor_friction=0.01",
)
OBSERVER = ("estimator={kind: observer}", "friction_compensation={coulomb: 0.01}")


@pytest.mark.parametrize("changes", [(), OBSERVER, (*OBSERVER, "safety={}")], ids=["differences", "observer", "safety"])
def test_a_whole_run(benchmark, changes):
    scenario = load_scenario("exact_breathing", ("duration=2.5", "tuner=block", *ENCODERS, *changes))
    reduced = scenario.replace({"plant.engine": "reduced"})
    mine, drake = [], []

    def seconds(each):
        begin = time.process_time()
        assert run(each).status == "completed"
        return time.process_time() - begin

    def both():
        drake.append(seconds(scenario))
        mine.append(seconds(reduced))

    seconds(reduced)
    benchmark.pedantic(both, rounds=5, warmup_rounds=1)
    ratio = float(np.median(np.array(drake) / mine))
    ticks = scenario.duration / scenario.controller.period
    benchmark.extra_info["drake / reduced"] = round(ratio, 2)
    print(
        f"\nwhole run: drake / reduced = {ratio:.1f} (processor time, median; "
        f"reduced {1e6 * np.median(mine) / ticks:.0f} us a tick, drake {1e6 * np.median(drake) / ticks:.0f})"
    )
    assert ratio > 5.0
