"""Sections: what each field refuses and how it says so, kinds and families, and the JSON schema of all that."""

import math
import pickle
import re
from typing import Annotated, Literal, get_args, get_origin

import jsonschema
import numpy as np
import pytest
from conftest import field_of
from pydantic import Field, TypeAdapter

from stewart_drake.base.config import (
    Flag,
    Fraction,
    LegNumber,
    Natural,
    NotNegative,
    Positive,
    PositivePair,
    Real,
    Section,
    Share,
    SixNumbers,
    check_value,
)
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.registry import CONTROLLERS, DISTURBANCES, ESTIMATORS, REFERENCES, SENSORS, TUNERS
from stewart_drake.control.tuners import FixedTuner
from stewart_drake.control.user_controller import PythonOptions
from stewart_drake.hardware.disturbances import UserDisturbance
from stewart_drake.references.recorded import UserReference
from stewart_drake.scenario.scenario import Scenario, load_scenario, scenario_schema

NEEDED = {
    "sine_bursts": {"frequency": (1.0,), "amplitude": ((0.0,) * 6,)},
    "minimum_jerk": {"poses": ((0.0,) * 6,) * 2, "durations": (1.0,)},
    "spline": {"poses": ((0.0,) * 6,) * 2, "times": (0.0, 1.0)},
    "recorded": {"motion_file": "x.csv"},
    "sum": {"parts": ({"kind": "tremor"},)},
    "adjusted": {"motion": {"kind": "tremor"}},
    "PythonOptions": {"kind": "mine:Mine"},
    "UserReference": {"kind": "mine:Mine"},
    "UserDisturbance": {"kind": "mine:Mine"},
    "block": {"q_pose": 1.0, "q_rate": 1.0, "q_integral": 1.0},
    "constant": {"wrench": (0.0,) * 6},
    "step": {"wrench": (0.0,) * 6, "time": 0.0},
    "impulse": {"impulse": (0.0,) * 6, "time": 0.0},
    "sine wrench": {"wrench": (0.0,) * 6, "frequency": 1.0},
    "noise": {"rms": (0.0,) * 6},
    "DeadMotor": {"leg": 0},
    "MotorFault": {"kind": "reversed", "leg": 0},
    "EncoderFault": {"kind": "nan", "leg": 0},
    "PoseFault": {"kind": "nan"},
    "ImuFault": {"kind": "nan"},
    "CommandFault": {"kind": "nan"},
    "BrokenRod": {"leg": 0, "time": 0.0},
    "Throw": {"time": 0.0, "velocity": (0.0, 0.0)},
}


def sections_in(annotation):
    """Classes of sections in a type, and in theirs."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        kind = annotation.model_fields.get("kind")
        if kind is None or kind.annotation is not str or kind.metadata:
            yield annotation
        for field in annotation.model_fields.values():
            yield from sections_in(field.annotation)
    for part in get_args(annotation):
        yield from sections_in(part)


FAMILIES = (REFERENCES, CONTROLLERS, TUNERS, SENSORS, ESTIMATORS, DISTURBANCES)
KINDS = [family[kind] for family in FAMILIES for kind in family.kinds]
STARTS = (Scenario, UserReference, UserDisturbance, PythonOptions, *KINDS)
EVERY = dict.fromkeys(section for start in STARTS for section in sections_in(start))
FIELDS = [(section, name) for section in EVERY for name in section.model_fields]
assert len(EVERY) > 30


def valid(section):
    kind = section.model_fields["kind"].default if "kind" in section.model_fields else None
    if kind == "sine" and section.section_key == "disturbances":
        kind = "sine wrench"
    return section(**NEEDED.get(kind, NEEDED.get(section.__name__, {})))


TAKES_TEXT = {"name", "motion_file", "weights_file"}


@pytest.mark.parametrize(("section", "name"), FIELDS, ids=lambda x: x if isinstance(x, str) else x.__name__)
def test_every_field_refuses_what_means_nothing_there_under_its_own_name(section, name):
    good, key = valid(section), ".".join(filter(None, (section.section_key, name)))
    for junk in (math.nan, math.inf, -1e300, "1", True, 3, (), ("x",), {}, b"1", None, 10**400, np.zeros(4), object()):
        try:
            result = good.replace(**{name: junk})
        except ConfigurationError as refused:
            error = refused
        else:
            # What is taken can be written and read again.
            assert type(result).from_dict(result.to_dict()) == result
            assert not isinstance(junk, bytes)
            assert not isinstance(junk, (int, float)) or math.isfinite(junk)
            assert not isinstance(junk, str) or name in TAKES_TEXT
            assert junk is not True or section.model_fields[name].annotation is bool
            continue
        assert field_of(error).startswith(key) or error.key.rpartition(".")[0] == section.section_key, error
        assert all(line.isprintable() and len(line) < 1000 for line in str(error).split("\n"))


@pytest.mark.parametrize("section", EVERY, ids=lambda s: s.__name__)
def test_any_section_comes_back_from_a_file_and_a_worker_has_texts_and_says_what_was_meant_by_a_typo(section):
    made = valid(section)
    assert pickle.loads(pickle.dumps(made)) == made == section.from_dict(made.to_dict())
    assert hash(made) == hash(valid(section))
    good = made.to_dict()

    def meant(word, data):
        with pytest.raises(ConfigurationError, match=rf"did you mean {re.escape(word)}\?") as caught:
            section.from_dict({**good, **data})
        return caught.value.key

    for name, field in section.model_fields.items():
        assert field.description or name == "kind", f"{section.__name__}.{name} has no text"
        key = ".".join(filter(None, (section.section_key, name)))
        assert meant(name, {name + name[-1]: 1}) == key + name[-1]
        for choice in get_args(field.annotation) if get_origin(field.annotation) is Literal else ():
            assert not isinstance(choice, str) or meant(choice, {name: choice + choice[-1]}) == key


@pytest.mark.parametrize(
    ("kind", "good", "bad", "words"),
    [
        (Positive, (1e-300, 1), (0, -1, 5e-324, "1", True, None), "a positive number"),
        (Real, (1,), (math.nan,), "a finite number"),
        (NotNegative, (0, 1.0), (-1e-300,), "a number at least 0"),
        (Fraction, (0.5,), (0,), "a number above 0 and below 1"),
        (Share, (0, 1), (1.1,), "a number at least 0 and at most 1"),
        (Natural, (0,), (0.0, True), "a whole number at least 0"),
        (LegNumber, (0, 5), (-1, 6, 1.0), "a leg from 0 to 5"),
        (Flag, (True, False), (1, "yes"), "true or false"),
        (PositivePair, ([1, 2], np.ones(2)), ((1.0,), 3, (1, 2, 3)), "a list of 2, each a positive number"),
        (SixNumbers, (2, [1.0] * 6), ("2", [1.0] * 5), "a number or a list of 6 numbers"),
        (Literal["red", "blue"], ("red",), ("green", ["red"], None), "red or blue"),
        (Annotated[tuple[Real, ...], Field(min_length=1)], ([1],), ([],), "a list of at least 1, each a number"),
    ],
)
def test_a_type_takes_what_it_says(kind, good, bad, words):
    for value in good:
        check_value("key", value, kind)
    for value in bad:
        with pytest.raises(ConfigurationError) as caught:
            check_value("key", value, kind)
        assert (caught.value.key, caught.value.allowed) == ("key", words)


# --- kinds ---------------------------------------------------------------------------------------------------


def test_a_registered_name_stands_for_an_import_path(monkeypatch):
    monkeypatch.setattr(CONTROLLERS, "_paths", {})
    CONTROLLERS.register("mine", "mine:Mine")
    by_path = Scenario(controller="mine:Mine")
    assert Scenario(controller="mine") == Scenario(controller={"kind": "mine"}) == by_path
    assert "mine" in str(scenario_schema())
    with pytest.raises(ConfigurationError, match=r"^controller: .*did you mean mine\?"):
        Scenario(controller="mne")
    for name, path in (("lqi", "mine:Mine"), ("other", "mine")):
        with pytest.raises(ConfigurationError):
            CONTROLLERS.register(name, path)


def test_a_kind_alone_is_one_on_the_command_line_in_python_and_in_a_list(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text("name: scenario\nreference: {kind: sum, parts: [hold, breathing]}\nsensors: encoders\n")
    found = load_scenario(path, ["tuner=block", "tuner.q_rate=7", "sensors.noise=1e-5", "estimator=observer"])
    assert found == Scenario(
        reference={"kind": "sum", "parts": [{"kind": "hold"}, {"kind": "breathing"}]},
        sensors={"kind": "encoders", "noise": 1e-5},
        tuner={"kind": "block", "q_rate": 7.0},
        estimator={"kind": "observer"},
    )
    assert Scenario(tuner={"kind": "fixed", "omega_q": 3.0}).replace({"tuner": {"kind": "fixed"}}).tuner == FixedTuner()


def test_a_change_of_kind_keeps_what_the_new_kind_has_and_names_what_it_drops(caplog):
    rubs = {"time_step": 5e-4, "motor_friction": 0.01, "payload_mass": 0.2}
    parts = [{"kind": "sine", "center": [0.0, 0.0, 0.0, 0.0, 0.0, 0.31], "amplitude": [0.1, 0, 0, 0, 0, 0]}]
    base = Scenario(
        plant=rubs, controller={"period": 0.002, "model": "exact"}, reference={"kind": "sum", "parts": parts},
        adaptation={"cautious": True}, model={"motors": {"kind": "position", "stiffness": 9.0}},
        motors={"kind": "position"},
    )  # fmt: skip
    for way in ("{}", "{}.kind"):
        changed = base.replace({way.format("plant"): "closed_form", way.format("controller"): "pid"})
        assert changed.plant.given() == {"kind": "closed_form", **rubs}
        assert changed.controller.given() == {"kind": "pid", "period": 0.002}
        # The same kind is no change, and sections inside others and in lists are changed likewise.
        assert base.replace({way.format("adaptation"): "regression"}).adaptation.cautious
        part = base.replace({way.format("reference.parts[0]"): "breathing"}).reference.parts[0]
        assert (part.kind, part.center) == ("breathing", (0.0, 0.0, 0.0, 0.0, 0.0, 0.31))
        torque = {way.format("motors"): "torque", way.format("model.motors"): "torque"}
        assert base.replace(torque).model.motors.given() == {"kind": "torque"}
        # What is of another unit or shape is not taken over either.
        coarse = Scenario(motors={"resolution": 0.01}, reference={"phase": [1, 0, 0, 0, 0, 0]})
        other = coarse.replace({way.format("motors"): "current", way.format("reference"): "breathing"})
        assert (other.motors.given(), other.reference.given()) == ({"kind": "current"}, {"kind": "breathing"})
        lines = ("controller.kind: dropped model, which pid", "model.motors.kind: dropped stiffness, which torque")
        for line in (
            *lines,
            "motors.kind: dropped resolution, which",
            "reference.kind: dropped phase, which breathing",
        ):
            assert line in caplog.text
    assert "plant.kind:" not in caplog.text
    assert base.replace({"plant": {"kind": "closed_form"}}).plant.given() == {"kind": "closed_form"}


@pytest.mark.parametrize(
    ("data", "line"),
    [
        ({"tuner": "fixd"}, r"tuner: expected fixed, .* or schedule, got 'fixd'; did you mean fixed\?"),
        ({"reference": {"center": 2}}, r"reference.center: expected a list of 6 numbers \[rad, m\], got 2"),
        ({"reference": "spline"}, "reference.times: expected .*, got None; this key is required\n.*poses: .*"),
        ({"tuner": np.array([1.0, 2.0])}, "tuner: expected a section with kind .* or such a kind alone, got .*"),
        ({"reference": ["hold"]}, "reference: expected a section with kind .* or such a kind alone, got .*"),
        (
            {"disturbances": ["noise", {"kind": "sine", "wrench": [0] * 6, "frequency": "4 s"}]},
            r"disturbances.0.rms: .*\ndisturbances.1.frequency: expected a number \[Hz\].*4 s is 0.25 Hz\), got .*",
        ),
        (
            {"initial_offset": [0, "3 s", 0, 0, 0, 0]},
            r"initial_offset: expected a number \[rad\], or one .*, got '3 s'",
        ),
        (
            {"plant": {"friction": {"coulomb": -1}}},
            r"plant.friction.coulomb: expected a number \[N m\] at least 0 .* or a list of 6, .*, got -1",
        ),
        ({"sensors": {"kind": "encoders", "delay": 5}}, r"sensors.delay: .* at most 1, got 5; did you mean 5 ms\?"),
        (
            {"controller": {"kind": "mine:Mine", "arguments": {1: 2}}},
            "controller.arguments.1: expected keys that are texts, .*",
        ),
    ],
)
def test_what_is_wrong_with_a_kind_is_a_line_a_problem_under_its_key(data, line):
    with pytest.raises(ConfigurationError) as caught:
        Scenario.from_dict(data)
    assert re.fullmatch(line, str(caught.value))


# --- JSON schema ---------------------------------------------------------------------------------------------

NUMBERS = [0, 1, -1, 6, 0.5, -0.5, 1e-300, 10**8]
PLAIN_JUNK = [*NUMBERS, None, True, "", "1", "mine:Mine", [], [0.5] * 6, ["x"] * 2, {}, {"no": 1}]


@pytest.mark.parametrize("section", EVERY, ids=lambda s: s.__name__)
def test_the_schema_takes_what_loads_and_nothing_else(section, monkeypatch):
    schema = jsonschema.Draft202012Validator(TypeAdapter(section).json_schema())
    good = valid(section).to_dict()
    assert schema.is_valid(good)
    # Without the rules between fields.
    for each in EVERY:
        monkeypatch.setattr(each, "rules", lambda _: None)
    for name in section.model_fields:
        for junk in PLAIN_JUNK:
            document = {**good, name: junk}
            try:
                section.from_dict(document)
                problem = None
            except ConfigurationError as error:
                problem = error
            # A robot's name has to be one that is there, which changes with what is installed.
            if problem is None or "an existing file" not in problem.allowed:
                assert schema.is_valid(document) == (problem is None), (name, junk, str(problem))


@pytest.mark.parametrize("make", [Scenario.from_dict, lambda data: Scenario(**data)])
@pytest.mark.parametrize("keys", [("initial_offset",), ("robot", "rod_length"), ("bounds", "rotation")])
def test_a_list_that_holds_itself_is_refused_in_a_line(make, keys):
    data = [0.0]
    data.append(data)
    for key in reversed(keys):
        data = {key: data}
    with pytest.raises(ConfigurationError) as caught:
        make(data)
    assert "[0.0, [...]]" in str(caught.value)
    assert str(caught.value).isprintable()


def test_an_assignment_to_a_key_says_what_to_do_instead():
    scenario = Scenario()
    with pytest.raises(ConfigurationError, match=r"^duration: expected no assignment, .*replace\(duration=\.\.\.\)"):
        scenario.duration = 2.0
    assert scenario == Scenario()
