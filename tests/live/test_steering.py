"""What the sliders ask for becomes a smooth reference within the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.live.start import _FARTHEST, _room
from stewart_drake.live.steering import HandReference, SmoothValue, nearest_allowed
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.references import SineReference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.limits import ReferenceLimits, limit_margins
from stewart_drake.scenario.scenario import Scenario

STEP = 1e-3
ROBOT = RobotParameters()
HOME = np.array(ROBOT.home_pose)
ALONE = np.zeros((1, 6))


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_smooth_value_reaches_its_target_without_overshoot(start: float, end: float) -> None:
    value = SmoothValue(np.array([start]), STEP)
    value.target[0] = end
    path = np.array([value.after(steps)[0, 0] for steps in range(0, 4000, 50)])
    low, high = sorted((start, end))
    assert path.min() >= low - 1e-9
    assert path.max() <= high + 1e-9
    assert path[-1] == pytest.approx(end, abs=1e-6)


def test_the_reference_tells_its_own_rates_while_hand_and_motion_move() -> None:
    reference = HandReference(SineReference(), STEP)
    reference.hand.target[:] = HOME + [0.1, 0.0, 0.0, 0.01, 0.0, 0.0]
    reference.share.target[0] = 0.0
    rows = []
    for k in range(400):
        rows.append(reference.at(k * STEP))
        reference.advance()
    rows = np.array(rows)
    np.testing.assert_allclose(np.gradient(rows[:, :6], STEP, axis=0)[2:-2], rows[2:-2, 6:12], atol=1e-4)
    np.testing.assert_allclose(np.gradient(rows[:, 6:12], STEP, axis=0)[2:-2], rows[2:-2, 12:], atol=1e-2)


def _margin(pose: np.ndarray) -> float:
    still = np.zeros((1, 6))
    margins = limit_margins(ROBOT, ReferenceLimits(), pose[None], still, still, STANDARD_GRAVITY)
    return min(float(values.min()) for values in margins.values())


def test_a_pose_that_is_allowed_is_taken_as_it_is() -> None:
    wanted = HOME + [0.1, 0.0, 0.0, 0.0, 0.01, 0.0]
    reached = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, ALONE)
    np.testing.assert_array_equal(reached.pose, wanted)
    assert reached.limit == ""


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pose_beyond_a_limit_ends_just_before_it_with_its_name(axis: int, sign: float) -> None:
    wanted = HOME.copy()
    wanted[axis] += sign * (1.5 if axis < 3 else 0.6)
    reached = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, ALONE)
    assert reached.limit
    assert _margin(reached.pose) >= 0.0
    assert not _margin(reached.pose + 1e-3 * (wanted - HOME)) >= 0.0


def test_the_motion_about_the_hand_stays_within_the_limits() -> None:
    reference = HandReference(SineReference(), STEP)
    around = reference.excursions(6.0)
    wanted = HOME + [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
    alone = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, ALONE)
    moving = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, around)
    assert moving.pose[5] < alone.pose[5]
    assert all(_margin(moving.pose + each) >= 0.0 for each in around)
    reference.share.target[0] = 0.0
    np.testing.assert_array_equal(reference.excursions(6.0), ALONE)


def test_sliders_go_as_far_as_each_axis_alone_can() -> None:
    room = _room(Scenario(), HOME)
    for axis in range(6):
        ends = [HOME + sign * room[axis] * np.eye(6)[axis] for sign in (1.0, -1.0)]
        beyond = [HOME + sign * (room[axis] + 2e-3) * np.eye(6)[axis] for sign in (1.0, -1.0)]
        assert max(map(_margin, ends)) >= 0.0
        assert room[axis] == _FARTHEST[axis] or not max(map(_margin, beyond)) >= 0.0
