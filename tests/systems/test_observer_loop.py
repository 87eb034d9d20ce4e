"""The observer and the friction feedforward in the closed loop, on Drake's plant."""

import numpy as np
import pytest

from stewart_drake.runs.simulation import run
from stewart_drake.scenario import load_scenario

HOME = [0, 0, 0, 0, 0, 0.3]
OBSERVER = {"kind": "observer"}


def made(**changes):
    noisy = {} if "sensors" in changes else {"sensors.noise": 2e-5}
    plain = {"duration": 1.0, "estimator": OBSERVER, "friction_compensation": None, "tuner": {"kind": "block"}}
    return load_scenario("exact_breathing").replace({**plain, **noisy, **changes})


def error(log, since=0.5):
    """[mm] RMSE of the position from a time on."""
    signals = log.signals
    off = (signals["pose"] - signals["reference"])[signals["time"] >= since, 3:]
    return 1e3 * float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize(("believed", "level"), [(0.01, 0.02), (0.05, 0.1)])
def test_a_robot_with_friction_comes_to_rest_and_stays(believed, level):
    # Up to twice the friction that is believed; without that rule it hunts by ten counts and more for ever.
    rest = {
        "plant": {"friction": {"coulomb": believed, "break_away": level}, "engine": "reduced"},
        "friction_compensation": {"coulomb": believed},
        "reference": {"kind": "minimum_jerk", "poses": [HOME, [0.05, 0, 0, 0.01, 0, 0.31]], "durations": [0.5]},
        "duration": 6.0,
        "tuner": {"kind": "block", "q_pose": 8e5, "q_rate": 150.0, "q_integral": 5e6},
    }
    log = run(made(**rest))
    late = log.signals["time"] >= 3.5
    count = 2.0 * np.pi / 2**17
    assert np.ptp(log.signals["crank_angle"][late], axis=0).max() < 4.0 * count
    assert error(log, 3.5) < 0.01 + 0.5 * level
