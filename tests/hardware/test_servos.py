"""Motors that take angles: their torque, what they must be told, and what a motion through them is like."""

import numpy as np
import pytest
from hypothesis import given
from setups import setup_for
from strategies import ROBOT, vectors

from stewart_drake import load_robot
from stewart_drake.analysis.linear_loop import linearize
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation.torques import recording_of_log
from stewart_drake.hardware.presets import PRESETS
from stewart_drake.hardware.servos import CurrentMotors, PositionServos
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plotting.run_plots import plot_torques
from stewart_drake.runs.checks import compared_with_model
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.controller import Controller
from stewart_drake.scenario.scenario import Scenario, load_scenario

REACHY = {
    "plant": {"kind": "closed_form", "motor_friction": 0.0128, "motor_damping": 0.0037},
    "motors": {"kind": "position"},
    "controller": {"kind": "feedforward", "period": 0.02},
    "model.friction": {"coulomb": 0.0128, "viscous": 0.0037, "width": 0.004},
    **{"tuner": "fixed", "estimator": {"kind": "difference"}, "safety": None, "duration": 4.0},
}


def torque(servos, command, angles, rates, steps=1):
    part = servos.part(ROBOT, 0.001)
    state = part.initial.copy()
    for _ in range(steps):
        part.tick(command, np.concatenate([angles, rates]), state)
    return state["torque"][0]


@given(vectors(6, 0.3), vectors(6, 3.0), vectors(6, 3.0))
def test_the_torque_is_that_of_the_hand_formula(error, angles, rates):
    servos = PositionServos(stiffness=30.0, damping=0.2, resolution_bits=12, dead_band=0.01)
    count = 2.0 * np.pi / 4096.0
    rounded = count * (np.rint((angles + error) / count) - np.rint(angles / count))
    limited = np.clip(30.0 * np.where(np.abs(rounded) <= 0.01, 0.0, rounded), -ROBOT.effort_limits, ROBOT.effort_limits)
    made = np.clip(limited - 0.2 * rates, -ROBOT.effort_limits, ROBOT.effort_limits)
    np.testing.assert_allclose(torque(servos, angles + error, angles, rates), made, atol=1e-9)


def test_between_its_own_ticks_a_servo_holds_its_drive():
    part = PositionServos(stiffness=3.0, damping=0.0, period=0.004, resolution_bits=None).part(ROBOT, 0.001)
    state, made = part.initial.copy(), []
    for step in range(8):
        part.tick(np.full(6, 0.1 * step), np.zeros(12), state)
        made.append(state["torque"][0, 0])
    np.testing.assert_allclose(made, [0.0] * 4 + [3.0 * 0.4] * 4)


@given(vectors(6, 2.0))
def test_what_a_servo_is_told_gives_the_torque_that_is_wanted(wanted):
    apart = [1.1, 0.9, 1.0, 1.2, 0.8, 1.0]
    servos = PositionServos(stiffness=20.0, ratios=apart, damping=0.3, resolution_bits=None)
    np.testing.assert_allclose(torque(servos, np.full(6, 0.01), np.zeros(6), np.zeros(6)), 0.2 * np.array(apart))
    context = setup_for()
    (inverse,) = servos.inverse_parts(context)
    pose, rate = ROBOT.home_pose + [0.1, 0.0, 0.05, 0.0, 0.01, 0.0], np.zeros(6)
    state = inverse.initial.copy()
    inverse.tick(wanted, np.concatenate([pose, rate]), np.zeros(18), state)
    made = torque(servos, state["command"][0], inverse_kinematics(ROBOT, pose), np.zeros(6))
    np.testing.assert_allclose(made, np.clip(wanted, -ROBOT.effort_limits, ROBOT.effort_limits), atol=1e-9)


def test_a_supply_that_is_low_weakens_a_servo_and_slows_it():
    full, low = (PositionServos(preset="xl330_m288", damping=0.0, resolution_bits=None, supply=u) for u in (1.0, 0.8))
    bent, fast = np.full(6, 0.1), np.full(6, 9.0)
    np.testing.assert_allclose(torque(low, bent, np.zeros(6), np.zeros(6)), 0.08)
    np.testing.assert_allclose(torque(full, 20 * bent, np.zeros(6), fast), 0.52 * (1.0 - 9.0 / np.radians(618.0)))
    # Faster than without a load: it brakes.
    assert (torque(low, 20 * bent, np.zeros(6), fast) < 0.0).all()


@given(vectors(6, 0.2))
def test_play_lets_the_crank_go_until_it_is_crossed(error):
    servos = PositionServos(stiffness=10.0, damping=0.0, resolution_bits=None, backlash=0.1)
    made = torque(servos, error, np.zeros(6), np.zeros(6))
    wound = np.sign(error) * np.maximum(np.abs(error) - 0.05, 0.0)
    np.testing.assert_allclose(made, np.clip(10.0 * wound, -ROBOT.effort_limits, ROBOT.effort_limits), atol=1e-9)


def test_backlash_in_the_model_is_compensated():
    loose = {"kind": "position", "stiffness": 10.0, "damping": 0.4, "resolution_bits": None, "backlash": 0.03}
    motion = {"motors": loose}
    assert rmse(motion) < 0.5 * rmse({**motion, "model.motors": {**loose, "backlash": 0.0}})


def test_currents_give_torques_by_the_constant_rounded_and_within_their_limits():
    motors = CurrentMotors(torque_constant=0.5, current_limit=2.0, resolution=0.1, no_load_speed=10.0)
    part = motors.part(ROBOT, 0.001)
    state = part.initial.copy()
    part.tick(np.array([0.44, -0.46, 9.0, -9.0, 9.0, -9.0]), np.repeat([0.0, 5.0], [10, 2]), state)
    np.testing.assert_allclose(state["torque"][0], [0.2, -0.25, 1.0, -1.0, 0.5, -1.0])
    (inverse,) = motors.inverse_parts(setup_for())
    state = inverse.initial.copy()
    inverse.tick(np.full(6, 0.4), state)
    np.testing.assert_allclose(state["command"][0], 0.8)


def test_a_preset_sets_servo_and_friction_unless_they_are_given():
    text = {"robot": "reachy_mini", "motors": {"kind": "position", "preset": "xc330m288t", "damping": 0.01}}
    scenario = Scenario.from_dict(text)
    assert (scenario.motors.stiffness, scenario.motors.damping, scenario.motors.torque_limit) == (2.54, 0.01, 0.8)
    assert (scenario.plant.motor_friction, scenario.plant.motor_damping) == (0.058, 0.095)
    assert scenario.controller_model.friction.coulomb == (0.058,) * 6
    assert scenario.replace({"motors.preset": "xl330_m288"}).motors.stiffness == 1.0
    rough = scenario.replace({"plant.friction": {"coulomb": 0.2}, "model.friction": None})
    assert rough.plant.friction_options.coulomb == (0.2,) * 6
    assert rough.controller_model.friction is None
    assert Scenario.from_dict(scenario.to_dict()) == scenario
    believed = scenario.replace({"model.motors": {"kind": "position", "preset": "xl330_m288"}})
    assert believed.controller_model.friction.coulomb == (0.0128,) * 6
    assert believed.plant.motor_friction == 0.058


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_motor(name):
    preset = PRESETS[name]
    assert preset.about
    for kind in (PositionServos, CurrentMotors):
        if name in kind.presets.names:
            motors = kind(preset=name)
            assert {key: getattr(motors, key) for key in kind.presets[name]} == kind.presets[name]
            part = motors.part(load_robot("reachy_mini"), 0.001)
            part.tick(motors.initial_command(setup_for()), np.zeros(12), part.initial.copy())


PLAIN = {"kind": "position", "damping": 0}


def rmse(changes):
    log = run(load_scenario("reachy_nod").replace({**REACHY, **changes}), check=False)
    assert log.status == "completed"
    return np.degrees(np.sqrt(np.mean((log["pose"] - log["reference"])[log.time > 2.0, 1] ** 2)))


def test_a_nod_is_followed_where_the_angles_of_inverse_kinematics_lag():
    plain = {"controller.feedforward": "none", "model.friction": None, "model.motors": PLAIN}
    ours, owners = rmse({}), rmse(plain)
    assert ours < 0.1
    assert owners > 4.0
    # What the delay is believed to be counts: without preview of it the head is late.
    assert rmse({"motors.delay": 0.02}) < 0.1
    assert rmse({"motors.delay": 0.02, "model.motors": {"kind": "position"}}) > 0.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motors": {"kind": "position", "stiffness": 1e6}}, r"^motors\.stiffness: expected at most .* got 1000000"),
        ({"motors": {"kind": "position", "supply": 1e6}}, r"^motors\.supply: expected at most .* got 1000000"),
        ({"motors": {"kind": "position", "ratios": 1e6}}, r"^motors\.ratios: expected at most .* got \(1000000"),
        ({"motors": {"kind": "position", "damping": 100}}, r"^motors\.damping: expected at most .* got 100"),
        ({"motors": {"kind": "position", "delay": 1e9}}, r"^motors\.delay: expected .*at most 1"),
        ({"motors": {"kind": "position", "period": 0.0015}}, r"^motors\.period: expected a whole multiple"),
        ({"motors": {"kind": "position", "preset": "xl330"}}, r"^motors\.preset: expected .*did you mean xl330_m288\?"),
        ({"motors": {"kind": "current", "preset": "sts3215"}}, r"^motors\.preset: expected xl330_m288"),
    ],
)
def test_one_clear_line_for_what_cannot_be(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        run(Scenario.from_dict({"duration": 0.1, **changes}), check=False)


def test_a_controller_gives_angles_that_a_servo_takes():
    scenario = load_scenario("reachy_nod").replace(REACHY)
    controller, angles, out = Controller(scenario.control()), np.zeros(6), np.empty(6)
    robot = scenario.robot
    controller.step(inverse_kinematics(robot, robot.home_pose), 0.0, out)
    assert controller.unit == "rad"
    held = inverse_kinematics(robot, robot.home_pose) + static_torque(robot, robot.home_pose) / 1.0
    np.testing.assert_allclose(out, held, atol=0.02)
    again = Controller(scenario.control())
    again.step(angles, 0.0, angles)
    np.testing.assert_array_equal(angles, out)


def test_linearize_refuses_servos_and_controllers_without_feedback():
    with pytest.raises(ConfigurationError, match=r"^motors\.kind: expected motors that take torque"):
        linearize(load_scenario("reachy_nod").replace(REACHY))
    with pytest.raises(ConfigurationError, match=r"^controller\.kind: expected one with feedback"):
        linearize(load_scenario("reachy_nod").replace({**REACHY, "motors": "torque"}))


@pytest.mark.parametrize("motors", ["torque", {"kind": "position"}])
def test_without_feedback_no_reading_changes_a_command_whatever_estimates(motors):
    changes = {"duration": 0.1, "motors": motors, "estimator": {"kind": "observer"}}
    scenario = load_scenario("reachy_nod").replace({**REACHY, **changes})
    controller, out, commands = Controller(scenario), np.empty(6), []
    log = run(scenario.replace({"plant.payload_mass": 0.2}), check=False)
    for time in log.time:
        controller.step(np.full(6, np.nan), time, out)
        commands.append(out.copy())
    asked = "torque" if motors == "torque" else "commanded_angle"
    np.testing.assert_array_equal(log[asked], commands)


def test_the_log_has_the_angle_that_is_sent_and_the_torques_apart():
    log = run(load_scenario("reachy_nod").replace({**REACHY, "duration": 0.4}), check=False)
    angles = inverse_kinematics(log.scenario.robot, log["pose"][5])
    assert np.abs(log["commanded_angle"][5] - angles).max() < 0.1
    assert {"commanded_angle_0_rad", "torque_0_Nm", "torque_applied_0_Nm"} <= set(log.table().column_names)
    log = run(load_scenario("reachy_nod").replace({"duration": 0.1, "plant.kind": "closed_form"}), check=False)
    assert "commanded_angle" not in log.signals


def test_torques_at_their_limit_are_those_of_the_servos():
    # Angles of the inverse kinematics ask for no torque; it is the servo that cannot lift the head.
    weak = {"controller.feedforward": "none", "robot.effort_limit": 0.01, "limits.torque_fraction": None}
    log = run(load_scenario("reachy_nod").replace({**REACHY, "duration": 0.5, **weak}), check=False)
    at_limit = np.abs(log["torque_applied"]) >= 0.01
    assert 0.1 < run_metrics(log)["saturated_fraction"] == pytest.approx(at_limit.mean(), abs=0.02)


@pytest.mark.parametrize(("motors", "believed"), [("torque", "position"), ("position", "torque")])
def test_what_motors_take_must_be_believed(motors, believed):
    with pytest.raises(ConfigurationError, match=rf"^model\.motors\.kind: expected motors that take .*'{believed}'"):
        load_scenario("reachy_nod").replace({**REACHY, "motors": motors, "model.motors": {"kind": believed}})


def test_a_check_compares_servos_with_the_model():
    changes = {"model.motors": {"kind": "position", "stiffness": 1.3}}
    rows = compared_with_model(load_scenario("reachy_nod").replace({**REACHY, **changes}))
    assert ("motors", "position", "position") in rows
    assert ("motors.stiffness", "1 N m/rad", "1.3 N m/rad") in rows


def test_gains_allow_for_a_delay_in_the_motors():
    def gain(**keys):
        return Scenario.from_dict({"controller": {"kind": "pid", "period": 0.002}, **keys}).controller.kp

    late = {"kind": "position", "delay": 0.018}
    assert gain(motors=late) == pytest.approx(gain(command_delay=9))
    assert gain(motors="position", model={"motors": late}) == pytest.approx(gain(command_delay=9))


def test_a_log_of_servos_does_not_identify_by_torques():
    log = run(load_scenario("reachy_nod").replace({**REACHY, "duration": 0.2}), check=False)
    with pytest.raises(ConfigurationError, match=r"^log: expected a log of motors that take torque"):
        recording_of_log(log)


def test_how_rough_a_run_is_shows_in_the_torque_that_servos_give():
    log = run(load_scenario("reachy_nod").replace({**REACHY, "controller.feedforward": "none", "duration": 1.0}))
    made = np.diff(log["torque_applied"][log.second_half], axis=0)
    assert run_metrics(log)["torque_change_rms"] == pytest.approx(np.sqrt(np.mean(made**2)))


def test_a_plot_labels_the_torque_of_servos_as_that_of_the_model():
    log = run(load_scenario("reachy_nod").replace({**REACHY, "duration": 0.2}), check=False)
    labels = {line.get_label() for axis in plot_torques(log).axes for line in axis.lines}
    assert "torque that the model asks for" in labels
    assert "commanded" not in labels
