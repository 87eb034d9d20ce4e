import numpy as np
import pytest
from hypothesis import assume, given, settings
from robots import PAPER, offsets, robots

from stewart_drake.compiled import dynamics, mechanism
from stewart_drake.errors import UnreachablePoseError
from stewart_drake.mechanics import kinematics

many = settings(max_examples=60)


def legs_of(robot, pose):
    legs = np.empty((6, 14))
    return mechanism.leg_vectors(mechanism.pack(robot), pose, legs), legs


def lines_of(legs):
    lines = np.empty((6, 6))
    mechanism.rod_lines(legs, lines)
    return lines


def reachable(robot, pose):
    assume(kinematics.reach_margin(robot, pose).min() > 0.01)
    return kinematics.leg_geometry(robot, pose)


@many
@given(robots, offsets())
def test_leg_vectors_lines_and_conditioning(robot, offset):
    pose = robot.home_pose + offset
    expected = reachable(robot, pose)
    bad, legs = legs_of(robot, pose)
    assert bad == -1
    for columns, name in ((slice(0, 3), "arm"), (slice(3, 6), "crank"), (slice(6, 9), "e_n"), (slice(9, 12), "e_l")):
        np.testing.assert_allclose(legs[:, columns], getattr(expected, name), atol=1e-12, err_msg=name)
    np.testing.assert_allclose(legs[:, 12], expected.transmission, atol=1e-12)
    np.testing.assert_allclose(legs[:, 13], kinematics.reach_margin(robot, pose), atol=1e-12)
    lines = lines_of(legs)
    np.testing.assert_allclose(lines, kinematics.rod_lines(expected), atol=1e-12)
    ratio = mechanism.line_conditioning(mechanism.pack(robot), lines)
    assert ratio == pytest.approx(float(kinematics.line_conditioning(robot, expected)), rel=1e-6)


@many
@given(robots, offsets(5.0))
def test_leg_vectors_find_the_same_leg_out_of_reach(robot, offset):
    pose = robot.home_pose + offset
    bad, legs = legs_of(robot, pose)
    margins = kinematics.reach_margin(robot, pose)
    assume(abs(margins.min()) > 1e-9)
    if margins.min() > 0.0:
        assert bad == -1
        return
    with pytest.raises(UnreachablePoseError) as caught:
        kinematics.leg_geometry(robot, pose)
    assert bad == caught.value.leg
    assert legs[bad, 13] == pytest.approx(caught.value.margin, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("theta", [np.array([3.0, 0.1, 3.0, 0.1, 3.0, 0.1]), np.full(6, np.nan)])
def test_forward_kinematics_says_when_it_has_not_converged(theta):
    pose = PAPER.home_pose.copy()
    assert not mechanism.forward_kinematics(mechanism.pack(PAPER), theta, pose, 1e-12, 12) <= 1e-12


def test_inverse_dynamics_says_so_of_lines_without_rank():
    own, torque = legs_of(PAPER, PAPER.home_pose)[1], np.empty(6)
    done = dynamics.inverse_dynamics(
        mechanism.pack(PAPER), own, np.zeros((6, 6)), np.eye(3), np.zeros(6), np.zeros(6), 9.81, torque
    )
    assert not done
