import re

import numpy as np
import pytest

from stewart_drake.campaigns.plan import vary
from stewart_drake.campaigns.sweep_file import Sweep, SweepFile, load_sweep
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.yaml_files import find_file, shipped_folder
from stewart_drake.scenario import Scenario, load_scenario

UNIFORM = {"kind": "uniform", "low": -1.0, "high": 1.0}
PLAIN = {"scenario": "paper_fig7", "runs": 4, "distributions": {"initial_offset[0]": UNIFORM}}
QUANTILES = np.linspace(0.0, 1.0, 1001)


def sweep(**changes):
    return Sweep.from_dict({**PLAIN, **changes})


def parsed(**data):
    return SweepFile.from_dict({**PLAIN, "distributions": {"here": data}}).distributions["here"]


def drawn_from(**data):
    distribution = parsed(**data)
    return np.array([distribution.at(q) for q in QUANTILES])


# --- distributions -------------------------------------------------------------------------------------------------


def test_uniform_and_loguniform_have_their_quantiles():
    np.testing.assert_allclose(drawn_from(kind="uniform", low=-2, high=6), -2.0 + 8.0 * QUANTILES, atol=1e-12)
    values = drawn_from(kind="loguniform", low=1e-3, high=10.0)
    np.testing.assert_allclose(np.log10(values), -3.0 + 4.0 * QUANTILES, atol=1e-12)
    assert 1e-3 <= values.min() < values.max() <= 10.0


@pytest.mark.parametrize(
    ("mean", "std", "low", "high"),
    [(1.0, 2.0, None, None), (0.0, 1.0, -1.0, 2.0), (0.0, 1.0, 5.0, None), (0.0, 1.0, None, -5.0), (3.0, 0.1, 2.9, 3)],
)
def test_a_normal_distribution_is_cut_off_and_has_its_shape_between(mean, std, low, high):
    from scipy.stats import truncnorm

    values = drawn_from(kind="normal", mean=mean, std=std, low=low, high=high)
    a, b = (-np.inf if low is None else (low - mean) / std), (np.inf if high is None else (high - mean) / std)
    inside = slice(1, -1)
    np.testing.assert_allclose(values[inside], truncnorm.ppf(QUANTILES[inside], a, b, mean, std), rtol=1e-9, atol=1e-9)
    assert np.isfinite(values[0])
    assert low is None or values.min() >= low
    assert high is None or values.max() <= high


def test_integers_and_choices_come_equally_often():
    values, counts = np.unique(drawn_from(kind="integers", low=-1, high=3), return_counts=True)
    assert values.tolist() == [-1, 0, 1, 2, 3]
    assert np.ptp(counts) <= 2
    values, counts = np.unique(drawn_from(kind="choice", values=["a", "b"]), return_counts=True)
    assert values.tolist() == ["a", "b"]
    assert np.ptp(counts) <= 1


# --- draws ---------------------------------------------------------------------------------------------------------

SEVERAL = {
    "initial_offset[0]": UNIFORM,
    "initial_offset[5]": {"kind": "normal", "mean": 0.0, "std": 0.001},
    "robot.platform_mass": {"kind": "uniform", "low": 0.8, "high": 1.2, "factor": True},
    "tuner.omega_q": {"kind": "grid", "values": [0.5, 1.0, 2.0]},
}


def draws(s):
    return [s.draw(index) for index in range(s.runs)]


@pytest.mark.parametrize("sampler", ["random", "sobol"])
def test_a_run_is_the_same_whatever_the_number_of_runs(sampler):
    few, many = (sweep(sampler=sampler, runs=runs, distributions=SEVERAL) for runs in (5, 77))
    assert draws(few) == draws(many)[:5]
    assert len({str(draw) for draw in draws(many)}) == 77
    assert [few.run_seed(i) for i in range(5)] == [many.run_seed(i) for i in range(5)]


def test_another_key_changes_nothing_about_the_draws_of_a_key():
    alone, among = sweep(), sweep(distributions=dict(reversed(SEVERAL.items())))
    assert [d["initial_offset[0]"] for d in draws(alone)] == [d["initial_offset[0]"] for d in draws(among)]


def test_keys_and_runs_are_independent_and_the_seed_changes_all():
    two = {"initial_offset[0]": UNIFORM, "initial_offset[1]": UNIFORM}
    values = np.array([list(d.values()) for d in draws(sweep(runs=2000, distributions=two))])
    assert abs(np.corrcoef(values.T)[0, 1]) < 0.08  # 3.6 standard deviations
    assert abs(np.corrcoef(values[:-1, 0], values[1:, 0])[0, 1]) < 0.08
    np.testing.assert_allclose(values.mean(axis=0), 0.0, atol=0.05)
    other = np.array([list(d.values()) for d in draws(sweep(runs=2000, distributions=two, seed=1))])
    assert not np.isin(values, other).any()


def test_sobol_covers_the_space_more_evenly():
    two = {"initial_offset[0]": UNIFORM, "initial_offset[1]": UNIFORM}
    cells = {}
    for sampler in ("random", "sobol"):
        points = [list(d.values()) for d in draws(sweep(runs=256, sampler=sampler, distributions=two))]
        cells[sampler] = np.histogram2d(*np.transpose(points), bins=16, range=[[-1, 1], [-1, 1]])[0]
    assert (cells["sobol"] == 1).all()
    assert (cells["random"] == 0).any()


def test_grids_run_through_all_their_combinations_the_first_key_fastest():
    grids = {
        "tuner.omega_q": {"kind": "grid", "values": [1.0, 2.0]},
        "controller.solver": {"kind": "grid", "values": ["split", "drake"]},
    }
    s = Sweep.from_dict({"scenario": "paper_fig7", "distributions": grids})
    assert s.runs == 4
    assert [tuple(d.values()) for d in draws(s)] == [(1.0, "split"), (2.0, "split"), (1.0, "drake"), (2.0, "drake")]
    assert s.replace(runs=5).draw(4) == s.draw(0)


def test_a_scenario_gets_what_was_drawn():
    s = sweep(distributions={**SEVERAL, "robot.platform_inertia": {"kind": "choice", "values": [2.0], "factor": True}})
    drawn, scenario = s.draw(1), s.scenario(1)
    assert scenario.initial_offset == (drawn["initial_offset[0]"], 0.0, 0.0, 0.0, 0.0, drawn["initial_offset[5]"])
    assert scenario.robot.platform_mass == s.base.robot.platform_mass * drawn["robot.platform_mass"]
    assert scenario.robot.platform_inertia == tuple(2.0 * x for x in s.base.robot.platform_inertia)
    assert scenario.tuner.omega_q == 1.0
    assert scenario.model_robot is None
    untouched = {"name", "robot", "initial_offset", "tuner"}
    assert {k: v for k, v in scenario.to_dict().items() if k not in untouched} == {
        k: v for k, v in s.base.to_dict().items() if k not in untouched
    }


def test_with_mismatch_the_controller_keeps_the_robot_of_the_scenario():
    masses = {"robot.platform_mass": {"kind": "uniform", "low": 2.0, "high": 3.0}}
    s = sweep(mismatch=True, distributions=masses, set={"robot.rod_length": 0.41, "initial_offset[5]": 0.01})
    scenario = s.scenario(0)
    assert scenario.initial_offset == (0.0, 0.0, 0.0, 0.0, 0.0, 0.01)
    assert scenario.robot.platform_mass == s.draw(0)["robot.platform_mass"]
    assert scenario.model_robot == s.base.robot
    assert (scenario.model_robot.platform_mass, scenario.model_robot.rod_length) == (1.0, 0.41)
    # A belief that the scenario has already stays.
    own = sweep(mismatch=True, distributions=masses, set={"model_robot.rod_mass": 0.1})
    assert own.scenario(0).model_robot == own.base.model_robot
    assert own.base.model_robot.rod_mass == 0.1


def test_the_numbers_of_one_leg_are_drawn_in_any_scenario_and_nothing_else_changes():
    legs = {
        "robot.legs[2].rod_length": {"kind": "uniform", "low": 0.999, "high": 1.001, "factor": True},
        "robot.legs[4].shaft_position[1]": {"kind": "grid", "values": [0.03]},
    }
    s = sweep(distributions=legs, mismatch=True)
    robot, believed = s.scenario(1).robot, s.base.robot
    rods = believed.rod_lengths.copy()
    rods[2] *= s.draw(1)["robot.legs[2].rod_length"]
    np.testing.assert_array_equal(robot.rod_lengths, rods)
    shafts = believed.shaft_positions.copy()
    shafts[4, 1] = 0.03
    np.testing.assert_array_equal(robot.shaft_positions, shafts)
    assert s.scenario(1).believed_robot == believed == Scenario().robot
    # What stays null follows the symmetric robot still.
    assert s.scenario(1).replace({"robot.rod_length": 0.41}).robot.rod_lengths[[1, 2]].tolist() == [0.41, rods[2]]
    shell = load_scenario("paper_fig7", ["robot.legs[2].rod_length=0.405", "robot.rod_length=0.41"])
    assert shell.robot.rod_lengths.tolist() == [0.41, 0.41, 0.405, 0.41, 0.41, 0.41]
    slips = {"robot.legs[6].rod_length": "from 0 to 5", "robot.legs[0].rod_lenght": "did you mean rod_length?"}
    for key, words in slips.items():
        with pytest.raises(ConfigurationError, match=re.escape(words)):
            load_scenario("paper_fig7", [f"{key}=0.4"])


def test_paths_are_relative_to_the_sweep_file(tmp_path):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "own.yaml").write_text("duration: 3.0\n")
    text = "scenario: own.yaml\nruns: 2\nset: {tuner.weights_file: w.json}\ndistributions:\n"
    text += "  gravity: {kind: uniform, low: 9, high: 10}\n"
    (tmp_path / "deep" / "my sweep.yaml").write_text(text)
    s = load_sweep(tmp_path / "deep" / "my sweep.yaml", runs=3)
    assert (s.name, s.runs, s.base.duration) == ("my sweep", 3, 3.0)
    assert s.base.tuner.weights_file == str(tmp_path / "deep" / "w.json")


@pytest.mark.slow
def test_the_shipped_sweeps_are_found_by_name_and_make_scenarios():
    names = [path.stem for path in shipped_folder("sweeps").glob("*.yaml")]
    assert "initial_offset" in names
    for name in names:
        s = load_sweep(name)
        assert find_file("sweep", name) == shipped_folder("sweeps") / f"{name}.yaml"
        assert all(s.scenario(index).name == f"{name} {index}" for index in range(s.runs))


# --- bad input -----------------------------------------------------------------------------------------------------


ANY = {"kind": "uniform", "low": 1, "high": 2}


def only(key, **distribution):
    return {"distributions": {key: distribution}}


BAD = [
    # changes, words that the line must have
    ({"runns": 3}, ["runns", "did you mean runs?"]),
    ({"runs": 0}, ["runs", "0", "from 1 to 1000000"]),
    ({"runs": None}, ["runs", "None", "grid"]),
    ({"seed": -1}, ["seed", "-1", "a whole number from 0"]),
    ({"sampler": "halton"}, ["sampler", "'halton'", "random or sobol"]),
    ({"name": "../x"}, ["name", "letters"]),
    ({"scenario": "paper_fig8"}, ["scenario", "'paper_fig8'", "paper_fig7"]),
    ({"set": {1: 2}}, ["set", "keys that are texts"]),
    ({"set": {"durration": 3}}, ["durration", "did you mean duration?"]),
    ({"set": {"initial_offset[6]": 3}}, ["set.initial_offset[6]", "0 to 5"]),
    ({"distributions": {}}, ["distributions", "at least one"]),
    ({"distributions": {"gravity": 3}}, ["distributions.gravity", "3", "kind: uniform"]),
    (only("gravity"), ["distributions.gravity.kind", "None", "loguniform"]),
    (only("gravity", kind="unifrom"), ["distributions.gravity.kind", "'unifrom'", "uniform"]),
    (only("gravity", kind="uniform", low=1), ["distributions.gravity.high", "required"]),
    (only("gravity", kind="uniform", low=1, hihg=2), ["distributions.gravity.hihg", "did you mean high?"]),
    (only("gravity", kind="uniform", low=2, high=1), ["distributions.gravity.high", "more than low, 2"]),
    (only("gravity", kind="uniform", low="1", high=2), ["distributions.gravity.low", "without quotes"]),
    (only("gravity", kind="uniform", low=-1e308, high=1), ["distributions.gravity.low", "from -1e+100 to 1e+100"]),
    (only("gravity", kind="loguniform", low=0, high=1), ["distributions.gravity.low", "above 0"]),
    (only("gravity", kind="normal", mean=0, std=0), ["distributions.gravity.std", "above 0"]),
    (only("gravity", kind="normal", mean=0, std=1, low=9), ["distributions.gravity.low", "bounds that keep"]),
    (only("gravity", kind="choice", values=[]), ["distributions.gravity.values", "[]"]),
    (only("gravity", kind="choice", values=[float("inf")]), ["distributions.gravity.values", "inf", "finite"]),
    (only("gravity", kind="choice", values=["x"], factor=True), ["distributions.gravity.values", "'x'", "numbers"]),
    (only("gravity", kind="choice", values=["9.81"]), ["distributions.gravity", "'9.81'", "a number"]),
    (only("gravty", **ANY), ["distributions.gravty", "did you mean gravity?"]),
    (only("gravity.x", **ANY), ["distributions.gravity.x", "gravity is not a section"]),
    (only("gravity[0]", **ANY), ["distributions.gravity[0]", "gravity is not a list"]),
    (only("initial_offset", **ANY), ["distributions.initial_offset", "initial_offset[0]"]),
    (only("initial_offset[6]", **ANY), ["initial_offset[6]", "0 to 5"]),
    (only("initial_offset[-1]", **ANY), ["initial_offset[-1]", "a key such as"]),
    (only("", **ANY), ["distributions.''", "a key such as"]),
    (only("model_robot.rod_mass", **ANY), ["model_robot.rod_mass", "mismatch: true"]),
    (only("controller.solver", **ANY), ["controller.solver", "choice and grid"]),
    (only("controller.solver", kind="choice", values=["sprit"]), ["controller.solver", "'sprit'", "split"]),
    (only("controller.solver", factor=True, **ANY), ["controller.solver", "to multiply"]),
    (only("tuner.window", **ANY), ["tuner.window", "'uniform'", "integers"]),
    (only("log_period", **ANY), ["log_period", "every tick"]),
    (
        {"distributions": {"robot": {"kind": "choice", "values": [{}]}, "robot.rod_mass": UNIFORM}},
        ["distributions.robot.rod_mass", "outside of robot"],
    ),
    (
        {"distributions": {"initial_offset[0]": UNIFORM, "initial_offset": {"kind": "choice", "values": [[0] * 6]}}},
        ["distributions.initial_offset[0]", "outside of initial_offset"],
    ),
]


@pytest.mark.parametrize(("changes", "words"), BAD, ids=[str(words[:2]) for _, words in BAD])
def test_bad_input_is_one_line_that_names_the_key(changes, words):
    with pytest.raises(ConfigurationError) as caught:
        sweep(**changes)
    text = str(caught.value)
    assert [word for word in words if word not in text] == [], text
    assert "\n" not in text
    assert len(text) < 700


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"distributions:\n  gravity: 1\n  gravity: 2\n", ["line 3", 'duplicate key "gravity"', "sweep.yaml"]),
        (b"runs: 3\n", ["scenario", "required"]),
        (None, ["sweep file", "initial_offset"]),
    ],
)
def test_a_file_that_is_no_sweep_is_refused_by_its_name(tmp_path, content, words):
    path = tmp_path / "sweep.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        load_sweep(path)
    assert [word for word in words if word not in str(caught.value)] == []


def test_a_number_out_of_range_is_left_to_its_run():
    s = sweep(**only("duration", kind="grid", values=[1.0, -1.0]), runs=2)
    assert s.scenario(0).duration == 1.0
    with pytest.raises(ConfigurationError, match=r"duration: expected .*got -1"):
        s.scenario(1)


def test_a_sweep_of_a_scenario_made_in_python():
    s = Sweep(load_scenario("paper_fig7", ["duration=1"]), {"gravity": parsed(**ANY)}, runs=3)
    assert 1.0 <= s.scenario(2).gravity <= 2.0
    assert s.scenario(2).duration == 1.0


def test_a_component_of_a_section_in_a_list_is_drawn_and_nothing_else_changes():
    push = {"kind": "step", "wrench": [0.0] * 6, "time": 0.1, "until": 0.2}
    base = Scenario.from_dict({"disturbances": [push, push], "tuner": {"kind": "fixed"}})
    changed = vary(
        base, {"disturbances[1].wrench[3]": 2.5, "disturbances[1].time": 0.05, "disturbances[0].wrench[0]": 1.0}
    )
    assert changed.disturbances[1].wrench == (0.0, 0.0, 0.0, 2.5, 0.0, 0.0)
    assert (changed.disturbances[1].time, changed.disturbances[0].time) == (0.05, 0.1)
    assert changed.disturbances[0].wrench == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bursts = {"kind": "sine_bursts", "frequency": [1.0], "amplitude": [[0.1, 0, 0, 0, 0, 0]]}
    varied = vary(base.replace({"reference": bursts}), {"reference.amplitude[0][2]": 0.2})
    assert varied.reference.amplitude == ((0.1, 0.0, 0.2, 0.0, 0.0, 0.0),)
    with pytest.raises(ConfigurationError, match="component from 0 to 1"):
        vary(base, {"disturbances[2].time": 0.1})
    with pytest.raises(ConfigurationError, match="wrenc"):
        vary(base, {"disturbances[0].wrenc[1]": 0.1})
