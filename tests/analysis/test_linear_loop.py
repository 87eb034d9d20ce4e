"""The linear loop against closed forms, and against Drake's plant."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, linearize, load_scenario, run
from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.analysis.linear_loop import linear_loops, plant_at
from stewart_drake.control.lqi import lqi_gain
from stewart_drake.control.riccati import INTEGRAL, POSITION, RATE
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.mechanics.kinematics_laws import robot_record

POSE = np.array([0.2, -0.1, 0.15, 0.02, -0.01, 0.31])
IDEAL = ["sensors={kind: ideal}", "command_delay=0"]
DIFFERENCES = "estimator={kind: difference, rate_cutoff: 150}"
PLAIN = ["sensors.noise=0", DIFFERENCES, "model.friction=null", "tuner={kind: block}"]
OBSERVER = ["estimator.kind=observer"]


def scenario(*changes):
    return load_scenario("exact_breathing", [*PLAIN, *changes])


def radius(loops):
    return np.abs(np.linalg.eigvals(loops.closed)).max(axis=-1)


def test_the_regulator_with_ideal_sensors_is_its_gain_and_an_integral():
    made = scenario(*IDEAL)
    loops = linear_loops(made, POSE[None])
    gain = lqi_gain(pose_acceleration_map(made.robot, POSE), made.lqi, np.array(made.tuner.weights))
    expected = -np.hstack([gain[:, POSITION], gain[:, RATE], gain[:, INTEGRAL]])
    np.testing.assert_allclose(loops.c[0], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    plant = plant_at(robot_record(made.robot), POSE[None], made.gravity, 0.001)
    np.testing.assert_allclose(loops.a[0, :12, :12], plant.a[0])
    np.testing.assert_allclose(loops.a[0, 12:], np.hstack([1e-3 * np.eye(6), np.zeros((6, 6)), np.eye(6)]), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes", [[], IDEAL, OBSERVER, [*OBSERVER, "command_delay=3"], ["controller={kind: pid}"]], ids=str
)
def test_the_linear_loop_answers_a_small_push_as_drakes_plant_does(changes):
    wrench = np.array([0.001, 0.002, -0.001, 0.03, -0.02, 0.04])
    push = np.linalg.solve(twist_jacobian(scenario().robot, POSE).T, wrench)
    off = []
    for time_step in (0.001, 0.0001):
        made = scenario(
            f"reference={{kind: hold, pose: {POSE.tolist()}}}",
            f"disturbances=[{{kind: step, wrench: {wrench.tolist()}, time: 0.01}}]",
            f"plant={{time_step: {time_step}}}",
            "sensors.resolution_bits=0",
            "duration=0.1",
            *changes,
        )
        moved = run(made)["pose"] - POSE
        loops = linear_loops(made, POSE[None])
        state, linear = np.zeros(loops.a.shape[-1]), []
        for tick in range(len(moved)):
            linear.append(state[:6])
            state = loops.closed[0] @ state + loops.b[0] @ (push if tick >= 10 else 0.0 * push)
        off.append((np.abs(moved - linear).max(axis=0) / np.abs(linear).max(axis=0)).max())
    # The loop is exact in time, the plant of first order in its step.
    assert off[1] < 0.02
    assert off[1] < 0.2 * off[0]


@pytest.mark.parametrize(
    "changes",
    [
        [*OBSERVER, "model.robot={platform_mass: 2.0, rod_length: 0.405}"],
        [*OBSERVER, "plant.payload_mass=0.5", "plant.payload_position=[0.02, 0, 0.05]"],
        ["controller={kind: pid, ki: 0}"],
    ],
    ids=str,
)
def test_the_loop_is_stable_with_a_wrong_model_and_without_an_integral(changes):
    made = scenario(*changes)
    loops = linear_loops(made, sample_poses(made.robot, NEAR, 3, np.random.default_rng(1)))
    assert len(loops.poses) == 3
    assert (radius(loops) < 1.0).all()


def test_a_loop_for_slow_buses_is_linearised_without_its_dead_band_and_what_it_learns():
    made = load_scenario("reachy_slow_bus")
    pose = made.start()[0][None]
    loops, plain = (linear_loops(each, pose) for each in (made, made.replace({"adaptation": None})))
    assert 0.9 < radius(loops)[0] < 0.99
    np.testing.assert_array_equal(loops.closed, plain.closed)
    proportional = linear_loops(made.replace({"controller.ki": 0.0}), pose)
    assert proportional.a.shape[-1] == loops.a.shape[-1] - 6


def test_a_line_tells_that_an_inertial_sensor_is_left_out(caplog):
    made = scenario("estimator=observer", "sensors={kind: encoders, imu: {}}")
    loops = linear_loops(made, POSE[None])
    assert [record.message for record in caplog.records if "inertial sensor is left out" in record.message]
    np.testing.assert_array_equal(loops.closed, linear_loops(made.replace({"sensors.imu": None}), POSE[None]).closed)


def test_a_pose_that_cannot_be_held_is_left_out():
    # Nothing holds the weight of a robot under a law without integral and without its model.
    weak = scenario(*IDEAL, "controller={kind: pid, ki: 0, feedforward: none, kp: 0.001, kd: 0.001}")
    with pytest.raises(ConfigurationError, match="an equilibrium at some pose"):
        linear_loops(weak, POSE[None])


# python-control 0.10.2 with numpy 2.5.
@pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning:control")
def test_near_a_pose_the_loop_is_stable_when_it_is_closed_and_python_control_agrees():
    made = scenario(*IDEAL)
    near = linearize(made, POSE)
    assert radius(linear_loops(made, POSE[None])) < 1.0
    system, closed = near.loop.to_control(), np.linalg.eigvals(near.loop.a + near.loop.b @ near.loop.c)
    assert system.dt == made.controller.period
    np.testing.assert_allclose(np.sort(np.abs(system.feedback(np.eye(6), sign=1).poles())), np.sort(np.abs(closed)))
    with pytest.raises(ConfigurationError, match="pose"):
        linearize(made, [0.0, 0.0])
