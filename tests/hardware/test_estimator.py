import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses, vectors

from stewart_drake.errors import (
    AssemblyModeError,
    ForwardKinematicsError,
    RunFailure,
    SingularPoseError,
)
from stewart_drake.hardware.sensors import EncoderOptions, estimate, flat_estimate, initial_memory
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    pose_jacobian,
    rod_lines,
)
from stewart_drake.robot import RobotParameters

HOME = ROBOT.home_pose
PERIOD = 0.001
SMOOTH = EncoderOptions(resolution_bits=0)
few = settings(max_examples=40)
both = pytest.mark.parametrize("compiled", [False, True], ids=["numpy", "compiled"])
PLUS = RobotParameters(branch=1)
OTHER = RobotParameters(
    shaft_circle_radius=0.25, platform_joint_radius=0.09, crank_length=0.08, rod_length=0.38, shaft_half_angle=0.3
)


def run(robot, options, readings, start, period=PERIOD, compiled=False):
    """Memory after each reading."""
    tick, memory, kept = flat_estimate(robot, options, period, compiled), initial_memory(start), []
    for angles in readings:
        memory = tick(np.asarray(angles, dtype=float), memory)
        kept.append(memory)
    return np.array(kept)


def at(pose, robot=ROBOT):
    return inverse_kinematics(robot, pose)


# --- pose and rate -------------------------------------------------------------------------------------------------


@few
@given(poses(0.8), vectors(6, 0.5), st.booleans())
def test_at_first_the_rate_is_the_one_of_the_start(pose, rate, compiled):
    start = initial_memory(pose, pose_jacobian(ROBOT, pose) @ rate)
    # Whatever the low pass does with later differences.
    options = EncoderOptions(resolution_bits=0, rate_cutoff=10.0)
    memory = flat_estimate(ROBOT, options, PERIOD, compiled)(at(pose), start)
    np.testing.assert_allclose(memory[6:12], rate, atol=1e-9)


@pytest.mark.parametrize("robot", [ROBOT, PLUS, OTHER], ids=["paper", "other branch", "other geometry"])
@both
def test_the_rate_is_that_of_now_to_first_order_in_the_period(robot, compiled):
    rate, acceleration = np.array([0.5, -0.3, 0.4, 0.1, 0.08, -0.12]), np.array([2.0, 3.0, -2.0, 1.0, -1.0, 0.5])
    start = robot.home_pose + [0.05, 0.02, -0.1, 0.01, -0.01, 0.0]

    def gap(period):
        readings = [at(start + t * rate + 0.5 * t * t * acceleration, robot) for t in (-period, 0.0)]
        found = run(robot, SMOOTH, readings, start, period, compiled)[-1]
        np.testing.assert_allclose(found[:6], start, atol=1e-9)
        return np.abs(found[6:12] - rate).max()

    assert 1e-5 < gap(0.001) < 0.005
    assert gap(0.0005) / gap(0.001) == pytest.approx(0.5, abs=0.02)


@few
@given(poses(0.7), st.sampled_from([10, 14, 17]))
def test_the_pose_is_as_good_as_the_counts(pose, bits):
    options = EncoderOptions(resolution_bits=bits)
    # Whole turns of a crank are no matter.
    readings = options.read(at(pose)) + 2.0 * np.pi * np.array([1, -1, 0, 3, 0, 2])
    memory = run(ROBOT, options, [readings], pose)[0]
    bound = np.abs(np.linalg.inv(pose_jacobian(ROBOT, pose))) @ np.full(6, 0.5 * options.quantum)
    assert (np.abs(memory[:6] - pose) <= 1.1 * bound + 1e-9).all()


@given(vectors(6, 3.0), st.integers(1, 24), vectors(6, 0.01))
def test_readings_are_whole_counts_of_angle_plus_offset(angles, bits, offset):
    options = EncoderOptions(resolution_bits=bits, offset=tuple(offset))
    readings = options.read(angles)
    quantum = 2.0 * np.pi / 2**bits
    np.testing.assert_allclose(readings / quantum, np.round(readings / quantum), atol=1e-6)
    assert np.abs(readings - angles - offset).max() <= 0.5 * quantum * (1.0 + 1e-9)
    without = EncoderOptions(resolution_bits=0, offset=tuple(offset))
    np.testing.assert_array_equal(without.read(angles), angles + offset)


@both
def test_the_low_pass_is_of_first_order_with_the_corner_that_the_option_names(compiled):
    cutoff, ticks = 30.0, 40
    speed = np.array([1.0, -0.5, 0.3, 0.8, -0.2, 0.1])
    readings = [at(HOME) + k * PERIOD * speed for k in range(ticks)]
    options = EncoderOptions(resolution_bits=0, rate_cutoff=cutoff)
    rates = run(ROBOT, options, readings, HOME, compiled=compiled)[:, 18:24]
    # The step response of 1 / (1 + s / (2 pi f)), at the ticks.
    law = 1.0 - np.exp(-2.0 * np.pi * cutoff * PERIOD * np.arange(ticks))
    np.testing.assert_allclose(rates, law[:, None] * speed, rtol=1e-9, atol=1e-11)
    bare = run(ROBOT, SMOOTH, readings, HOME, compiled=compiled)[:, 18:24]
    np.testing.assert_allclose(bare[1:], np.broadcast_to(speed, (ticks - 1, 6)), rtol=1e-9)


# --- what is not believed ------------------------------------------------------------------------------------------


def standing(robot=ROBOT, pose=HOME):
    return estimate(robot, SMOOTH, PERIOD, at(pose, robot), initial_memory(pose))


def test_a_reading_may_move_as_fast_as_the_option_says_and_no_faster():
    options = EncoderOptions(resolution_bits=0, max_speed=10.0)
    for share, believed in ((0.99, True), (1.01, False)):
        angles = at(HOME)
        angles[2] += share * 10.0 * PERIOD
        if believed:
            assert estimate(ROBOT, options, PERIOD, angles, standing())[20] == pytest.approx(share * 10.0)
        else:
            with pytest.raises(RunFailure, match="faster than 10"):
                estimate(ROBOT, options, PERIOD, angles, standing())
    # Not at the first reading, which has none before it.
    estimate(ROBOT, options, PERIOD, angles, initial_memory(HOME))


def test_a_pose_may_move_as_far_as_the_option_says_and_no_farther():
    for axis, limit in ((1, 0.02), (4, 0.005)):
        options = EncoderOptions(resolution_bits=0, max_speed=1e6, max_step=(0.02, 0.005))
        for share, believed in ((0.99, True), (1.01, False)):
            pose = HOME + share * limit * np.eye(6)[axis]
            for memory in (standing(), initial_memory(HOME)):
                if believed:
                    np.testing.assert_allclose(estimate(ROBOT, options, PERIOD, at(pose), memory)[:6], pose, atol=1e-9)
                else:
                    with pytest.raises(AssemblyModeError) as caught:
                        estimate(ROBOT, options, PERIOD, at(pose), memory)
                    np.testing.assert_allclose(caught.value.pose, pose, atol=1e-9)
                    np.testing.assert_allclose(caught.value.last, HOME, atol=1e-12)


MODE_GUESS = HOME + np.array([0.0, -1.83, 0.0, 0.09, 0.0, -0.06])
"""Near another assembly mode for the cranks of the home pose: pitched by 105 degrees."""


@both
def test_another_assembly_mode_of_the_same_cranks_is_refused(compiled):
    angles = at(HOME)
    other = forward_kinematics(ROBOT, angles, MODE_GUESS)
    # A second robot from the same cranks, on the same branch of the inverse kinematics, its lines turned inside out.
    np.testing.assert_allclose(np.cos(at(other) - angles), 1.0, atol=1e-12)
    assert np.abs(other - HOME).max() > 1.0
    assert (
        np.linalg.det(rod_lines(leg_geometry(ROBOT, other))) < 0.0 < np.linalg.det(rod_lines(leg_geometry(ROBOT, HOME)))
    )
    options = EncoderOptions(resolution_bits=0, hold_ticks=0)
    tick = flat_estimate(ROBOT, options, PERIOD, compiled)
    good = tick(angles, initial_memory(HOME))
    # Newton led astray: the last pose next to the other mode, and as if the step to it were short.
    astray = good.copy()
    astray[:6] = other + 1e-3
    with pytest.raises(AssemblyModeError) as caught:
        tick(angles, astray)
    assert caught.value.reason == "assembly_mode"
    # The other mode is as good where the robot stands in it from the start.
    np.testing.assert_allclose(tick(angles, initial_memory(other + 1e-3))[:6], other, atol=1e-9)
    # However far a step may be, its orientation gives it away; and its distance, did it have the right one.
    generous = EncoderOptions(resolution_bits=0, hold_ticks=0, max_step=(10.0, 10.0))
    wide = flat_estimate(ROBOT, generous, PERIOD, compiled)
    with pytest.raises(AssemblyModeError):
        wide(angles, np.concatenate([MODE_GUESS, good[6:]]))
    with pytest.raises(AssemblyModeError):
        tick(angles, np.concatenate([MODE_GUESS + [0, 0.4, 0, 0, 0, 0], good[6:24], [0.0, -1.0, 1.0]]))


@both
def test_cranks_for_which_there_is_no_pose_are_named(compiled):
    options = EncoderOptions(resolution_bits=0, max_speed=1e9, hold_ticks=0)
    with pytest.raises(ForwardKinematicsError) as caught:
        flat_estimate(ROBOT, options, PERIOD, compiled)(np.array([3.0, 0.1, 3.0, 0.1, 3.0, 0.1]), standing())
    assert caught.value.reason == "forward_kinematics"
    assert caught.value.residual > 1e-6


@both
@pytest.mark.parametrize("leg", [0, 3])
def test_a_crank_beyond_its_dead_centre_is_named_though_the_pose_is_the_same(leg, compiled):
    pose = HOME + [0.1, -0.05, 0.08, 0.01, 0.02, -0.005]
    angles = at(pose)
    angles[leg] = inverse_kinematics(ROBOT, pose, branch=-ROBOT.branch)[leg]
    np.testing.assert_allclose(forward_kinematics(ROBOT, angles, pose), pose, atol=1e-9)
    tick = flat_estimate(ROBOT, SMOOTH, PERIOD, compiled)
    with pytest.raises(SingularPoseError) as caught:
        tick(angles, initial_memory(pose))
    assert (caught.value.reason, caught.value.leg) == ("crank_dead_centre", leg)


# --- held ticks ----------------------------------------------------------------------------------------------------

BAD = {"not a number": np.nan, "infinite": -np.inf, "jump": at(HOME)[2] + 0.5}


@both
@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_the_last_good_pose_stands_in_for_so_many_ticks_and_no_more(bad, compiled):
    options = EncoderOptions(resolution_bits=0, hold_ticks=3)
    tick = flat_estimate(ROBOT, options, PERIOD, compiled)
    angles = at(HOME)
    bad = np.where(np.arange(6) == 2, bad, angles)
    if not np.isfinite(bad).all():
        with pytest.raises(RunFailure, match="finite"):
            tick(bad, initial_memory(HOME))
    good = tick(angles + 1e-4, tick(angles, initial_memory(HOME)))
    assert np.abs(good[6:12]).max() > 0.0
    memory = good
    for _ in range(2):
        for count in range(1, 4):
            memory = tick(bad, memory)
            np.testing.assert_array_equal(memory[:24], good[:24])
            assert memory[24] == count
        # Back again: the difference is over all the ticks that passed.
        memory = tick(angles + 5e-4, memory)
        assert memory[24] == 0.0
        np.testing.assert_allclose(memory[18:24], 4e-4 / (4.0 * PERIOD), rtol=1e-6)
        good = memory = tick(angles + 1e-4, memory)
    for _ in range(3):
        memory = tick(bad, memory)
    with pytest.raises(RunFailure) as caught:
        tick(bad, memory)
    assert caught.value.reason == "encoder"


# --- compiled ------------------------------------------------------------------------------------------------------


@few
@given(
    st.sampled_from([ROBOT, PLUS, OTHER]),
    vectors(6),
    vectors(6, 1.0),
    st.sampled_from([0, 12, 17]),
    st.sampled_from([None, 50.0]),
    st.integers(0, 3),
)
def test_compiled_is_numpy(robot, away, rate, bits, cutoff, held):
    pose = robot.home_pose + np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01]) * away
    options = EncoderOptions(resolution_bits=bits, rate_cutoff=cutoff)
    readings = [options.read(at(pose + k * PERIOD * rate, robot)) for k in range(3)]
    readings[2:2] = [np.full(6, np.nan)] * held
    one, other = (run(robot, options, readings, pose, compiled=compiled) for compiled in (False, True))
    np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-8)


@few
@given(vectors(6, 3.2))
def test_compiled_refuses_what_numpy_refuses_by_the_same_name(angles):
    options = EncoderOptions(resolution_bits=0, hold_ticks=0, max_speed=1e9)
    outcomes = []
    for compiled in (False, True):
        try:
            outcomes.append(flat_estimate(ROBOT, options, PERIOD, compiled)(at(HOME) + angles, standing())[:12])
        except RunFailure as error:
            outcomes.append(error.reason)
    if isinstance(outcomes[0], str):
        assert outcomes[1] == outcomes[0]
    else:
        np.testing.assert_allclose(outcomes[1], outcomes[0], rtol=1e-7, atol=1e-8)
