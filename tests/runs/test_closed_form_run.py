"""`plant.kind: closed_form`: the runs of Drake's plant, sooner."""

import pytest

from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import load_scenario

ENCODERS = "sensors={kind: encoders, resolution_bits: 0}"
HELD = "tuner={kind: block, q_pose: 8.0e5, q_rate: 150.0, q_integral: 5.0e6}"


def both(name, *changes):
    scenario = load_scenario(name, changes)
    return run(scenario.replace({"plant.kind": "closed_form"}), check=False), run(scenario, check=False)


ENDS = {
    "falls": ("paper_fig7_uncompensated",),
    "dead motor": ("exact_breathing", HELD, ENCODERS, "safety={}", "motors={dead: {leg: 1, time: 0.2}}"),
}


@pytest.mark.slow
@pytest.mark.parametrize("given", ENDS.values(), ids=ENDS.keys())
def test_it_ends_as_the_run_on_drakes_plant_ends(given):
    mine, drake = both(given[0], "duration=1", *given[1:])
    assert (mine.status, mine.reason) == (drake.status, drake.reason)
    assert mine.status in ("failed", "stopped")
    # A robot that falls does so a step sooner or later.
    assert mine.end_time == pytest.approx(drake.end_time, abs=0.003)
    assert mine.outcome_time == pytest.approx(drake.outcome_time, abs=0.003)
    assert (mine.safety or {}) | {"leg": 0} == (drake.safety or {}) | {"leg": 0}
