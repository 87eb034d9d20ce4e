"""`plant.kind: closed_form`: the runs of Drake's plant, sooner."""

import numpy as np
import pytest

from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import load_scenario

ENCODERS = "sensors={kind: encoders, resolution_bits: 0}"
PUSH = "disturbances=[{kind: step, wrench: [0.02, 0, 0.03, 3, -2, -4], time: 0.2, until: 0.4}]"
OBSERVER = "estimator={kind: observer}"
HELD = "tuner={kind: block, q_pose: 8.0e5, q_rate: 150.0, q_integral: 5.0e6}"


def both(name, *changes):
    scenario = load_scenario(name, changes)
    return run(scenario.replace({"plant.kind": "closed_form"}), check=False), run(scenario, check=False)


def apart(one, other):
    rows = min(len(one.time), len(other.time))
    between = one["pose"][:rows] - other["pose"][:rows]
    return [float(np.linalg.norm(part, axis=1).max()) for part in (between[:, 3:], between[:, :3])]


CASES = {
    # Smooth loops at 1 kHz: what is left is the gap of Drake's loops and the order of the method.
    "friction": (("exact_heart", HELD, ENCODERS, "plant.motor_friction=0.01"), 1e-7, 1e-6),
    "push, payload": (
        ("exact_breathing", HELD, ENCODERS, PUSH, "plant.payload_mass=0.3",
         "plant.payload_position=[0.02, 0.01, 0.05]"),
        1e-6,
        1e-5,
    ),
    "observer, delay": (
        ("exact_heart", HELD, ENCODERS, OBSERVER, "command_delay=2", "plant.motor_friction=0.01",
         "model.friction={coulomb: 0.01}"),
        1e-7,
        1e-6,
    ),
    # Soft loops at 200 Hz show the first order of both methods.
    "paper": (("paper_fig7",), 1e-5, 1e-4),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("given", "metres", "radians"), CASES.values(), ids=CASES.keys())
def test_it_is_the_run_on_drakes_plant(given, metres, radians):
    mine, drake = both(given[0], "duration=0.8", *given[1:])
    assert (mine.status, mine.reason) == (drake.status, drake.reason)
    assert mine.status == "completed"
    np.testing.assert_array_equal(mine.time, drake.time)
    assert set(drake.signals) - set(mine.signals) == {"plant_state"}
    distance, angle = apart(mine, drake)
    assert distance < metres
    assert angle < radians
    np.testing.assert_allclose(mine["reference"], drake["reference"], rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(mine["crank_angle"], drake["crank_angle"], atol=20.0 * radians)
    assert mine["loop_gap"].max() == 0.0
    assert run_metrics(mine)["torque_rms"] == pytest.approx(run_metrics(drake)["torque_rms"], rel=0.2)


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
