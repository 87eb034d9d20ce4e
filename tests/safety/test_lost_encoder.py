"""A robot that loses an encoder is held, or led home, on the five others and the inertial sensor."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stewart_drake import Controller, RobotParameters, load_scenario
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.jit import njit
from stewart_drake.base.records import record
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.safety.lost_encoder import HALT, SPEED, GoingParams, lost_angle, quintic, way_to_rest
from stewart_drake.scenario.stepped_loop import SteppedLoop

IMU = {"preset": "bmi088"}
ENCODERS = {"kind": "encoders", "resolution_bits": 17, "noise": 2e-5, "imu": IMU}
MINI = {"kind": "closed_form", "motor_damping": 0.095, "motor_friction": 0.058}
LOOPS = {
    "breathing": ("exact_breathing", {"plant": "closed_form", "safety": {}, "sensors": ENCODERS}),
    "mini": ("reachy_nod", {"plant": MINI, "safety": {}, "sensors.imu": IMU}),
    "slow_imu": ("reachy_nod", {"plant": MINI, "safety": {}, "sensors.imu": {**IMU, "period": 0.02, "delay": 0.005}}),
}
ROBOTS = {"paper": RobotParameters(), "mini": load_scenario("reachy_nod").robot}
ONSET = 1.5  # [s]
rows = st.lists(st.floats(-1.0, 1.0), min_size=18, max_size=18).map(np.array)


def matrix(rpy):
    return Rotation.from_euler("ZYX", rpy[::-1]).as_matrix()


def turned_by(pose, other):
    """[deg], [mm] between two poses."""
    angle = Rotation.from_matrix(matrix(pose[:3]).T @ matrix(other[:3])).magnitude()
    return np.degrees(angle), 1e3 * np.linalg.norm(pose[3:6] - other[3:6])


@njit
def solved(robot, angles, leg, rotation, pose, legs, difference):
    robot, legs = record(robot), record(legs)
    done = True
    for _ in range(4):
        done = done and lost_angle(robot, angles, leg, rotation, pose, legs, difference)
    return done


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=40, deadline=None)
@given(rows, st.integers(0, 5), st.floats(-0.1, 0.1))
def test_five_angles_and_the_orientation_give_the_sixth_angle(name, numbers, leg, error):
    robot = ROBOTS[name]
    pose = robot.home_pose + numbers[:6] * np.repeat([0.2, 0.1 * robot.characteristic_length], 3)
    angles, turn, guess = inverse_kinematics(robot, pose), matrix(pose[:3]), pose.copy()
    wrong = angles.copy()
    wrong[leg] += error
    assert solved(laws.robot_record(robot), wrong, leg, turn, guess, laws.Legs.empty(), np.empty(3))
    np.testing.assert_allclose(wrong, angles, atol=1e-7)


@given(rows, rows, st.floats(0.1, 3.0))
def test_the_polynomial_joins_its_start_and_rest_and_its_rows_are_derivatives(start, goal, duration):
    h, now, before, after = 1e-5, np.empty(18), np.empty(18), np.empty(18)
    quintic(start, goal[:6], duration, 0.0, now)
    np.testing.assert_allclose(now, start, atol=1e-12)
    quintic(start, goal[:6], duration, duration - 1e-9, now)
    np.testing.assert_allclose(now[:12], np.concatenate([goal[:6], np.zeros(6)]), atol=1e-5)
    for time, out in ((0.4 * duration - h, before), (0.4 * duration, now), (0.4 * duration + h, after)):
        quintic(start, goal[:6], duration, time, out)
    scale = max(1.0, np.abs(now).max()) / duration**2
    np.testing.assert_allclose((after[:12] - before[:12]) / (2.0 * h), now[6:], atol=1e-4 * scale)


def test_the_way_home_is_slow_and_ends_at_home():
    robot, start = RobotParameters(), np.zeros(18)
    start[:6] = robot.home_pose + np.array([0.3, -0.2, 0.1, 0.02, 0.0, -0.03])
    start[6:12] = 0.5, 0.0, 0.0, 0.0, 0.1, 0.0
    speed = SPEED * robot.characteristic_length
    going = GoingParams.new(home=robot.home_pose, speed=speed)
    path = np.empty((8001, 18))
    times = 1e-3 * np.arange(len(path))
    for time, row in zip(times, path, strict=True):
        record_way(going, start, time, row)
    np.testing.assert_array_equal(path[-1], np.concatenate([robot.home_pose, np.zeros(12)]))
    later = times > HALT
    assert 0.9 < np.linalg.norm(path[later, 6:9], axis=1).max() / SPEED < 1.001
    assert np.linalg.norm(path[later, 9:12], axis=1).max() < 1.001 * speed
    assert np.abs(np.diff(path[:, :12], axis=0)).max() < 0.01  # No jump of pose and rate.


@njit
def record_way(going, start, time, out):
    way_to_rest(record(going), start, time, out)


def lost(name, fault, reaction, duration=5.0, more=(), leg=2):
    """A run to its end: the loop, its failure, farthest true pose [deg], [mm] from the reference after the onset."""
    base, changes = LOOPS[name]
    faults = [{"time": ONSET, "leg": leg, **fault}, *more]
    keys = {"sensors.faults": faults, "safety.on_lost_encoder": reaction, "safety.safe_hold_time": duration}
    loop = SteppedLoop(load_scenario(base).replace({**changes, **keys, "duration": 30.0}))
    wanted, farthest, failure = loop.runner.signal("used_reference"), np.zeros(2), None
    loop.begin()
    while loop.time < ONSET + duration + 8.0 and failure is None:
        try:
            loop.run_parts()
            loop.move()
        except RunFailure as stop:
            failure = stop
        if loop.time > ONSET and loop.now % 5 == 0:
            farthest = np.maximum(farthest, turned_by(wanted, loop.pose))
    return loop, failure, farthest


DRIFT, FREEZE, NAN, JUMP = (
    {"kind": "drift", "size": 0.3},
    {"kind": "freeze"},
    {"kind": "nan"},
    {"kind": "jump", "size": 0.1},
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fault", "most"),
    [
        ("breathing", DRIFT, (2.0, 3.0)),
        ("breathing", FREEZE, (2.0, 4.0)),
        ("breathing", NAN, (2.0, 3.0)),
        ("breathing", JUMP, (2.0, 3.0)),
        ("mini", DRIFT, (2.5, 3.0)),
        ("mini", JUMP, (2.0, 3.0)),
        ("slow_imu", DRIFT, (4.0, 3.0)),
    ],
)
def test_the_robot_is_held_on_five_encoders(name, fault, most):
    loop, failure, farthest = lost(name, fault, "hold")
    assert (failure.leg, loop.runner.state("safety")["lost"][0, 0]) == (2, 2.0)
    assert "held on five encoders and the inertial sensor for 5 s" in str(failure)
    assert loop.time > ONSET + 5.0
    assert (farthest < most).all()
    assert np.abs(loop.measured[6:12]).max() < 0.02  # [rad/s], [m/s] At rest, when brakes close.


@pytest.mark.slow
@pytest.mark.parametrize("name", ["breathing", "mini"])
def test_the_robot_is_led_home_on_five_encoders(name):
    loop, failure, farthest = lost(name, DRIFT, "home", 1.0, leg=4)
    assert (failure.leg, "inertial sensor for 1 s" in str(failure)) == (4, True)
    assert (farthest < (2.0, 3.0)).all()
    assert (np.array(turned_by(loop.pose, loop.scenario.robot.home_pose)) < (0.5, 0.5)).all()


@pytest.mark.slow
def test_without_it_the_robot_is_held_for_forty_milliseconds():
    loop, failure, _ = lost("breathing", DRIFT, "stop")
    assert "held for 0.04 s" in str(failure)
    assert loop.time < ONSET + 0.3


@pytest.mark.slow
@pytest.mark.parametrize("second", [NAN, DRIFT])
def test_a_second_fault_stops(second):
    loop, failure, farthest = lost("breathing", DRIFT, "home", more=[{"time": 3.0, "leg": 5, **second}], duration=20.0)
    assert "held for 0.04 s" in str(failure)
    assert loop.runner.state("safety")["lost"][0, 0] == -1.0
    assert loop.time < 3.5
    assert farthest[0] < 3.0


@pytest.mark.slow
def test_a_sensor_that_falls_silent_is_a_second_fault():
    base, changes = LOOPS["breathing"]
    faults = [{**DRIFT, "time": ONSET, "leg": 2}]
    scenario = load_scenario(base).replace({**changes, "sensors.faults": faults})
    loop, controller, out = SteppedLoop(scenario), Controller(scenario), np.empty(6)
    loop.begin()
    while loop.time < 1.8:
        loop.run_parts()
        controller.step(loop.runner.signal("reading"), loop.time, out, imu=loop.runner.signal("imu"))
        loop.move()
    assert controller.status == "safe_hold"
    assert controller.first_trip["leg"] == 2
    with pytest.raises(RunFailure, match=r"parity: .*held for 0\.04 s"):
        steps(controller, loop.runner.signal("reading"), out)


def steps(controller, reading, out):
    for k in range(100):
        controller.step(reading, 1.9 + 0.001 * k, out)


def test_nothing_changes_while_no_encoder_is_lost():
    base, changes = LOOPS["breathing"]
    commands = []
    for reaction in ("stop", "hold", "home"):
        loop = SteppedLoop(load_scenario(base).replace({**changes, "safety.on_lost_encoder": reaction}))
        loop.begin()
        for _ in range(700):
            loop.run_parts()
            for name in ("reading", "reference", "reference_ahead"):
                np.testing.assert_array_equal(loop.runner.signal(f"used_{name}"), loop.runner.signal(name))
            loop.move()
        commands.append(loop.runner.signal("safe_torque").copy())
    np.testing.assert_array_equal(commands[1:], commands[:1] * 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"sensors": "encoders", "estimator": "observer"},
            "safety.on_lost_encoder: expected stop or null, got 'home'; the others need encoders",
        ),
        ({"sensors": "ideal"}, "safety.on_lost_encoder: expected stop or null, got 'home'; the others need encoders"),
    ],
)
def test_what_cannot_go_on_is_refused(changes, message):
    scenario = load_scenario("exact_fig7").replace({"safety": {"on_lost_encoder": "home"}, **changes})
    with pytest.raises(ConfigurationError, match=message):
        Controller(scenario)
