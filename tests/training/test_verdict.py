import numpy as np
import pytest

from stewart_drake.studies.workers import Workers
from stewart_drake.training.baselines import Baselines
from stewart_drake.training.benchmark import Case, with_setting
from stewart_drake.training.situations import HELD_OUT, ROBOTS, kinds_of, situation
from stewart_drake.training.verdict import BEST_FIXED, Verdict, candidates, geometric_mean, judge, median, page

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
    assert geometric_mean(verdict.of(BEST_FIXED)) == (1.0, 1.0, 1.0)
    hold, fast = verdict.of("rival")
    assert np.exp(hold) == pytest.approx(0.5)
    overall = geometric_mean(verdict.of("rival"))
    assert overall.value == pytest.approx(np.exp(0.5 * (np.log(0.5) + fast.mean())))
    assert overall.low < overall.value < overall.high
    assert geometric_mean(verdict.of("rival", lambda cell: cell[0] == "hold")).high == pytest.approx(0.5)
    assert verdict.worst_cell("rival") == (("fast", "paper"), pytest.approx(np.exp(fast.mean())))


def test_an_interval_has_the_true_mean_as_often_as_it_says():
    rng = np.random.default_rng(1)
    within = 0
    for trial in range(60):
        cells = [rng.normal(mean, 0.4, 25) for mean in (-1.0, 0.5, 0.2)]
        interval = geometric_mean(cells, seed=trial)
        within += interval.low <= np.exp(-0.1) <= interval.high
    assert 50 <= within <= 60


def test_a_median_is_that_of_all_runs():
    cells = [np.log([1.0, 2.0, 3.0]), np.log([4.0, 50.0])]
    assert median(cells).value == pytest.approx(3.0)


def test_the_page_says_who_failed_where_it_is_worst_and_who_wins_a_duel():
    lines = page(made_verdict()).splitlines()
    line = next(line for line in lines if line.startswith("| rival"))
    assert ", fast, paper" in line
    assert line.endswith("| 1 |")
    duels = lines[lines.index("J of `rival` over that of") + 2 :]
    assert duels[0] == "|  | third |"
    assert duels[2] == "| all kinds | 0.25 (0.25 to 0.25) |"


def test_each_candidate_makes_a_scenario_of_either_robot():
    baselines = Baselines.load()
    entered = candidates(baselines, {"schedule": {"tuner": baselines.schedule}})
    for case in (Case("fast", "paper", 1), Case("nod", "reachy_mini", 1)):
        scenario = situation(*case)
        kinds = {name: scenario.replace(one(case, scenario)).tuner.kind for name, one in entered.items()}
        assert kinds["the paper's tuner"] == "paper"
        assert kinds["best of the nine pairs"] == "fixed"
        assert kinds["schedule"] == "schedule"
        assert kinds[BEST_FIXED] == kinds["oracle of each kind"] == "block"


@pytest.mark.slow
def test_a_small_verdict_is_written_and_taken_up_again(tmp_path, monkeypatch):
    few = {"paper": ["hold"], "reachy_mini": ["nod"]}
    monkeypatch.setattr("stewart_drake.training.benchmark.kinds_of", lambda robot, _: few[robot])
    entered = {BEST_FIXED: with_setting([0.0] * 4), "quiet": with_setting([0.0, 0.0, 0.0, -1.0])}
    done = []
    for _ in range(2):
        verdict = judge(entered, tmp_path, 1, "reduced", Workers(0), done.append)
    assert done.count(4.0) == 2
    assert done[-1] == 4.0
    assert {case.seed for case in verdict.cases} == {HELD_OUT[0]}
    assert {path.name for path in tmp_path.glob("verdict.*")} == {"verdict.parquet", "verdict.csv", "verdict.md"}
    hold = verdict.of("quiet", lambda cell: cell[0] == "hold")
    assert geometric_mean(hold).value < 0.8
    assert not verdict.failed.any()


def test_the_shipped_baselines_have_every_kind():
    baselines = Baselines.load()
    for robot in ROBOTS:
        assert set(baselines.best_of_kind[robot]) == set(kinds_of(robot))
