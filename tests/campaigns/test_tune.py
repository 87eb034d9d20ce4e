import copy
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.campaigns.comparison_file import Comparison, load_comparison
from stewart_drake.campaigns.executors import Lasting, SerialExecutor, workplace
from stewart_drake.campaigns.tune import measure_cost, run_tuning, write_picture
from stewart_drake.campaigns.tune_file import SEARCHED, START, TUNED, Ranges, Tuning, load_tuning
from stewart_drake.control.objective import CostScales
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.yaml_files import parse_yaml
from stewart_drake.keys import value_at
from stewart_drake.logs.cost import FAILED, mean_cost
from stewart_drake.runs.simulation import run

FILE = {
    "name": "small",
    "scenario": "paper_fig7",
    "set": {"duration": 0.12, "plant": {"engine": "reduced"}, "reference": {"kind": "hold"}},
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


class Counting(SerialExecutor):
    """Counts what it runs; of it the first is a look at the worker. Interrupts after so many."""

    def __init__(self, most=math.inf):
        self.done, self.most = 0, most

    def submit(self, function, /, *args, **kwargs):
        if self.done > self.most:
            raise KeyboardInterrupt
        self.done += function.__name__ == "_do"
        return super().submit(function, *args, **kwargs)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tune")
    counting, told = Counting(), []
    plan = tuning()
    return plan, run_tuning(plan, folder, counting, told.append), folder, counting.done, told


@pytest.mark.slow
def test_a_search_betters_what_it_starts_from_and_the_verdict_says_so(done):
    plan, result, _, count, told = done
    assert len(result.rows) == 2 * plan.evaluations
    assert count == plan.runs == told[-1] == 2 * 13 * 2 + 2 * 2 * 2 * 2
    assert told == sorted(told)
    for name in plan.ranges:
        own = [row for row in result.rows if row["controller"] == name]
        assert own[0]["setting"] == plan.ranges[name].start
        np.testing.assert_array_equal([row["best"] for row in own], np.minimum.accumulate([row["cost"] for row in own]))
        assert own[-1]["best"] < 0.8 * own[0]["cost"]
        judged = {
            way: mean_cost(row["cost"] for row in result.verdict.rows if row["controller"] == f"{name}, {way}")
            for way in (START, TUNED)
        }
        # Other noise, the same motions.
        assert judged[TUNED] < 0.9 * judged[START]
        assert {row["seed"] for row in result.verdict.rows} == {7, 8}


@pytest.mark.slow
def test_a_cost_is_the_mean_of_its_runs(done):
    plan, result, _, _, _ = done
    row = result.rows[-1]
    runs = [plan.comparison.scenario(place).replace(row["setting"]) for place in plan.cells("torque")]
    assert [each.sensors.noise_seed for each in runs] == [1, 1]
    costs = [measure_cost(run(each), CostScales(position=0.01))["cost"] for each in runs]
    assert row["cost"] == pytest.approx(mean_cost(costs), rel=1e-12)
    assert max(costs) < FAILED


@pytest.mark.slow
def test_what_is_found_goes_into_the_comparison(done):
    plan, result, folder, _, _ = done
    found = parse_yaml((folder / "tuned.yaml").read_text(), "tuned")
    assert found == {"name": "small", "controllers": result.tuned}
    with_it = Comparison.from_dict({**FILE, "tuned": str(folder / "tuned.yaml")})
    places = [place for place, cell in enumerate(with_it.cells) if cell.controller == "pid"]
    for place in places:
        assert with_it.scenario(place).controller.kp == result.tuned["pid"]["controller.kp"]
        assert with_it.scenario(place).controller.ki == 30.0
    # And a search starts from what the file itself has.
    assert tuning(tuned="nowhere.yaml").ranges["pid"].start == plan.ranges["pid"].start
    table = pq.read_table(folder / "tune.parquet")
    assert table["cost"].to_pylist() == [row["cost"] for row in result.rows]
    text = (folder / "tune.md").read_text()
    assert all(name in text for name in plan.ranges)
    assert write_picture(result, folder) is None
    assert (folder / "tune.png").stat().st_size > 10_000


@pytest.mark.slow
def test_interrupted_it_goes_on_and_finds_the_same(done, tmp_path):
    plan, result, _, count, _ = done
    with pytest.raises(KeyboardInterrupt):
        run_tuning(plan, tmp_path, Counting(37))
    told, rest = [], Counting()
    again = run_tuning(tuning(), tmp_path, rest, told.append)
    assert again.rows == result.rows
    assert rest.done == count - 38
    assert told[-1] == plan.runs
    # More generations, and one controller alone, take what is there.
    rest = Counting()
    longer = run_tuning(tuning(budget=17, controllers=("torque",)), tmp_path, rest)
    assert longer.rows[:13] == [row for row in result.rows if row["controller"] == "torque"]
    assert len(longer.rows) == 17
    assert rest.done < 4 * 2 + 2 * 2 * 2 + 1


@pytest.mark.slow
def test_a_setting_with_which_runs_fail_costs_the_most_and_the_search_goes_on(tmp_path):
    loaded = {"torque": {**FILE["controllers"]["torque"], "plant.payload_mass": 0.5}}
    changes = {"controllers": {"torque": {"plant.payload_mass": [0.01, 1e3]}}, "generations": 2, "spread": 0.5}
    plan = Tuning.from_dict({**FILE, "controllers": loaded, **tune_changed(**changes)})
    result = run_tuning(plan, tmp_path, SerialExecutor())
    failed = [row for row in result.rows if row["not_completed"]]
    assert failed
    assert all(FAILED / 2 <= row["cost"] <= FAILED for row in failed)
    assert result.rows[-1]["best"] < FAILED / 2


def test_in_the_search_alone_some_keys_are_others():
    plan = tuning(**tune_changed(set={"duration": 0.05}))
    assert {plan.comparison.scenario(place).duration for place in plan.cells("pid")} == {0.05}
    verdict = plan.verdict({"pid": {"controller.kp": 9.0, "controller.kd": 0.1}})
    durations = {cell.controller: verdict.scenario(place).duration for place, cell in enumerate(verdict.cells)}
    assert durations[f"pid, {START}"] == durations[f"pid, {TUNED}"] == 0.12
    assert durations[f"pid, {SEARCHED}"] == 0.05
    gains = {cell.controller: verdict.scenario(place).controller for place, cell in enumerate(verdict.cells)}
    assert [gains[f"pid, {way}"].kp for way in (START, TUNED, SEARCHED)] == [4.0, 9.0, 9.0]
    assert gains[f"torque, {TUNED}"].natural_frequency == 30.0


@given(st.floats(0.01, 1.0), st.floats(1.5, 1e4), st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
def test_points_of_the_cube_are_settings_between_the_bounds(low, factor, point):
    ranges = Ranges({"a": (low, low * factor), "b": (1.0, 100.0)}, {})
    setting = ranges.setting(point)
    assert low * (1 - 1e-3) <= setting["a"] <= low * factor * (1 + 1e-3)
    assert setting["b"] == pytest.approx(10.0 ** (2.0 * point[1]), rel=1e-3)
    np.testing.assert_allclose(ranges.point(setting), point, atol=2e-3)


def searched(**keys):
    return tune_changed(controllers={"pid": {key.replace("__", "."): ends for key, ends in keys.items()}})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tune": None}, r"^tune: expected .*, got None"),
        ({"cost": None}, r"^cost: expected .*, got None"),
        ({"cost": {"position": -1.0}}, r"^cost\.position: expected .*got -1"),
        (tune_changed(controllers={}), r"^tune\.controllers: expected .*got \{\}"),
        (tune_changed(controllers={"pid": {}}), r"^tune\.controllers\.pid: expected at least one"),
        (tune_changed(controllers={"none": {"controller.kp": [1, 2]}}), r"^tune\.controllers: expected .*got 'none'"),
        (searched(controller__kpp=[1, 2]), r"^tune\.controllers\.pid: controller\.kpp: .*kp"),
        (searched(controller__kp=[9, 1]), r"^tune\.controllers\.pid\.controller\.kp: expected .*got \[9"),
        (searched(controller__kp=[0, 1]), r"^tune\.controllers.*kp.*: expected .*, got 0"),
        (searched(controller__kp=[5, 9]), r"^tune\.controllers\.pid: controller\.kp: expected .*, got 4"),
        (searched(tuner=[5, 9]), r"^tune\.controllers\.pid: tuner"),
        (searched(duration=[0.1, 1e9]), r"^tune\.controllers\.pid: duration: expected .*, got 1"),
        (tune_changed(set={"plant.engin": "reduced"}), r"^tune: set\.plant\.engin"),
        (tune_changed(generation=2), r"^tune\.generation: .*did you mean generations"),
        (tune_changed(population=1), r"^tune\.population: expected .*, got 1"),
    ],
)  # fmt: skip
def test_what_cannot_be_searched_is_refused_in_a_line(changes, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        tuning(**changes)
    assert "\n" not in str(caught.value)


def test_what_the_command_line_asks_is_refused_in_a_line():
    with pytest.raises(ConfigurationError, match=r"^--controller: expected one of pid, torque"):
        tuning(controllers=("other",))
    with pytest.raises(ConfigurationError, match=r"^--budget: expected at least 5"):
        tuning(budget=4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "^tuned: expected a file"),
        ("controllers: {nobody: {controller.kp: 1.0}}", r"^tuned\.controllers: expected .*got 'nobody'"),
        ("controllers: {pid: {controller.kp: -1.0}}", r"^tuned\.controllers\.pid.*: expected .*got -1"),
        ("controllers: {pid: {controller.kq: 1.0}}", r"^pid, off, noise: controller\.kq"),
        ("[1, 2]", "^tuned file .*: expected .*got"),
    ],
)
def test_a_tuned_file_that_does_not_fit_is_refused(tmp_path, text, message):
    if text is not None:
        (tmp_path / "tuned.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        Comparison.from_dict({**FILE, "tuned": "tuned.yaml"}, tmp_path)


def test_the_shipped_search_can_be_done():
    plan = load_tuning("fair")
    assert len(plan.ranges) == 4
    # The same runs for all of them, on the fast engine; the comparison itself on Drake's plant.
    runs = [
        [(plan.comparison.cells[i].reference, plan.comparison.cells[i].condition) for i in plan.cells(name)]
        for name in plan.ranges
    ]
    assert all(each == runs[0] for each in runs)
    assert {plan.comparison.scenario(i).plant.engine for i in range(plan.comparison.runs)} == {"reduced"}
    assert {each.plant.engine for each in plan.verdict({}).variants()} == {"drake", "reduced"}


def test_an_executor_that_lasts_is_opened_once_until_it_is_worn():
    class Place(type(workplace(None))):
        workers, worn, opened, closed = 2, 3, 0, 0

        def __init__(self):
            pass

        def open(self, most):  # noqa: ARG002
            type(self).opened += 1
            return SerialExecutor()

        def close(self, executor, abort):  # noqa: ARG002
            type(self).closed += 1

    place = Place()
    with Lasting(place) as lasting:
        first = lasting.open(3)
        lasting.close(first, abort=False)
        assert lasting.open(3) is first
        assert Place.opened == 1
        assert lasting.open(1) is not first
        assert (Place.opened, Place.closed) == (2, 1)
    assert Place.closed == 2


def test_what_the_shipped_comparison_takes_is_what_its_search_can_find():
    plan, compared = load_tuning("fair"), load_comparison("fair")
    for name, ranges in plan.ranges.items():
        place = next(place for place, cell in enumerate(compared.cells) if cell.controller == name)
        found = value_of(compared.scenario(place), ranges.keys)
        assert found != ranges.start
        assert all(low <= found[key] <= high for key, (low, high) in ranges.keys.items())


def value_of(scenario, keys):
    return {key: value_at(scenario.in_full(), key) for key in keys}
