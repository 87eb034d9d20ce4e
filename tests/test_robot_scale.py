import numpy as np
import pytest

from stewart_drake.control.classical import PidOptions
from stewart_drake.control.lqi import lqi_gain
from stewart_drake.control.riccati import POSITION
from stewart_drake.control.tuners import BlockTuner
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.planning.limits import Bounds, Limits
from stewart_drake.references import HoldReference, SineReference
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.safety import SafetyOptions
from stewart_drake.scenario import Scenario

PAPER, HEXAPOD = RobotParameters(), load_robot("servo_hexapod")
ALL = {"safety": {}, "tuner": {"kind": "block"}, "sensors": {"kind": "encoders"}}


def test_the_papers_robot_has_the_defaults_of_the_classes_to_the_last_bit():
    for scenario in (Scenario.from_dict(ALL), Scenario(robot="paper", **ALL), Scenario(robot=PAPER, **ALL)):
        assert scenario.reference == SineReference()
        assert (scenario.limits, scenario.bounds, scenario.safety) == (Limits(), Bounds(), SafetyOptions())
        assert (scenario.tuner, scenario.sensors) == (BlockTuner(), EncoderOptions())
    assert Scenario(controller={"kind": "pid"}).controller == PidOptions()


def test_another_robot_has_lengths_torques_and_home_of_its_own():
    scenario = Scenario(robot=HEXAPOD, **ALL)
    length, torque = 0.065 / 0.11, 1.5 / 5.0
    assert scenario.limits.clearance == pytest.approx(0.005 * length)
    assert scenario.bounds.position == pytest.approx(0.03 * length)
    assert scenario.safety.workspace == pytest.approx((1.2, 0.12 * length))
    assert scenario.safety.torque_rate == pytest.approx(4000.0 * torque)
    assert scenario.sensors.max_step == pytest.approx((0.2, 0.05 * length))
    assert scenario.reference.center == (0.0, 0.0, 0.0, 0.0, 0.0, 0.151)
    assert scenario.reference.amplitude[5] == pytest.approx(0.05 * length)
    assert scenario.limits.crank_speed == Limits().crank_speed


def test_what_is_given_stays_and_what_is_off_stays_off():
    given = {
        "limits": {"clearance": 0.005},
        "safety": {"workspace": None},
        "reference": {"kind": "hold", "pose": [0] * 6},
    }
    scenario = Scenario(robot=HEXAPOD, **given)
    assert (scenario.limits.clearance, scenario.safety.workspace) == (0.005, None)
    assert scenario.reference.pose == (0.0,) * 6
    assert scenario.replace({"duration": 1.0}).limits.clearance == 0.005
    assert Scenario.from_dict(scenario.to_dict()) == scenario


def test_a_motion_made_in_python_or_inside_a_sum_stands_about_the_robots_home():
    home = (0.0, 0.0, 0.0, 0.0, 0.0, 0.151)
    assert Scenario(robot=HEXAPOD, reference=HoldReference()).reference.pose == home
    parts = [{"kind": "breathing"}, {"kind": "heartbeat"}]
    summed = Scenario(robot=HEXAPOD, reference={"kind": "sum", "parts": parts}).reference
    assert [part.center for part in summed.parts] == [home, home]


def test_another_robot_in_place_of_the_first_takes_its_own_defaults_along():
    scenario = Scenario(robot="reachy_mini", controller={"weight_length": None}, **ALL)
    assert scenario.replace({"robot": "paper"}) == Scenario(controller={"weight_length": 0.11}, **ALL)
    changed = scenario.replace({"robot": HEXAPOD, "limits.crank_speed": 3.0})
    assert changed.limits == Limits(clearance=0.005 * (0.065 / 0.11), crank_speed=3.0)
    assert changed.controller.weight_length == 0.065
    # What the controller believes in sizes the controller.
    scenario = Scenario(robot=PAPER, model_robot=PAPER.replace(platform_mass=2.0), **ALL)
    assert scenario.tuner.q_pose > 4.0e5
    assert scenario.limits == Limits()


@pytest.mark.parametrize("name", ["paper", "reachy_mini", "servo_hexapod"])
def test_default_block_weights_make_every_robots_loop_as_fast(name):
    robot = load_robot(name)
    scenario = Scenario(robot=robot, tuner={"kind": "block"}, controller={"weight_length": None, "period": 0.001})
    options, weights = scenario.controller, np.array(scenario.tuner.weights)
    response = pose_acceleration_map(robot, robot.home_pose)
    feedback = response @ lqi_gain(response, options, weights)
    # The closed loop of each direction is s^2 + c s + k = 0 but for the slow integral; these are the k.
    speed = np.sqrt(np.abs(np.linalg.eigvals(feedback[:, POSITION])))
    assert np.exp(np.mean(np.log(speed))) == pytest.approx(93.0, rel=0.25)
