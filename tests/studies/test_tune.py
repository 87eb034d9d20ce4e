import copy

import numpy as np
import pyarrow.parquet as pq
import pytest

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.yaml_files import parse_yaml
from stewart_drake.logs.metrics import mean_cost
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.experiment import write_figures
from stewart_drake.studies.tune import START, TUNED, Tuning, minimise, run_tuning
from stewart_drake.studies.workers import Workers

FILE = {
    "name": "small",
    "scenario": "paper_fig7",
    "set": {"duration": 0.12, "plant": {"kind": "closed_form"}, "reference": {"kind": "hold"}},
    "cost": {"position": 0.01},
    "controllers": {
        "pid": {"controller": {"kind": "pid", "kp": 4.0, "ki": 30.0, "kd": 0.02}},
        "torque": {"controller": {"kind": "computed_torque", "natural_frequency": 30.0}},
        "other": {"controller": {"kind": "pid"}},
    },
    "references": {
        "off": {"initial_offset": [0.0, 0.0, 0.0, 0.0, 0.0, -0.001]},
        "payload": {"plant.payload_mass": 0.1},
    },
    "conditions": {"noise": {"sensors": {"kind": "encoders", "noise": 1e-5, "noise_seed": "{seed}"}}},
    "seeds": [7, 8],
    "tune": {
        "controllers": {
            "pid": {"controller.kp": [1.0, 100.0], "controller.kd": [0.01, 1.0]},
            "torque": {"controller.natural_frequency": [10.0, 200.0]},
        },
        "population": 4,
        "generations": 3,
        "seeds": [1],
    },
}


def tuning(budget=None, controllers=(), **changes):
    return Tuning.from_dict({**copy.deepcopy(FILE), **changes}, None, controllers, budget)


def tune_changed(**changes):
    return {"tune": {**FILE["tune"], **changes}}


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder, told, plan = tmp_path_factory.mktemp("tune"), [], tuning()
    return plan, run_tuning(plan, folder, Workers(0), told.append), folder, told


@pytest.mark.slow
def test_a_search_betters_what_it_starts_from_and_the_verdict_says_so(done):
    plan, result, _, told = done
    assert len(result.rows) == 2 * plan.evaluations
    assert plan.runs == told[-1] == 2 * 13 * 2 + 2 * 2 * 2 * 2
    for name in plan.start:
        own = [row for row in result.rows if row["controller"] == name]
        assert own[0]["setting"] == plan.start[name]
        np.testing.assert_array_equal([row["best"] for row in own], np.minimum.accumulate([row["cost"] for row in own]))
        assert own[-1]["best"] < 0.8 * own[0]["cost"]
        # Other noise, the same motions.
        verdict = result.test.rows["comparison"]
        start, tuned = (
            mean_cost(row["cost"] for row in verdict if row["controller"] == f"{name}, {way}") for way in (START, TUNED)
        )
        assert tuned < 0.9 * start
        assert {row["seed"] for row in verdict} == {7, 8}


@pytest.mark.slow
def test_what_is_found_goes_into_the_comparison(done):
    plan, result, folder, _ = done
    found = parse_yaml((folder / "tuned.yaml").read_text(), "tuned")
    assert found == {"name": "small", "controllers": result.tuned}
    with_it = Comparison.from_dict({**FILE, "tuned": str(folder / "tuned.yaml")})
    place = [trial.labels["controller"] for trial in with_it.trials].index("pid")
    assert with_it.scenario(place).controller.kp == result.tuned["pid"]["controller.kp"]
    assert with_it.scenario(place).controller.ki == 30.0
    # And a search starts from what the file itself has.
    assert tuning(tuned="nowhere.yaml").start["pid"] == plan.start["pid"]
    table = pq.read_table(folder / "tune.parquet")
    assert table["cost"].to_pylist() == [row["cost"] for row in result.rows]
    write_figures(plan.figures({"tune": result.rows}), folder)
    assert {"tune.md", "tune.png", "tune.pdf"} <= {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"controller.kpp": [1, 2]}, r"^tune\.controllers\.pid: controller\.kpp: .*kp"),
        ({"controller.kp": [5, 9]}, r"^tune\.controllers\.pid: controller\.kp: expected .*got 4"),
        ({"duration": [0.1, 1e9]}, r"^tune\.controllers\.pid: duration: expected .*got 1"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_a_line(ranges, message):
    with pytest.raises(ConfigurationError, match=message):
        tuning(**tune_changed(controllers={"pid": ranges}))


def test_points_stay_within_the_box_and_the_start_comes_first():
    low, high, asked = np.array([0.0, -0.5]), np.array([0.2, 0.5]), []

    def evaluate(points):
        asked.append(np.array(points))
        return [float(np.sum((point - 3.0) ** 2)) for point in points]  # least outside of the box

    found, _ = minimise(evaluate, np.array([0.1, 0.0]), low, high, generations=20, population=6, seed=2)
    assert asked[0] == pytest.approx(np.array([[0.1, 0.0]]))
    assert all(((points >= low - 1e-12) & (points <= high + 1e-12)).all() for points in asked)
    assert found == pytest.approx(high, abs=0.02)
