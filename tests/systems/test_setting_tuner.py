"""Tuners of settings in the closed loop."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, load_scenario, run
from stewart_drake.control.policy import disturbance_of, weights_of

SETTING = (0.15, -0.2, -0.4, -0.8)
PUSHED = {
    "duration": 0.25,
    "disturbances": [{"kind": "step", "wrench": [0, 0, 0, 3, -2, -4], "time": 0.1}],
    "safety": {},
}


def loop(**changes):
    base = load_scenario("exact_breathing").replace({**PUSHED, "tuner": {"kind": "block"}, "plant.engine": "reduced"})
    return base.replace(changes)


def test_a_schedule_of_one_setting_is_that_setting():
    base = loop()
    q_pose, q_rate, q_integral, r = weights_of(np.array(base.tuner.weights), np.array(SETTING))
    fixed = {"kind": "block", "q_pose": q_pose, "q_rate": q_rate, "q_integral": q_integral, "r": r}
    level = float(disturbance_of(base.estimator.disturbance, np.array(SETTING)))
    held = run(base.replace({"tuner": fixed, "estimator.disturbance": level}))
    tuned = run(base.replace({"tuner": {"kind": "schedule", "calm": SETTING, "alert": SETTING}}))
    for signal in ("pose", "torque", "innovation", "safety"):
        np.testing.assert_allclose(tuned[signal], held[signal], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tuned["setting"][:, :4], np.tile(SETTING, (len(tuned.time), 1)))
    assert "setting" not in held.signals


def test_it_needs_an_observer():
    with pytest.raises(ConfigurationError, match=r"estimator\.kind: .*observer, for tuner\.kind schedule"):
        loop(tuner={"kind": "schedule"}, estimator={"kind": "difference"})
