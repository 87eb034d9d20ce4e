import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from setups import setup_for
from strategies import ROBOT, poses

from stewart_drake.base.errors import AssemblyModeError, RunFailure
from stewart_drake.control.estimator import DifferenceOptions, difference_part
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics, pose_jacobian

HOME = ROBOT.home_pose
PERIOD, STILL = 0.001, np.zeros(6)


DEFAULTS = DifferenceOptions()


def estimator(options=DEFAULTS, start=HOME, rate=STILL, period=PERIOD):
    """`tick(angles, state)`: the state after a tick; and the state before the first."""
    part = difference_part(options, setup_for(period=period, pose=start, pose_rate=rate))

    def tick(angles, state):
        after = state.copy()
        part.tick(np.asarray(angles, dtype=float), after)
        return after

    return tick, part.initial


def run(readings, start, period=PERIOD):
    """States after each reading."""
    tick, state = estimator(start=start, period=period)
    states = []
    for angles in readings:
        state = tick(angles, state)
        states.append(state[0])
    return np.array(states)


def at(pose):
    return inverse_kinematics(ROBOT, pose)


def test_the_rate_is_that_of_now_to_first_order_in_the_period():
    rate, acceleration = np.array([0.5, -0.3, 0.4, 0.1, 0.08, -0.12]), np.array([2.0, 3.0, -2.0, 1.0, -1.0, 0.5])
    start = HOME + [0.05, 0.02, -0.1, 0.01, -0.01, 0.0]

    def gap(period):
        readings = [at(start + t * rate + 0.5 * t * t * acceleration) for t in (-period, 0.0)]
        result = run(readings, start, period)[-1]["measurement"]
        np.testing.assert_allclose(result[:6], start, atol=1e-9)
        return np.abs(result[6:] - rate).max()

    assert 1e-5 < gap(0.001) < 0.005
    assert gap(0.0005) / gap(0.001) == pytest.approx(0.5, abs=0.02)


@settings(max_examples=40)
@given(poses(0.7), st.sampled_from([10, 14, 17]))
def test_the_pose_is_as_good_as_the_counts(pose, bits):
    options = EncoderOptions(resolution_bits=bits)
    readings = np.rint(at(pose) / options.quantum) * options.quantum + 2.0 * np.pi * np.array([1, -1, 0, 3, 0, 2])
    found = run([readings], pose)[0]["measurement"][:6]
    bound = np.abs(np.linalg.inv(pose_jacobian(ROBOT, pose))) @ np.full(6, 0.5 * options.quantum)
    assert (np.abs(found - pose) <= 1.1 * bound + 1e-9).all()


@pytest.mark.parametrize("limits", [(0.2, 0.05), (10.0, 10.0)])
def test_another_assembly_mode_of_the_same_cranks_is_refused(limits):
    # However far a step may be, its orientation gives it away: the lines of the legs are turned inside out.
    angles, near_it = at(HOME), HOME + np.array([0.0, -1.83, 0.0, 0.09, 0.0, -0.06])
    other = forward_kinematics(ROBOT, angles, near_it)
    np.testing.assert_allclose(np.cos(at(other) - angles), 1.0, atol=1e-12)
    options = DifferenceOptions(hold_ticks=0, max_step=limits)
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


@pytest.mark.parametrize("bad", [np.nan, -np.inf, at(HOME)[2] + 0.5], ids=["not a number", "infinite", "jump"])
def test_the_last_good_pose_bridges_so_many_ticks_and_no_more(bad):
    tick, initial = estimator(DifferenceOptions(hold_ticks=3))
    angles = at(HOME)
    bad = np.where(np.arange(6) == 2, bad, angles)
    good = tick(angles + 1e-4, tick(angles, initial))
    state = good
    for count in range(1, 4):
        state = tick(bad, state)
        for name in ("measurement", "angles", "crank_rate"):
            np.testing.assert_array_equal(state[name], good[name])
        assert state["missed"] == count
    with pytest.raises(RunFailure) as caught:
        tick(bad, state)
    assert caught.value.reason == "encoder"
    # Back again: the difference is over all the ticks that passed.
    state = tick(angles + 5e-4, state)
    assert state["missed"] == 0.0
    np.testing.assert_allclose(state["crank_rate"], 4e-4 / (4.0 * PERIOD), rtol=1e-6)
