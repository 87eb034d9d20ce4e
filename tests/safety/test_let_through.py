"""What Drake lets through, and this package does not."""

import numpy as np
import pytest

from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario

LOOP = {
    "duration": 1.0,
    "reference": {"kind": "hold"},
    "controller": {"period": 0.001, "model": "exact", "solver": "split", "weight_length": 0.11},
    "tuner": {"kind": "block", "q_pose": 4e5, "q_rate": 30.0, "q_integral": 4e7},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nan", "inf"])
@pytest.mark.parametrize("safety", [None, {}])
def test_a_torque_that_is_no_number_never_ends_in_success(kind, safety):
    # Saturation in the plant would let NaN through, and cut infinity to a torque that looks sound.
    log = run(
        Scenario.from_dict(LOOP | {"safety": safety, "link": {"faults": [{"kind": kind, "time": 0.1, "leg": 2}]}})
    )
    ends = ("failed", "not_finite") if safety is None else ("stopped", "command_not_finite")
    assert (log.status, log.reason) == ends
    applied = log["torque_applied"][:-1] if safety is None else log["torque_applied"]
    assert np.isfinite(applied).all()


@pytest.mark.slow
def test_a_finite_blow_up_ends_the_run_by_name_before_it_is_one():
    # All stays finite, and a Simulator would run to the end of it.
    pushed = LOOP | {"link": {"faults": [{"kind": "offset", "time": 0.05, "size": 20.0}]}}
    wild, tamed = (run(Scenario.from_dict(pushed | {"safety": safety})) for safety in (None, {}))
    for log in (wild, tamed):
        assert np.isfinite(log["plant_state"]).all()
    assert (tamed.status, tamed.reason) == ("stopped", "crank_speed")
    assert tamed.safety["time"] < 0.07
    far = [np.linalg.norm(log["pose"][:, 3:] - log["reference"][:, 3:], axis=1).max() for log in (wild, tamed)]
    assert far[1] < 0.05
    assert wild.status == "lost"
    assert far[0] > 0.06
