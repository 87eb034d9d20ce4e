"""Motors as kinds: the effort limit, and the seam for motors whose command is not a torque."""

from typing import Literal

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Controller, load_scenario, run
from stewart_drake.base.config import Positive
from stewart_drake.base.registry import MOTORS
from stewart_drake.hardware.motors import Command, MotorOptions, Torque, within_limit
from stewart_drake.loop.part import Part

LIMIT = 0.6


def test_a_torque_is_cut_to_its_motors_limit_and_no_number_stays_none():
    limit = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    given = np.array([1.5, -2.5, np.inf, -np.inf, np.nan, 0.1])
    np.testing.assert_array_equal(within_limit(given, limit), [1.0, -2.0, 3.0, -4.0, np.nan, 0.1])
    np.testing.assert_array_equal(within_limit(np.tile(given, (2, 1)), limit)[1], within_limit(given, limit))


@pytest.mark.parametrize("motors", [{}, {"ripple": 1e-3}], ids=["perfect", "ripple"])
@pytest.mark.parametrize("kind", ["drake", "closed_form"])
def test_motors_give_no_more_than_their_limit_on_every_plant(kind, motors):
    """A controller that asks for ten times more than there is; what is logged is what moves the robot."""
    asked = np.array([6.0, -6.0, 0.1, 0.1, 0.1, 0.1])
    changes = {"plant": kind, "motors": motors, "controller": lambda *_: asked, "duration": 0.02}
    scenario = load_scenario("exact_fig7").replace({**changes, "robot.effort_limit": LIMIT})
    log = run(scenario, check=False)
    np.testing.assert_array_equal(log["torque"], np.tile(asked, (len(log.time), 1)))
    np.testing.assert_array_equal(log["torque_applied"][:, :2], np.tile([LIMIT, -LIMIT], (len(log.time), 1)))
    np.testing.assert_allclose(log["torque_applied"][:, 2:], 0.1, atol=1e-3)
    if not motors:
        # Asked for the limit itself, the robot does the same.
        same = run(scenario.replace(controller=lambda *_: np.clip(asked, -LIMIT, LIMIT)), check=False)
        np.testing.assert_array_equal(log["pose"], same["pose"])


class DrivenMotors(MotorOptions):
    """Motors that take voltages."""

    command_quantity, unit = "voltage", "V"

    kind: Literal["driven"] = "driven"
    constant: Positive = 0.25
    """[N m/V]"""

    def part(self, robot, time_step):
        constants = {"constant": self.constant, "limit": robot.effort_limits}
        return Part("motors", turn, constants, {"command": 6}, ("torque",), Torque.new(), period=time_step)

    def inverse_parts(self, context):  # noqa: ARG002
        return (Part("voltages", ask, {"constant": self.constant}, {"torque": 6}, ("command",), Command.new()),)

    def initial_command(self, context):
        return context.initial_torque / self.constant


def turn(constant, limit, command, state):
    state["torque"][0] = within_limit(constant * command, limit)


def ask(constant, torque, state):
    state["command"][0] = torque / constant


@pytest.fixture
def driven(monkeypatch):
    monkeypatch.setattr(MOTORS, "_lines", dict(MOTORS._lines))
    MOTORS.add(DrivenMotors)


@pytest.mark.usefixtures("driven")
@pytest.mark.parametrize("kind", ["drake", "closed_form"])
@pytest.mark.parametrize("controller", ["lqi", "pid", "computed_torque"])
def test_a_controller_runs_on_motors_that_take_voltages_as_on_those_that_take_torques(controller, kind):
    changes = {"plant.kind": kind, "controller.kind": controller, "command_delay": 2, "duration": 0.05}
    changes |= {"sensors": "encoders", "estimator": "observer"}
    torque = load_scenario("exact_heart").replace(changes)
    # A power of two scales without rounding.
    log, by_torque = run(torque.replace(motors="driven")), run(torque)
    np.testing.assert_array_equal(log["pose"], by_torque["pose"])
    np.testing.assert_array_equal(log["torque"], by_torque["torque"])
    np.testing.assert_array_equal(log["torque_applied"][2:], log["torque"][:-2])
    mine, out = Controller(torque.replace(motors="driven")), np.empty(6)
    mine.step(log["crank_angle"][0], 0.0, out)
    np.testing.assert_array_equal(out, mine.signal("torque") / 0.25)


@pytest.mark.usefixtures("driven")
def test_a_safety_layer_looks_at_torques():
    with pytest.raises(ConfigurationError, match=r"motors.kind: .*, got 'driven'; these take voltage \[V\]"):
        run(load_scenario("exact_fig7").replace({"motors": "driven", "safety": {}}))
