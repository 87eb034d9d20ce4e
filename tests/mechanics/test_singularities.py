import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from strategies import ROBOT, robots_and_poses, vectors

from stewart_drake.base.jit import njit
from stewart_drake.base.records import record
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry, pose_rate_to_twist, reach_margin, rod_lines
from stewart_drake.mechanics.kinematics_laws import QUICK, Legs, robot_record
from stewart_drake.mechanics.singularities import CONTROLLED, MONITORED, PLANNED, WEIGHT_TRUSTED, measure_pose
from stewart_drake.safety import SafetyOptions
from stewart_drake.safety.limits import Observed
from stewart_drake.scenario.limits import ReferenceLimits


@njit
def _measure(robot, pose, twist, enough, legs, out):
    return measure_pose(record(robot), pose, twist, QUICK, enough, record(legs), np.empty((6, 1)), record(out))


def measured(robot, pose, twist, enough=np.inf):
    out = np.full((1, Observed.layout.itemsize // 8), np.nan).view(Observed.layout)[0]
    return _measure(robot_record(robot), pose, twist, enough, Legs.empty(), out), out[0]


def test_a_motion_is_planned_further_away_than_it_is_stopped_and_stopped_further_away_than_a_controller_fails():
    assert (ReferenceLimits().transmission, ReferenceLimits().conditioning) == PLANNED
    assert (SafetyOptions().transmission, SafetyOptions().conditioning) == MONITORED
    for further, nearer in ((PLANNED, MONITORED), (MONITORED, WEIGHT_TRUSTED), (MONITORED, CONTROLLED)):
        assert all(np.greater(further, nearer))


@given(at=robots_and_poses(), rate=vectors(6))
def test_measures_of_a_pose_are_what_kinematics_gives_for_each(at, rate):
    robot, pose = at
    spans, found = measured(robot, pose, pose_rate_to_twist(pose, rate))
    legs = leg_geometry(robot, pose)
    assert spans
    np.testing.assert_array_equal(found["reach_margin"], reach_margin(robot, pose))
    np.testing.assert_array_equal(found["transmission"], np.abs(legs.transmission))
    np.testing.assert_allclose(found["speed"], crank_rates(robot, legs, pose, rate), rtol=1e-9, atol=1e-9)
    lines = rod_lines(legs)
    assert found["assembly_sign"] == np.sign(np.linalg.det(lines))
    sigma = np.linalg.svd(lines / ([robot.characteristic_length] * 3 + [1.0] * 3), compute_uv=False)
    np.testing.assert_allclose(found["conditioning"], sigma[-1] / sigma[0], rtol=1e-6)


@given(at=robots_and_poses(), enough=st.floats(1e-3, 1.0))
def test_the_conditioning_is_what_it_is_or_a_lower_bound_that_is_enough(at, enough):
    (_, exact), (_, found) = (measured(*at, np.zeros(6), least) for least in (np.inf, enough))
    exact, found = exact["conditioning"], found["conditioning"]
    assert found == exact or enough <= found < exact
    # The bound is by the norms of Frobenius, each at most sqrt(6) times too large.
    assert found < exact or exact < 6.001 * enough
    assert found >= exact / 6.001


def test_a_leg_out_of_reach_transmits_nothing_and_the_others_what_they_do():
    pose = ROBOT.home_pose + [0.3, 0.0, 0.0, 0.0, 0.0, 0.1]
    spans, found = measured(ROBOT, pose, np.zeros(6))
    beyond = reach_margin(ROBOT, pose) < 0.0
    assert not spans
    assert 0 < beyond.sum() < 6
    np.testing.assert_array_equal(found["transmission"] == 0.0, beyond)
    assert np.isnan(found["conditioning"])
