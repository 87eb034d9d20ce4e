import dataclasses
import math

import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.control.network import default_network_path, load_network
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.force_map import force_map
from stewart_drake.paper import sensitivity_section as sensitivity
from stewart_drake.paper.report import Section
from stewart_drake.paper.sensitivity_changes import Change, changes, feedforward_share, scaled_network
from stewart_drake.paper.sensitivity_section import Effect, Response, controllers, make
from stewart_drake.paper.study import Study
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import AnnTuner, FixedTuner, Scenario

ROBOT = RobotParameters()
BASE = Scenario(tuner=FixedTuner())


def flat(data, prefix=""):
    """Nested mapping -> dotted key -> value."""
    found = {}
    for key, value in data.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found


def differing(one, other):
    a, b = flat(one.to_dict()), flat(other.to_dict())
    return {key for key in a.keys() | b.keys() if a.get(key) != b.get(key)}


# --- changes -------------------------------------------------------------------------------------------------------


def applied(base, folder):
    return {(change.factor, change.label): base.replace(change.keys) for change in changes(base, folder)}


def test_masses_and_inertias_are_scaled_apart(tmp_path):
    made = applied(BASE, tmp_path)
    heavy, stubborn = made["masses", "+20 %"].robot, made["inertias", "-20 %"].robot
    for body in ("platform", "rod", "crank"):
        assert getattr(heavy, f"{body}_mass") == pytest.approx(1.2 * getattr(ROBOT, f"{body}_mass"))
        assert getattr(heavy, f"{body}_inertia") == getattr(ROBOT, f"{body}_inertia")
        assert getattr(stubborn, f"{body}_mass") == getattr(ROBOT, f"{body}_mass")
        np.testing.assert_allclose(
            getattr(stubborn, f"{body}_inertia"), 0.8 * np.array(getattr(ROBOT, f"{body}_inertia"))
        )
    assert made["rod length", "-1 mm"].robot.rod_length == pytest.approx(ROBOT.rod_length - 1e-3)


def test_a_scaled_network_answers_so_much_more_within_a_range_so_much_higher():
    network = load_network(default_network_path())
    densities = np.random.default_rng(3).uniform(-1e3, 1e3, (200, 12))
    densities[:100] = np.random.default_rng(4).uniform(0.0, 2.0, (100, 12))
    omega = network.weights(densities)
    scaled = scaled_network(network, omega_q=1.5, omega_r=0.5).weights(densities)
    np.testing.assert_allclose(scaled, omega * [1.5, 0.5], rtol=1e-12)


def test_each_change_touches_nothing_but_its_own(tmp_path):
    keys = {
        "motor friction": {"plant.motor_friction"},
        "motor damping": {"plant.motor_damping"},
        "sample time": {"controller.period"},
        "omega_Q": {"tuner.omega_q"},
        "omega_R": {"tuner.omega_r"},
    }
    seen = set()
    for (factor, _), made in applied(BASE, tmp_path).items():
        seen.add(factor)
        if factor in keys:
            assert differing(made, BASE) in (keys[factor], set())
            continue
        # Another robot; the controller goes on believing in the old one.
        assert made.believed_robot == BASE.robot
        assert made.robot != BASE.robot
        assert made.replace({"robot": dataclasses.asdict(BASE.robot), "model_robot": None}) == BASE
    assert seen == {*keys, "masses", "inertias", "rod length"}


def test_under_a_network_a_weight_is_changed_at_its_output(tmp_path):
    base = Scenario(tuner=AnnTuner())
    half = applied(base, tmp_path / "new")["omega_R", "-50 %"]
    densities = np.random.default_rng(5).uniform(0.0, 2.0, (20, 12))
    made = half.load_tuner_network().weights(densities)
    np.testing.assert_allclose(made, base.load_tuner_network().weights(densities) * [1.0, 0.5], rtol=1e-12)


def test_the_share_of_the_feedforward_is_its_force_in_phase_with_what_the_law_leaves_out():
    assert feedforward_share(ROBOT, ROBOT, 9.81) == 0.0
    other, robot = (ROBOT.replace(rod_length=ROBOT.rod_length + d) for d in (-1e-3, 1e-3))
    assert feedforward_share(robot, ROBOT, 0.0) == 0.0
    short, long = (feedforward_share(each, ROBOT, 9.81) for each in (other, robot))
    assert short > 0.0 > long
    # By its definition: the force less that share is in quadrature with -m Z''.
    pose, _, acceleration = paper_reference().evaluate(np.linspace(0.0, np.pi, 65)[:-1])
    torque = static_torque(ROBOT, pose, 9.81) - static_torque(robot, pose, 9.81)
    force = np.array([force_map(robot, q) @ t for q, t in zip(pose, torque, strict=True)])[:, 5]
    left_out = -ROBOT.platform_mass * acceleration[:, 5]
    assert (force - force.mean() - long * left_out) @ left_out == pytest.approx(0.0, abs=1e-10)


# --- responses -----------------------------------------------------------------------------------------------------


def effect(factor, label, pose, torque=1.0):
    return Effect(factor, label, None if pose is None else {"pose_mm": pose, "torque_rms": torque}, "completed")


def test_swings_are_the_largest_change_of_a_factor_the_largest_first():
    levels = (("a", "-", 3.0), ("a", "+", 4.4), ("b", "+", 6.0, 0.7), ("c", "+", None), ("d", "+", 4.0))
    made = Response("tuner", {"pose_mm": 4.0, "torque_rms": 1.0}, tuple(effect(*level) for level in levels))
    assert made.swings("pose_mm") == {"c": math.inf, "b": 50.0, "a": 25.0, "d": 0.0}
    assert list(made.swings("pose_mm")) == ["c", "b", "a", "d"]
    assert made.swings("torque_rms")["b"] == pytest.approx(30.0)
    assert made.shift(made.effects[0], "pose_mm") == -25.0
    assert made.shift(made.effects[3], "pose_mm") is None


# --- the section ---------------------------------------------------------------------------------------------------


@pytest.fixture
def made_runs(runs_by):
    """Runs by formula: Z off by 4 mm, in proportion to the sample time; lost where the robot is a fifth too heavy."""

    def rule(scenario):
        rows = round(scenario.duration / 0.01) + 1
        pose = np.zeros((rows, 6))
        pose[:, 5] = 4e-3 * scenario.controller.period / 0.005
        log = made_log(rows=rows, step=0.01, pose=pose, torque_applied=np.ones((rows, 6)))
        if scenario.robot.platform_mass > 1.1:
            log = dataclasses.replace(log, status="failed", reason="crank_dead_centre", leg=4, end_time=0.5)
        return log

    return runs_by(rule)


@pytest.mark.usefixtures("no_pictures")
def test_the_section_holds_every_change_of_every_controller(tmp_path, made_runs):
    section = make(Study(tmp_path))
    numbers = section.numbers["controllers"]
    assert set(numbers) == {"tuner", "ratio 1", "ratio 100"}
    for name, of in numbers.items():
        assert of["unchanged"]["score"]["pose_mm"] == pytest.approx(4.0)
        by = {(e["factor"], e["to"]): e for e in of["effects"]}
        assert by["sample time", "10 ms"]["score"]["pose_mm"] == pytest.approx(8.0)
        assert by["masses", "+20 %"]["score"] is None
        assert by["masses", "+20 %"]["ended"] == "crank dead centre, leg 4, 0.500 s"
        # Nominal values change nothing; the window acts on the network alone.
        assert not {("sample time", "5 ms"), ("motor friction", "0 N m"), ("window m", "49")} & by.keys()
        assert (("window m", "10") in by) == (name == "tuner")
    assert len(made_runs[0]) == sum(1 + len(of["effects"]) for of in numbers.values())
    head, *rows = [line.strip("| ").split(" | ") for line in section.body.split("\n") if line.startswith("| ")]
    rows = {tuple(row[:2]): dict(zip(head, row, strict=True)) for row in rows[1:]}
    assert rows["sample time", "10 ms"]["ratio 1: pose [mm]"] == "8 (+100.0 %)"
    assert rows["masses", "+20 %"]["tuner: pose [mm]"] == "crank dead centre, leg 4, 0.500 s"
    assert "Runs end early: tuner at +20 %; ratio 1 at +20 %; ratio 100 at +20 %" in section.body
    assert len(section.files) == len(numbers)
    assert Section.from_json(section.to_json()) == section


@pytest.mark.usefixtures("no_pictures")
def test_a_robot_that_cannot_follow_the_reference_is_a_row_with_its_reason(tmp_path, made_runs, monkeypatch):
    impossible = [Change("rod length", f"{length} m", {"robot.rod_length": length}) for length in (0.1, 0.35)]
    monkeypatch.setattr(sensitivity, "changes", lambda *_: impossible)
    effects = make(Study(tmp_path)).numbers["controllers"]["tuner"]["effects"]
    assert [e["score"] for e in effects] == [None, None]
    assert effects[0]["ended"].startswith("not run: robot.home_height")
    assert effects[1]["ended"].startswith("not run: reference: breaks the limit reach")
    assert len(made_runs[0]) == 3


@pytest.mark.usefixtures("made_runs", "no_pictures")
def test_without_gravity_nothing_is_said_of_its_feedforward(tmp_path):
    section = make(Study(tmp_path, True, Scenario(gravity=0.0)))
    assert "feedforward_share" not in section.numbers
    assert "A rod of another length" not in section.body


def test_the_controllers_follow_the_paper_for_two_of_its_periods(tmp_path):
    found = controllers(Study(tmp_path))
    assert found["tuner"].tuner.kind == "paper"
    for name, ratio in (("ratio 1", 1.0), ("ratio 100", 100.0)):
        assert found[name].tuner.omega_q / found[name].tuner.omega_r == pytest.approx(ratio)
    for scenario in found.values():
        assert scenario.reference == paper_reference()
        assert scenario.duration == pytest.approx(2.0 * np.pi, abs=0.005)
