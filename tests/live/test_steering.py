"""What the sliders ask for becomes a smooth reference within the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.live.start import _room
from stewart_drake.live.steering import CRANK_SPEED, REACH, HandReference, SmoothValue, nearest_allowed
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import inverse_kinematics
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
    value = SmoothValue(np.array([start]))
    value.target[0] = end
    path = np.array([value.after(steps * STEP)[0, 0] for steps in range(0, 4000, 50)])
    low, high = sorted((start, end))
    assert path.min() >= low - 1e-9
    assert path.max() <= high + 1e-9
    assert path[-1] == pytest.approx(end, abs=1e-6)


def test_rates_of_the_reference_are_right_while_hand_and_motion_move() -> None:
    reference = HandReference(SineReference())
    reference.hand.target[:] = HOME + [0.1, 0.0, 0.0, 0.01, 0.0, 0.0]
    reference.share.target[0] = 0.0
    rows = []
    for k in range(400):
        reference.advance(k * STEP)
        rows.append(reference.at(k * STEP))
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
    reference = HandReference(SineReference())
    around = reference.excursions(6.0)
    wanted = HOME + [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
    alone = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, ALONE)
    moving = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, around)
    assert moving.pose[5] < alone.pose[5]
    assert all(_margin(moving.pose + each) >= 0.0 for each in around)
    reference.share.target[0] = 0.0
    np.testing.assert_array_equal(reference.excursions(6.0), ALONE)


def test_the_motion_about_the_hand_is_known_by_its_peaks() -> None:
    # A sine that is zero at each of 24 times in 6 s.
    reference = HandReference(SineReference(angular_frequency=(np.pi * 23.0 / 6.0,) * 6))
    around = reference.excursions(6.0)
    np.testing.assert_allclose(np.abs(around).max(axis=0), SineReference().amplitude, rtol=1e-4)


def test_whole_turns_are_no_way_around_a_limit() -> None:
    wanted = HOME + [0.0, 0.0, 48.0 * np.pi, 0.0, 0.0, 0.0]
    reached = nearest_allowed(ROBOT, ReferenceLimits(), HOME, wanted, STANDARD_GRAVITY, ALONE)
    assert reached.limit
    assert reached.pose[2] < 2.0
    reference = HandReference(SineReference())
    with pytest.raises(ConfigurationError, match=r"pose: expected a pose within 1 rad and 0\.5 m of"):
        reference.aim(Scenario(), wanted)
    np.testing.assert_array_equal(reference.goal, HOME)


@pytest.mark.parametrize(("axis", "sign"), [(0, 1.0), (2, -1.0), (5, 1.0)])
def test_a_hand_moves_no_crank_faster_than_it_may_and_arrives(axis: int, sign: float) -> None:
    scenario, step = Scenario(), 0.02
    reference = HandReference(SineReference())
    reference.share.target[0] = reference.share.state[0, 0] = 0.0
    rows, now = [], 0.0
    for end in (sign, -sign):
        goal = reference.aim(scenario, HOME + end * REACH * np.eye(6)[axis]).pose
        for _ in range(150):
            reference.govern(scenario, now)
            reference.advance(now := now + step)
            rows.append(reference.hand.state[0])
        np.testing.assert_allclose(rows[-1], goal, atol=1e-3)
    assert min(map(_margin, rows)) >= -1e-3
    speeds = np.abs(np.diff(inverse_kinematics(ROBOT, np.array(rows)), axis=0)) / step
    assert 0.9 * CRANK_SPEED < speeds.max() < 1.01 * CRANK_SPEED


def test_sliders_go_as_far_as_each_axis_alone_can() -> None:
    room = _room(Scenario(), HOME)
    for axis in range(6):
        ends = [HOME + sign * room[axis] * np.eye(6)[axis] for sign in (1.0, -1.0)]
        beyond = [HOME + sign * (room[axis] + 2e-3) * np.eye(6)[axis] for sign in (1.0, -1.0)]
        assert max(map(_margin, ends)) >= 0.0
        assert room[axis] == REACH[axis] or not max(map(_margin, beyond)) >= 0.0
