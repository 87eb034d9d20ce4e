import math

import jsonschema
import numpy as np
import pytest
from conftest import python
from hypothesis import example, given, settings
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.base.yaml_files import parse_yaml, shipped_folder
from stewart_drake.control.classical import PidOptions
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.control.tuners import FixedTuner, PaperTuner
from stewart_drake.references import HoldReference
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.runs.checks import check_scenario
from stewart_drake.scenario.scenario import Scenario, load_scenario, scenario_schema
from stewart_drake.studies.comparison import load_comparison

SHIPPED = sorted(path.stem for path in shipped_folder("scenarios").glob("*.yaml"))


def refusal(data):
    with pytest.raises(ConfigurationError) as caught:
        Scenario.from_dict(data)
    return one_line(caught.value)


def one_line(error):
    message, *_ = lines = str(error).split("\n")
    for line in lines:
        assert line.isprintable(), repr(line)
        assert len(line) < 1000
    assert message.startswith(f"{error.key}: ")
    assert error.key
    return error


def adjusted_tremor(**keys):
    return {"kind": "adjusted", "motion": {"kind": "sum", "parts": [{"kind": "tremor", **keys}]}}


def write(folder, text, name="some.yaml"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_the_defaults_are_the_papers_run():
    scenario = Scenario()
    pose, _, _ = scenario.reference.evaluate(np.array([0.3]))
    np.testing.assert_allclose(pose[0], [math.pi / 6 * math.sin(0.6), 0, 0, 0, 0, 0.3 + 0.05 * math.sin(0.6)])
    assert (scenario.duration, scenario.controller.period, scenario.plant.time_step) == (10.0, 0.005, 0.001)
    assert scenario.gravity == 9.81
    assert isinstance(scenario.tuner, PaperTuner)
    assert (scenario.tuner.omega_q, scenario.tuner.omega_r) == (1.0, 1.0)


def test_what_is_not_believed_otherwise_is_the_simulated_machines():
    real = {"robot": "reachy_mini", "gravity": 9.0, "command_delay": 2, "sensors": {"kind": "encoders", "noise": 1e-3}}
    right, wrong = (
        Scenario.from_dict(real),
        {"robot": {"platform_mass": 0.3}, "gravity": 9.8, "noise": 1e-4, "delay": 1},
    )
    assert right.controller_model == right.default_model
    assert right.controller_model[1:6] == (9.0, None, "angles", right.sensors.reading_noise, 2)
    other = Scenario.from_dict({**real, "model": wrong})
    assert other.controller_model.robot == right.robot.replace(platform_mass=0.3)
    assert other.controller_model[1:6] == (9.8, None, "angles", 1e-4, 1)
    # The machine stays as it is, and the controller's side has all of its belief in its own file.
    assert (other.robot, other.gravity, other.command_delay) == (right.robot, 9.0, 2)
    assert other.control().controller_model == other.controller_model
    assert not {"robot", "gravity", "plant", "sensors", "command_delay"} & set(other.control().to_dict())


# That every section refuses what means nothing in it under its own key is in test_config.py.
WRONG = [
    # key as it must be named, document, words that must be there
    ("model_robot", {"model_robot": "paper"}, "it is now model.robot"),
    ("friction_compensation", {"friction_compensation": {"coulomb": 0.01}}, "it is now model.friction"),
    ("sensors.max_step", {"sensors": {"kind": "encoders", "max_step": [1, 1]}}, "it is now estimator.max_step"),
    ("estimator.delay", {"estimator": {"kind": "observer", "delay": 1}}, "it is now model.delay"),
    ("model.reading", {"sensors": "encoders", "model": {"reading": "pose"}}, "angles, as sensors read"),
    ("zzz", {"zzz": 3}, "the keys here are name, model"),
    ("model.robot.crank_mas", {"model": {"robot": {"crank_mas": 0.4}}}, "did you mean crank_mass?"),
    ("reference.parts", {"reference": {"kind": "sum", "parts": []}}, "a list of at least 1"),
    ("reference.parts.0.kind", {"reference": {"kind": "sum", "parts": [{"kind": "sum", "parts": []}]}}, "recorded"),
    ("reference.motion.parts.0.hgh", {"reference": adjusted_tremor(hgh=1)}, "did you mean high?"),
    ("reference.motion.parts.0.high", {"reference": adjusted_tremor(high=1)}, "above low, 6 Hz"),
    ("duration", {"duration": 8000, "plant": {"time_step": 1e-6}, "log_period": 1}, "1e9 steps"),
    ("duration", {"duration": 0.004}, "at least one control period, 0.005 s"),
    ("controller.period", {"controller": {"period": 0.0055}}, "a whole multiple of the plant's time step 0.001 s"),
    ("log_period", {"log_period": 10.001}, "at most the duration, 10 s"),
    ("name", {"name": "a" * 101}, "at most 100"),
    ("name", {"name": "../up"}, "letters, digits"),
]


@pytest.mark.parametrize(("key", "data", "words"), WRONG, ids=[f"{i}-{w[0]}" for i, w in enumerate(WRONG)])
def test_a_bad_value_is_named_with_its_key_and_what_is_allowed(key, data, words):
    error = refusal(data)
    assert error.key == key
    assert words in error.allowed or words in str(error)


def test_every_problem_has_a_line_and_unknown_keys_come_first():
    error = refusal({"duration": "a", "gravity": "b", "plant": {"time_stp": 1}, "tuner": {"kind": "pap"}})
    lines = str(error).split("\n")
    named = [error.key, *(other.key for other in error.others)]
    assert named == [line.partition(":")[0] for line in lines]
    assert named[0] == "plant.time_stp"
    assert sorted(named[1:]) == ["duration", "gravity", "tuner.kind"]


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        (" duration = 2 ", "duration", 2.0),
        ("plant.time_step=5e-4", "plant.time_step", 0.0005),
        ("reference.center=[0, 0, 0, 0, 0, 0.31]", "reference.center", (0.0, 0.0, 0.0, 0.0, 0.0, 0.31)),
        ("controller={period: 0.01, solver: split}", "controller.period", 0.01),
        ("name=a+b", "name", "a+b"),
        ("limits.reach=", "limits.reach", None),
        ("model.robot.rod_mass=0.1", "model.robot.rod_mass", 0.1),
        ("reference.angular_frequency=3", "reference.angular_frequency", (3.0,) * 6),
        ("reference.phase[2]=1", "reference.phase", (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)),
        ("duration=300 ms", "duration", 0.3),
        ("plant.payload_mass=100 g", "plant.payload_mass", 0.1),
        ("reference.angular_frequency=0.5Hz", "reference.angular_frequency", (math.pi,) * 6),
    ],
)
def test_an_override_sets_one_key(text, key, value):
    here = load_scenario("paper_fig7", [text])
    for part in key.split("."):
        here = getattr(here, part)
    assert here == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        (" =3", "--set", "key=value"),
        ("duration=[1", "--set duration", "line 1"),
        ("duration.x=3", "duration.x", "a section with this key, which duration is not"),
        ("reference.center.5=3", "reference.center.5", "initial_offset[0]"),
        ("reference.center[6]=3", "reference.center[6]", "center has components from 0 to 5"),
        ("initial_offset=3", "initial_offset", "a list of 6 numbers [rad, m]"),
        (".=3", ".", "a key such as"),
        ("tuner.kappa=2", "tuner.kappa", "no such key, got 2; kind policy has it. The keys here are kind, period"),
        ("duration=-1", "duration", "a positive number [s]"),
        ("duration=3 kg", "duration", "a number [s], or one with s, ms, us, min behind it, got '3 kg'"),
        (
            "reference.angular_frequency=5 s",
            "reference.angular_frequency",
            "rpm, Hz, kHz behind it (a period of 5 s is 0.2 Hz), got '5 s'",
        ),
        ("duration=5 Hz", "duration", "5 Hz is a period of 0.2 s), got '5 Hz'"),
        ("controller.period=5", "controller.period", "at most 1, got 5; did you mean 5 ms"),
    ],
)
def test_a_bad_override_is_named(text, key, words):
    with pytest.raises(ConfigurationError) as caught:
        load_scenario("paper_fig7", [text])
    assert one_line(caught.value).key == key
    assert words in str(caught.value)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_keeps_to_the_schema_and_comes_back_from_its_yaml(tmp_path, name):
    data = parse_yaml((shipped_folder("scenarios") / f"{name}.yaml").read_text(), name)
    jsonschema.Draft202012Validator(scenario_schema()).validate(data)
    scenario = load_scenario(name)
    assert load_scenario(write(tmp_path, scenario.to_yaml())) == scenario


@given(st.text(max_size=20), st.text(max_size=20))
@settings(max_examples=100)
@example("\b", "'")
@example("name", "!!binary MQ==")
def test_random_overrides_give_a_scenario_or_one_line(key, value):
    try:
        load_scenario("hold", [f"{key}={value}"])
    except ConfigurationError as error:
        one_line(error)


def test_another_kind_drops_the_keys_of_the_old_one_and_keeps_those_that_both_have(tmp_path):
    assert load_scenario("exact_fig7").replace({"controller.kind": "pid"}).controller == PidOptions(period=0.001)
    as_run = write(tmp_path, load_scenario("paper_fig7").to_yaml())
    scenario = load_scenario(as_run, ["reference.kind=hold", "tuner.kind=fixed", "tuner.omega_q=10"])
    assert scenario.reference == HoldReference()
    assert scenario.tuner == FixedTuner(omega_q=10.0)
    assert load_scenario("exact_fig7", ["controller.kind=pid", "controller.kp=3"]).controller.kp == 3.0
    assert Scenario.from_dict({"controller": {"period": 0.002}}).controller == LqiOptions(period=0.002)


def test_unknown_names_have_a_suggestion():
    for load, name, meant in (
        (load_scenario, "paper_fig", "paper_fig7"),
        (load_robot, "reachi_mini", "reachy_mini"),
        (load_comparison, "trackin", "tracking"),
    ):
        with pytest.raises(ConfigurationError, match=rf"file: expected .*, got '{name}'; did you mean {meant}\?$"):
            load(name)


@pytest.mark.slow
def test_the_package_imports_nothing_and_commands_and_scenarios_nothing_heavy():
    code = (
        "import sys, stewart_drake; print({'numpy', 'pydantic'} & set(sys.modules));"
        "import stewart_drake.cli.app; from stewart_drake import load_scenario; load_scenario('exact_fig7');"
        "heavy = ('pydrake', 'torch', 'matplotlib', 'pyarrow', 'scipy.optimize');"
        "print([name for name in sys.modules if name.startswith(heavy)]);"
        "from numba.core.dispatcher import Dispatcher; import gc;"
        "print([each for each in gc.get_objects() if isinstance(each, Dispatcher) and each.signatures])"
    )
    assert python("-c", code).split() == ["set()", "[]", "[]"]


def test_a_scenario_and_its_robot_show_themselves_in_ten_lines():
    lines = repr(load_scenario("exact_heart", ["safety={}"])).splitlines()
    assert (len(lines), lines[0]) == (10, "Scenario exact_heart: 10 s, gravity 9.81 m/s^2")
    assert "rods 0.404 m" in lines[-1]
    assert any("monitors" in line for line in lines)
    assert "  safety: none" in repr(Scenario()).splitlines()
    assert "six different legs" in repr(load_robot("reachy_mini"))


@pytest.mark.parametrize(
    ("amplitude", "answer"),
    [
        ([30.0, 0, 0, 0, 0, 0], "30 rad is -?1719 deg: did you mean -?30 deg"),
        ([0, 0, 0, 0, 0, 50.0], "reference.amplitude has 50 m; did you mean 50 mm"),
        ([0, 0, 0, 0, 0, 0.2], "about 53 % of its size"),
    ],
)
def test_a_motion_that_is_refused_says_what_to_do(amplitude, answer):
    with pytest.raises((ConfigurationError, InfeasibleReferenceError), match=answer):
        check_scenario(load_scenario("exact_fig7").replace({"reference.amplitude": amplitude}))


def test_a_motion_in_millimetres_and_a_recording_in_milliseconds_are_named(tmp_path):
    with pytest.raises(InfeasibleReferenceError, match="goes to 300 m: are its lengths in mm"):
        check_scenario(Scenario(duration=0.1, reference=lambda _: [0, 0, 0, 0, 0, 300]))
    names = "time_s,pose_roll_rad,pose_pitch_rad,pose_yaw_rad,pose_x_m,pose_y_m,pose_z_m"
    file = tmp_path / "motion.csv"
    file.write_text("\n".join([names, *(f"{100 * k},0,0,0,0,0,0.3" for k in range(5))]))
    with pytest.raises(
        ConfigurationError, match=r"less than 60 s apart; of times in ms.* got|rows 100 s apart.*time_ms"
    ):
        check_scenario(Scenario(duration=0.1, reference={"kind": "recorded", "motion_file": str(file)}))


def test_a_wrong_unit_hides_no_other_problem():
    data = {"duration": "5 mm", "command_delay": -1, "sensors": {"kind": "encoders", "noise": "3 mm"}, "contoller": 1}
    with pytest.raises(ConfigurationError) as caught:
        Scenario.from_dict(data)
    told = {each.key for each in (caught.value, *caught.value.others)}
    assert told == {"duration", "command_delay", "sensors.noise", "contoller"}
