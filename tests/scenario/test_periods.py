"""Parts with periods of their own: readings between the controller's ticks, and a tuner that decides less often."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Controller, load_scenario, run

SLOW_BUS = {"duration": 0.3, "controller.period": 0.004, "command_delay": 1, "tuner.period": 0.02}
FAST_READINGS = {**SLOW_BUS, "estimator.period": 0.001}


def run_with(changes):
    return run(load_scenario("exact_breathing").replace({**changes, "plant.kind": "closed_form", "log_period": 0.001}))


def test_parts_run_at_their_periods():
    fast = run_with(FAST_READINGS)
    assert Controller(fast.scenario).period == 0.001
    # The command changes every 4 ms, the measurement every millisecond, the weights every 20 ms.
    for name, steps in {"torque": 4, "measured_pose": 1, "block_weights": 20}.items():
        changed = np.flatnonzero((np.diff(fast[name], axis=0) != 0.0).any(axis=1)) + 1
        assert len(changed) > 5
        assert (np.diff(changed) % steps == 0).all(), name
        assert np.diff(changed).min() == steps, name


def test_an_observer_that_reads_between_two_commands_knows_the_motion_better():
    errors = []
    for changes in (SLOW_BUS, FAST_READINGS):
        log = run_with(changes)
        rows = slice(100, None, 4)  # Those of the controller's ticks, once it has found the motion.
        errors.append(np.sqrt(np.mean((log["measured_pose_rate"][rows] - log["pose_rate"][rows]) ** 2)))
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize(
    ("key", "period"), [("estimator.period", 0.003), ("tuner.period", 0.01), ("estimator.period", 0.0005)]
)
def test_periods_that_do_not_fit_are_refused(key, period):
    with pytest.raises(ConfigurationError, match="whole multiple"):
        load_scenario("exact_breathing").replace({"controller.period": 0.004, key: period})
