import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import made_log

from stewart_drake.paper.experiments import PAIRS, RATIOS, growth, outcome, pair_of, paper_scenario, refusal, score
from stewart_drake.paper.nine_experiments_section import (
    EQUAL_GAINS,
    distinct,
    gains_along_reference,
    make,
    relative_distances,
    trajectory_spread,
)
from stewart_drake.paper.study import Study
from stewart_drake.references import paper_reference
from stewart_drake.scenario import Scenario

BASE = Scenario()


def log(rows=105, step=0.05, duration=5.2, **changes):
    return made_log(rows=rows, step=step, duration=duration, **changes)


def failed(end_time, rows=5):
    return log(rows=rows, status="failed", reason="crank_dead_centre", message="it broke", leg=2, end_time=end_time)


# --- pairs and scenarios -------------------------------------------------------------------------------------------


def test_the_nine_pairs_have_five_ratios_and_each_ratio_its_first_pair():
    assert len(PAIRS) == len(set(PAIRS)) == 9
    assert {round(np.log10(q / r)) for q, r in PAIRS} == {-2, -1, 0, 1, 2}
    for ratio in RATIOS:
        pair = pair_of(ratio)
        assert pair in PAIRS
        assert pair[0] / pair[1] == pytest.approx(ratio)
        earlier = PAIRS[: PAIRS.index(pair)]
        assert not any(q / r == pytest.approx(ratio) for q, r in earlier)
    with pytest.raises(ValueError, match=r"ratio 3; the nine pairs have 0.01, 0.1, 1, 10, 100"):
        pair_of(3.0)


def test_a_scenario_of_the_paper_keeps_all_of_its_base_but_what_the_experiment_sets():
    base = BASE.replace({"robot.platform_mass": 1.2, "controller.period": 0.002, "gravity": 3.0})
    made = paper_scenario(base, 5.2, 0.0, "platform", (0.1, 10.0))
    assert made.robot == base.robot
    assert made.controller == dataclasses.replace(base.controller, feedforward="platform")
    assert made.reference == paper_reference()
    assert (made.duration, made.gravity) == (5.2, 0.0)
    assert (made.tuner.kind, made.tuner.omega_q, made.tuner.omega_r) == ("fixed", 0.1, 10.0)


# --- only the ratio matters ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{}, {"controller.solver": "split", "controller.force_map": "printed"}], ids=str)
def test_gains_of_one_ratio_are_equal_to_1e_10_and_of_two_ratios_are_not(changes):
    gains = gains_along_reference(BASE.replace(changes))
    assert gains.shape == (9, 9, 6, 18)
    ratio = np.array([q / r for q, r in PAIRS])
    distances, equal = relative_distances(gains), np.isclose(ratio[:, None], ratio)
    assert distances[equal].max() < 1e-10 < 1e-2 < distances[~equal].min()
    assert distinct(distances, 1e-10) == 5


def test_gains_are_those_of_the_controller_and_of_the_robot_that_it_believes_in():
    gains = gains_along_reference(BASE)
    for changes in ({"controller.period": 0.001}, {"model_robot": {"platform_mass": 2.0}}):
        others = gains_along_reference(BASE.replace(changes))
        assert relative_distances(np.stack([gains[:, 0], others[:, 0]], 1)).max() > 1e-3
    # The simulated robot's own mass is not the controller's once it believes in another.
    same = BASE.replace({"robot.platform_mass": 2.0, "model_robot": BASE.to_dict()["robot"]})
    np.testing.assert_array_equal(gains_along_reference(same), gains)


def test_distances_are_relative_to_the_larger_gain_at_the_worst_pose():
    gains = np.array([[[1.0, -4.0], [1.0, -4.0], [2.0, -4.0]], [[1.0, 0.0], [1.5, 0.0], [1.0, 0.0]]])
    distances = relative_distances(gains[..., None])
    np.testing.assert_allclose(distances, [[0.0, 1 / 3, 0.25], [1 / 3, 0.0, 1 / 3], [0.25, 1 / 3, 0.0]])


@given(st.lists(st.sampled_from([0.0, 1.0, 2.0, 3.0]), min_size=1, max_size=8), st.floats(-1e-12, 1e-12))
def test_distinct_counts_values_that_differ_by_more_than_the_tolerance(values, noise):
    x = np.array(values) + noise * np.arange(len(values))
    assert distinct(np.abs(x[:, None] - x), 1e-10) == len(set(values))


def test_the_spread_of_trajectories_is_the_largest_difference_over_common_rows():
    pose = np.zeros((20, 6))
    one, two, short = pose.copy(), pose.copy(), np.zeros((10, 6))
    one[3, 4], two[15, 0] = -0.25, 0.5
    logs = [log(rows=20, pose=pose), log(rows=20, pose=one), log(rows=20, pose=two)]
    assert trajectory_spread(logs) == 0.5
    assert trajectory_spread([*logs, log(rows=10, pose=short)]) == 0.25
    assert trajectory_spread(logs[:1]) == 0.0
    assert trajectory_spread([logs[2], log(rows=0)]) == 0.0


# --- what became of a run ------------------------------------------------------------------------------------------


def test_a_run_that_breaks_is_told_with_reason_leg_and_time():
    assert outcome(log()) == "completed"
    assert outcome(failed(2.54)) == "crank dead centre, leg 2, 2.540 s"


def with_error(first, late, axis=0):
    """A run whose error in one axis is `first`, in the second half `late`; 1 mm or mrad in the other axes."""
    pose = np.full((105, 6), 1e-3)
    pose[:52, axis], pose[52:, axis] = first, late
    return log(pose=pose)


@pytest.mark.parametrize("axis", [0, 5])
def test_growth_compares_the_second_half_with_the_first_in_the_axes_that_move(axis):
    # The other axis does not change: 1 is the least that can come out.
    assert growth(with_error(0.1, 0.3, axis)) == pytest.approx(3.0)
    assert growth(with_error(0.1, 0.01, axis)) == pytest.approx(1.0)
    both = with_error(0.2, 0.1)
    both["pose"][52:, 5] *= 0.25
    assert growth(both) == pytest.approx(0.5)
    both["pose"][52:, 1:5] = 7.0
    assert growth(both) == pytest.approx(0.5)
    assert growth(failed(2.0)) is None


def off(rows=101, **errors):
    """A log of 10 s whose pose is off by `errors` (axis number as a5=...) in the second half, far more before."""
    pose, torque = np.full((rows, 6), 50.0), np.full((rows, 6), 9.0)
    pose[50:], torque[50:] = 0.0, 0.25
    for axis, value in errors.items():
        pose[50:, int(axis[1:])] = value
    return made_log(rows=rows, pose=pose, torque_applied=torque)


def test_rotations_count_with_the_characteristic_length_and_only_the_second_half_counts():
    found = score(off(a0=0.01, a1=0.02, a3=0.002, a5=-0.001))
    rotation, position = np.hypot(0.01, 0.02), np.hypot(0.002, 0.001)
    assert found == pytest.approx({"pose_mm": 1e3 * np.hypot(0.11 * rotation, position), "torque_rms": 0.25})
    longer = made_log(pose=off(a0=0.01)["pose"], scenario={"robot": {"characteristic_length": 0.2}})
    assert score(longer)["pose_mm"] == pytest.approx(2.0)


def test_a_run_that_ended_early_has_no_score_even_where_it_reached_the_second_half():
    assert score(made_log(rows=80, status="failed", reason="crank_dead_centre")) is None


def test_a_scenario_that_can_run_is_not_refused_and_one_that_cannot_says_why():
    scenario = Scenario(duration=1.0)
    assert refusal(scenario) is None
    far = scenario.replace({"reference.amplitude": [0.0, 0.0, 0.0, 0.4, 0.0, 0.0]})
    assert "reference: breaks the limit" in refusal(far)


# --- the section ---------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(runs_by):
    """Logs by a rule: with gravity and no feedforward a run ends after its ratio in s."""

    def rule(scenario):
        ratio = scenario.tuner.omega_q / scenario.tuner.omega_r
        bare = scenario.gravity > 0.0 and scenario.controller.feedforward == "none"
        end = min(scenario.duration, ratio if bare else scenario.duration)
        rows = int(end / 0.01 + 1e-9) + 1
        pose = np.zeros((rows, 6))
        pose[:, 0] = ratio
        pose[:, 5] = -0.001 * np.arange(rows)
        outcome = {} if end == scenario.duration else {"status": "failed", "reason": "crank_dead_centre", "leg": 1}
        return made_log(rows=rows, step=0.01, pose=pose, end_time=end, **outcome)

    return runs_by(rule)


def test_the_section_shows_what_its_runs_gave(tmp_path, asked):
    section = make(Study(tmp_path, False, BASE))
    n = section.numbers
    conditions, names = n["conditions"], [f"{q:g} / {r:g}" for q, r in PAIRS]
    assert set(conditions) == {f"gravity {g}, {f}" for g in ("0", "9.81") for f in ("none", "gravity", "platform")}
    assert all([row["omega_Q / omega_R"] for row in rows] == names for rows in conditions.values())
    # Five seconds and one period are within every run that the claim is about.
    assert all(s.duration >= 5.0 for s in asked[0] if s.gravity == 0.0 and s.controller.feedforward == "none")
    assert all(s.duration >= np.pi for group in asked for s in group)
    rows = {row["omega_Q / omega_R"]: row for row in n["conditions"]["gravity 9.81, none"]}
    early = rows["0.1 / 10"]
    assert early["ended"] == "crank dead centre, leg 1, 0.010 s"
    assert early["RMSE roll [deg]"] is early["largest abs(z) at 5 s [rad s, m s]"] is None
    assert rows["10 / 0.1"]["RMSE roll [deg]"] == pytest.approx(np.degrees(100.0), rel=1e-3)
    cells = [line for line in section.body.split("\n") if line.startswith("| 0.1 / 10 | - | - |")]
    assert any(line.endswith("| crank dead centre, leg 1, 0.010 s |") for line in cells)
    assert "*(37), (38) for 10 s, gravity 9.81 m/s^2, feedforward none; RMSE" in section.body
    # The ratio is what tells the runs apart.
    assert n["controllers"] == 5
    assert n["gain_spread"] < EQUAL_GAINS < n["gain_spread_next_ratio"]
    assert n["trajectory_spread_same_ratio"] == pytest.approx(0.0, abs=1e-12)
    assert n["trajectory_spread_next_ratio"] == pytest.approx(0.09)
    # The time to failure, by ratio for each map and period.
    times = n["time_to_failure"]
    assert set(times) == {"0.005 statics", "0.005 printed", "0.001 statics", "0.001 printed"}
    assert times["0.001 printed"] == dict(
        zip((f"ratio {r}" for r in ("0.01", "0.1", "1", "10", "100")), (0.01, 0.1, 1.0, None, None), strict=True)
    )
    assert n["largest_drop_mm"] == pytest.approx([1.0, 1000.0])
    assert "by 1.0 to 1000.0 mm below" in section.body
    assert "ends early in 6 of 10 runs, the printed map in 6" in section.body
    bare = {(s.controller.period, s.controller.force_map) for s in asked[1]}
    assert bare == {(p, m) for p in (0.005, 0.001) for m in ("statics", "printed")}


def test_a_plant_with_long_steps_is_not_asked_for_periods_that_it_cannot_have(tmp_path, asked):
    # A base without gravity still shows the runs with it.
    coarse = BASE.replace({"plant.time_step": 0.002, "controller.period": 0.004, "gravity": 0.0})
    section = make(Study(tmp_path, False, coarse))
    assert set(section.numbers["time_to_failure"]) == {"0.004 statics", "0.004 printed"}
    assert {s.controller.period for group in asked for s in group} == {0.004}
    assert "gravity 9.81, none" in section.numbers["conditions"]
