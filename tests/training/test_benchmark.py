import numpy as np
import pytest

from stewart_drake.control.features import CostScales
from stewart_drake.logs.metrics import run_cost, run_metrics
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.runs.simulation import run
from stewart_drake.studies.workers import Workers
from stewart_drake.training.benchmark import (
    BEST_FIXED,
    Baselines,
    Verdict,
    assess,
    estimate,
    mean_over_cells,
    with_setting,
)
from stewart_drake.training.situations import HELD_OUT, ROBOTS, TRAINING, Case, kinds_of, situation


def test_each_cell_counts_alike_however_many_runs_it_has():
    cases = [Case("hold", "paper", 0), Case("fast", "paper", 0), Case("fast", "paper", 1), Case("fast", "paper", 2)]
    values = np.array([[1.0, 3.0, 4.0, 5.0], [0.0, 0.0, 0.0, 3.0]])
    assert mean_over_cells(values, cases) == pytest.approx([2.5, 0.5])


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


@pytest.mark.slow
def test_a_small_verdict_is_written_taken_up_again_and_says_what_a_run_costs(tmp_path, monkeypatch):
    few = {"paper": ["hold"], "reachy_mini": ["nod"]}
    monkeypatch.setattr("stewart_drake.training.benchmark.kinds_of", lambda robot, _: few[robot])
    entered = {BEST_FIXED: with_setting([0.0] * 4), "quiet": with_setting([0.0, 0.0, 0.0, -1.0])}
    for _ in range(2):
        verdict = assess(entered, tmp_path, 1, "reduced", Workers(0), lambda _: None)
    assert {case.seed for case in verdict.cases} == {HELD_OUT[0]}
    assert {path.name for path in tmp_path.glob("verdict.*")} == {"verdict.parquet", "verdict.csv", "verdict.md"}
    # A robot that rests wants to be quiet.
    assert estimate(verdict.of("quiet", lambda cell: cell[0] == "hold")).value < 0.8
    log = run(situation(*verdict.cases[1][:3]).replace({"plant.engine": "reduced"}))
    expected = run_cost(run_metrics(log), log.status, 0.01, CostScales())
    assert np.exp(verdict.logs[0, 1]) == pytest.approx(expected)


def test_the_shipped_baselines_have_every_kind():
    baselines = Baselines.load()
    for robot in ROBOTS:
        assert set(baselines.best_of_kind[robot]) == set(kinds_of(robot))


EACH = [(kind, robot) for robot in ROBOTS for kind in kinds_of(robot)]


@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_motion_is_within_the_limits_and_nothing_else_than_drawn_is_changed(kind, robot):
    for seed in (TRAINING[0], HELD_OUT[0]):
        made, base = situation(kind, robot, seed), ROBOTS[robot].base
        assert check_reference(made.robot, made.limits, made.reference, made.duration).feasible
        assert made.to_dict() == situation(kind, robot, seed).to_dict()
        for name in ("robot", "tuner", "controller", "estimator", "duration", "friction_compensation", "safety"):
            assert getattr(made, name) == getattr(base, name)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_run_completes_at_the_default_setting(kind, robot):
    for seed in (TRAINING[1], HELD_OUT[1]):
        assert run(situation(kind, robot, seed).replace({"plant.engine": "reduced"})).status == "completed"
