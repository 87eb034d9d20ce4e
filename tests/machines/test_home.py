"""A machine whose zeros are not the model's, `model.home`."""

import re

import numpy as np
import pytest

from stewart_drake import ConfigurationError, inverse_kinematics
from stewart_drake.machines.machine import Homed, Reading, command_limits, open_machine
from stewart_drake.machines.simulated import SimulatedRobot
from stewart_drake.runs.drive import connected, measured_home
from stewart_drake.scenario.scenario import load_driven

HOME = [0.3, -0.2, 0.1, 0.05, -0.4, 0.6]
PLAIN = load_driven("reachy_servos")
SCENARIO = PLAIN.replace({"model.home": HOME})
ROBOT = SCENARIO.controller_model.robot
ANGLES = inverse_kinematics(ROBOT, ROBOT.home_pose)


class Own:
    period, takes, reads, paced = 0.02, "angle", True, True

    def __init__(self):
        self.own, self.told = ANGLES - HOME, []

    def connect(self):
        pass

    def read(self):
        return Reading(self.own.copy(), 0.0, 0.0, 1, arrived=self.told[-1] if self.told else None)

    def command(self, values):
        self.told.append(values)


def test_angles_are_the_models_and_commands_the_machines():
    own = Own()
    machine = Homed(own, HOME)
    np.testing.assert_allclose(machine.read().angles, ANGLES)
    machine.command(ANGLES)
    np.testing.assert_allclose(own.told, [ANGLES - HOME])
    np.testing.assert_allclose(machine.read().arrived, ANGLES)
    assert (machine.period, machine.takes) == (0.02, "angle")
    np.testing.assert_allclose(connected(SCENARIO, machine, 1.0).pose, ROBOT.home_pose, atol=1e-9)
    own.takes = "torque"
    machine.command(ANGLES)
    np.testing.assert_array_equal(own.told[-1], ANGLES)


def test_stops_move_with_the_zero():
    np.testing.assert_allclose(command_limits(SCENARIO), command_limits(PLAIN) - HOME)


def test_it_is_measured_in_the_home_pose():
    np.testing.assert_allclose(measured_home(ROBOT, ANGLES - HOME, np.zeros(6)), HOME, atol=1e-4)
    np.testing.assert_allclose(measured_home(ROBOT, ANGLES, HOME), HOME, atol=1e-4)
    wrong = Own()
    wrong.own = wrong.own + [2.0, 0, 0, 0, 0, 0]
    with pytest.raises(ConfigurationError) as raised:
        connected(PLAIN, wrong, 1.0)
    given = re.search(r"in its home pose its model\.home is \[(.*)\]", str(raised.value))[1]
    np.testing.assert_allclose(
        [float(each) for each in given.split(",")], np.array(HOME) - [2.0, 0, 0, 0, 0, 0], atol=1e-4
    )


def test_a_servo_that_woke_up_a_turn_on_is_refused_with_the_home_that_takes_the_turn_off():
    hobby = load_driven("hobby_servos")
    home, turned = inverse_kinematics(hobby.controller_model.robot, hobby.controller_model.robot.home_pose), Own()
    turned.own = home + [0.0, 0.0, 2.0 * np.pi, 0.0, -4.0 * np.pi, 0.0]
    with pytest.raises(ConfigurationError, match=r"angle of leg 4.*-2 turns") as raised:
        connected(hobby, turned, 1.0)
    given = [float(each) for each in re.search(r"model\.home=\[(.*?)\]", str(raised.value))[1].split(",")]
    start = connected(hobby.replace({"model.home": given}), Homed(turned, given), 1.0)
    np.testing.assert_allclose(start.angles, home, atol=1e-4)
    assert turned.told == []


def test_gains_of_servos_ride_along():
    gains = np.array([1.05, 0.95, 1.04, 0.96, 1.0, 1.02])
    legs = [{**leg, "servo_gain": gain} for leg, gain in zip(ROBOT.each_leg(), gains.tolist(), strict=True)]
    turning = SCENARIO.replace({"robot.legs": legs, "model.robot.legs": legs})
    own = Own()
    own.own = (ANGLES - HOME) / gains
    machine = Homed(own, HOME, gains)
    np.testing.assert_allclose(machine.read().angles, ANGLES)
    machine.command(ANGLES)
    np.testing.assert_allclose(own.told[-1], own.own)
    np.testing.assert_allclose(command_limits(turning), command_limits(SCENARIO) / gains)
    robot = SimulatedRobot(turning)
    np.testing.assert_allclose(robot.reading(), own.own, atol=2e-3)
    robot.follow(own.own)
    np.testing.assert_allclose(robot.command, ANGLES)


def test_a_simulated_servo_turns_by_its_own_gain_whatever_the_model_believes():
    gains = np.array([1.05, 0.95, 1.04, 0.96, 1.0, 1.02])
    legs = [{**leg, "servo_gain": gain} for leg, gain in zip(ROBOT.each_leg(), gains.tolist(), strict=True)]
    robot = SimulatedRobot(PLAIN.replace({"robot.legs": legs, "model.robot.legs": ROBOT.each_leg()}))
    np.testing.assert_allclose(robot.reading(), ANGLES / gains, atol=2e-3)
    robot.follow(ANGLES / gains)
    for _ in range(100):  # The delay of the commands.
        robot.advance(False)
    np.testing.assert_allclose(robot._loop.runner.signal("turned_command"), ANGLES)


def test_a_simulated_machine_has_the_same_zero():
    robot = SimulatedRobot(SCENARIO)
    np.testing.assert_allclose(robot.reading(), ANGLES - HOME, atol=2e-3)
    robot.follow(ANGLES - HOME)
    np.testing.assert_allclose(robot.command, ANGLES)
    assert isinstance(open_machine("sim:", SCENARIO), Homed)
    assert not isinstance(open_machine("sim:", PLAIN), Homed)
