"""Numbers with their units, and what was meant without one."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake import Scenario, load_scenario
from stewart_drake.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.references import SineReference
from stewart_drake.runs.checks import check_scenario
from stewart_drake.units import UNITS, in_unit


@given(st.floats(-1e6, 1e6), st.sampled_from([*UNITS]))
def test_a_number_with_a_unit_is_that_many_of_it(number, unit):
    base, size = UNITS[unit]
    assert in_unit(f"{number!r} {unit}", "key", base) == pytest.approx(number * size, rel=1e-12)


def test_each_number_of_a_list_has_the_unit_of_its_place():
    given = ["30 deg", 0.1, 0, 0, 0, "50 mm"]
    assert SineReference(amplitude=given).amplitude == pytest.approx((math.radians(30), 0.1, 0.0, 0.0, 0.0, 0.05))
    with pytest.raises(ConfigurationError, match=r"amplitude: expected a number \[rad\], or one with .*deg"):
        SineReference(amplitude=["30 mm", 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("duration=300 ms", "duration", 0.3),
        ("controller.period=2 ms", "controller.period", 0.002),
        ("plant.payload_mass=100 g", "plant.payload_mass", 0.1),
        ("reference.angular_frequency=0.5Hz", "reference.angular_frequency", (math.pi,) * 6),
    ],
)
def test_units_stand_in_files_and_behind_set(text, key, value):
    found = load_scenario("exact_fig7", [text])
    for name in key.split("."):
        found = getattr(found, name)
    assert found == pytest.approx(value)


def test_a_name_is_no_number():
    assert Scenario(name="3 s").name == "3 s"


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("duration=3 kg", r"expected a number \[s\], or one with s, ms, us, min behind it, got '3 kg'"),
        ("reference.angular_frequency=5 s", r"a period of 5 s is 0.2 Hz\), got '5 s'"),
        ("duration=5 Hz", r"5 Hz is a period of 0.2 s\), got '5 Hz'"),
        ("controller.period=5", "at most 1, got 5; did you mean 5 ms"),
    ],
)
def test_a_unit_that_does_not_fit_is_answered_with_those_that_do(text, answer):
    with pytest.raises(ConfigurationError, match=answer):
        load_scenario("exact_fig7", [text])


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
