"""The observer, the friction feedforward and a tuner of settings in the closed loop."""

import numpy as np
import pytest

from stewart_drake.control.policy import disturbance_of, weights_of
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import load_scenario

HOME = [0, 0, 0, 0, 0, 0.3]
BASE = load_scenario("exact_breathing").replace({"plant.engine": "reduced", "tuner": {"kind": "block"}})


@pytest.mark.slow
@pytest.mark.parametrize(("believed", "level"), [(0.01, 0.02), (0.05, 0.1)])
def test_a_robot_with_friction_comes_to_rest_and_stays(believed, level):
    # Up to twice the friction that is believed; without that rule it hunts by ten counts and more for ever.
    rest = {
        "plant.friction": {"coulomb": believed, "break_away": level},
        "friction_compensation": {"coulomb": believed},
        "reference": {"kind": "minimum_jerk", "poses": [HOME, [0.05, 0, 0, 0.01, 0, 0.31]], "durations": [0.5]},
        "duration": 6.0,
        "estimator": {"kind": "observer"},
        "sensors.noise": 2e-5,
        "tuner": {"kind": "block", "q_pose": 8e5, "q_rate": 150.0, "q_integral": 5e6},
    }
    log = run(BASE.replace({**rest, "plant.motor_friction": 0.0}))
    late = log.time >= 3.5
    count = 2.0 * np.pi / 2**17
    assert np.ptp(log["crank_angle"][late], axis=0).max() < 4.0 * count
    error = np.linalg.norm((log["pose"] - log["reference"])[late, 3:], axis=1)
    assert 1e3 * np.sqrt(np.mean(error**2)) < 0.01 + 0.5 * level


def test_a_schedule_of_one_setting_is_that_setting():
    setting, push = (0.15, -0.2, -0.4, -0.8), {"kind": "step", "wrench": [0, 0, 0, 3, -2, -4], "time": 0.1}
    base = BASE.replace({"duration": 0.25, "disturbances": [push], "safety": {}})
    weights = weights_of(np.array(base.tuner.weights), np.array(setting))
    fixed = {"kind": "block", **dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights, strict=True))}
    level = float(disturbance_of(base.estimator.disturbance, np.array(setting)))
    held = run(base.replace({"tuner": fixed, "estimator.disturbance": level}))
    tuned = run(base.replace({"tuner": {"kind": "schedule", "calm": setting, "alert": setting}}))
    for signal in ("pose", "torque", "innovation", "safety"):
        np.testing.assert_allclose(tuned[signal], held[signal], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tuned["setting"][:, :4], np.tile(setting, (len(tuned.time), 1)))
    assert "setting" not in held.signals
