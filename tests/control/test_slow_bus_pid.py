"""The loop for slow buses: its equation at a tick, what it does where a crank sticks, and robots that others lose."""

import numpy as np
import pytest
from setups import setup_for
from ticks import standing, ticked

from stewart_drake import ConfigurationError, forward_kinematics, inverse_kinematics, load_robot, load_scenario, run
from stewart_drake.control.base import heave_inertia
from stewart_drake.control.classical import PidOptions
from stewart_drake.mechanics.dynamics import crank_inertia, static_torque

ROBOT = load_robot("reachy_mini")
INERTIA = heave_inertia(ROBOT)
SLOW_BUS = {"inertia": "robot", "feedforward": "motion", "derivative": "difference", "sticking": 4.0, "dead_band": 2.5}
GAINS = {"kp": 400.0 * INERTIA, "ki": 1200.0 * INERTIA, "kd": 32.0 * INERTIA}
OPTIONS = PidOptions(period=0.01, **SLOW_BUS, **GAINS)


def tick(pose, goal, rate=0.0, **before):
    (part,) = OPTIONS.parts(setup_for(ROBOT, period=0.01))
    now = np.concatenate(standing(goal))
    now[11] = rate
    return ticked(part, pose, np.zeros(6), standing(goal), now, **before)


def test_a_tick_is_statics_and_a_pid_through_the_inertia():
    home = ROBOT.home_pose
    weight = static_torque(ROBOT, home)
    np.testing.assert_allclose(tick(home, home).torque, weight, atol=1e-12)
    off = 1e-5 * np.array([1.0, -2.0, 0.5, 3.0, 0.0, -1.0])
    pose = forward_kinematics(ROBOT, inverse_kinematics(ROBOT, home) - off, home)
    integral, before = 1e-4 * np.arange(6.0), np.zeros(6)
    state = tick(pose, home, crank_integral=-integral, error=-before, ticks=5.0)
    wanted = 400.0 * (off + 3.0 * integral) + 2.0 * 0.8 * 20.0 * (off - before) / 0.01
    np.testing.assert_allclose(state.torque - weight, crank_inertia(ROBOT, home) @ wanted, atol=1e-9)


def test_the_torque_of_a_crank_that_sticks_grows_and_no_other_does():
    home, count = ROBOT.home_pose, 2.0 * np.pi / 2**12
    (part,) = OPTIONS.parts(setup_for(ROBOT, period=0.01, noise=count / np.sqrt(12.0)))
    angles, state = inverse_kinematics(ROBOT, home), part.initial.copy()
    for step in range(20):
        goal = home + np.array([0, 0, 0, 0, 0, 1e-4 * step])
        now = np.concatenate(standing(goal))
        now[11] = 0.01
        went = inverse_kinematics(ROBOT, goal) - angles
        went[2] = 0.0  # It sticks; the others are where they should be.
        pose = forward_kinematics(ROBOT, angles + went, home)
        part.tick(np.concatenate([pose, np.zeros(6)]), np.concatenate(standing(goal)), now, state)
    torque = state["stick_torque"][0]
    assert np.flatnonzero(torque).tolist() == [2]
    way = abs(inverse_kinematics(ROBOT, goal) - angles)[2]
    # From the tick on in which its reference is three counts ahead.
    assert OPTIONS.sticking * (way - 3.0 * count) == pytest.approx(torque[2], abs=OPTIONS.sticking * way / 19.0)


def slow(dry, viscous, constant, head, **changes):
    keys = {
        "robot": ROBOT.replace(**ROBOT.scaled_masses(head)),
        "plant": {"kind": "closed_form", "motor_friction": dry, "motor_damping": viscous},
        "motors": {"kind": "current", "torque_constant": constant},
        "model": {"robot": ROBOT, "motors": {"kind": "current"}}
        | {"friction": {"coulomb": 0.058, "viscous": 0.095, "width": 0.004}},
        "controller": {"kind": "pid", "period": 0.01, **SLOW_BUS},
        "estimator": "difference",
        "tuner": "block",
        "bounds": dict.fromkeys(("rotation", "position", "motion_ratio", "error_ratio")),
        "safety": None,
        "adaptation": "regression",
        "duration": 6.0,
    }
    return load_scenario("reachy_nod").replace({**keys, **changes})


@pytest.mark.parametrize("rubs", [0.0, 2.0])
@pytest.mark.parametrize("constant", [0.7, 1.3])
def test_robots_that_nobody_knows_are_not_lost(rubs, constant):
    log = run(slow(rubs * 0.058, rubs * 0.095, constant, 1.2), check=False)
    assert log.status == "completed"
    late = log.error[log.time > 4.0]
    assert np.degrees(np.sqrt(np.mean(np.sum(late[:, :3] ** 2, axis=1)))) < 0.15


def test_a_push_of_3_n_does_not_lose_it_and_at_rest_it_is_still():
    push = {"kind": "step", "wrench": [0.0, 0.0, 0.0, 3.0, 0.0, -3.0], "time": 3.0, "until": 3.5}
    log = run(slow(0.03, 0.05, 0.8, 1.1, disturbances=[push]), check=False)
    assert log.status == "completed"
    assert np.abs(log.error[log.time > 5.5, :3]).max() < np.radians(0.5)
    rest = run(slow(0.03, 0.05, 0.8, 1.1, reference={"kind": "hold", "pose": ROBOT.home_pose.tolist()}), check=False)
    still = rest["crank_angle"][rest.time > 4.0]
    assert np.ptp(still, axis=0).max() < 1e-6


def test_the_kind_that_was_names_what_to_write():
    with pytest.raises(ConfigurationError, match=r"^controller\.kind: expected pid with inertia: robot, feedf"):
        load_scenario("reachy_nod", ["controller.kind=decoupled_pid"])


def test_a_state_that_is_predicted_is_refused():
    with pytest.raises(ConfigurationError, match=r"^estimator\.kind: expected one that tells what was read, such as d"):
        run(load_scenario("reachy_slow_bus").replace({"estimator": "observer"}))
