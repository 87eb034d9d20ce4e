import numpy as np
import pytest

from stewart_drake.campaigns.executors import SerialExecutor
from stewart_drake.training.front import TASTES, Front, find_front, table


def test_the_best_setting_is_told_for_each_taste():
    quiet, stiff = (0.02, 0.001), (0.005, 0.02)
    costs = np.array([[1.0, 0.8, 0.3, 0.1, 0.0], [0.2, 0.3, 0.5, 0.9, 1.5]])
    tuner = np.tile([[0.01, 0.01]], (len(TASTES), 1))
    front = Front(np.zeros((2, 4)), np.array([quiet, stiff]), tuner, costs, costs.min(axis=0) + np.log(0.5))
    assert front.best.tolist() == [1, 1, 0, 0, 0]
    lines = table(front)
    assert len(lines) == 2 + len(TASTES)
    assert all(line.endswith("| 0.50 |") for line in lines[2:])
    assert "0.0050" in lines[2]
    assert "0.0200" in lines[-1]


@pytest.mark.slow
def test_a_taste_for_quiet_finds_quieter_settings(tmp_path, monkeypatch):
    monkeypatch.setattr("stewart_drake.training.contest.kinds_of", lambda _: ["pushes"])

    def tuner_at(taste):
        # As a tuner that has learned it would.
        setting = [-0.1 * taste, 0.0, 0.0, -taste]
        return {"tuner": {"kind": "schedule", "calm": setting, "alert": setting}}

    front = find_front(tuner_at, tmp_path, [[0.0] * 4], settings=4, seeds=1, where=SerialExecutor())
    assert front.cloud.shape == (5, 2)
    # The stiffest one is restless, and may err a little more than the next.
    assert (np.diff(front.tuner[1:, 0]) > 0.0).all()
    assert (np.diff(front.tuner[:, 1]) < 0.0).all()
    # The default costs the same as a tuner that stays there.
    assert front.tuner[2] == pytest.approx(front.cloud[0])
    assert front.tuner_costs[2] == pytest.approx(front.cloud_costs[0, 2])
