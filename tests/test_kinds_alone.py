"""A text in place of a section is its kind, and a kind's older name is read."""

import warnings

import jsonschema
import pytest

from stewart_drake import run
from stewart_drake.errors import ConfigurationError, OlderFileWarning
from stewart_drake.logs.log import load_log
from stewart_drake.registry import CONTROLLERS, ESTIMATORS, REFERENCES, SENSORS, TUNERS
from stewart_drake.scenario import FixedTuner, Scenario, load_scenario, scenario_schema

FAMILIES = {
    "reference": REFERENCES,
    "controller": CONTROLLERS,
    "tuner": TUNERS,
    "sensors": SENSORS,
    "estimator": ESTIMATORS,
}
KINDS = [(key, kind) for key, family in FAMILIES.items() for kind in family.kinds]
SCHEMA = jsonschema.Draft202012Validator(scenario_schema())


def made(data):
    try:
        return Scenario.from_dict(data)
    except ConfigurationError as error:
        return str(error)


@pytest.mark.parametrize("robot", ["paper", "reachy_mini"])
@pytest.mark.parametrize(("key", "kind"), KINDS)
def test_a_kind_alone_is_a_section_of_nothing_else(key, kind, robot):
    base = {"robot": robot, "duration": 1.0}
    full = made({**base, key: {"kind": kind}})
    assert made({**base, key: kind}) == full
    assert SCHEMA.is_valid({key: kind}) == SCHEMA.is_valid({key: {"kind": kind}})


@pytest.mark.parametrize("robot", ["paper", "reachy_mini"])
def test_a_kind_alone_is_one_on_the_command_line_in_python_and_in_a_list(tmp_path, robot):
    path = tmp_path / "short.yaml"
    path.write_text(f"robot: {robot}\nreference: {{kind: sum, parts: [hold, breathing]}}\nsensors: encoders\n")
    found = load_scenario(path, ["tuner=block", "tuner.q_rate=7", "sensors.noise=1e-5", "estimator=observer"])
    parts = [{"kind": "hold"}, {"kind": "breathing"}]
    in_full = {
        "name": "scenario",
        "robot": robot,
        "reference": {"kind": "sum", "parts": parts},
        "sensors": {"kind": "encoders", "noise": 1e-5},
        "tuner": {"kind": "block", "q_rate": 7.0},
        "estimator": {"kind": "observer"},
    }
    assert found.replace({"name": "scenario"}) == Scenario.from_dict(in_full)
    assert Scenario(tuner="fixed").tuner == FixedTuner()
    assert Scenario().replace({"controller": "computed_torque"}).controller.kind == "computed_torque"


def test_a_change_of_the_kind_alone_leaves_out_what_the_old_section_had():
    assert Scenario(tuner={"kind": "fixed", "omega_q": 3.0}).replace({"tuner": "fixed"}).tuner == FixedTuner()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"tuner": "fixd"}, "tuner: got 'fixd'; allowed: fixed, .* did you mean fixed?"),
        ({"estimator": "observe"}, "estimator: got 'observe'; allowed: difference or observer; did you mean observer?"),
        ({"reference": "minimum_jerk"}, "reference.poses: .*this key is required"),
        ({"reference": ["hold"]}, "reference: .* a section, with kind: hold, .* or a kind by itself"),
    ],
)
def test_what_is_wrong_with_a_kind_alone_is_a_line_a_problem_under_its_key(data, words):
    with pytest.raises(ConfigurationError, match=words) as caught:
        Scenario.from_dict(data)
    (key,) = data
    assert all(line.startswith(key) for line in str(caught.value).split("\n"))


def test_the_papers_tuner_by_its_older_name(tmp_path):
    today = Scenario(tuner={"kind": "paper", "window": 9})
    for older in ({"kind": "ann", "window": 9}, "ann"):
        with pytest.warns(OlderFileWarning, match="the kind `ann` is named `paper` now"):
            found = Scenario.from_dict({"tuner": older})
        assert found.tuner == (today if older != "ann" else Scenario(tuner="paper")).tuner
    path = tmp_path / "older.yaml"
    path.write_text("name: scenario\ntuner: {kind: ann, window: 9}\n")
    with pytest.warns(OlderFileWarning, match="paper"):
        assert load_scenario(path) == today
    with pytest.warns(OlderFileWarning, match="paper"):
        # The key that only the old kind has goes.
        changed = Scenario(tuner={"kind": "block", "q_rate": 3.0, "window": 9}).replace({"tuner.kind": "ann"})
    assert changed == today
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert made(today.to_dict()) == today
    assert not SCHEMA.is_valid({"tuner": "ann"})


@pytest.mark.slow
def test_a_log_with_the_older_name_is_read(tmp_path, monkeypatch):
    log = run(Scenario(duration=0.01, tuner="paper"))
    stored = log.scenario.to_dict()
    older = {**stored, "tuner": {**stored["tuner"], "kind": "ann"}}
    with monkeypatch.context() as patch:
        patch.setattr(Scenario, "to_dict", lambda _: older)
        log.save(tmp_path / "log.parquet")
    with pytest.warns(OlderFileWarning, match="paper"):
        assert load_log(tmp_path / "log.parquet").scenario == log.scenario
