import numpy as np
import pytest
from strategies import ROBOT
from ticks import REST, ticked

from stewart_drake.control.base import Setpoint
from stewart_drake.control.user_controller import function_part
from stewart_drake.errors import NotFiniteError
from stewart_drake.files.user_errors import ControllerError
from stewart_drake.part import guarded

POSE, RATE = ROBOT.home_pose + 0.01, np.full(6, 0.2)
SETPOINT = Setpoint(ROBOT.home_pose, np.full(6, 0.1), np.full(6, 3.0))
NOW = np.array([0.25])


def spring(measurement, setpoint, time):
    measurement.pose[:] -= setpoint.pose
    return -measurement.pose - measurement.pose_rate + setpoint.pose_rate + setpoint.pose_acceleration + time


class Counting:
    """Called likewise, with a memory."""

    def __init__(self):
        self.ticks = 0

    def __call__(self, *_):
        self.ticks += 1
        return [self.ticks] * 6


def test_a_function_gets_what_it_asks_for_and_what_it_changes_is_its_own():
    state = ticked(function_part(spring), POSE, RATE, SETPOINT, NOW)
    np.testing.assert_allclose(state.torque, -0.01 - 0.2 + 0.1 + 3.0 + 0.25)
    np.testing.assert_allclose(state.error, 0.01)
    np.testing.assert_array_equal(state.integral, REST)
    counting = function_part(Counting())
    assert [ticked(counting, POSE, RATE, SETPOINT, NOW).torque[0] for _ in range(3)] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("answer", "kind", "words"),
    [
        (None, ControllerError, "returned None"),
        ("much", ControllerError, "'much'; expected six torques"),
        (np.zeros(5), ControllerError, r"shape \(5,\); expected six torques"),
        (np.zeros((6, 1)), ControllerError, r"shape \(6, 1\)"),
        ([0.0, np.nan, 0.0, 0.0, 0.0, 0.0], NotFiniteError, "torque of .*lambda.* is not finite"),
    ],
    ids=str,
)
def test_what_is_no_torque_ends_the_run_with_a_line(answer, kind, words):
    with pytest.raises(kind, match=words):
        ticked(function_part(lambda *_: answer), POSE, RATE, SETPOINT, NOW)


def test_what_it_raises_is_shown_with_its_line_and_can_be_bridged():
    part = function_part(lambda measurement, *_: measurement.nothing)
    with pytest.raises(
        ControllerError, match=r"user's code raised AttributeError.*test_function_part.py, line"
    ) as caught:
        ticked(part, POSE, RATE, SETPOINT, NOW)
    assert caught.value.reason == "controller_raised"
    state = ticked(guarded(part), POSE, RATE, SETPOINT, NOW, torque=np.ones(6))
    np.testing.assert_array_equal(state.torque, np.ones(6))
    assert state.health[0] > 0.0
