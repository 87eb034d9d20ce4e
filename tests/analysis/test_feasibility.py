import math

import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake import ConfigurationError, ReferenceLimits, SineReference, check_reference, paper_reference
from stewart_drake.analysis.feasibility import check_motion, largest_amplitude, refuse_turns

ALL = ReferenceLimits()
NONE = ReferenceLimits(**dict.fromkeys(ReferenceLimits.__pydantic_fields__))
GRAVITY = 9.81
AXES = np.eye(6)
HOME = tuple(ROBOT.home_pose)


def only(**limits):
    """Limits of which all but these are off."""
    return NONE.replace(**limits)


def sine(axis, amplitude, frequency_hz, center=HOME):
    return SineReference(
        center=center, amplitude=tuple(amplitude * AXES[axis]), angular_frequency=(2.0 * math.pi * frequency_hz,) * 6
    )


def test_the_papers_reference_keeps_to_what_the_geometry_promises():
    report = check_reference(ROBOT, ALL, paper_reference(), math.pi, GRAVITY)
    smallest = report.smallest
    report.raise_if_infeasible()
    assert report.first_violation is None
    assert min(margin.margin for margin in smallest.values()) > 0.0
    assert smallest["clearance"].margin + ALL.clearance + 2.0 * ROBOT.link_radius >= 0.030
    assert smallest["transmission"].margin + ALL.transmission >= 0.41
    # 0.27759, written 0.278 in the description of the geometry.
    assert smallest["conditioning"].margin + ALL.conditioning == pytest.approx(0.278, abs=5e-4)
    # Roll and heave are largest together, at sin(2 t) = 1; the universal joint of one leg then swings most.
    swing = smallest["joint_swing"]
    assert (swing.leg, swing.where) == (2, "universal joint of leg 2")
    assert swing.time == pytest.approx(math.pi / 4.0, abs=2e-3)


def test_the_earliest_violation_wins_and_of_simultaneous_ones_the_first_in_order():
    poses, rates = np.tile(ROBOT.home_pose, (4, 1)), np.zeros((4, 6))
    poses[1, 4], poses[2, 1], rates[3, 5] = 0.19, 1.49, 5.0

    def first(**limits):
        motion = poses, rates, 0.0 * poses
        found = check_motion(ROBOT, only(**limits), [0.0, 0.1, 0.2, 0.3], *motion, GRAVITY).first_violation
        return found.limit, found.time

    assert first(crank_speed=10.0) == ("crank_speed", 0.3)
    assert first(transmission=0.5, crank_speed=10.0, euler_pitch=1.4) == ("transmission", 0.1)
    assert first(transmission=0.5, reach=0.7) == ("reach", 0.1)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize(
    ("limits", "frequency"),
    [
        (only(torque_fraction=0.2), 4.0),
        pytest.param(ALL, 1.0, marks=pytest.mark.slow),
        pytest.param(ALL, 5.0, marks=pytest.mark.slow),
    ],
)
def test_the_largest_amplitude_is_feasible_and_a_little_more_is_not(limits, frequency, axis):
    amplitude = largest_amplitude(ROBOT, limits, axis, frequency, GRAVITY)

    def feasible(factor):
        reference = sine(axis, factor * amplitude, frequency)
        return check_reference(ROBOT, limits, reference, 1.0 / frequency, GRAVITY, 1000.0 * frequency).feasible

    assert all(feasible(factor) for factor in (0.1, 0.5, 0.9, 0.9995))
    # A turn ends at pi.
    assert amplitude == math.pi or not feasible(1.001)


def test_half_a_turn_is_a_pose_and_more_is_refused_with_what_was_meant():
    pose, time = np.zeros((2, 6)), np.array([0.0, 0.5])
    pose[1, 2] = -math.pi
    refuse_turns("reference", pose, time)
    pose[1, 2] = 3.2
    with pytest.raises(ConfigurationError, match=r"^reference: .*half a turn .*-3\.083 is the same orientation"):
        refuse_turns("reference", pose, time)
    pose[1, 2] = 15.0
    with pytest.raises(ConfigurationError, match=r"did you mean 15 deg\?"):
        refuse_turns("reference", pose, time)
