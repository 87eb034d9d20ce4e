import numpy as np
import pytest

from stewart_drake.control.features import CostScales
from stewart_drake.logs.metrics import FAILED, run_cost, run_metrics
from stewart_drake.runs.simulation import run
from stewart_drake.studies.workers import Workers
from stewart_drake.training.benchmark import (
    BEST_FIXED,
    LEAST_COST,
    Baselines,
    Verdict,
    assess,
    estimate,
    log_cost,
    mean_over_cells,
    page,
    with_setting,
)
from stewart_drake.training.situations import HELD_OUT, ROBOTS, Case, kinds_of, situation


def test_a_setting_moves_weights_and_disturbance_as_it_says():
    case = Case("hold", "paper", 0)
    scenario = situation(*case[:3])
    made = scenario.replace(with_setting([0.1, 0.2, -0.3, -0.5])(case, scenario))
    before, after = np.array(scenario.tuner.weights), np.array(made.tuner.weights)
    assert np.log10(after / before) == pytest.approx([0.4, 0.4, 0.3, 0.0])
    assert np.log10(made.estimator.disturbance / scenario.estimator.disturbance) == pytest.approx(-0.5)


def test_each_cell_counts_alike_however_many_runs_it_has():
    cases = [Case("hold", "paper", 0), Case("fast", "paper", 0), Case("fast", "paper", 1), Case("fast", "paper", 2)]
    values = np.array([[1.0, 3.0, 4.0, 5.0], [0.0, 0.0, 0.0, 3.0]])
    assert mean_over_cells(values, cases) == pytest.approx([2.5, 0.5])


def test_a_failed_run_costs_the_most_and_one_of_nothing_the_least():
    good = {"status": "completed", **dict.fromkeys(("rmse_norm_mm", "torque_change_rms"), 0.0), "period": 0.001}
    scales = CostScales()
    assert log_cost({**good, "rmse_norm_deg": 0.03}, scales) == pytest.approx(0.0)
    assert log_cost({**good, "rmse_norm_deg": 0.03, "status": "lost"}, scales) == pytest.approx(np.log(FAILED))
    assert log_cost({"status": "rejected"}, scales) == pytest.approx(np.log(FAILED))
    assert log_cost({**good, "rmse_norm_deg": 0.0}, scales) == pytest.approx(np.log(LEAST_COST))


CASES = tuple(Case(kind, "paper", seed) for kind in ("hold", "fast") for seed in range(40))


def made_verdict():
    """A rival that costs half in one kind and, give or take, twice as much in the other; and one that costs 4 times."""
    rng = np.random.default_rng(0)
    fixed = rng.normal(0.0, 1.0, len(CASES))
    rival = fixed + np.where(np.arange(len(CASES)) < 40, np.log(0.5), np.log(2.0) + rng.normal(0.0, 0.3, len(CASES)))
    failed = np.zeros((3, len(CASES)), dtype=bool)
    failed[1, 3] = True
    logs = np.array([fixed, rival, rival + np.log(4.0)])
    return Verdict((BEST_FIXED, "rival", "third"), CASES, logs, failed)


def test_ratios_are_to_the_best_fixed_setting_in_the_same_run():
    verdict = made_verdict()
    assert estimate(verdict.of(BEST_FIXED)) == (1.0, 1.0, 1.0)
    hold, fast = verdict.of("rival")
    assert np.exp(hold) == pytest.approx(0.5)
    overall = estimate(verdict.of("rival"))
    assert overall.value == pytest.approx(np.exp(0.5 * (np.log(0.5) + fast.mean())))
    assert overall.low < overall.value < overall.high
    assert estimate(verdict.of("rival", lambda cell: cell[0] == "hold")).high == pytest.approx(0.5)
    assert estimate([np.log([1.0, 2.0, 3.0]), np.log([4.0, 50.0])], "median").value == pytest.approx(3.0)


def test_the_page_says_who_failed_where_it_is_worst_and_who_wins_a_duel():
    lines = page(made_verdict()).splitlines()
    line = next(line for line in lines if line.startswith("| rival"))
    assert ", fast, paper" in line
    assert line.endswith("| 1 |")
    duels = lines[lines.index("J of `rival` over that of") + 2 :]
    assert duels[0] == "|  | third |"
    assert duels[2] == "| all kinds | 0.25 (0.25 to 0.25) |"


@pytest.mark.slow
def test_a_small_verdict_is_written_taken_up_again_and_says_what_a_run_costs(tmp_path, monkeypatch):
    few = {"paper": ["hold"], "reachy_mini": ["nod"]}
    monkeypatch.setattr("stewart_drake.training.benchmark.kinds_of", lambda robot, _: few[robot])
    entered = {BEST_FIXED: with_setting([0.0] * 4), "quiet": with_setting([0.0, 0.0, 0.0, -1.0])}
    done = []
    for _ in range(2):
        verdict = assess(entered, tmp_path, 1, "reduced", Workers(0), done.append)
    assert done.count(4.0) == 2
    assert done[-1] == 4.0
    assert {case.seed for case in verdict.cases} == {HELD_OUT[0]}
    assert {path.name for path in tmp_path.glob("verdict.*")} == {"verdict.parquet", "verdict.csv", "verdict.md"}
    # A robot that rests wants to be quiet.
    assert estimate(verdict.of("quiet", lambda cell: cell[0] == "hold")).value < 0.8
    assert not verdict.failed.any()
    log = run(situation(*verdict.cases[1][:3]).replace({"plant.engine": "reduced"}))
    expected = run_cost(run_metrics(log), log.status, 0.01, CostScales())
    assert np.exp(verdict.logs[0, 1]) == pytest.approx(expected)


def test_the_shipped_baselines_have_every_kind():
    baselines = Baselines.load()
    for robot in ROBOTS:
        assert set(baselines.best_of_kind[robot]) == set(kinds_of(robot))
