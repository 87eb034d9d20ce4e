import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.paper.tracking_score import refusal, tracking_score
from stewart_drake.scenario import Scenario


def off(rows=101, **errors):
    """A log of 10 s whose pose is off by `errors` (axis number as a5=...) in the second half, far more before."""
    pose = np.full((rows, 6), 50.0)
    pose[50:] = 0.0
    for axis, value in errors.items():
        pose[50:, int(axis[1:])] = value
    torque = np.full((rows, 6), 9.0)
    torque[50:] = 0.25
    return made_log(rows=rows, pose=pose, torque_applied=torque)


def test_rotations_count_with_the_characteristic_length_and_only_the_second_half_counts():
    score = tracking_score(off(a0=0.01, a1=0.02, a3=0.002, a5=-0.001))
    rotation, position = np.hypot(0.01, 0.02), np.hypot(0.002, 0.001)
    assert score.rotation_deg == pytest.approx(np.degrees(rotation))
    assert score.position_mm == pytest.approx(1e3 * position)
    assert score.pose_mm == pytest.approx(1e3 * np.hypot(0.11 * rotation, position))
    assert score.torque_rms == pytest.approx(0.25)


def test_the_characteristic_length_is_that_of_the_simulated_robot():
    log = off(a0=0.01)
    longer = made_log(pose=log["pose"], scenario={"robot": {"characteristic_length": 0.2}})
    assert tracking_score(longer).pose_mm == pytest.approx(2.0)


def test_a_run_that_ended_early_has_no_score_even_where_it_reached_the_second_half():
    assert tracking_score(made_log(rows=80, status="failed", reason="crank_dead_centre")) is None


def test_a_scenario_that_can_run_is_not_refused_and_one_that_cannot_says_why():
    scenario = Scenario(duration=1.0)
    assert refusal(scenario) is None
    far = scenario.replace({"reference.amplitude": [0.0, 0.0, 0.0, 0.4, 0.0, 0.0]})
    assert "reference: breaks the limit" in refusal(far)
