"""Runs with a ball: balanced, thrown, fallen; and what the controller's side knows of it."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Controller, Scenario, load_scenario, run, run_metrics
from stewart_drake.export.fmu import robot_unit
from stewart_drake.machines.machine import open_machine
from stewart_drake.runs.checks import check_scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop

ROLLS = {"reference": "hold", "plant": "closed_form", "duration": 1.0}


def test_it_settles_is_caught_and_follows_a_circle():
    """diagrams/scenarios/ball.yaml."""
    log = run(load_scenario("ball"))
    away = 1e3 * np.linalg.norm(log["ball"] - log.scenario.ball_control.target.evaluate(log.time)[:, :2], axis=1)
    assert log.status == "completed"
    assert not log.warnings
    assert away[0] == 50.0
    assert away[(log.time > 1.0) & (log.time < 3.0)].max() < 2.0
    assert away[(log.time > 3.0) & (log.time < 4.0)].max() > 30.0, "thrown"
    assert away[(log.time > 5.0) & (log.time < 7.0)].max() < 2.0
    metrics = run_metrics(log)
    assert metrics["ball_rmse_mm"] < 0.6
    assert 0.01 < metrics["ball_friction"] < 0.3


def test_a_slow_bus_with_servos_and_a_late_camera():
    """diagrams/scenarios/ball_hexapod.yaml: 50 Hz, 40 ms until a reading, 20 ms until a pulse acts."""
    log = run(load_scenario("ball_hexapod"))
    assert log.status == "completed"
    assert run_metrics(log)["ball_rmse_mm"] < 8.0


def test_a_ball_over_the_rim_is_lost():
    log = run(Scenario(**ROLLS, ball={"throws": [{"time": 0.1, "velocity": [0.3, 0.4]}], "plate": {"radius": 0.12}}))
    assert (log.status, log.reason) == ("lost", "ball_fell")
    assert log.message == "the ball fell off the plate, whose rim is 0.12 m from its centre"
    assert log.outcome_time == pytest.approx(0.1 + 0.12 / 0.5, abs=0.02)


def test_the_friction_that_a_ball_needs_on_a_slope():
    """2/7 of the slope for a solid ball; too smooth a plate is a warning."""
    slope = {"reference": {"kind": "hold", "pose": [0.05, 0, 0, 0, 0, 0.3]}, "duration": 0.3}
    exact = {
        "controller": {"model": "exact", "feedforward": "full"},
        "ball": {"mass": 0.001, "resistance": 0.0, "friction": 0.01},
    }
    log = run(Scenario(**{**ROLLS, **slope, **exact}))
    assert run_metrics(log)["ball_friction"] == pytest.approx(2.0 / 7.0 * np.tan(0.05), rel=0.1)
    assert [warning["name"] for warning in log.warnings] == ["ball_slips"]


def test_what_has_no_ball_says_so():
    scenario = load_scenario("ball_hexapod")
    with pytest.raises(ConfigurationError, match="ball_control: expected null, for a machine"):
        open_machine("sim:", scenario)
    with pytest.raises(ConfigurationError, match="ball: expected null, for the FMU of a robot"):
        robot_unit(scenario, "ball")


def test_a_throw_from_outside_in_a_running_loop():
    scenario, step = Scenario(**ROLLS, ball={"resistance": 0.0}), 0.001
    throw = {200: scenario.ball.force([0.1, -0.05], step)}
    loop = SteppedLoop(scenario, sources={"ball_push": lambda n: throw.get(n, np.zeros(2))})
    loop.begin()
    for _ in range(400):
        loop.run_parts()
        loop.move()
    np.testing.assert_allclose(loop.runner.signal("ball")[2:4], [0.1, -0.05], rtol=0.1)


def test_what_the_controller_believes_of_the_ball_is_its_own():
    """A controller that takes the steel ball for a hollow one, and its plate for a high one, still balances it."""
    scenario = load_scenario("ball").replace({"duration": 3.0})
    wrong = scenario.replace({"model.ball": {"hollow": True, "plate": {"height": 0.1}, "sensor": {"noise": 0.001}}})
    right, other = run(scenario), run(wrong)
    assert np.linalg.norm(other["ball"][-1]) < 0.005
    assert np.abs(right["ball"] - other["ball"]).max() > 1e-3
    names = {part.name: part for part in SteppedLoop(wrong).parts.parts}
    assert names["ball_control"].parameters["params"]["tilt"][0] == pytest.approx(9.81 / (1.0 + 2.0 / 3.0))


def test_the_controller_takes_the_place_of_the_ball():
    scenario = load_scenario("ball").replace({"duration": 1.0})
    loop, controller, out = SteppedLoop(scenario), Controller(scenario.control()), np.empty(6)
    loop.begin()
    for _ in range(300):
        loop.run_parts()
        controller.step(loop.runner.signal("reading"), loop.time, out, ball=loop.runner.signal("ball_reading"))
        np.testing.assert_allclose(out, loop.runner.signal("torque"), atol=1e-9)
        loop.move()
    assert np.linalg.norm(loop.runner.signal("ball")[:2]) < 0.04
    with pytest.raises(ConfigurationError, match=r"ball: expected None, or an array of shape \(2,\)"):
        controller.step(loop.runner.signal("reading"), 9.0, out, ball=np.zeros(3))


@pytest.mark.parametrize(
    ("key", "value", "limit"),
    [("max_tilt", 0.5, "reach"), ("max_rate", 60.0, "crank_speed"), ("max_acceleration", 3000.0, "torque")],
)
def test_tilts_that_the_robot_cannot_do_are_refused_before_the_run(key, value, limit):
    scenario = load_scenario("ball").replace({f"ball_control.{key}": value, "robot": "servo_hexapod"})
    with pytest.raises(ConfigurationError, match=rf"ball_control\.{key}: expected less, as the robot cannot .*{limit}"):
        check_scenario(scenario)


def test_a_ball_can_be_added_to_a_running_loop():
    scenario = load_scenario("ball")
    bare = SteppedLoop(scenario.replace({"ball": None, "ball_control": None}))
    bare.begin()
    for _ in range(20):
        bare.run_parts()
        bare.move()
    loop = SteppedLoop(scenario)
    loop.take_over(bare)
    np.testing.assert_array_equal(loop.measured[:24], bare.measured)
    assert not loop.measured[24:].any(), "in the middle"
    bare.take_over(loop)
