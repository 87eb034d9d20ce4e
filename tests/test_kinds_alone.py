"""A text in place of a section is its kind, and a kind's older name is read."""

import jsonschema
import pytest

from stewart_drake.errors import ConfigurationError
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
        ({"tuner": "fixd"}, "tuner: expected fixed, .* did you mean fixed?"),
        ({"estimator": "observe"}, "estimator: expected difference or observer; did you mean observer?"),
        ({"reference": "minimum_jerk"}, "reference.poses: .*this key is required"),
        ({"reference": ["hold"]}, "reference: .* a section, with kind: hold, .* or a kind by itself"),
    ],
)
def test_what_is_wrong_with_a_kind_alone_is_a_line_a_problem_under_its_key(data, words):
    with pytest.raises(ConfigurationError, match=words) as caught:
        Scenario.from_dict(data)
    (key,) = data
    assert all(line.startswith(key) for line in str(caught.value).split("\n"))
