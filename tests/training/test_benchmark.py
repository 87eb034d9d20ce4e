import numpy as np
import pytest

from stewart_drake.control.objective import CostScales
from stewart_drake.logs.cost import FAILED, run_cost
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run
from stewart_drake.studies.workers import Workers
from stewart_drake.training.benchmark import (
    LEAST_COST,
    Benchmark,
    Case,
    cases_of,
    log_cost,
    mean_over_cells,
    with_setting,
)
from stewart_drake.training.situations import situation

BASE = with_setting([0.0] * 4)


def test_a_setting_of_zeros_is_the_default():
    case = Case("hold", "reachy_mini", 0)
    scenario = situation(*case)
    assert scenario.replace(BASE(case, scenario)).to_dict() == scenario.to_dict()


def test_a_setting_moves_weights_and_disturbance_as_it_says():
    case = Case("hold", "paper", 0)
    scenario = situation(*case)
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


@pytest.mark.slow
def test_what_is_in_the_folder_is_not_run_again_and_is_what_a_run_costs(tmp_path):
    cases, done = cases_of([("hold", "reachy_mini"), ("nod", "reachy_mini")], [5]), []
    quiet = with_setting([0.0, 0.0, 0.0, -1.0])
    with Benchmark(tmp_path, "reduced", Workers(0)) as benchmark:
        first = benchmark.log_costs([BASE, quiet], cases)
    with Benchmark(tmp_path, "reduced", Workers(0), done.append) as benchmark:
        again = benchmark.log_costs([BASE, quiet], cases)
    assert np.array_equal(first, again)
    assert done == [4.0]
    log = run(situation(*cases[1]).replace({"plant.engine": "reduced"}))
    expected = run_cost(run_metrics(log), log.status, 0.01, CostScales())
    assert np.exp(first[0, 1]) == pytest.approx(expected)
    # A robot that rests wants to be quiet.
    assert first[1, 0] < first[0, 0]
