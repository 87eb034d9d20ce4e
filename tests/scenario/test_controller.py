"""The controller's side alone: what it says to the readings of a run is what it said in the run."""

import json
from functools import cache

import numpy as np
import pytest
from conftest import python
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import vectors

from stewart_drake import Controller, RobotParameters, Scenario, load_controller, load_scenario, run
from stewart_drake.base.atomic_files import read_checked
from stewart_drake.base.errors import ConfigurationError, RunFailure, SafetyStop
from stewart_drake.control import network
from stewart_drake.hardware.sensors import EncoderOptions, encoder_part
from stewart_drake.scenario.assembly import loop_of
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.scenario import load_driven

ENCODERS = {"sensors": {"kind": "encoders"}, "estimator": {"kind": "difference", "rate_cutoff": 150.0}}
OBSERVED = {
    **ENCODERS,
    "estimator": "observer",
    "model": {"friction": {"coulomb": 0.01}},
    "plant.motor_friction": 0.01,
    "command_delay": 1,
}
POLICY = {**OBSERVED, "tuner": "policy"}
PERIODS = {
    **{"controller.period": 0.004, "command_delay": 1, "tuner.period": 0.02, "estimator.period": 0.001},
    "log_period": 0.001,
}


def short(name, changes=(), duration=0.1):
    return load_scenario(name).replace({"duration": duration, **dict(changes)})


def readings_of(log):
    sensors = log.scenario.sensors
    if not isinstance(sensors, EncoderOptions):
        return np.concatenate([log["pose"], log["pose_rate"]], axis=1)
    part, readings = encoder_part(sensors), []
    state = part.initial.copy()
    for angles in log["crank_angle"]:
        part.tick(np.append(angles, np.zeros(6)), state)
        readings.append(state["reading"][0].copy())
    return np.array(readings)


def replayed(controller, log, names=("torque",)):
    period, out, said = controller.period, np.empty(6), {name: [] for name in (*names, "out")}
    for tick, reading in enumerate(readings_of(log)):
        controller.step(reading, tick * period, out)
        said["out"].append(out.copy())
        for name in names:
            said[name].append(controller.signal(name).copy())
    return {name: np.array(values) for name, values in said.items()}


CASES = {
    "pose": ("exact_fig7", {}),
    "encoders": ("exact_breathing", {**ENCODERS, "tuner": "block", "sensors.noise": 2e-5}),
    "observer, friction": ("exact_breathing", {**OBSERVED, "tuner": "block"}),
    "policy": ("exact_breathing", POLICY),
    "learning": ("exact_breathing", {**OBSERVED, "tuner": "block", "adaptation": "regression", "duration": 0.3}),
    "periods": ("exact_breathing", {**PERIODS, "duration": 0.3}),
    "the paper's network": ("paper_fig7", {"controller.solver": "split", "duration": 0.3}),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["closed_form", "drake"])
@pytest.mark.parametrize(("name", "changes"), CASES.values(), ids=CASES.keys())
def test_a_controller_fed_with_the_readings_of_a_run_gives_what_the_run_logged(name, changes, kind, tmp_path):
    log = run(short(name, {**changes, "plant.kind": kind}))
    assert log.status == "completed"
    names = [each for each in ("torque", "error", "integral", "innovation") if each in log.signals]
    (tmp_path / "carried.yaml").write_text(log.scenario.control().to_yaml())
    said = replayed(Controller(load_controller(tmp_path / "carried.yaml")), log, names)
    bound = {"rtol": 0.0, "atol": 0.0} if kind == "closed_form" else {"rtol": 1e-7, "atol": 1e-8}
    for signal in names:
        np.testing.assert_allclose(said[signal], log[signal], **bound, err_msg=signal)
    np.testing.assert_array_equal(said["out"], said["torque"])
    assert np.ptp(said["torque"], axis=0).min() > 0.0


def test_the_shipped_controller_is_that_of_the_shipped_scenario():
    shipped, own = load_controller("reachy_mini"), load_scenario("reachy_nod").control()
    assert shipped.controller_model.noise == pytest.approx(own.controller_model.noise, rel=0.01)
    assert shipped.controller_model._replace(noise=own.controller_model.noise) == own.controller_model
    for name in set(ControlOptions.model_fields) - {"name", "model"}:
        assert getattr(shipped, name) == getattr(own, name), name


def test_reset_gives_the_same_again():
    log = run(short("exact_breathing", {**POLICY, "plant.kind": "closed_form", "safety": {}}))
    controller = Controller(log.scenario)
    first = replayed(controller, log)
    controller.reset()
    again = replayed(controller, log)
    np.testing.assert_array_equal(first["out"], again["out"])


def test_behind_a_safety_layer_it_says_how_it_is_and_ends_by_name():
    log = run(short("exact_breathing", {"plant.kind": "closed_form", "safety.safe_hold_time": 0.01}, 0.15))
    controller, out = Controller(log.scenario), np.empty(6)
    readings, period = readings_of(log), controller.period
    for tick in range(50):
        controller.step(readings[tick], tick * period, out)
        assert controller.status == "none"
        np.testing.assert_array_equal(out, log["torque"][tick])
    levels = []
    # An encoder that tells nothing more: the estimator bridges it for a while, and then the layer takes over.
    readings[50:, 2] = np.nan

    def go_on():
        for tick in range(50, len(readings)):
            controller.step(readings[tick], tick * period, out)
            levels.append(controller.status)
            assert np.isfinite(out).all()

    with pytest.raises(SafetyStop) as caught:
        go_on()
    assert list(dict.fromkeys(levels))[:2] == ["none", "hold"]
    assert caught.value.reason in ("sensor_failed", "measurement_not_finite")
    assert caught.value.time == pytest.approx((50 + len(levels)) * period)


WITHOUT = """
import json, sys
sys.modules.update(pydrake=None, torch=None, pyarrow=None, matplotlib=None)
import numpy as np
from stewart_drake import Controller, load_scenario
name, changes, readings = json.loads(sys.argv[1])
controller, out = Controller(load_scenario(name).replace(changes)), np.empty(6)
torques = []
for tick, reading in enumerate(readings):
    controller.step(np.array(reading), tick * controller.period, out)
    torques.append(out.tolist())
print(json.dumps(torques))
"""


@pytest.mark.slow
def test_it_runs_where_drake_is_not_installed():
    changes = {**POLICY, "safety": {}, "duration": 0.05}
    log = run(short("exact_breathing", {**changes, "plant.kind": "closed_form"}))
    given = json.dumps(["exact_breathing", changes, readings_of(log).tolist()])
    torques = json.loads(python("-c", WITHOUT, given).splitlines()[-1])
    np.testing.assert_array_equal(torques, replayed(Controller(log.scenario), log)["out"])


def test_a_solver_that_needs_drake_is_refused_where_it_would_be_ignored():
    scenario = short("exact_fig7", {"controller.solver": "drake"})
    fast = scenario.replace({"plant.kind": "closed_form"})
    for ignores in (lambda: Controller(scenario), lambda: run(fast)):
        with pytest.raises(ConfigurationError, match=r"controller.solver: expected split, or null .*, got 'drake'"):
            ignores()


@pytest.mark.parametrize("name", ["exact_breathing", "paper_fig7"])
def test_a_tuners_file_is_read_once_a_loop(name, monkeypatch):
    paths = []

    def counted(path, *more):
        paths.append(path)
        return read_checked(path, *more)

    monkeypatch.setattr(network, "read_checked", counted)
    loop_of(load_scenario(name))
    assert len(paths) == 1


def test_a_torque_that_is_no_number_never_comes_out():
    controller = Controller(
        load_scenario("exact_fig7", ("controller=lqi", "tuner=fixed", "controller.feedforward=none"))
    )
    out = np.full(6, 1.5)
    with pytest.raises(RunFailure):
        controller.step(np.full(12, np.nan), 0.0, out)
    np.testing.assert_array_equal(out, 1.5)


HOME = RobotParameters().home_pose


class NoArray:
    def __array__(self, *given, **named):
        raise ZeroDivisionError


REFUSED = {
    "an object that is no array": ("readings", {"readings": NoArray()}),
    "five readings": ("readings", {"readings": np.zeros(5)}),
    "one reading for all": ("readings", {"readings": 0.0}),
    "complex readings": ("readings", {"readings": np.zeros(12, dtype=complex)}),
    "readings of words": ("readings", {"readings": ["0.1"] * 12}),
    "read-only": ("out", {"out": np.broadcast_to(0.0, 6)}),
    "whole numbers out": ("out", {"out": np.zeros(6, dtype=int)}),
    "seven torques": ("out", {"out": np.zeros(7)}),
    "a list": ("out", {"out": [0.0] * 6}),
    "the same time": ("time", {"time": 0.0}),
    "an earlier time": ("time", {"time": -1.0}),
    "no time": ("time", {"time": np.nan}),
    "a time of words": ("time", {"time": "0"}),
    "an endless time": ("time", {"time": 10**400}),
    "two times": ("time", {"time": np.ones(2)}),
    "rows of two lengths": ("readings", {"readings": [[0.0], [0.0, 1.0]]}),
    "an age of words": ("age", {"age": "0"}),
    "a reading of the future": ("age", {"age": -0.001}),
}


@pytest.mark.parametrize(("key", "given"), REFUSED.values(), ids=REFUSED.keys())
def test_bad_arguments_are_refused_and_change_nothing(key, given):
    controller = Controller(Scenario(controller=lambda *_: np.full(6, 8.0), robot={"effort_limit": 5.0}))
    usual = {"readings": np.concatenate([HOME, np.zeros(6)]), "time": 0.001, "out": np.full(6, 1.5)}
    controller.step(usual["readings"], 0.0, np.empty(6))
    before = controller._running.values.copy()
    with pytest.raises(ConfigurationError) as caught:
        controller.step(**{**usual, **given})
    assert caught.value.key == key
    assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(controller._running.values, before)
    controller.step(**usual)
    np.testing.assert_array_equal(usual["out"], 5.0)  # The limit of the motors.


class Odd:
    """A monitor that raises, or answers what is no leg."""

    def __init__(self, answer):
        self.answer = answer

    def look(self, _):
        return self.answer()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda: 1 / 0, r"the user's code raised ZeroDivisionError: .* \(test_controller.py, line \d+, in <lambda>\)"),
        (lambda: exit(3), "the user's code raised SystemExit: 3"),
        (lambda: 7, "safety.monitors.0.kind: expected a class whose look"),
    ],
)
def test_whatever_a_monitor_does_is_a_failure_of_the_run(answer, words):
    controller = Controller(Scenario(reference="hold", safety={"monitors": [Odd(answer)]}))
    with pytest.raises(RunFailure, match=words):
        controller.step(np.concatenate([HOME, np.zeros(6)]), 0.0, np.empty(6))


def test_readings_that_are_too_old_reach_the_deadline():
    scenario = Scenario(controller=lambda *_: np.zeros(6), gravity=0.0, reference="hold", safety={"deadline": 2})
    controller, out = Controller(scenario), np.empty(6)
    at_home, period = np.concatenate([HOME, np.zeros(6)]), controller.period
    for tick, (age, status) in enumerate(
        [(0.0, "none"), (2.0, "none"), (2.1, "hold"), (0.0, "none"), (np.inf, "hold")]
    ):
        controller.step(at_home, tick * period, out, age * period)
        assert controller.status == status


KINDS = [
    {"kind": kind, "saturation": saturation, "period": 0.001}
    for kind, ways in {"lqi": ("none", "clamp", "back_calculation"), "computed_torque": ("none", "clamp")}.items()
    for saturation in ways
] + [{"kind": "pid", "period": 0.001}]


@pytest.mark.parametrize("safety", [None, {}])
@pytest.mark.parametrize("controller", KINDS, ids=lambda keys: f"{keys['kind']}-{keys.get('saturation')}")
@settings(max_examples=20, deadline=None)
@given(steps=st.lists(st.tuples(vectors(6), st.floats(0.0, 5.0), st.floats(0.1, 5.0)), min_size=1, max_size=8))
def test_whatever_it_reads_and_whenever_no_kind_gives_more_than_the_limit(controller, safety, steps):
    """Angles far from the reference, readings of any age, ticks at any time; the limit is near the weight's torque."""
    mine = the_controller(json.dumps(controller), json.dumps(safety))
    mine.reset()
    out, time = np.zeros(6), 0.0
    for unit, age, later in steps:
        pose = HOME + unit * [0.2, 0.2, 0.2, 0.03, 0.03, 0.02]
        assert (abs(out) <= 0.6).all()
        try:
            mine.step(np.concatenate([pose, 0.1 * unit]), time, out, 0.001 * age)
        except RunFailure:
            break
        time += 0.001 * later
    assert (abs(out) <= 0.6).all()


@cache
def the_controller(controller, safety):
    keys = {"controller": json.loads(controller), "safety": json.loads(safety), "robot.effort_limit": 0.6}
    return Controller(short("exact_fig7", {**keys, "duration": 1.0}))


@pytest.mark.parametrize(
    ("reference", "names", "words"),
    [
        ("stream", ["targets"], "sources: expected reference or reference_ahead, got 'targets'"),
        ("hold", ["target"], "target is for a reference of kind stream"),
        ("stream", ["target", "reference"], "sources: expected target, got 'reference'"),
    ],
)
def test_sources_of_other_names_are_refused(reference, names, words):
    scenario = Scenario(reference={"kind": reference}, command_delay=1, estimator="observer")
    with pytest.raises(ConfigurationError, match="sources: expected ") as caught:
        Controller(scenario, dict.fromkeys(names, lambda _: np.zeros(6)))
    assert words in str(caught.value)


@pytest.mark.parametrize("given", [np.eye(4), np.zeros(5), 0.0])
def test_a_source_that_returns_another_shape_is_named(given):
    controller = Controller(Scenario(reference={"kind": "stream"}), {"target": lambda _: given})
    with pytest.raises(RunFailure, match=r"sources: target: expected a function that returns an array of shape \(6,\)"):
        controller.step(np.concatenate([HOME, np.zeros(6)]), 0.0, np.empty(6))


def test_a_controllers_file_alone_is_simulated_with_the_friction_that_it_compensates():
    friction = load_driven("reachy_mini").plant.friction_options
    assert (friction.coulomb, friction.viscous) == ((0.058,) * 6, (0.095,) * 6)
    # The torque of servos is between command and angle, so friction is of less account.
    assert load_driven("reachy_servos").plant.friction is None
