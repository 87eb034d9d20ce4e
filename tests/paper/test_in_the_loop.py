import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import made_log
from matplotlib.figure import Figure

from stewart_drake.control.network import default_network_path, load_network
from stewart_drake.paper import in_the_loop_section as in_the_loop
from stewart_drake.paper.experiments import PAIRS, RATIOS
from stewart_drake.paper.in_the_loop_section import make, on_trajectory, under_tuner
from stewart_drake.paper.study import Study
from stewart_drake.paper.trajectories import Trajectory, paper_trajectory
from stewart_drake.paper.tuner_comparison import (
    BEST_FIXED,
    LABELS,
    MEAN_OF_NINE,
    ORACLE,
    Comparison,
    baselines,
    best_fixed_ratio,
    constant_at,
    fit_answers,
    improvement,
    improvements,
    log_ratio,
    mean_answer,
    mean_log_ratio,
)
from stewart_drake.references import SineReference
from stewart_drake.scenario import FixedTuner, Scenario

FALLING = dict(zip(RATIOS, (20.0, 10.0, 4.0, 2.0, 1.0), strict=True))


def compared(name="a", tuner=5.0, **changes):
    """A trajectory on which the ratios make 20, 10, 4, 2, 1 mm; `r100=None` is a run that ended early."""
    return Comparison(name, tuner, FALLING | {float(k[1:].replace("_", ".")): v for k, v in changes.items()})


# --- the comparison ------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.01, 100.0), min_size=5, max_size=5))
def test_the_mean_of_the_nine_is_that_over_the_pairs_themselves(rmse):
    of_ratio = dict(zip(RATIOS, rmse, strict=True))
    by_pair = [next(v for r, v in of_ratio.items() if np.isclose(q / s, r)) for q, s in PAIRS]
    comparison = Comparison("a", 1.0, of_ratio)
    assert LABELS == {0.01: 1, 0.1: 2, 1.0: 3, 10.0: 2, 100.0: 1}
    assert comparison.mean_of_nine == pytest.approx(np.mean(by_pair))
    assert comparison.oracle == min(by_pair)
    assert of_ratio[comparison.oracle_ratio] == min(by_pair)


def test_a_pair_that_ends_early_leaves_no_mean_but_an_oracle():
    comparison = compared(r100=None)
    assert comparison.mean_of_nine is None
    assert (comparison.oracle_ratio, comparison.oracle) == (10.0, 2.0)
    nothing = Comparison("a", 1.0, dict.fromkeys(RATIOS))
    assert (nothing.oracle_ratio, nothing.oracle) == (None, None)


def test_the_best_fixed_pair_is_best_by_geometric_mean_and_completes_everything():
    both = [compared(), compared(r100=3.0, r10=2.0)]
    assert best_fixed_ratio(both) == 100.0  # sqrt(1 * 3) against 2
    assert best_fixed_ratio([compared(), compared(r100=5.0)]) == 10.0
    assert best_fixed_ratio([compared(), compared(r100=None)]) == 10.0
    assert best_fixed_ratio([Comparison("a", 1.0, dict.fromkeys(RATIOS))]) is None


def test_every_baseline_is_there_for_every_trajectory():
    found = baselines([compared(), compared(r100=None)])
    assert found["ratio 100"] == [1.0, None]
    assert found[BEST_FIXED] == [2.0, 2.0]
    assert found[ORACLE] == [1.0, 2.0]
    assert found[MEAN_OF_NINE] == [pytest.approx((20 + 2 * 10 + 3 * 4 + 2 * 2 + 1) / 9), None]
    assert set(found) == {f"ratio {r:g}" for r in RATIOS} | {BEST_FIXED, MEAN_OF_NINE, ORACLE}


def test_improvement_is_a_share_of_the_baseline_and_its_averages_are_two():
    assert improvement(1.0, 2.0) == 50.0
    assert improvement(4.0, 2.0) == -100.0
    assert improvement(None, 2.0) is None
    assert improvement(2.0, None) is None
    found = improvements([compared(tuner=0.5), compared(tuner=2.0), compared(tuner=None)])[ORACLE]
    assert found.each == [50.0, -100.0, None]
    assert found.mean == pytest.approx(-25.0)
    assert found.typical == pytest.approx(0.0)  # half and double
    lost = improvements([compared(tuner=None)])[ORACLE]
    assert (lost.mean, lost.typical) == (None, None)


def test_constant_weights_between_two_of_the_five_lie_on_the_straight_line_of_logarithms():
    comparison = compared()
    for ratio, rmse in FALLING.items():
        assert constant_at(comparison, np.log10(ratio)) == pytest.approx(rmse)
    assert constant_at(comparison, 0.5) == pytest.approx(np.sqrt(4.0 * 2.0))
    assert constant_at(comparison, 9.0) == pytest.approx(1.0)
    assert constant_at(compared(r1=None), 0.5) is None


# --- what the network sees -----------------------------------------------------------------------------------------

TRUTH = np.log10(RATIOS)


def test_a_fit_tells_a_perfect_estimator_from_a_blind_one_and_one_that_shrinks_to_the_middle():
    perfect = fit_answers(TRUTH, np.tile(TRUTH, (4, 1)))
    assert perfect == pytest.approx({"slope": 1.0, "r_squared": 1.0, "by_trajectory": 0.0, "mean": 0.0})
    blind = fit_answers(TRUTH, np.repeat([[-1.0], [0.0], [0.4]], 5, axis=1))
    assert blind == pytest.approx({"slope": 0.0, "by_trajectory": 1.0, "mean": -0.2, "r_squared": blind["r_squared"]})
    assert blind["r_squared"] < 0.0
    assert fit_answers(TRUTH, np.tile(0.3 * TRUTH - 0.5, (2, 1)))["slope"] == pytest.approx(0.3)


def test_the_answer_is_read_off_the_densities_of_the_second_half():
    network = load_network(default_network_path())
    densities = np.random.default_rng(1).uniform(0.0, 3.0, (101, 12))
    log = made_log(density=densities)
    omega = network.weights(densities[50:])
    assert mean_answer(network, log) == pytest.approx(np.mean(np.log10(omega[:, 0] / omega[:, 1])))


def test_the_ratio_in_force_is_averaged_as_a_logarithm_over_the_second_half():
    weights = np.ones((101, 2))
    weights[50:, 0], weights[50:, 1] = 10.0, 0.1
    assert mean_log_ratio(made_log(weights=weights)) == pytest.approx(2.0)
    np.testing.assert_allclose(log_ratio(np.array([[0.1, 10.0], [1.0, 1.0]])), [-2.0, 0.0])


# --- the section ---------------------------------------------------------------------------------------------------


def test_the_tuner_is_the_reports_own_where_it_has_one(tmp_path):
    study = Study(tmp_path)
    assert study.tuner_file == default_network_path()
    assert under_tuner(study, Scenario()).tuner.weights_file is None
    dataclasses.replace(load_network(default_network_path()), density="signed", window=7).save(tmp_path / "tuner.json")
    tuner = under_tuner(study, Scenario(tuner=FixedTuner(omega_q=10.0))).tuner
    assert study.tuner_file == tmp_path / "tuner.json"
    assert (tuner.kind, tuner.weights_file) == ("paper", str(tmp_path / "tuner.json"))
    assert (tuner.density, tuner.window, tuner.omega_q, tuner.omega_r) == ("signed", 7, 1.0, 1.0)


def test_a_quick_report_and_a_whole_one_in_one_folder_have_their_own_tuners(tmp_path):
    whole, quick = Study(tmp_path), Study(tmp_path, quick=True)
    load_network(default_network_path()).save(tmp_path / quick.name("tuner", ".json"))
    assert whole.tuner_file == default_network_path()
    assert quick.tuner_file == tmp_path / "tuner-quick.json"
    assert quick.save_figure(Figure(), "answers") == "answers-quick.png"
    assert (tmp_path / "figures" / "answers-quick.png").is_file()


def test_a_trajectory_takes_the_place_of_the_reference_alone():
    trajectory = Trajectory("x", "x", SineReference(amplitude=(0.0, 0.1, 0.0, 0.0, 0.0, 0.0)), 3.0)
    moved = on_trajectory(Scenario(), trajectory)
    assert moved.reference == trajectory.reference
    assert moved.replace({"reference": Scenario().to_dict()["reference"], "duration": 10.0}) == Scenario()


@pytest.fixture
def made_runs(runs_by):
    """Runs by formula instead of simulation: pose off by 1 mm / sqrt(ratio) in Z, 3 mm under the tuner."""

    def rule(scenario):
        tuner, rows = scenario.tuner, round(scenario.duration / 0.05) + 1
        fixed = tuner.kind == "fixed"
        pose = np.full((rows, 6), 1e-12)
        pose[:, 5] = 1e-3 / np.sqrt(tuner.omega_q / tuner.omega_r) if fixed else 3e-3
        log = made_log(rows=rows, step=0.05, pose=pose, torque_applied=np.ones((rows, 6)))
        if fixed and tuner.omega_q / tuner.omega_r < 0.05 and scenario.reference != paper_trajectory().reference:
            log = dataclasses.replace(log, status="failed", reason="crank_dead_centre", leg=4, end_time=0.5)
        return log

    return runs_by(rule)


@pytest.mark.usefixtures("no_pictures")
def test_the_section_compares_every_trajectory_with_all_five_controllers(tmp_path, made_runs):
    section = make(Study(tmp_path))
    numbers = section.numbers["pose_rmse_mm"]
    assert len(numbers) >= 11
    assert numbers["(37), (38)"]["tuner"] == pytest.approx(3.0)
    for ratio in RATIOS:
        assert numbers["(37), (38)"][f"ratio {ratio:g}"] == pytest.approx(1.0 / np.sqrt(ratio))
    gains = section.numbers["improvement_percent"]
    assert gains["ratio 1"]["each"][0] == pytest.approx(-200.0)
    assert gains["ratio 0.01"]["each"] == [pytest.approx(70.0)] + [None] * (len(numbers) - 1)
    assert section.numbers["best_fixed_ratio"] == 100.0
    # Runs that end early are rows with their reason.
    rows = set(section.body[section.body.index("*Not completed*") :].split("\n")[4:])
    reason = "crank dead centre, leg 4, 0.500 s"
    assert rows == {f"| {name} | ratio 0.01 | {reason} |" for name in numbers if name != "(37), (38)"}
    starts = 5
    (asked,) = made_runs
    assert len(asked) == 6 * len(numbers) + 2 + 3 * starts
    offsets = {scenario.initial_offset for scenario in asked if any(scenario.initial_offset)}
    assert len(offsets) == starts
    assert 0.0 < np.abs(list(offsets)).max() <= 1e-10
    nearby = section.numbers["nearby_starts"]["gravity off, feedforward none, 1 / 1, fixed"]
    assert nearby["z_rmse_mm"] == [pytest.approx(1.0)] * starts
    assert "rotations times 110 mm, the robot's characteristic length" in section.body


@pytest.mark.usefixtures("no_pictures")
def test_a_trajectory_beyond_the_limits_is_a_row_with_its_reason(tmp_path, made_runs, monkeypatch):
    far = Trajectory("far", "X 400 mm", SineReference(amplitude=(0.0, 0.0, 0.0, 0.4, 0.0, 0.0)), 4.0)
    monkeypatch.setattr(in_the_loop, "unseen_trajectories", lambda: (far,))
    section = make(Study(tmp_path))
    assert list(section.numbers["pose_rmse_mm"]) == ["(37), (38)"]
    ((name, weights, reason),) = (row.values() for row in section.numbers["incomplete"])
    assert (name, weights) == ("far", "all")
    assert reason.startswith("not run: reference: breaks the limit")
    assert len(made_runs[0]) == 8 + 3 * 5
