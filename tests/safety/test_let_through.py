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
