"""Kinds that are not of the package: each runs, is checked, logged and plotted like the package's own."""

import json
from typing import Annotated, ClassVar, Literal

import numpy as np
import pytest

from stewart_drake.base.config import NotNegative, Positive
from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.base.records import Record, Vec12
from stewart_drake.base.registry import CONTROLLERS, ENCODER_FAULTS, SENSORS
from stewart_drake.control.base import ControllerOptions
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.hardware.faults import FaultKind
from stewart_drake.hardware.sensors import SensorOptions
from stewart_drake.logs.log import load_log
from stewart_drake.logs.metrics import MetricError, run_metrics
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.kinematics_laws import Robot, robot_record
from stewart_drake.plotting.run_plots import plot_states, plot_torques
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import Scenario, load_scenario, scenario_schema
from stewart_drake.studies.runs import identity

SHORT = {"duration": 0.1, "tuner": {"kind": "fixed"}}
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])


class ToyReference:
    """A slow rise; knows one time at a time, and nothing of arrays."""

    def __init__(self, height=0.001):
        self.height = height

    def evaluate(self, t):
        if t > 1.0:
            raise RuntimeError("the end of the world")
        up = np.array([0.0, 0.0, 0.0, 0.0, 0.0, self.height])
        return HOME + up * t, up, 0.0 * up


class ToyPush:
    """A push upwards."""

    def __init__(self, force=1.0):
        self.force = force

    def evaluate(self, t):
        return [0.0, 0.0, 0.0, 0.0, 0.0, self.force * t]


def checked_logged_and_plotted(scenario, tmp_path):
    check_scenario(scenario)
    log = run(scenario)
    assert log.status == "completed", log.message
    log.save(tmp_path / "log.parquet")
    again = load_log(tmp_path / "log.parquet")
    assert again.scenario.to_dict() == scenario.to_dict()
    np.testing.assert_array_equal(again["pose"], log["pose"])
    assert plot_states(again).axes
    assert plot_torques(again).axes
    return log


@pytest.mark.parametrize(
    "given", [ToyReference, ToyReference(0.002), {"kind": ToyReference, "arguments": {"height": 0.003}}]
)
def test_any_object_with_evaluate_is_a_reference(given, tmp_path):
    scenario = Scenario(**SHORT, reference=given)
    log = checked_logged_and_plotted(scenario, tmp_path)
    height = {type: 0.001, ToyReference: 0.002, dict: 0.003}[type(given)]
    np.testing.assert_allclose(log["reference"][-1, 5], 0.3 + height * log.time[-1], rtol=1e-9)
    inside = scenario.replace({"reference": {"kind": "adjusted", "motion": given, "scale": 2.0}})
    np.testing.assert_allclose(inside.reference.evaluate(0.1)[1][5], 2.0 * height)


def test_what_a_reference_raises_is_told_before_the_run_and_in_it_keeps_the_log():
    scenario = Scenario(**{**SHORT, "duration": 1.2}, reference=ToyReference())
    with pytest.raises(ConfigurationError, match=r"reference.*the end of the world"):
        check_scenario(scenario)
    log = run(scenario, check=False)
    assert (log.status, log.reason) == ("failed", "controller_raised")
    assert "the end of the world (test_outside_kinds.py" in log.message
    assert len(log.time) > 50
    with pytest.raises(InfeasibleReferenceError):
        check_scenario(Scenario(**SHORT, reference=ToyReference(50.0)))


class ToySensorOptions(SensorOptions):
    """A sensor that is off along Z."""

    kind: Literal["toy"] = "toy"
    off: NotNegative = 0.001
    """[m]"""


@pytest.fixture
def added(monkeypatch):
    for family in (SENSORS, CONTROLLERS, ENCODER_FAULTS):
        monkeypatch.setattr(family, "_lines", dict(family._lines))
    SENSORS.add(ToySensorOptions)


@pytest.mark.usefixtures("added")
def test_a_kind_that_was_added_has_its_section_its_messages_and_its_place_in_the_schema():
    scenario = Scenario.from_dict({**SHORT, "sensors": {"kind": "toy", "off": 0.002}})
    with pytest.raises(ConfigurationError, match=r"^sensors\.off: expected a number \[m\] at least 0"):
        scenario.replace({"sensors.off": -1})
    with pytest.raises(ConfigurationError, match=r"did you mean toy\?"):
        scenario.replace({"sensors": {"kind": "tooy"}})
    assert "ToySensorOptions" in json.dumps(scenario_schema())


@pytest.mark.usefixtures("added")
def test_an_object_of_a_subclass_is_refused_and_not_taken_for_its_base():
    class Louder(LqiOptions):
        """Without a kind of its own."""

    with pytest.raises(ConfigurationError, match=r"^controller: expected LqiOptions, got 'Louder'; a subclass of it"):
        Scenario(**SHORT, controller=Louder())


def doubled(factor):
    return FaultKind(lambda fault, now: np.multiply.at(now.values, fault.channels, factor))


@pytest.mark.usefixtures("added")
def test_results_are_kept_under_the_code_of_added_kinds():
    def kinds():
        return identity({}, [Scenario(**SHORT)])["kinds"]

    ENCODER_FAULTS.add("doubled", doubled(2.0))
    before = [kinds(), kinds()]
    SENSORS._lines["toy"] = type("Other", (ToySensorOptions,), {"__module__": __name__})
    other_sensor = kinds()
    ENCODER_FAULTS._lines["doubled"] = FaultKind(lambda fault, now: np.add.at(now.values, fault.channels, 3.0))
    assert len({*before, other_sensor, kinds()}) == 3


class Reading(Record):
    reading: Annotated[np.ndarray, ("size",)]


class Measured(Record):
    measurement: Vec12


class HeavierRobot(Record):
    mass: Robot


class ToySensor:
    """Reads the pose with an offset along Z, or numbers that nobody can use."""

    def __init__(self, off=0.001, size=12):
        self.off, self.size = off, size

    def parts(self, _):
        state, constants = Reading.sized(size=self.size).new(), {"off": self.off}
        return (Part("toy", read, constants, {"plant_pose": 12}, ("reading",), state),)


def read(off, plant_pose, state):
    state["reading"][0] = plant_pose
    state["reading"][0, 5] += off


class ToyEstimator:
    """Takes half of the sensor's offset away."""

    def parts(self, _):
        return (Part("half", halve, {}, {"reading": 12}, ("measurement",), Measured.new()),)


def halve(reading, state):
    state["measurement"][0] = reading
    state["measurement"][0, 5] -= 0.0005


class ToyLaw:
    """Believes that the head grows heavier."""

    writes: ClassVar = {"mass": ("controller.robot",)}

    def parts(self, context):
        robot = robot_record(context.robot)
        state = HeavierRobot.new(mass=robot)
        return (Part("grows", grow, {}, {}, ("mass",), state),)


def grow(state):
    state["mass"]["platform_mass"] += 1e-4


def test_a_sensor_an_estimator_and_an_adaptive_law_may_be_a_users_classes(tmp_path):
    base = {**SHORT, "plant": "closed_form", "controller": "computed_torque"}
    parts = {
        "sensors": {"kind": ToySensor, "arguments": {"off": 0.001}},
        "estimator": ToyEstimator(),
        "adaptation": ToyLaw,
    }
    log = checked_logged_and_plotted(Scenario(**base, **parts), tmp_path)
    np.testing.assert_allclose(log["pose_reading"][:, 5] - log["pose"][:, 5], 0.001)
    np.testing.assert_allclose(log["measured_pose"][:, 5] - log["pose"][:, 5], 0.0005)
    del parts["adaptation"]
    # Held by a feedback without an integral, the platform stands higher where it is believed to be heavier.
    assert log["pose"][-1, 5] > run(Scenario(**base, **parts))["pose"][-1, 5] + 1e-6
    drake = run(Scenario(**{**base, "plant": "drake"}, **parts, adaptation=ToyLaw()))
    np.testing.assert_allclose(drake["pose_reading"][:, 5] - drake["pose"][:, 5], 0.001)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"sensors": ToyPush}, r"^sensors\.kind: expected a class whose parts\(.*not one without parts"),
        ({"sensors": {"kind": ToySensor, "arguments": {"size": 6}}}, r"of 12 numbers, got '6 numbers'"),
        ({"sensors": {"kind": ToySensor, "reading": "angles"}}, r"^estimator\.reading: expected a signal of 6 numbers"),
        ({"estimator": {"kind": ToyEstimator, "arguments": {"size": 6}}}, r"takes estimator\.arguments"),
        ({"adaptation": type("Broken", (), {"parts": lambda *_: 1 / 0})}, r"^adaptation\.kind: .*ZeroDivisionError"),
        ({"adaptation": type("Odd", (), {"parts": lambda *_: 3})}, r"^adaptation\.kind: .*not a int of something else"),
    ],
)
def test_a_users_parts_that_do_not_fit_are_refused_in_a_line(section, message):
    with pytest.raises(ConfigurationError, match=message):
        run(Scenario(**SHORT, plant="closed_form", **section))


class ToyMonitor:
    """Trips where the platform is too low."""

    def __init__(self, lowest=0.3):
        self.lowest = lowest

    def look(self, inputs):
        if self.lowest < 0.0:
            raise ZeroDivisionError("blind")
        return -1 if inputs.pose[5] < self.lowest else None


@pytest.mark.slow
def test_a_monitor_stops_a_run_by_its_name_and_refuses_a_motion_that_would_trip_it(tmp_path):
    given = {"kind": ToyMonitor, "arguments": {"lowest": 0.3}}
    base = {**SHORT, "duration": 1.0, "reference": {"kind": "hold", "pose": [0, 0, 0, 0, 0, 0.302]}}
    push = {"kind": "step", "wrench": [0, 0, 0, 0, 0, -30.0], "time": 0.05}
    scenario = Scenario.from_dict({**base, "safety": {"monitors": [given]}})
    log = checked_logged_and_plotted(scenario, tmp_path)
    assert log.safety is None
    pushed = scenario.replace({"disturbances": [push], "safety.following_error": None})
    log = run(pushed)
    assert (log.status, log.reason) == ("stopped", "ToyMonitor")
    assert log.safety["monitor"] == "ToyMonitor"
    assert log["pose"][log.time < log.safety["time"], 5].min() > 0.2999
    with pytest.raises(ConfigurationError, match=r"^safety\.monitors\.0: expected .*got 'ToyMonitor'"):
        check_scenario(scenario.replace({"reference.pose": [0, 0, 0, 0, 0, 0.299]}))
    with pytest.raises(ConfigurationError, match=r"^safety\.monitors: .*blind"):
        check_scenario(scenario.replace({"safety": {"monitors": [ToyMonitor(-1.0)]}}))


METRIC = """
from stewart_drake import Metric

height = Metric("height", "m", "largest height", lambda rows: rows["pose"][:, 5].max(), "steps")
broken = Metric("broken", "", "raises", lambda t: 1 / 0, "steps")
"""


def test_a_metric_by_its_path_is_computed_in_its_runs_alone(tmp_path):
    (tmp_path / "mine.py").write_text(METRIC)

    def of(name):
        text = f"duration: 0.05\ntuner: fixed\nreference: hold\nmetrics: ['mine.py:{name}']\n"
        (tmp_path / "s.yaml").write_text(text)
        return load_scenario(tmp_path / "s.yaml", trust_code=True)

    assert run_metrics(run(of("height")))["height"] == pytest.approx(0.3, abs=1e-3)
    assert "height" not in run_metrics(run(Scenario(**SHORT)))
    with pytest.raises(MetricError, match=r"^metric broken: ZeroDivisionError: division by zero \(mine.py, line 5\)"):
        run(of("broken"))


class Nothing:
    """Has no method at all."""


class Answers:
    """Says the same whatever it is asked."""

    def __init__(self, answer):
        self.answer = answer

    def evaluate(self, t):  # noqa: ARG002
        return self.answer

    def look(self, inputs):  # noqa: ARG002
        return self.answer


PLACES = {
    "reference": (lambda given: {"reference": {"kind": given}}, "evaluate"),
    "reference.parts.1": (lambda given: {"reference": {"kind": "sum", "parts": [{"kind": "hold"}, given]}}, "evaluate"),
    "disturbances.1": (lambda given: {"disturbances": [ToyPush, given]}, "evaluate"),
    "safety.monitors.0": (lambda given: {"safety": {"monitors": [given]}}, "look"),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("given", [Nothing, *map(Answers, ("a text", [1.0, [2.0]]))])
def test_a_class_of_another_shape_is_bad_input_that_names_key_class_and_what_is_asked(place, given):
    section, method = PLACES[place]
    scenario = Scenario.from_dict({**SHORT, **section(given)})
    with pytest.raises(ConfigurationError, match=rf"a class whose {method}\(.*\) returns .*, not ") as caught:
        run(scenario)
    assert caught.value.key == f"{place}.kind"
    assert "Nothing" in str(caught.value) or "Answers" in str(caught.value)
    assert "\n" not in str(caught.value)


class AnotherLqi(ControllerOptions):
    """Takes the name of a kind that exists."""

    kind: Literal["lqi"] = "lqi"
    period: Positive = 0.001


@pytest.mark.usefixtures("added")
def test_a_kind_needs_a_name_of_its_own():
    with pytest.raises(ConfigurationError, match=r"^kind: .*a new name.*'lqi'"):
        CONTROLLERS.add(AnotherLqi)
    assert CONTROLLERS["lqi"] is LqiOptions
    SENSORS.add(ToySensorOptions)  # as a cell of a notebook does
