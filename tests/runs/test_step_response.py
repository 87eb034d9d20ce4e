"""The step response of the whole loop."""

import pytest

from stewart_drake import ConfigurationError, load_scenario, step

SCENARIO = {"plant.kind": "closed_form", "duration": 0.4, "model.friction": None, "plant.motor_friction": 0.0}


def test_a_small_step_settles_and_one_down_is_one_up():
    scenario = load_scenario("exact_breathing").replace(SCENARIO)
    up, down = step(scenario, "Z", 0.001), step(scenario, "Z", -0.001)
    assert up.value[0] == pytest.approx(0.0, abs=1e-3)
    assert up.value[-1] == pytest.approx(1.0, abs=0.02)
    assert up.settling_time < 0.4
    assert up.rise_time == pytest.approx(down.rise_time, abs=0.003)
    assert step(scenario, "roll").rise_time < 0.1


@pytest.mark.parametrize(("axis", "size", "words"), [("W", None, "axis: expected one of roll"), ("Z", 0.0, "size")])
def test_what_is_no_step_is_refused(axis, size, words):
    with pytest.raises(ConfigurationError, match=words):
        step("exact_breathing", axis, size)
