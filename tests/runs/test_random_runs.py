from collections import Counter

import numpy as np
import pytest
from random_scenarios import random_scenario

from stewart_drake.runs.simulation import run

RUNS, PARTS = 90, 3


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_no_completed_run_of_90_is_worse_than_standing_still(part):
    ends = Counter()
    for seed in range(part, RUNS, PARTS):
        log = run(random_scenario(seed))
        ends[log.status, log.reason] += 1
        duration, scale = log.scenario.duration, np.array([0.11] * 3 + [1.0] * 3)
        reference, pose = scale * log["reference"], scale * log["pose"]
        motion, moved = (np.sqrt(np.sum((each - each.mean(axis=0)) ** 2, axis=1).mean()) for each in (reference, pose))
        error, start = np.sqrt(np.sum((pose - reference) ** 2, axis=1)), scale * (log["pose"] - log["reference"])[0]
        whole = np.sqrt(np.mean(error**2)) / (motion + np.linalg.norm(start))
        if log.status == "completed" and motion > 0.33e-3 and duration >= 0.5:
            assert whole <= 1.0, seed
            assert moved >= 0.2 * motion, seed
            assert whole <= 0.5 or "poorly_followed" in {warning["name"] for warning in log.warnings}, seed
    # Neither is a rare end here.
    assert min(ends["completed", None], ends["lost", "not_followed"]) >= 3
