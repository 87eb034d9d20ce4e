import re

import numpy as np
import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.yaml_files import find_file, shipped_folder
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.studies.sweep import Sweep, SweepFile, load_sweep

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


ANY = {"kind": "uniform", "low": 1, "high": 2}


def only(key, **distribution):
    return {"distributions": {key: distribution}}


BAD = [
    # changes, words that the line must have
    ({"runs": None}, ["runs", "None", "grid"]),
    ({"sampler": "halton"}, ["sampler", "'halton'", "random or sobol"]),
    ({"scenario": "paper_fig8"}, ["scenario", "'paper_fig8'", "paper_fig7"]),
    ({"set": {"durration": 3}}, ["durration", "did you mean duration?"]),
    ({"set": {"initial_offset[6]": 3}}, ["set.initial_offset[6]", "0 to 5"]),
    ({"distributions": {}}, ["distributions", "at least one"]),
    (only("gravity", kind="unifrom"), ["distributions.gravity.kind", "'unifrom'", "uniform"]),
    (only("gravity", kind="uniform", low=2, high=1), ["distributions.gravity.high", "more than low, 2"]),
    (only("gravity", kind="uniform", low=-1e308, high=1), ["distributions.gravity.low", "at most 1e+100"]),
    (only("gravity", kind="loguniform", low=0, high=1), ["distributions.gravity.low", "a positive number"]),
    (only("gravity", kind="normal", mean=0, std=1, low=9), ["distributions.gravity.low", "bounds that keep"]),
    (only("gravity", kind="choice", values=["x"], factor=True), ["distributions.gravity.values", "'x'", "numbers"]),
    (only("gravity", kind="choice", values=["9.81"]), ["distributions.gravity", "'9.81'", "a number"]),
    (only("gravty", **ANY), ["distributions.gravty", "did you mean gravity?"]),
    (only("initial_offset", **ANY), ["distributions.initial_offset", "initial_offset[0]"]),
    (only("initial_offset[6]", **ANY), ["initial_offset[6]", "0 to 5"]),
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
