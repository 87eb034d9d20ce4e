import numpy as np
import pytest

from stewart_drake.campaigns.executors import SerialExecutor
from stewart_drake.control.settings import SIZE
from stewart_drake.training.baselines import HIGH, LOW, PAIRS, Baselines, Generations, find_baselines, schedule_of
from stewart_drake.training.contest import Case, with_setting
from stewart_drake.training.situations import HELD_OUT, ROBOTS, kinds_of, situation
from stewart_drake.training.verdict import BEST_FIXED, Verdict, contestants, geometric_mean, judge, median, page

CASES = tuple(Case(kind, "paper", seed) for kind in ("hold", "fast") for seed in range(40))


def made_verdict():
    """A rival that costs half in one kind and, give or take, twice as much in the other."""
    rng = np.random.default_rng(0)
    fixed = rng.normal(0.0, 1.0, len(CASES))
    rival = fixed + np.where(np.arange(len(CASES)) < 40, np.log(0.5), np.log(2.0) + rng.normal(0.0, 0.3, len(CASES)))
    failed = np.zeros((2, len(CASES)), dtype=bool)
    failed[1, 3] = True
    return Verdict((BEST_FIXED, "rival"), CASES, np.array([fixed, rival]), failed)


def baselines(**changes):
    zeros = [0.0] * SIZE
    found = {
        "best": [0.0, 0.1, -0.3, -0.5],
        "best_of_robot": dict.fromkeys(ROBOTS, zeros),
        "best_of_kind": {robot: dict.fromkeys(kinds_of(robot), zeros) for robot in ROBOTS},
        "pair": {robot: [10.0, 0.1] for robot in ROBOTS},
        "schedule": schedule_of(np.arange(10) * 0.01),
        "costs": {},
        "evaluations": {},
    }
    return Baselines.from_dict({**found, **changes})


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


def test_a_duel_is_told_beside_the_ratios_to_the_best_fixed_setting():
    fixed = made_verdict()
    third = Verdict(
        (*fixed.names, "third"),
        CASES,
        np.vstack([fixed.logs, fixed.logs[1:] + np.log(4.0)]),
        np.zeros((3, len(CASES)), bool),
    )
    assert geometric_mean(third.of("rival", over="third")).value == pytest.approx(0.25)
    lines = page(third).splitlines()
    told = lines[lines.index("J of `rival` over that of") + 2 :]
    assert told[0] == "|  | third |"
    assert told[2] == "| all kinds | 0.25 (0.25 to 0.25) |"


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


def test_the_page_says_who_failed_and_where_it_is_worst():
    text = page(made_verdict())
    line = next(line for line in text.splitlines() if line.startswith("| rival"))
    assert ", fast, paper" in line
    assert line.endswith("| 1 |")
    assert f"{len(CASES)} runs" in text


def test_baselines_are_read_back_as_they_were_written(tmp_path):
    found = baselines()
    found.save(tmp_path / "found.yaml")
    assert Baselines.load(tmp_path / "found.yaml") == found


def test_each_contestant_makes_a_scenario_of_either_robot():
    entered = contestants(baselines(), {"schedule": {"tuner": baselines().schedule}})
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
    monkeypatch.setattr("stewart_drake.training.contest.kinds_of", lambda robot: few[robot])
    entered = {BEST_FIXED: with_setting([0.0] * 4), "quiet": with_setting([0.0, 0.0, 0.0, -1.0])}
    done = []
    for _ in range(2):
        verdict = judge(entered, tmp_path, 1, "reduced", SerialExecutor(), done.append)
    assert done.count(4.0) == 2
    assert done[-1] == 4.0
    assert {case.seed for case in verdict.cases} == {HELD_OUT[0]}
    assert {path.name for path in tmp_path.glob("verdict.*")} == {"verdict.parquet", "verdict.csv", "verdict.md"}
    hold = verdict.of("quiet", lambda cell: cell[0] == "hold")
    assert geometric_mean(hold).value < 0.8
    assert not verdict.failed.any()


def test_the_shipped_baselines_are_whole_and_within_the_box_of_their_search():
    found = Baselines.load()
    for robot in ROBOTS:
        assert set(found.best_of_kind[robot]) == set(kinds_of(robot))
        assert tuple(found.pair[robot]) in PAIRS
        for setting in (found.best, found.best_of_robot[robot], *found.best_of_kind[robot].values()):
            assert (np.array(setting) >= LOW).all()
            assert (np.array(setting) <= HIGH).all()
    case = Case("hold", "paper", HELD_OUT[0])
    assert situation(*case).replace({"tuner": found.schedule}).tuner.kind == "schedule"


@pytest.mark.slow
def test_a_small_search_finds_what_costs_no_more_than_its_start(tmp_path, monkeypatch):
    few = {"paper": ["hold"], "reachy_mini": ["nod"]}
    for module in ("contest", "baselines"):
        monkeypatch.setattr(f"stewart_drake.training.{module}.kinds_of", lambda robot: few[robot])
    once = Generations(1, 1, 1)
    found = find_baselines(tmp_path, once, seeds=1, where=SerialExecutor())
    assert found == find_baselines(tmp_path, once, seeds=1, where=SerialExecutor())
    for robot, (kind,) in few.items():
        costs = found.costs[robot][kind]
        assert costs["best_of_kind"] <= costs["best"]
        assert costs["best_of_robot"] <= costs["best"]
    hold = found.costs["paper"]["hold"]
    assert hold["best"] < hold["default"]
