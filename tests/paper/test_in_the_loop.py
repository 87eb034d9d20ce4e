import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import made_log

from stewart_drake.control.density import density
from stewart_drake.control.network import default_network_path, load_network
from stewart_drake.paper import in_the_loop_section as in_the_loop
from stewart_drake.paper.experiments import PAIRS, RATIOS, pair_of, paper_scenario
from stewart_drake.paper.in_the_loop_section import make, on_trajectory, span, under_tuner
from stewart_drake.paper.plots.in_the_loop_plots import plot_answers, plot_ranking, plot_weights_in_force
from stewart_drake.paper.rendering import render
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.paper.tracking_score import tracking_score
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
    falling,
    findings,
    fit_answers,
    improvement,
    improvements,
    log_ratio,
    mean_answer,
    mean_log_ratio,
)
from stewart_drake.references import SineReference
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import FixedTuner, Scenario

FALLING = dict(zip(RATIOS, (20.0, 10.0, 4.0, 2.0, 1.0), strict=True))


def compared(name="a", tuner=5.0, **changes):
    """A trajectory on which the ratios make 20, 10, 4, 2, 1 mm; `r100=None` is a run that ended early."""
    return Comparison(name, tuner, FALLING | {float(k[1:].replace("_", ".")): v for k, v in changes.items()})


# --- the comparison ------------------------------------------------------------------------------------------------


def test_the_labels_of_the_five_ratios_are_the_nine_pairs():
    assert LABELS == {0.01: 1, 0.1: 2, 1.0: 3, 10.0: 2, 100.0: 1}


@given(st.lists(st.floats(0.01, 100.0), min_size=5, max_size=5))
def test_the_mean_of_the_nine_is_that_over_the_pairs_themselves(rmse):
    of_ratio = dict(zip(RATIOS, rmse, strict=True))
    by_pair = [next(v for r, v in of_ratio.items() if np.isclose(q / s, r)) for q, s in PAIRS]
    comparison = Comparison("a", 1.0, of_ratio)
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


def test_a_perfect_estimator_has_slope_one_and_a_blind_one_slope_zero():
    perfect = fit_answers(TRUTH, np.tile(TRUTH, (4, 1)))
    assert (perfect.slope, perfect.r_squared) == (pytest.approx(1.0), pytest.approx(1.0))
    assert perfect.by_trajectory == pytest.approx(0.0)
    blind = fit_answers(TRUTH, np.repeat([[-1.0], [0.0], [0.4]], 5, axis=1))
    assert blind.slope == pytest.approx(0.0)
    assert blind.by_trajectory == pytest.approx(1.0)
    assert blind.mean == pytest.approx(-0.2)
    assert blind.r_squared < 0.0


def test_an_estimator_that_shrinks_to_the_middle_shows_by_how_much():
    assert fit_answers(TRUTH, np.tile(0.3 * TRUTH - 0.5, (2, 1))).slope == pytest.approx(0.3)


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


@pytest.mark.parametrize("kind", ["magnitude", "signed"])
def test_ten_times_the_error_has_the_same_densities(kind):
    # What the section says of (35), (36): the size of a signal is divided out.
    samples = np.random.default_rng(2).normal(1.0, 0.5, (50, 12))
    np.testing.assert_allclose(density(10.0 * samples, kind), density(samples, kind), rtol=1e-12)


# --- words ---------------------------------------------------------------------------------------------------------


def said(*comparisons):
    return render("in_the_loop", "verdict", **findings(comparisons, improvements(comparisons)))


def test_the_verdict_on_a_tuner_that_loses():
    words = said(compared("(37), (38)", tuner=8.0), compared(tuner=8.0))
    assert (
        "Does not hold: on (37), (38) the tuner's pose RMSE is 8 mm: 100 % above that of 1/1 held fixed, 700 % above"
        in words
    )
    assert "that of the best fixed pair (ratio 100). 45 % on average is reached against ratio 0.01." in words
    worse = said(compared(tuner=12.0))
    nearest = "(the most is 40 %, against ratio 0.01, or 40 % by geometric mean)"
    assert worse.endswith(f"45 % on average is reached against no baseline {nearest}.")


def test_the_verdict_on_a_tuner_that_wins():
    words = said(compared(tuner=0.5), compared(tuner=0.5))
    assert words.startswith("Holds: ")
    assert "88 % below that of 1/1 held fixed, 50 % below that of the best of the nine" in words
    names = [f"ratio {r:g}" for r in RATIOS] + [BEST_FIXED, MEAN_OF_NINE, ORACLE]
    assert words.endswith(f"45 % on average is reached against {', '.join(names)}.")


def test_the_verdict_on_runs_that_end_early():
    words = said(compared("(37), (38)", tuner=None, r1=None))
    assert words.startswith("Does not hold: on (37), (38) the run under the tuner ends early. Over 1")
    assert "not comparable with the mean of the nine" in words
    assert words.endswith("no baseline.")


def explained(comparisons, slope, score, factors, spread):
    """The section's "Why", for an estimator of that slope; None where no trajectory is completed by all five."""
    fit = None if slope is None else {"slope": slope, "mean": -0.6, "by_trajectory": 0.8, "r_squared": slope}
    numbers = {"answers": fit, "torque_spread_percent": spread, "tuner_over_constant": dict(enumerate(factors))}
    typical = np.exp(np.mean(np.log(factors))) if factors else None
    return render("in_the_loop", "why", n=numbers, falling=falling(comparisons), score=score, typical=typical)


def test_the_explanation_follows_the_numbers():
    blind = explained([compared()], 0.0, 0.82, [1.2, 1.3], 2.0)
    for words in ("on 1 of 1 trajectories", "it hardly sees that here", "validation R^2 was 0.82", "costs 25 %"):
        assert words in blind
    assert "almost nothing to save" in blind
    seeing = explained([compared(r100=3.0)], 0.95, None, [0.5], 40.0)
    for words in ("on 0 of 1 trajectories", "it sees that here", "gains 50 %"):
        assert words in seeing
    assert "validation" not in seeing
    assert "nothing to save" not in seeing
    assert "it sees in part that" in explained([compared()], 0.5, None, [], 1.0)
    assert "What the network sees" not in explained([compared(r1=None)], None, None, [], 1.0)


@pytest.mark.parametrize(
    ("growth", "late", "words"),
    [
        (0.5, 0.5, "at 5 s the largest abs(z) is 0.5, 50 % of that of the run; the error of the second half is 0.50 "
                   "times that of the first: it shrinks."),
        (1.5, None, "the error of the second half is 1.50 times that of the first: it grows."),
        (1.0, None, "the error of the second half is 1.00 times that of the first: it neither shrinks nor grows."),
        (None, 0.5, "at 5 s the largest abs(z) is 0.5, 50 % of that of the run."),
        (None, None, "the run ends early."),
    ],
)  # fmt: skip
def test_whether_the_error_shrinks_is_said_by_the_numbers(growth, late, words):
    found = {"integral_at_5s": late, "integral_largest": 1.0, "growth": growth}
    numbers = {"fig7": {"here, tuner": found, "here, 1 / 1, fixed": found}}
    assert render("in_the_loop", "shrinking", n=numbers) == f"- here, tuner: {words}"


# --- figures -------------------------------------------------------------------------------------------------------


def texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_the_ranking_is_labelled_logarithmic_and_holds_every_mark():
    rows = [compared("one"), compared("two", tuner=None, r100=None)]
    figure = plot_ranking(rows)
    (panel,) = figure.axes
    assert panel.get_xscale() == "log"
    assert "[mm]" in panel.get_xlabel()
    assert [t.get_text() for t in panel.get_yticklabels()] == ["one", "two"]
    low, high = panel.get_xlim()
    assert low < 1.0 < 20.0 < high
    assert {"tuner", "mean of the nine", "oracle: best of the nine", *(f"ratio {r:g}" for r in RATIOS)} <= set(
        texts(figure)
    )


def test_the_weights_have_a_panel_a_trajectory_with_units():
    time = np.linspace(0.0, 1.0, 11)
    made = {str(i): (time, np.full(11, 0.3)) for i in range(4)}
    figure = plot_weights_in_force(made, {"0": 100.0, "1": None, "2": 1.0, "3": 1.0})
    shown = [panel for panel in figure.axes if panel.axison]
    assert [p.get_title(loc="left") for p in shown] == list(made)
    assert all(p.get_yscale() == "log" for p in shown)
    assert shown[0].get_ylabel().endswith("[-]")
    assert sum(p.get_xlabel() == "time [s]" for p in shown) == 3


def test_the_answers_are_shown_beside_a_perfect_estimator():
    figure = plot_answers(RATIOS, {"(37), (38)": [0.0] * 5, "b": [1.0] * 5})
    (panel,) = figure.axes
    assert panel.get_xlabel().endswith("[-]")
    assert panel.get_ylabel().endswith("[-]")
    lines = {line.get_label(): line for line in panel.get_lines()}
    np.testing.assert_allclose(lines["a perfect estimator"].get_ydata(), RATIOS)
    np.testing.assert_allclose(lines["mean over all"].get_ydata(), np.sqrt(10.0))


# --- the section ---------------------------------------------------------------------------------------------------


def test_the_tuner_is_the_reports_own_where_it_has_one(tmp_path):
    study = Study(tmp_path)
    assert study.tuner_file == default_network_path()
    assert under_tuner(study, Scenario()).tuner.weights_file is None
    dataclasses.replace(load_network(default_network_path()), density="signed", window=7).save(tmp_path / "tuner.json")
    tuner = under_tuner(study, Scenario(tuner=FixedTuner(omega_q=10.0))).tuner
    assert study.tuner_file == tmp_path / "tuner.json"
    assert (tuner.kind, tuner.weights_file) == ("ann", str(tmp_path / "tuner.json"))
    assert (tuner.density, tuner.window, tuner.omega_q, tuner.omega_r) == ("signed", 7, 1.0, 1.0)


def test_a_quick_report_and_a_whole_one_in_one_folder_have_their_own_tuners(tmp_path):
    whole, quick = Study(tmp_path), Study(tmp_path, quick=True)
    load_network(default_network_path()).save(tmp_path / quick.name("tuner", ".json"))
    assert whole.tuner_file == default_network_path()
    assert quick.tuner_file == tmp_path / "tuner-quick.json"
    assert quick.save_figure(plot_answers(RATIOS, {"a": [0.0] * 5}), "answers") == "answers-quick.png"
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


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.usefixtures("no_pictures")
def test_the_section_compares_every_trajectory_with_all_five_controllers(tmp_path, made_runs, quick):
    section = make(Study(tmp_path, quick))
    numbers = section.numbers["pose_rmse_mm"]
    assert len(numbers) >= (2 if quick else 11)
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
    starts = 2 if quick else 5
    (made_runs,) = made_runs
    assert len(made_runs) == 6 * len(numbers) + 2 + 3 * starts
    offsets = {scenario.initial_offset for scenario in made_runs if any(scenario.initial_offset)}
    assert len(offsets) == starts
    assert 0.0 < np.abs(list(offsets)).max() <= 1e-10
    nearby = section.numbers["nearby_starts"]["gravity off, feedforward none, 1 / 1, fixed"]
    assert nearby["z_rmse_mm"] == [pytest.approx(1.0)] * starts
    assert "rotations times 110 mm, the robot's characteristic length" in section.body
    assert len(section.files) == 5
    assert Section.from_json(section.to_json()) == section


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


def test_a_span_is_one_figure_where_all_agree():
    assert span([0.44501, 0.44502, None]) == "0.445"
    assert span([2.71, 4.13, 2.88]) == "2.71 to 4.13"
    assert span([None]) is None


def test_the_quick_report_ranks_its_own_network(report):
    section = report.sections["in_the_loop"]
    n = section.numbers
    assert n["incomplete"] == []
    assert f"All {6 * len(n['pose_rmse_mm'])} runs of the comparison completed." in section.body
    scenario = paper_scenario(Scenario(), 3.2, Scenario().gravity, "gravity", pair_of(10.0))
    assert n["pose_rmse_mm"]["(37), (38)"]["ratio 10"] == pytest.approx(tracking_score(run(scenario)).pose_mm, rel=1e-9)
    # Who knows the best of the nine cannot be beaten by one that stays within them.
    for found in n["pose_rmse_mm"].values():
        assert found["oracle"] == min(found[f"ratio {ratio:g}"] for ratio in RATIOS) <= found["mean of the nine"]
