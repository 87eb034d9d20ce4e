"""One list of parts, two ways to run it: a Diagram by Drake's Simulator, and step by step on the same plant."""

import numpy as np
import pytest

from stewart_drake.runs.simulation import run
from stewart_drake.runs.stepped_loop import SteppedLoop
from stewart_drake.scenario.scenario import load_scenario

PUSH = {"kind": "step", "wrench": [0.02, 0.0, 0.03, 3.0, -2.0, -4.0], "time": 0.05}
REAL = {
    "plant": {"motor_friction": 0.02, "payload_mass": 0.2},
    "sensors": "encoders",
    "estimator": "observer",
    "command_delay": 1,
    "motors": {"resolution": 0.01, "ripple": 0.005},
    "disturbances": [PUSH],
}
CASES = {
    # The Diagram would solve the Riccati equation by Drake.
    "paper_fig7": ("paper_fig7", {"controller.solver": "split"}),
    "exact_heart": ("exact_heart", {}),
    "exact_breathing": ("exact_breathing", {"tuner": "block", **REAL}),
    "a rod breaks": ("exact_fig7", {"plant.broken_rod": {"leg": 2, "time": 0.1005}}),
}


@pytest.mark.parametrize(("name", "changes"), CASES.values(), ids=CASES.keys())
def test_the_stepped_loop_on_drakes_plant_is_the_diagram_to_the_bit(name, changes):
    scenario = load_scenario(name).replace({"duration": 0.2, **changes})
    log = run(scenario.replace(log_period=scenario.plant.time_step), check=False)
    loop = SteppedLoop(scenario)
    loop.begin()
    for step in range(len(log.time)):
        loop.run_parts()
        np.testing.assert_array_equal(loop.pose, log["pose"][step])
        np.testing.assert_array_equal(loop.torque, log["torque_applied"][step])
        if step + 1 < len(log.time):
            loop.move()
    assert len(log.time) > 150
    assert np.ptp(log["pose"], axis=0).max() > 1e-4


@pytest.mark.parametrize("kind", ["drake", "closed_form"])
def test_a_plant_goes_on_from_what_it_has_saved(kind):
    scenario = load_scenario("exact_heart").replace({"plant": {"kind": kind, "motor_friction": 0.02}})
    make, torque, push = scenario.plant.make, np.full(6, 0.3), np.array([0.0, 0.01, 0.0, 1.0, 0.0, 0.0])

    def moved(plant):
        return [plant.step(torque, push).copy() for _ in range(30)]

    first, second = (make(scenario.robot, scenario.gravity) for _ in range(2))
    first.initial(*scenario.start())
    moved(first)
    state = first.save()
    after = moved(first)
    np.testing.assert_array_equal(second.restore(state), first.restore(state))
    np.testing.assert_array_equal(moved(second), after)
    np.testing.assert_array_equal(moved(first), after)
    # At the start it is again as it was at first.
    np.testing.assert_array_equal(first.initial(*scenario.start())[:6], scenario.start()[0])
