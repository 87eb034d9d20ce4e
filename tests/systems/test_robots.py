"""Robots with legs of their own in the whole loop: plant, encoders, exact model, safety, compiled and not."""

import numpy as np
import pytest
from strategies import ROBOTS

from stewart_drake import Scenario, run, run_metrics
from stewart_drake.runs.replay import write_replay

OPTIONS = {
    "duration": 0.3,
    "controller": {
        "period": 0.001,
        "model": "exact",
        "feedforward": "full",
        "feedforward_at": "reference",
        "weight_length": 0.11,
        "solver": "split",
    },
    "tuner": {"kind": "block", "q_pose": 4.0e5, "q_rate": 30.0, "q_integral": 4.0e7, "r": 1.0},
    "reference": {"kind": "sine", "amplitude": [0.05, 0, 0, 0, 0, 0.01], "angular_frequency": [1.9] * 6},
    "sensors": {"kind": "encoders", "resolution_bits": 17, "rate_cutoff": 150.0},
    "safety": {},
    "limits": {"clearance": None, "joint_swing": None},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in ROBOTS if name != "paper"])
def test_it_follows_as_well_compiled_as_not_and_has_its_pictures(name, tmp_path):
    base = Scenario(robot=ROBOTS[name]).to_dict()
    slow, fast = (run(Scenario.from_dict({**base, **OPTIONS, "compiled": compiled})) for compiled in (False, True))
    assert slow.status == fast.status == "completed"
    np.testing.assert_allclose(fast["pose"], slow["pose"], rtol=0.0, atol=1e-8)
    assert run_metrics(fast)["rmse_norm_mm"] < 2e-3
    assert fast["loop_gap"].max() < 1e-6
    write_replay(fast, tmp_path / "replay.html")
    assert "<title>" in (tmp_path / "replay.html").read_text()
