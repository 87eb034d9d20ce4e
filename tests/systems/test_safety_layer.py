import numpy as np
import pytest

from stewart_drake import Scenario, load_scenario, run
from stewart_drake.base.yaml_files import shipped_folder

BASE = {
    "duration": 0.12,
    "reference": {"kind": "sine"},
    "controller": {"period": 0.001, "model": "exact", "feedforward": "full", "weight_length": 0.11, "solver": "split"},
    "tuner": {"kind": "block", "q_pose": 4e5, "q_rate": 30.0, "q_integral": 4e7},
    "safety": {},
}


def scenario(**changes):
    return Scenario.from_dict(BASE | changes)


@pytest.mark.slow
def test_a_run_in_which_nothing_is_wrong_is_the_run_without():
    plain, guarded = (run(scenario(safety=safety, sensors={"kind": "encoders"})) for safety in (None, {}))
    assert guarded.safety is None
    for name in plain.signals:
        np.testing.assert_array_equal(guarded[name], plain[name], err_msg=name)
    np.testing.assert_array_equal(guarded["safety"], np.tile([0.0, 0.0, -1.0], (121, 1)))
    assert "safety" not in plain.signals


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nan", "inf"])
@pytest.mark.parametrize(
    ("safety", "ends"), [(None, ("failed", "not_finite")), ({}, ("stopped", "command_not_finite"))], ids=str
)
def test_a_torque_that_is_no_number_never_ends_in_success(kind, safety, ends):
    # Saturation in Drake's plant would let NaN through, and cut infinity to a torque that looks sound.
    log = run(scenario(duration=1.0, safety=safety, link={"faults": [{"kind": kind, "time": 0.1, "leg": 2}]}))
    assert (log.status, log.reason) == ends
    assert np.isfinite(log["torque_applied"][:-1]).all()


@pytest.mark.slow
def test_cranks_that_all_stick_read_like_frozen_sensors_and_the_message_names_both():
    log = run(load_scenario("sway", ["robot=servo_hexapod", "plant.motor_friction=0.5", "duration=1.0"]))
    assert (log.status, log.reason, log.safety["leg"]) == ("stopped", "reading_stuck", None)
    assert "a sensor repeats itself, or no crank moves at all" in log.message


NOMINAL = sorted({path.stem for path in shipped_folder("scenarios").glob("*.yaml")} - {"paper_fig7_uncompensated"})


@pytest.mark.slow
@pytest.mark.parametrize("name", NOMINAL)
def test_no_nominal_scenario_trips_anything(name):
    case = load_scenario(name)
    # The part in which the most happens; each has gone through its fastest motion by then.
    log = run(case.replace({"safety": {}, "duration": min(2.5, case.duration), "plant.kind": "closed_form"}))
    assert (log.status, log.safety) == ("completed", None)
    assert (log["safety"][:, 0] == 0.0).all()
