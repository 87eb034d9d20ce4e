import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses

from stewart_drake.errors import (
    AssemblyModeError,
    ForwardKinematicsError,
    RunFailure,
    SingularPoseError,
)
from stewart_drake.hardware.estimator import difference_part
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    pose_jacobian,
    rod_lines,
)
from stewart_drake.robot import RobotParameters

HOME = ROBOT.home_pose
PERIOD, STILL = 0.001, np.zeros(6)
SMOOTH = EncoderOptions(resolution_bits=0)
few = settings(max_examples=40)
PLUS = RobotParameters(branch=1)


def estimator(options=SMOOTH, start=HOME, rate=STILL, robot=ROBOT, period=PERIOD):
    """`tick(angles, state)`: the state after a tick; and the state before the first."""
    part = difference_part(robot, options, period, start, rate)

    def tick(angles, state):
        after = state.copy()
        part.tick(np.asarray(angles, dtype=float), after)
        return after

    return tick, part.initial


def run(robot, options, readings, start, period=PERIOD):
    """States after each reading."""
    tick, state = estimator(options, start, STILL, robot, period)
    states = []
    for angles in readings:
        state = tick(angles, state)
        states.append(state[0])
    return np.array(states)


def at(pose, robot=ROBOT):
    return inverse_kinematics(robot, pose)


# --- pose and rate -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [ROBOT, PLUS], ids=["paper", "other branch"])
def test_the_rate_is_that_of_now_to_first_order_in_the_period(robot):
    rate, acceleration = np.array([0.5, -0.3, 0.4, 0.1, 0.08, -0.12]), np.array([2.0, 3.0, -2.0, 1.0, -1.0, 0.5])
    start = robot.home_pose + [0.05, 0.02, -0.1, 0.01, -0.01, 0.0]

    def gap(period):
        readings = [at(start + t * rate + 0.5 * t * t * acceleration, robot) for t in (-period, 0.0)]
        result = run(robot, SMOOTH, readings, start, period)[-1]["measurement"]
        np.testing.assert_allclose(result[:6], start, atol=1e-9)
        return np.abs(result[6:] - rate).max()

    assert 1e-5 < gap(0.001) < 0.005
    assert gap(0.0005) / gap(0.001) == pytest.approx(0.5, abs=0.02)


@few
@given(poses(0.7), st.sampled_from([10, 14, 17]))
def test_the_pose_is_as_good_as_the_counts(pose, bits):
    options = EncoderOptions(resolution_bits=bits)
    # Whole turns of a crank are no matter.
    readings = np.rint(at(pose) / options.quantum) * options.quantum + 2.0 * np.pi * np.array([1, -1, 0, 3, 0, 2])
    found = run(ROBOT, options, [readings], pose)[0]["measurement"][:6]
    bound = np.abs(np.linalg.inv(pose_jacobian(ROBOT, pose))) @ np.full(6, 0.5 * options.quantum)
    assert (np.abs(found - pose) <= 1.1 * bound + 1e-9).all()


def test_the_low_pass_is_of_first_order_with_the_corner_that_the_option_names():
    cutoff, ticks = 30.0, 40
    speed = np.array([1.0, -0.5, 0.3, 0.8, -0.2, 0.1])
    readings = [at(HOME) + k * PERIOD * speed for k in range(ticks)]
    options = EncoderOptions(resolution_bits=0, rate_cutoff=cutoff)
    # The step response of 1 / (1 + s / (2 pi f)), at the ticks.
    law = 1.0 - np.exp(-2.0 * np.pi * cutoff * PERIOD * np.arange(ticks))
    rates = run(ROBOT, options, readings, HOME)["crank_rate"]
    np.testing.assert_allclose(rates, law[:, None] * speed, rtol=1e-9, atol=1e-11)
    bare = run(ROBOT, SMOOTH, readings, HOME)["crank_rate"]
    np.testing.assert_allclose(bare[1:], np.broadcast_to(speed, (ticks - 1, 6)), rtol=1e-9)


# --- what is not believed ------------------------------------------------------------------------------------------


def test_another_assembly_mode_of_the_same_cranks_is_refused():
    angles, near_it = at(HOME), HOME + np.array([0.0, -1.83, 0.0, 0.09, 0.0, -0.06])
    other = forward_kinematics(ROBOT, angles, near_it)
    # A second robot from the same cranks, on the same branch of the inverse kinematics, its lines turned inside out.
    np.testing.assert_allclose(np.cos(at(other) - angles), 1.0, atol=1e-12)
    sides = [np.linalg.det(rod_lines(leg_geometry(ROBOT, pose))) for pose in (other, HOME)]
    assert sides[0] < 0.0 < sides[1]
    # However far a step may be, its orientation gives it away.
    for limits in ((0.2, 0.05), (10.0, 10.0)):
        options = EncoderOptions(resolution_bits=0, hold_ticks=0, max_step=limits)
        tick, initial = estimator(options)
        # Newton led astray: the last pose next to the other mode.
        astray = tick(angles, initial)
        astray["measurement"][0, :6] = other + 1e-3
        with pytest.raises(AssemblyModeError) as caught:
            tick(angles, astray)
        assert caught.value.reason == "assembly_mode"
        # The other mode is as good where the robot stands in it from the start.
        tick, initial = estimator(options, other + 1e-3)
        np.testing.assert_allclose(tick(angles, initial)["measurement"][0, :6], other, atol=1e-9)


@pytest.mark.parametrize("leg", [0, 3])
def test_a_crank_beyond_its_dead_centre_is_named_and_so_are_cranks_without_a_pose(leg):
    pose = HOME + [0.1, -0.05, 0.08, 0.01, 0.02, -0.005]
    angles = at(pose)
    angles[leg] = inverse_kinematics(ROBOT, pose, branch=-ROBOT.branch)[leg]
    np.testing.assert_allclose(forward_kinematics(ROBOT, angles, pose), pose, atol=1e-9)
    tick, initial = estimator(start=pose)
    with pytest.raises(SingularPoseError) as caught:
        tick(angles, initial)
    assert (caught.value.reason, caught.value.leg) == ("crank_dead_centre", leg)
    with pytest.raises(ForwardKinematicsError) as caught:
        tick(np.array([3.0, 0.1, 3.0, 0.1, 3.0, 0.1]), initial)
    assert caught.value.residual > 1e-6


BAD = {"not a number": np.nan, "infinite": -np.inf, "jump": at(HOME)[2] + 0.5}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_the_last_good_pose_stands_in_for_so_many_ticks_and_no_more(bad):
    tick, initial = estimator(EncoderOptions(resolution_bits=0, hold_ticks=3))
    angles = at(HOME)
    bad = np.where(np.arange(6) == 2, bad, angles)
    if not np.isfinite(bad).all():
        with pytest.raises(RunFailure, match="finite"):
            tick(bad, initial)
    good = tick(angles + 1e-4, tick(angles, initial))
    assert np.abs(good["measurement"][0, 6:]).max() > 0.0
    state = good
    for _ in range(2):
        for count in range(1, 4):
            state = tick(bad, state)
            for name in ("measurement", "angles", "crank_rate"):
                np.testing.assert_array_equal(state[name], good[name])
            assert state["held"] == count
        # Back again: the difference is over all the ticks that passed.
        state = tick(angles + 5e-4, state)
        assert state["held"] == 0.0
        np.testing.assert_allclose(state["crank_rate"], 4e-4 / (4.0 * PERIOD), rtol=1e-6)
        good = state = tick(angles + 1e-4, state)
    for _ in range(3):
        state = tick(bad, state)
    with pytest.raises(RunFailure) as caught:
        tick(bad, state)
    assert caught.value.reason == "encoder"
