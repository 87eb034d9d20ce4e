"""The JSON schema and loading agree, but for rules between fields, which a schema cannot say."""

import copy
import math

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.config import Section
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code_trust import code_rule
from stewart_drake.scenario import Scenario, scenario_schema

VALIDATOR = jsonschema.Draft202012Validator(scenario_schema())
DOCUMENTS = [
    {"safety": {}},
    {"controller": {"kind": "pid"}, "tuner": {"kind": "fixed"}, "sensors": {"kind": "encoders"}},
    {"controller": {"kind": "computed_torque"}, "plant": {"broken_rod": {"leg": 1, "time": 0.5}}},
    {"controller": {"kind": "mine:Mine", "period": 0.001}, "model_robot": {}},
    {"controller": {"kind": "python", "system": "mine:Mine"}, "reference": {"kind": "mine.py:Mine"}},
    *({"reference": {"kind": kind}} for kind in ("hold", "sine", "breathing", "heartbeat", "tremor")),
    {"reference": {"kind": "minimum_jerk", "poses": [[0.0] * 6] * 2, "durations": [1.0]}},
    {"reference": {"kind": "sum", "parts": [{"kind": "tremor"}]}},
]
NUMBERS = [0, 1, -1, 5, 6, 0.5, -0.5, 2.5, math.pi / 3.0, 1e-300, 10**8]
PATHS = ["mine:Mine", "mine.py:Mine"]
KINDS = ["freeze", "nan", "offset", "reversed", "constant", "lqi", "ideal", "none", *PATHS]
LEG = [{}, None, {"rod_length": 0.4}, {"branch": 2}]
VALUES = (
    st.sampled_from([None, True, "", "1", "x", *NUMBERS, *KINDS])
    | st.lists(st.sampled_from([None, "x", *NUMBERS[:-1], *PATHS]), max_size=7)
    | st.lists(st.sampled_from(LEG), min_size=5, max_size=7)
    | st.dictionaries(
        st.sampled_from(["kind", "leg", "time", "size", "arguments", "wrench", "no"]),
        st.sampled_from([*NUMBERS, *KINDS, [0.0] * 6, {}]),
        max_size=4,
    ).flatmap(lambda section: st.sampled_from([section, [section]]))
)


def no_rules(_):
    """In place of the rules between fields."""


def keys(section):
    """Every key in a section and in those inside, as a list of names."""
    for name, value in section.items():
        yield [name]
        if isinstance(value, dict) and name != "arguments":
            yield from ([name, *inner] for inner in keys(value))


@st.composite
def documents(draw):
    made = copy.deepcopy(draw(st.sampled_from(DOCUMENTS)))
    with pytest.MonkeyPatch.context() as patch, code_rule("name"):
        patch.setattr(Section, "__post_init__", no_rules)
        everything = Scenario.from_dict(copy.deepcopy(made)).to_dict()
    everything["robot"].pop("name", None)
    for *parents, last in draw(st.lists(st.sampled_from(list(keys(everything))), min_size=1, max_size=2)):
        here = made
        for name in parents:
            if not isinstance(here.get(name), dict):
                here[name] = {}
            here = here[name]
        here[last] = draw(VALUES)
    return made


@given(documents())
def test_the_schema_takes_what_loads_and_nothing_else(document):
    with pytest.MonkeyPatch.context() as patch, code_rule("name"):
        # Without the rules between fields.
        patch.setattr(Section, "__post_init__", no_rules)
        try:
            Scenario.from_dict(copy.deepcopy(document))
            problem = None
        except ConfigurationError as error:
            problem = error
    # A robot's name has to be one that is there, which changes with what is installed.
    if problem is None or "an existing file" not in problem.allowed:
        found = [error.message for error in VALIDATOR.iter_errors(document)]
        assert (not found) == (problem is None), (str(problem), found)


def test_no_two_keys_of_a_section_have_the_same_text():
    for name, section in scenario_schema()["$defs"].items():
        texts = [each.get("description", "") for each in section.get("properties", {}).values()]
        # "[rad, m]" says the unit and no more.
        said = [text for text in texts if text.partition("] ")[2]]
        assert len(said) == len(set(said)), name
