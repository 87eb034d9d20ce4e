import dataclasses
import math

import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake.errors import InfeasibleReferenceError
from stewart_drake.planning.feasibility import (
    check_motion,
    check_reference,
    largest_amplitude,
    largest_scale,
)
from stewart_drake.planning.limits import Limits
from stewart_drake.references import HoldReference, SineReference, paper_reference

ALL = Limits()
NONE = Limits(**{field.name: None for field in dataclasses.fields(Limits)})
GRAVITY = 9.81
AXES = np.eye(6)
HOME = tuple(ROBOT.home_pose)
REACH_MM = {"X": (-218, 203), "Y": (-201, 201), "Z": (-108, 121)}
TURN_DEG = {"roll": (-70, 70), "pitch": (-62, 85), "yaw": (-83, 83)}


def only(**limits):
    """Limits of which all but these are off."""
    return dataclasses.replace(NONE, **limits)


def at_rest(poses, limits=ALL):
    poses = np.atleast_2d(poses)
    return check_motion(ROBOT, limits, np.arange(len(poses)), poses, 0.0 * poses, 0.0 * poses, GRAVITY)


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


@pytest.mark.parametrize(("name", "axis"), [(n, i) for i, n in enumerate([*TURN_DEG, *REACH_MM])])
def test_the_range_at_rest_ends_where_the_geometry_says(name, axis):
    low, high = (TURN_DEG | REACH_MM)[name]
    unit = math.radians(1.0) if axis < 3 else 1e-3
    limits = only(conditioning=0.05, transmission=0.2)
    for end, inwards in ((low, 1.0), (high, -1.0)):
        inside = np.linspace(0.0, end + inwards, 200)[:, None] * unit * AXES[axis]
        assert at_rest(ROBOT.home_pose + inside, limits).feasible
        assert not at_rest(ROBOT.home_pose + (end - inwards) * unit * AXES[axis], limits).feasible


def test_out_of_reach_breaks_reach_whatever_the_limits_and_leaves_out_what_cannot_be_judged():
    for limits, known, bound in ((ALL, ["reach", "euler_pitch"], 0.98), (NONE, ["reach"], 1.0)):
        report = at_rest([[0, 0, 0, 0, 0, 0.6]], limits)
        assert list(report.smallest) == known
        assert (report.first_violation.limit, report.first_violation.bound) == ("reach", bound)
    # The samples within reach are judged on.
    report = check_reference(ROBOT, ALL, sine(5, 0.2, 0.05), 20.0, GRAVITY)
    first = report.first_violation
    with pytest.raises(InfeasibleReferenceError, match=rf"{first.limit} with .* at t = {first.time:.3f} s"):
        report.raise_if_infeasible()
    assert first.time < report.smallest["reach"].time


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


def test_the_largest_scale_is_the_first_at_which_a_limit_breaks():
    def hold(scale):
        # A larger scale that is feasible again is not taken.
        return HoldReference(pose=(0.0, 0.0, 0.0, 0.0, 0.0, 0.6 if 0.3 < scale < 0.5 else 0.3))

    assert largest_scale(ROBOT, ALL, hold, 0.1, GRAVITY) == pytest.approx(0.3, rel=1e-3)
    assert largest_scale(ROBOT, ALL, lambda _: HoldReference(), 0.1, GRAVITY) == 1.0
    assert largest_scale(ROBOT, only(torque_fraction=0.01), lambda _: HoldReference(), 0.1, GRAVITY) == 0.0
