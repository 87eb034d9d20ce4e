import numpy as np
import pytest

from stewart_drake import check_reference, run, run_metrics
from stewart_drake.control.features import CostScales
from stewart_drake.logs.metrics import run_cost
from stewart_drake.studies.experiment import run_experiment
from stewart_drake.studies.workers import Workers
from stewart_drake.training.benchmark import (
    BEST_FIXED,
    Baselines,
    estimate,
    evaluation,
    mean_over_cells,
    ratios,
    with_setting,
)
from stewart_drake.training.situations import HELD_OUT, ROBOTS, TRAINING, Case, kinds_of, situation


def test_each_cell_counts_alike_however_many_runs_it_has():
    cases = [Case("hold", "paper", 0), Case("fast", "paper", 0), Case("fast", "paper", 1), Case("fast", "paper", 2)]
    values = np.array([[1.0, 3.0, 4.0, 5.0], [0.0, 0.0, 0.0, 3.0]])
    assert mean_over_cells(values, cases) == pytest.approx([2.5, 0.5])


def made_rows():
    """A candidate that costs half in one kind and, give or take, twice as much in the other."""
    rng = np.random.default_rng(0)
    fixed = rng.normal(0.0, 1.0, 80)
    other = fixed + np.where(np.arange(80) < 40, np.log(0.5), np.log(2.0) + rng.normal(0.0, 0.3, 80))
    kinds = np.repeat(["hold", "fast"], 40).tolist()
    return [
        {"candidate": name, "kind": kind, "robot": "paper", "cost": np.exp(log)}
        for name, logs in ((BEST_FIXED, fixed), ("other", other))
        for kind, log in zip(kinds, logs, strict=True)
    ]


def test_ratios_are_to_the_best_fixed_setting_in_the_same_run():
    rows = made_rows()
    assert estimate(ratios(rows, BEST_FIXED)) == (1.0, 1.0, 1.0)
    hold, fast = ratios(rows, "other")
    assert np.exp(hold) == pytest.approx(0.5)
    overall = estimate(ratios(rows, "other"))
    assert overall.value == pytest.approx(np.exp(0.5 * (np.log(0.5) + fast.mean())))
    assert overall.low < overall.value < overall.high


@pytest.mark.slow
def test_a_small_evaluation_is_written_continued_and_has_the_cost_of_a_run(tmp_path, monkeypatch):
    few = {"paper": ["hold"], "reachy_mini": ["nod"]}
    monkeypatch.setattr("stewart_drake.training.benchmark.kinds_of", lambda robot, _: few.get(robot, []))
    candidates = {BEST_FIXED: with_setting([0.0] * 4), "quiet": with_setting([0.0, 0.0, 0.0, -1.0])}
    plan = evaluation(candidates, 1, "closed_form")
    for _ in range(2):
        result = run_experiment(plan, tmp_path, Workers(0), lambda _: None)
    rows, table = result.rows["verdict"], result.tables["verdict"]
    assert {row["seed"] for row in rows} == {HELD_OUT[0]}
    assert {"status", "cost", "ratio", "rmse_norm_mm", "torque_change_rms"} <= set(table.column_names)
    assert {path.name for path in tmp_path.glob("verdict.*")} == {"verdict.parquet", "verdict.csv", "verdict.md"}
    assert estimate(ratios(rows, "quiet", lambda cell: cell[0] == "hold")).value < 0.8
    case = [plan.trials[1].labels[name] for name in ("kind", "robot", "seed")]
    log = run(situation(*case).replace({"plant.kind": "closed_form"}))
    expected = run_cost(run_metrics(log), log.status, 0.01, CostScales())
    assert rows[1]["cost"] == pytest.approx(expected)


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
        for name in ("robot", "tuner", "controller", "estimator", "duration", "model", "safety"):
            assert getattr(made, name) == getattr(base, name)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_run_completes_at_the_default_setting(kind, robot):
    for seed in (TRAINING[1], HELD_OUT[1]):
        assert run(situation(kind, robot, seed).replace({"plant.kind": "closed_form"})).status == "completed"
