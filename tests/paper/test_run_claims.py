import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import made_log

from stewart_drake.control.network import load_network
from stewart_drake.errors import ConfigurationError
from stewart_drake.paper import in_the_loop, workspace
from stewart_drake.paper.in_the_loop import BEST_FIXED, FIXED, MEAN_OF_NINE, ORACLE, TUNER
from stewart_drake.paper.network import best_possible_scores, run_distances
from stewart_drake.paper.nine_experiments import distinct, gains_along_reference, relative_distances
from stewart_drake.paper.reproduce import PAIRS, RATIOS, Study, growth, outcome, pair_of, paper_scenario, score
from stewart_drake.paper.sensitivity import changes, scaled_network
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.references import paper_reference
from stewart_drake.runs.checks import check_scenario
from stewart_drake.scenario import AnnTuner, FixedTuner, Scenario
from stewart_drake.training.collect import FREQUENCIES, Dataset
from stewart_drake.training.train import r_squared

BASE = Scenario()
ratio_of = np.array([q / r for q, r in PAIRS])


def log(rows=105, step=0.05, duration=5.2, **changed):
    return made_log(rows=rows, step=step, duration=duration, **changed)


# --- pairs, scenarios, outcomes --------------------------------------------------------------------------------------


def test_the_nine_pairs_have_five_ratios_and_each_ratio_its_first_pair():
    assert {round(np.log10(ratio)) for ratio in ratio_of} == {-2, -1, 0, 1, 2}
    for ratio in RATIOS:
        assert PAIRS.index(pair_of(ratio)) == np.flatnonzero(np.isclose(ratio_of, ratio))[0]


def test_a_scenario_of_the_paper_keeps_all_of_its_base_but_what_the_experiment_sets():
    base = BASE.replace({"robot.platform_mass": 1.2, "controller.period": 0.002, "gravity": 3.0})
    made = paper_scenario(base, 5.2, 0.0, "platform", (0.1, 10.0))
    assert made.robot == base.robot
    assert made.controller == dataclasses.replace(base.controller, feedforward="platform")
    assert made.reference == paper_reference()
    assert (made.duration, made.gravity, made.tuner.weights) == (5.2, 0.0, (0.1, 10.0))


@pytest.mark.parametrize("axis", [0, 5])
def test_growth_is_the_error_of_the_second_half_over_that_of_the_first(axis):
    pose = np.full((105, 6), 1e-3)
    pose[:52, axis], pose[52:, axis] = 0.01, 0.03
    assert growth(log(pose=pose)) == pytest.approx(3.0)
    assert score(log(pose=pose))["pose_mm"] > 3.0


def test_a_run_that_breaks_has_no_score_and_is_told_with_reason_leg_and_time():
    broken = log(rows=5, status="failed", reason="crank_dead_centre", message="it broke", leg=2, end_time=2.54)
    assert (growth(broken), score(broken)) == (None, None)
    assert outcome(broken) == "crank dead centre, leg 2, 2.540 s"
    assert outcome(log()) == "completed"


def test_equal_scenarios_run_once():
    short = paper_scenario(BASE, 0.02, 0.0, "none", (1.0, 1.0))
    shares = []
    logs = Study(workers=0, progress=shares.append).run({"a": short, "b": short, "c": short.replace({"gravity": 1.0})})
    assert logs["a"] is logs["b"] is not logs["c"]
    assert shares == [0.5, 1.0]


# --- only the ratio matters ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("changed", [{}, {"controller.solver": "split", "controller.force_map": "printed"}], ids=str)
def test_gains_of_one_ratio_are_equal_to_1e_10_and_of_two_ratios_are_not(changed):
    distances = relative_distances(gains_along_reference(BASE.replace(changed)))
    equal = np.isclose(ratio_of[:, None], ratio_of)
    assert distances[equal].max() < 1e-10 < 1e-2 < distances[~equal].min()
    assert distinct(distances, 1e-10) == 5


def test_distances_are_relative_to_the_larger_gain_at_the_worst_pose():
    gains = np.array([[[1.0, -4.0], [1.0, -4.0], [2.0, -4.0]], [[1.0, 0.0], [1.5, 0.0], [1.0, 0.0]]])
    distances = relative_distances(gains[..., None])
    np.testing.assert_allclose(distances, [[0.0, 1 / 3, 0.25], [1 / 3, 0.0, 1 / 3], [0.25, 1 / 3, 0.0]])


# --- data, and what nothing could learn ------------------------------------------------------------------------------


def test_distances_between_runs_are_the_largest_difference_of_any_density_at_any_tick():
    inputs = np.random.default_rng(0).uniform(0.5, 1.5, (180, 12))
    data = Dataset(inputs, np.repeat(PAIRS, 20, axis=0), np.repeat(np.arange(9), 20), 0.005 * np.arange(180))
    distances = run_distances(data)
    for a, b in itertools.product(range(9), repeat=2):
        assert distances[a, b] == np.abs(inputs[20 * a : 20 * a + 20] - inputs[20 * b : 20 * b + 20]).max()


def test_over_the_nine_pairs_half_of_each_weight_s_variance_is_irreducible():
    # Labels -1, 0, 1; ratio 0 has a variance of 2/3 left in three pairs, ratios -1 and 1 of 1/4 in two, the ends none:
    # (3 * 2/3 + 4 * 1/4) / (9 * 2/3) = 1/2.
    assert best_possible_scores() == pytest.approx({"omega_Q": 0.5, "omega_R": 0.5, "ratio": 1.0}, abs=1e-12)
    # And no function of the ratio does better: least squares over one indicator a ratio.
    logs = np.log10(PAIRS)
    ratio = np.round(logs[:, 0] - logs[:, 1], 6)
    basis = (ratio[:, None] == np.unique(ratio)).astype(float)
    for label in logs.T:
        assert r_squared(label, basis @ np.linalg.lstsq(basis, label, rcond=None)[0]) == pytest.approx(0.5)


# --- motions beyond the data, and the tuner against fixed weights ----------------------------------------------------


def test_motions_keep_to_every_limit_and_their_second_halves_hold_whole_swings():
    for reference, duration in in_the_loop.unseen_trajectories().values():
        check_reference(BASE.robot, BASE.limits, reference, duration, BASE.gravity).raise_if_infeasible()
        frequency = np.array(reference.angular_frequency)[np.array(reference.amplitude) != 0.0] / (2.0 * np.pi)
        # None is in the training data or the paper.
        assert np.abs(frequency[:, None] - np.array([*FREQUENCIES, 1.0 / np.pi])).min() > 0.01
        np.testing.assert_allclose(duration * frequency, np.round(duration * frequency), atol=1e-9)


def row(tuner=5.0, **changed):
    return dict(zip(FIXED, (20.0, 10.0, 4.0, 2.0, 1.0), strict=True)) | {TUNER: tuner} | changed


@given(st.lists(st.floats(0.01, 100.0), min_size=5, max_size=5))
def test_the_mean_of_the_nine_is_that_over_the_pairs_themselves(rmse):
    of_ratio = dict(zip(FIXED, rmse, strict=True))
    by_pair = [of_ratio[f"ratio {ratio:g}"] for ratio in np.round(ratio_of, 6)]
    found = in_the_loop.baselines({"a": {TUNER: 1.0, **of_ratio}})
    assert found[MEAN_OF_NINE] == pytest.approx([np.mean(by_pair)])
    assert found[ORACLE] == [min(by_pair)]


def test_the_best_fixed_pair_is_best_by_geometric_mean():
    better = in_the_loop.baselines({"a": row(), "b": row(**{"ratio 100": 3.0})})
    assert better[BEST_FIXED] == [1.0, 3.0]  # sqrt(1 * 3) against 2
    assert in_the_loop.baselines({"a": row(), "b": row(**{"ratio 100": 5.0})})[BEST_FIXED] == [2.0, 2.0]


def test_improvement_is_a_share_of_the_baseline_and_its_averages_are_two():
    found = in_the_loop.improvement({"a": row(tuner=0.5), "b": row(tuner=2.0)}, [1.0, 1.0])
    assert found["each"] == [50.0, -100.0]
    assert found["mean"] == pytest.approx(-25.0)
    assert found["typical"] == pytest.approx(0.0)  # half and double


# --- one change at a time --------------------------------------------------------------------------------------------


def test_each_change_touches_nothing_but_its_own(tmp_path):
    base = Scenario(tuner=FixedTuner())
    robots = {"masses", "inertias", "rod length"}
    sections = {"motor friction": "plant", "motor damping": "plant", "sample time": "controller"}
    sections |= {"omega_Q": "tuner", "omega_R": "tuner"}
    seen = set()
    for (factor, to), keys in changes(base, tmp_path).items():
        made = base.replace(keys)
        seen.add(factor)
        if factor in robots:
            # The controller goes on believing in the old one.
            assert made.believed_robot == base.robot != made.robot
        else:
            unlike = {name for name, value in base.to_dict().items() if made.to_dict()[name] != value}
            assert unlike <= {sections[factor]}
        if (factor, to) == ("masses", "+20 %"):
            assert made.robot.rod_mass == pytest.approx(1.2 * base.robot.rod_mass)
    assert seen == {*sections, *robots}


def test_a_scaled_network_answers_so_much_more_within_a_range_so_much_higher(tmp_path):
    network, densities = load_network(), np.random.default_rng(3).uniform(-1e3, 1e3, (200, 12))
    densities[:100] = np.random.default_rng(4).uniform(0.0, 2.0, (100, 12))
    expected = network.weights(densities) * [1.0, 0.5]
    np.testing.assert_allclose(scaled_network(network, omega_r=0.5).weights(densities), expected, rtol=1e-12)
    base = Scenario(tuner=AnnTuner())
    half = base.replace(changes(base, tmp_path)["omega_R", "-50 %"]).load_tuner_network()
    np.testing.assert_allclose(half.weights(densities), expected, rtol=1e-12)


# --- what motions visit ----------------------------------------------------------------------------------------------


def test_the_motions_can_be_run_and_keep_half_of_the_room():
    motions = workspace.controlled_motions(Study(quick=True))
    assert next(iter(motions)) == "the paper's motion"
    for scenario in motions.values():
        check_scenario(scenario)
    sideways = motions["Y at 1 Hz"]
    assert sideways.reference.amplitude[4] > 0.05
    far = [2.05 * size for size in sideways.reference.amplitude]
    with pytest.raises(ConfigurationError, match="reference"):
        check_scenario(sideways.replace({"reference.amplitude": far}))


def test_what_a_run_visits_is_its_largest_torque_and_share_of_a_limit():
    time = np.linspace(0.0, 1.0, 101)
    pose, rate, acceleration = paper_reference().evaluate(time)
    torque = np.outer(np.sin(time), np.arange(6.0))
    signals = {"reference": pose, "reference_rate": rate, "reference_acceleration": acceleration}
    made = made_log(rows=101, step=0.01, duration=1.0, pose=pose, pose_rate=rate, torque_applied=torque, **signals)
    found = workspace.visited(made)
    assert found["peak_torque"] == pytest.approx(5.0 * np.sin(1.0))
    assert 0.9 < found["limit_use"] <= 1.0
