"""Tuners of settings in the closed loop, on both engines."""

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


def loop(engine, **changes):
    base = load_scenario("exact_breathing").replace({**PUSHED, "tuner": {"kind": "block"}, "plant.engine": engine})
    return base.replace(changes)


@pytest.mark.parametrize("engine", ["drake", "reduced"])
def test_a_schedule_of_one_setting_is_that_setting(engine):
    base = loop(engine)
    q_pose, q_rate, q_integral, r = weights_of(np.array(base.tuner.weights), np.array(SETTING))
    fixed = {"kind": "block", "q_pose": q_pose, "q_rate": q_rate, "q_integral": q_integral, "r": r}
    level = float(disturbance_of(base.estimator.disturbance, np.array(SETTING)))
    held = run(base.replace({"tuner": fixed, "estimator.disturbance": level}))
    tuned = run(base.replace({"tuner": {"kind": "schedule", "calm": SETTING, "alert": SETTING}}))
    for signal in ("pose", "torque", "innovation", "safety"):
        np.testing.assert_allclose(tuned[signal], held[signal], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tuned["setting"][:, :4], np.tile(SETTING, (len(tuned.time), 1)))
    assert "setting" not in held.signals


def test_both_engines_choose_alike_and_act_from_the_next_tick_on():
    alert = (0.3, 0.1, 0.0, 0.3)
    tuner = {"kind": "schedule", "calm": SETTING, "alert": alert, "threshold": 2.5, "hold": 0.2}
    logs = [run(loop(engine, tuner=tuner)) for engine in ("drake", "reduced")]
    settings = [log["setting"][:, :4] for log in logs]
    np.testing.assert_allclose(*settings, atol=1e-12)
    np.testing.assert_allclose(logs[0]["pose"], logs[1]["pose"], atol=1e-4)
    # The push comes at 0.1 s: not before, soon after, and all of the way soon.
    np.testing.assert_array_equal(settings[0][:101], np.tile(SETTING, (101, 1)))
    assert (settings[0][115] != SETTING).all()
    assert np.abs(settings[0] - alert).max(axis=1).min() < 1e-12
    steps = np.abs(np.diff(settings[0], axis=0)).max(axis=0)
    np.testing.assert_allclose(steps, 0.03 * np.abs(np.subtract(alert, SETTING)), rtol=1e-9)


def test_it_needs_an_observer():
    with pytest.raises(ConfigurationError, match=r"estimator\.kind.*difference.*observer, for tuner\.kind schedule"):
        loop("drake", tuner={"kind": "schedule"}, estimator={"kind": "difference"})
