"""What a whole run on Drake's plant costs beside one on the closed form: `make bench`."""

import time

import numpy as np
import pytest

from stewart_drake import load_scenario, run

ENCODERS = (
    "sensors={kind: encoders, resolution_bits: 17, noise: 2.0e-5}",
    "estimator={kind: difference, rate_cutoff: 150}",
    "command_delay=1",
    "plant.motor_friction=0.01",
)
OBSERVER = ("estimator={kind: observer}", "model.friction={coulomb: 0.01}")


SAFETY = (*OBSERVER, "safety={}")


@pytest.mark.parametrize(
    ("changes", "least"), [((), 9.0), (OBSERVER, 7.5), (SAFETY, 6.5)], ids=["differences", "observer", "safety"]
)
def test_a_whole_run(benchmark, changes, least):
    scenario = load_scenario("exact_breathing", ("duration=2.5", "tuner=block", *ENCODERS, *changes))
    fast = scenario.replace({"plant.kind": "closed_form"})
    mine, drake = [], []

    def seconds(each):
        begin = time.process_time()
        assert run(each).status == "completed"
        return time.process_time() - begin

    def both():
        drake.append(seconds(scenario))
        mine.append(seconds(fast))

    seconds(fast)
    benchmark.pedantic(both, rounds=5, warmup_rounds=1)
    ratio = float(np.median(np.array(drake) / mine))
    ticks = scenario.duration / scenario.controller.period
    benchmark.extra_info["drake / closed form"] = round(ratio, 2)
    print(
        f"\nwhole run: drake / closed form = {ratio:.1f} (processor time, median; "
        f"closed form {1e6 * np.median(mine) / ticks:.0f} us a tick, drake {1e6 * np.median(drake) / ticks:.0f})"
    )
    assert ratio > least
