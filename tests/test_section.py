import dataclasses
import math
import pickle
import re
from typing import Annotated, Literal, get_args, get_origin

import numpy as np
import pytest
from conftest import field_of
from pydantic import Field

from stewart_drake.config import (
    MAX_SEED,
    Count,
    Flag,
    Fraction,
    LegNumber,
    Natural,
    NotNegative,
    Positive,
    PositivePair,
    Real,
    Section,
    Seed,
    Share,
    Text,
    check_value,
    describe,
)
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import Family
from stewart_drake.files.code_trust import code_rule
from stewart_drake.hardware.disturbances import UserDisturbance
from stewart_drake.references.user_reference import UserReference
from stewart_drake.registry import CONTROLLERS, DISTURBANCES, ESTIMATORS, REFERENCES, SENSORS, TUNERS
from stewart_drake.robot.friction_options import FrictionOptions
from stewart_drake.safety import SafetyOptions
from stewart_drake.scenario import Scenario

NEEDED = {
    "sine_bursts": {"frequency": (1.0,), "amplitude": ((0.0,) * 6,)},
    "minimum_jerk": {"poses": ((0.0,) * 6,) * 2, "durations": (1.0,)},
    "spline": {"poses": ((0.0,) * 6,) * 2, "times": (0.0, 1.0)},
    "recorded": {"motion_file": "x.csv"},
    "sum": {"parts": ({"kind": "tremor"},)},
    "adjusted": {"motion": {"kind": "tremor"}},
    "python": {"system": "mine:Mine"},
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
    "CommandFault": {"kind": "nan"},
    "BrokenRod": {"leg": 0, "time": 0.0},
}


@pytest.fixture(autouse=True)
def code_may_be_named():
    with code_rule("name"):
        yield


def sections_in(annotation):
    """Classes of sections in a type, and in theirs."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        kind = annotation.__pydantic_fields__.get("kind")
        if kind is None or kind.annotation is not str or kind.metadata:
            yield annotation
        for field in annotation.__pydantic_fields__.values():
            yield from sections_in(field.annotation)
    for part in get_args(annotation):
        yield from sections_in(part)


FAMILIES = {
    "reference": REFERENCES,
    "controller": CONTROLLERS,
    "tuner": TUNERS,
    "sensors": SENSORS,
    "estimator": ESTIMATORS,
}
EVERY = dict.fromkeys(
    found
    for start in (
        Scenario,
        UserReference,
        UserDisturbance,
        *(f.section(kind) for f in (*FAMILIES.values(), DISTURBANCES) for kind in f.kinds),
    )
    for found in sections_in(start)
)
FIELDS = [(section, name) for section in EVERY for name in section.__pydantic_fields__]
assert len(EVERY) > 30
assert {section.section_key for section in EVERY} >= {"", *FAMILIES, "disturbances", "link", "safety", "plant"}


def valid(section):
    kind = getattr(section, "kind", None)
    if kind == "sine" and section.section_key == "disturbances":
        kind = "sine wrench"
    return section(**NEEDED.get(kind, NEEDED.get(section.__name__, {})))


@pytest.mark.parametrize(("section", "name"), FIELDS, ids=lambda x: x if isinstance(x, str) else x.__name__)
def test_every_field_refuses_what_means_nothing_there_under_its_own_name(section, name):
    good, key = valid(section), ".".join(filter(None, (section.section_key, name)))
    for junk in (math.nan, math.inf, -1e300, "1", True, 3, (), ("x",), {}, b"1", None, 10**400, np.zeros(4), object()):
        try:
            made = dataclasses.replace(good, **{name: junk})
        except ConfigurationError as refused:
            error = refused
        else:
            # What is taken can be written and read again.
            assert type(made).from_dict(made.to_dict()) == made
            assert not isinstance(junk, bytes)
            continue
        assert field_of(error).startswith(key) or error.key.rpartition(".")[0] == section.section_key, error
        assert all(line.isprintable() and len(line) < 1000 for line in str(error).split("\n"))


def test_no_field_takes_junk_unless_it_says_so():
    """Number of fields that take each; a constraint that is lost shows here."""
    taken = {}
    for section, name in FIELDS:
        for label, junk in {"nan": math.nan, "infinite": math.inf, "text": "1e-3", "true": True, "list": ()}.items():
            try:
                dataclasses.replace(valid(section), **{name: junk})
            except ConfigurationError:
                continue
            taken.setdefault(label, set()).add(name)
    assert "nan" not in taken
    assert "infinite" not in taken
    assert taken["text"] == {"name", "motion_file", "weights_file"}
    assert taken["list"] <= {
        "dwell",
        "dropped",
        "late",
        "faults",
        "disturbances",
        "premature_beats",
        "monitors",
        "metrics",
    }
    booleans = {name for section, name in FIELDS if section.__pydantic_fields__[name].annotation is bool}
    assert taken["true"] == booleans


# What the fields take, stated a second time: a bound that is lost or moved shows here.
SIGNED = {
    *("BreathingReference.phase", "CommandFault.size", "EncoderFault.size", "LegParameters.branch"),
    "PolicyTuner.kappa",
    *("RobotParameters.branch", "RobotParameters.crank_plane_angle", "SineWrench.phase"),
}
ZERO = set(
    re.findall(
        r"\S+",
        """
        AdjustedReference.fade_in AdjustedReference.scale BreathingReference.phase BrokenRod.leg BrokenRod.time
        CommandFault.leg CommandFault.size CommandFault.time ComputedTorqueOptions.integral_frequency
        DeadMotor.leg DeadMotor.time EncoderFault.leg EncoderFault.size EncoderFault.time
        EncoderOptions.hold_ticks EncoderOptions.noise EncoderOptions.noise_seed EncoderOptions.resolution_bits
        FrictionCompensation.break_away FrictionCompensation.coulomb FrictionCompensation.viscous
        FrictionOptions.break_away FrictionOptions.coulomb FrictionOptions.viscous
        HeartbeatReference.prematurity HeartbeatReference.respiratory_variation HeartbeatReference.seed
        HeartbeatReference.slow_variation ImpulseWrench.time LinkOptions.drop_probability PolicyTuner.kappa
        ScheduleTuner.hold
        LinkOptions.late_probability LinkOptions.seed LinkOptions.stop_time LqiOptions.hold_ticks MotorFault.leg
        MotorFault.time MotorOptions.resolution MotorOptions.ripple NoiseWrench.low NoiseWrench.seed
        ObserverOptions.delay ObserverOptions.hold_ticks
        PidOptions.kd PidOptions.ki PidOptions.kp PlantOptions.motor_damping PlantOptions.motor_friction
        PlantOptions.payload_mass PlantOptions.platform_joint_damping PlantOptions.universal_damping
        PoseFault.time RobotParameters.crank_plane_angle RobotParameters.rotor_inertia
        RobotParameters.shaft_height SafetyOptions.damping SafetyOptions.deadline SafetyOptions.hold_ticks
        SafetyOptions.hold_time SafetyOptions.horizon SafetyOptions.innovation_time SafetyOptions.torque_limit_time
        SafetyOptions.torque_rate_time Scenario.command_delay Scenario.gravity SineWrench.phase StepWrench.time
        TremorReference.seed
        """,
    )
)
LARGEST = {
    **dict.fromkeys(
        ("LinkOptions.drop_probability", "LinkOptions.late_probability", "SafetyOptions.torque_limit"), 1.0
    ),
    **dict.fromkeys(
        ("Limits.reach", "Limits.conditioning", "Limits.transmission", "HeartbeatReference.slow_variation"), 1.0
    ),
    **dict.fromkeys((f"{kind}Options.hold_ticks" for kind in ("Lqi", "Encoder", "Observer")), 1000),
    **dict.fromkeys((f"{kind}.window" for kind in ("FixedTuner", "AnnTuner", "BlockTuner", "PolicyTuner")), 100_000),
    **dict.fromkeys((f"PlantOptions.{name}" for name in ("motor_damping", "motor_friction", "payload_mass")), 1e6),
    **dict.fromkeys((f"AdjustedReference.{name}" for name in ("scale", "slowdown", "fade_in")), 1e6),
    **dict.fromkeys((f"{fault}.leg" for fault in ("DeadMotor", "MotorFault", "EncoderFault", "CommandFault")), 5),
    **{"Scenario.duration": 1e6, "Scenario.gravity": 1e6, "Scenario.command_delay": 100, "PlantOptions.time_step": 0.1},
    **{"MotorOptions.ripple_periods": 10_000, "LinkOptions.late_steps": 100_000, "SafetyOptions.deadline": 1000},
    **{"SafetyOptions.hold_ticks": 20, "SafetyOptions.hold_time": 0.03, "Limits.euler_pitch": math.pi / 2.0},
    **{"Limits.joint_swing": math.pi, "BreathingReference.order": 3, "HeartbeatReference.prematurity": 0.7},
    **{"RecordedReference.settle": 1e6, "LqiOptions.weight_length": 1e6, "EncoderOptions.resolution_bits": 40},
    **{
        "EncoderOptions.noise": 1e6,
        "ObserverOptions.delay": 100,
        "ObserverOptions.disturbance": 1e6,
        "TremorReference.seed": MAX_SEED,
        "BrokenRod.leg": 5,
        "PolicyTuner.kappa": 1,
    },
}
BELOW_ONE = {
    *(
        f"{kind}Options.{name}"
        for kind in ("Lqi", "Pid", "ComputedTorque")
        for name in ("min_transmission", "min_conditioning")
    ),
    *("SafetyOptions.transmission", "SafetyOptions.conditioning"),
}


def takes(section, name, value):
    try:
        dataclasses.replace(valid(section), **{name: value})
    except ConfigurationError as error:
        # A rule between fields names another field, or says so.
        return field_of(error) != ".".join(filter(None, (section.section_key, name))) or "together" in error.allowed
    return True


def test_every_bound_is_where_it_was():
    taken = {label: {f"{s.__name__}.{n}" for s, n in FIELDS if takes(s, n, x)} for label, x in (("-1", -1), ("0", 0))}
    # Options whose rules name another field are let through by `takes`.
    assert {each for each in taken["-1"] if each not in SIGNED} <= {"RobotParameters.shaft_height"}
    assert taken["-1"] >= SIGNED
    assert taken["0"] == ZERO
    names = {f"{section.__name__}.{name}": (section, name) for section, name in FIELDS}
    for label, most in LARGEST.items():
        more = most + 1 if isinstance(most, int) else most * (1.0 + 1e-9)
        assert not takes(*names[label], more), label
        if label not in ("Scenario.duration", "SafetyOptions.deadline", "PlantOptions.time_step"):
            assert takes(*names[label], most), label
    assert not takes(*names["SafetyOptions.runaway"], 0.999)
    assert takes(*names["SafetyOptions.runaway"], 1.0)
    for label in BELOW_ONE:
        assert takes(*names[label], 0.999), label
        assert not takes(*names[label], 1.0), label
        assert not takes(*names[label], 0.0), label


@pytest.mark.parametrize(("section", "name"), FIELDS, ids=lambda x: x if isinstance(x, str) else x.__name__)
def test_a_bad_entry_of_a_vector_is_named_with_its_place(section, name):
    good = valid(section)
    value = getattr(good, name)
    if not (isinstance(value, tuple) and len(value) > 1 and all(isinstance(x, float) for x in value)):
        return
    key = ".".join(filter(None, (section.section_key, name)))
    for junk in (math.nan, math.inf, "a", None, True, (1.0,)):
        with pytest.raises(ConfigurationError) as caught:
            dataclasses.replace(good, **{name: (*value[:-1], junk)})
        assert caught.value.key == f"{key}.{len(value) - 1}"
    if Ellipsis not in get_args(section.__pydantic_fields__[name].annotation):
        for bad in (value[:-1], (*value, 0.0), 0.3, None, "six"):
            if bad is None and type(None) in get_args(section.__pydantic_fields__[name].annotation):
                continue
            if bad == 0.3 and issubclass(section, FrictionOptions):  # one number for all motors
                continue
            with pytest.raises(ConfigurationError) as caught:
                dataclasses.replace(good, **{name: bad})
            assert field_of(caught.value) == key


@pytest.mark.parametrize("section", EVERY, ids=lambda s: s.__name__)
def test_a_mistyped_key_or_choice_of_any_section_is_told_what_was_meant(section):
    good = valid(section).to_dict()

    def meant(word, data):
        with pytest.raises(ConfigurationError, match=rf"did you mean {re.escape(word)}\?") as caught:
            section.from_dict({**good, **data})
        return caught.value.key

    for name, field in section.__pydantic_fields__.items():
        key = ".".join(filter(None, (section.section_key, name)))
        assert meant(name, {name + name[-1]: 1}) == key + name[-1]
        for choice in get_args(field.annotation) if get_origin(field.annotation) is Literal else ():
            assert not isinstance(choice, str) or meant(choice, {name: choice + choice[-1]}) == key


@pytest.mark.parametrize("section", EVERY, ids=lambda s: s.__name__)
def test_a_section_is_frozen_hashable_and_comes_back_from_a_file_and_from_a_worker(section):
    made = valid(section)
    with pytest.raises(Exception, match=r"frozen|immutable|cannot assign"):
        made.kind = "other"
    assert section.from_dict(made.to_dict()) == made
    assert pickle.loads(pickle.dumps(made)) == made
    assert hash(made) == hash(valid(section))
    for name, field in section.__pydantic_fields__.items():
        text = " ".join((field.description or "").split())
        assert text or name == "kind", f"{section.__name__}.{name} has no text"
        assert f"{name}: {text}".rstrip(": ") in section.__doc__


@pytest.mark.parametrize(
    ("kind", "good", "bad", "words"),
    [
        (Real, (0, -1.5), (math.nan, "1", True, None), "a number"),
        (Positive, (1e-300, 1), (0, -1, 5e-324, math.inf), "a positive number"),
        (NotNegative, (0, 1.0), (-1e-300,), "a number, zero or positive"),
        (Fraction, (0.5,), (0, 1), "a number between 0 and 1"),
        (Share, (0, 1), (-0.1, 1.1), "a number from 0 to 1"),
        (Count, (-3,), (1.0, True), "a whole number"),
        (Natural, (0,), (-1, 0.0), "a whole number, zero or positive"),
        (Seed, (0, MAX_SEED), (-1, MAX_SEED + 1), f"a whole number from 0 to {MAX_SEED}"),
        (LegNumber, (0, 5), (-1, 6, 1.0), "a leg from 0 to 5"),
        (Flag, (True, False), (1, "yes"), "true or false"),
        (Text, ("",), (3, None), "a text"),
        (PositivePair, ([1, 2], np.ones(2)), ((1.0,), 3, (0.0, 1.0)), "positive number"),
        (Literal["red", "blue"], ("red",), ("green", ["red"], None), "red or blue"),
        (Annotated[Positive, Field(le=2.0)], (2,), (2.1,), "a number above 0, at most 2"),
        (Annotated[Natural, Field(ge=1, le=9)], (1, 9), (0, 10), "a whole number from 1 to 9"),
        (
            Annotated[tuple[Real, ...], Field(min_length=1, max_length=2)],
            ([1],),
            ([],),
            "a list of at least 1 and at most 2",
        ),
    ],
)
def test_a_type_takes_what_it_says(kind, good, bad, words):
    for value in good:
        check_value("key", value, kind)
    for value in bad:
        with pytest.raises(ConfigurationError) as caught:
            check_value("key", value, kind)
        assert field_of(caught.value) == "key"
        assert words.split("number")[0] in caught.value.allowed
    assert words in describe(kind)


class Inner(Section, key="inner"):
    """A section inside."""

    size: Positive = 1.0
    """[m, s] size."""
    mode: Literal["fast", "slow"] = "fast"
    """How."""

    def rules(self):
        if self.size > 2.0 and self.mode == "slow":
            raise ConfigurationError("size", self.size, "at most 2 where it is slow")


class Outer(Section):
    """A section outside."""

    inner: Inner = Inner()
    """Inside."""
    many: tuple[Inner, ...] = ()
    """More."""


@pytest.mark.parametrize(
    ("make", "lines"),
    [
        (lambda: Inner(size=3, mode="slow"), ["inner.size: expected at most 2 where it is slow"]),
        (lambda: Inner(mode="slwo"), ["inner.mode: expected fast or slow; did you mean slow?"]),
        (
            lambda: Outer.from_dict({"many": [{}, {"size": 3, "mode": "slow"}]}),
            ["many.1.size: expected at most 2"],
        ),
        (
            lambda: Outer(inner=3, many=({"size": "1"},)),
            ["inner: expected a positive"],
        ),
        (lambda: Outer(iner={}, many=3), ["iner: expected no such key, did you mean inner?", "many: got 3; "]),
        (lambda: Outer(inner=Outer()), ["inner: got Outer("]),
    ],
)
def test_every_problem_has_its_line_and_its_place(make, lines):
    with pytest.raises(ConfigurationError) as caught:
        make()
    found = str(caught.value).split("\n")
    assert len(found) == len(lines)
    for line, start in zip(found, lines, strict=True):
        assert line.startswith(start)


def test_a_family_takes_a_kind_from_outside_of_the_package():
    family = Family({})

    class Mine(Section):
        """Mine."""

        kind: Literal["mine"] = "mine"
        size: Positive = 1.0
        """[m]"""

    family.add(Mine)

    class Holder(Section):
        """Holder."""

        part: Annotated[Section, family]
        """One of the family."""

    assert Holder(part={"kind": "mine", "size": 2}).part == Mine(size=2.0)
    with pytest.raises(ConfigurationError, match=r"^part\.kind: .*did you mean mine"):
        Holder(part={"kind": "mne"})


def test_numbers_and_truth_values_of_numpy_are_taken():
    safety = SafetyOptions(failures=np.bool_(True))
    scenario = Scenario(safety=safety, command_delay=np.int64(2), duration=np.float32(1.5))
    assert (scenario.safety.failures, scenario.command_delay, scenario.duration) == (True, 2, 1.5)
    assert type(scenario.safety.failures) is bool
