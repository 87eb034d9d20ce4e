"""Encoders against an inertial sensor: which of them is wrong. Oracles: SciPy's rotations, finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stewart_drake import ConfigurationError, RobotParameters, load_scenario, run
from stewart_drake.base.jit import njit
from stewart_drake.base.records import record
from stewart_drake.hardware.imu import ImuOptions
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.mechanics.rotations import rotation_between, turn_by
from stewart_drake.safety.parity import ParityState, parity_part, parity_rows
from stewart_drake.safety.wrong_leg import encoder_lines, suspect_leg
from stewart_drake.scenario.control_side import context_of

GRAVITY = np.array([0.0, 0.0, -9.81])
PERIOD, ONSET = 0.01, 2.0  # [s]
BOUND = np.radians(0.6)
# Standard deviations of a sample of a cheap sensor: rates [rad/s], specific force [m/s^2]; and of its biases.
NOISE, BIAS = (2e-3, 0.02), (0.01, 0.2)
SENSORS = {"kind": "encoders", "noise": 2e-5, "imu": {"preset": "bmi088"}}
LOOP = {"plant": "closed_form", "safety": {}, "duration": 2.5}
vectors = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


def matrix(rpy):
    return Rotation.from_euler("ZYX", rpy[::-1]).as_matrix()


@njit
def lines_at(robot, pose, legs, out):
    robot, legs = record(robot), record(legs)
    return laws.legs_at(robot, pose, legs) < 0 and encoder_lines(legs, out)


@given(vectors, vectors)
def test_rotation_vectors(first, second):
    turned = matrix(second)
    turn_by(first, turned)
    expected = Rotation.from_rotvec(first).as_matrix() @ matrix(second)
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    out = np.empty(3)
    rotation_between(turned, matrix(second), out)
    np.testing.assert_allclose(out, first, atol=1e-9)


def test_the_lines_are_turns_per_radian_of_an_encoder():
    robot = RobotParameters()
    pose, lines = robot.home_pose + np.array([0.1, -0.2, 0.1, 0.01, 0.0, 0.01]), np.empty((6, 3))
    assert lines_at(laws.robot_record(robot), pose, laws.Legs.empty(), lines)
    angles, step = inverse_kinematics(robot, pose), 1e-5
    for leg in range(6):
        moved = forward_kinematics(robot, angles + step * np.eye(6)[leg], guess=pose)
        turn = Rotation.from_matrix(matrix(moved[:3]) @ matrix(pose[:3]).T).as_rotvec()
        np.testing.assert_allclose(lines[leg], turn / step, atol=1e-4)
        found, error = suspect_leg(lines, 0.03 * lines[leg], np.zeros(3))
        assert found == leg
        assert error == pytest.approx(0.03)


@given(st.integers(0, 5), st.floats(0.0, 1.0), st.floats(-0.2, 0.2))
def test_a_leg_is_named_although_the_turn_around_gravity_has_decayed(leg, share, roll):
    robot, lines, down = RobotParameters(), np.empty((6, 3)), np.array([0.0, 0.0, -1.0])
    pose = robot.home_pose + np.array([roll, 0.1, 0.0, 0.0, 0.0, 0.0])
    lines_at(laws.robot_record(robot), pose, laws.Legs.empty(), lines)
    found, error = suspect_leg(lines, 0.03 * lines[leg] * [1.0, 1.0, share], down)
    assert found in (leg, -1)  # Two lines may be too much alike.
    assert found == -1 or error == pytest.approx(0.03)


def test_a_difference_along_no_line_names_no_leg():
    robot, lines = RobotParameters(), np.empty((6, 3))
    lines_at(laws.robot_record(robot), robot.home_pose, laws.Legs.empty(), lines)
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    units = lines / np.linalg.norm(lines, axis=1)[:, None]
    off = np.sqrt(1.0 - np.max(np.abs(directions @ units.T), axis=1) ** 2)
    legs = np.array([suspect_leg(lines, direction, np.zeros(3))[0] for direction in directions])
    assert (legs[off > 0.36] == -1).all()
    assert (legs[off > 0.36].size, legs[off < 0.1].min()) > (100, -1)


def samples(scenario, duration, seed=0):
    """Angles (n, 6), samples of the sensor (n, 6) and references (n, 18) of a motion that is followed exactly."""
    random, times = np.random.default_rng(seed), PERIOD * np.arange(round(duration / PERIOD))
    reference = np.concatenate(scenario.reference.evaluate(times), axis=1)
    turns = Rotation.from_matrix(np.array([matrix(row[:3]) for row in reference])).inv()
    omega, place = np.empty((len(times), 3)), np.array([0.01, 0.02, 0.005])
    at = reference[:, 3:6] + turns.inv().apply(place)
    force = np.gradient(np.gradient(at, PERIOD, axis=0), PERIOD, axis=0)
    # The mean rate of a period is its turn.
    omega[1:] = (turns[1:] * turns[:-1].inv()).inv().as_rotvec() / PERIOD
    omega[0] = omega[1]
    imu = np.hstack([omega, turns.apply(force - GRAVITY)])
    imu += np.repeat(NOISE, 3) * random.normal(size=imu.shape) + np.repeat(BIAS, 3) * random.normal(size=6)
    angles = inverse_kinematics(scenario.robot, reference[:, :6]) + 1e-4 * random.normal(size=(len(times), 6))
    noise, context = np.array(NOISE) * np.sqrt(2.0 * PERIOD), context_of(scenario)._replace(period=PERIOD, noise=1e-4)
    sizes = {
        "gyro_noise": noise[0],
        "accelerometer_noise": noise[1],
        "gyro_bias": BIAS[0],
        "accelerometer_bias": BIAS[1],
    }
    options = ImuOptions(position=place.tolist(), scale_error=0.0, gyro_range=10.0, accelerometer_range=50.0, **sizes)
    params = parity_part(context, options, BOUND).parameters["params"]
    return params, angles, imu, reference


def compare(scenario, params, angles, imu, reference):
    """First sample that differs, or -1; the leg that is named then; all differences [rad]."""
    robot, legs, out = laws.robot_record(scenario.robot), laws.Legs.empty(), np.empty((len(angles), 3))
    row = parity_rows(robot, params, angles, imu, reference, legs, ParityState.new(), out)
    state = ParityState.new()
    parity_rows(robot, params, angles[: row + 1], imu, reference, legs, state, out)
    return row, int(state["parity"][0, 1]), out


@pytest.fixture(scope="module", params=["exact_breathing", "reachy_nod"])
def scenario(request):
    return load_scenario(request.param)


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_biases_are_no_difference(scenario, seed):
    row, _, difference = compare(scenario, *samples(scenario, 30.0, seed))
    assert row == -1
    assert np.abs(difference).max() < 0.9 * BOUND


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("rate", [0.3, 0.01])
def test_an_encoder_that_drifts_is_named(scenario, leg, rate):
    params, angles, imu, reference = samples(scenario, ONSET + 0.035 / rate)
    angles[:, leg] += rate * np.maximum(0.0, PERIOD * np.arange(len(angles)) - ONSET)
    row, named, _ = compare(scenario, params, angles, imu, reference)
    assert row >= 0
    assert named == leg
    # [rad], less than 1 deg of the platform, and three samples.
    assert ((row - 3) * PERIOD - ONSET) * rate < 0.027


def test_an_encoder_that_freezes_is_named(scenario):
    params, angles, imu, reference = samples(scenario, ONSET + 4.0)
    onset = round(ONSET / PERIOD)
    angles[onset:, 3] = angles[onset, 3]
    row, named, _ = compare(scenario, params, angles, imu, reference)
    assert row >= onset
    assert named == 3


@pytest.mark.parametrize(("channel", "size"), [(0, 0.1), (2, 0.1), (4, 3.0)])
def test_a_sensor_that_jumps_differs_and_no_leg_is_named(channel, size):
    scenario = load_scenario("exact_breathing")
    params, angles, imu, reference = samples(scenario, ONSET + 4.0)
    imu[round(ONSET / PERIOD) :, channel] += size
    row, named, _ = compare(scenario, params, angles, imu, reference)
    assert row >= round(ONSET / PERIOD)
    assert named == -1


def dead(imu):
    imu[:, 4] = np.nan


def frozen(imu):
    imu[:] = imu[0]


def saturated(imu):
    imu[:, 0] = 10.0


@pytest.mark.parametrize("fail", [dead, frozen, saturated])
def test_a_sensor_without_new_values_is_wrong_and_no_leg_is(scenario, fail):
    scenario = scenario.replace({"reference": {"kind": "hold"}})
    params, angles, imu, reference = samples(scenario, ONSET + 0.5)
    onset = round(ONSET / PERIOD)
    fail(imu[onset:])
    row, leg, _ = compare(scenario, params, angles, imu, reference)
    assert 0 < row - onset <= 21
    assert leg == -1


def test_gaps_between_readings_are_bridged(scenario):
    params, angles, imu, reference = samples(scenario, 20.0)
    imu[np.arange(len(imu)) % 16 > 7] = np.nan
    assert compare(scenario, params, angles, imu, reference)[0] == -1


@pytest.mark.parametrize("angle", [0.25, 3.0])
def test_a_sensor_that_is_mounted_otherwise_is_wrong_from_the_start(scenario, angle):
    params, angles, imu, reference = samples(scenario, ONSET)
    turn = Rotation.from_rotvec([angle, 0.0, 0.0])
    imu = np.hstack([turn.apply(imu[:, :3]), turn.apply(imu[:, 3:])])
    row, leg, _ = compare(scenario, params, angles, imu, reference)
    assert 0 <= row <= round(0.5 / PERIOD)
    assert leg == -1


def test_a_slow_error_of_the_gyroscopes_along_the_line_of_a_leg_is_not_that_leg():
    scenario = load_scenario("exact_breathing")
    params, angles, imu, reference = samples(scenario, ONSET + 4.0)
    lines = np.empty((6, 3))
    lines_at(laws.robot_record(scenario.robot), scenario.robot.home_pose, laws.Legs.empty(), lines)
    imu[round(ONSET / PERIOD) :, :3] += 0.015 * lines[2] / np.linalg.norm(lines[2])
    row, leg, _ = compare(scenario, params, angles, imu, reference)
    assert row > 0
    assert leg == -1


@pytest.mark.parametrize("leg", [1, 4])
def test_a_tick_names_an_encoder(scenario, leg):
    params, angles, imu, reference = samples(scenario, ONSET + 4.0)
    angles[:, leg] += 0.02 * np.maximum(0.0, PERIOD * np.arange(len(angles)) - ONSET)
    row, named, _ = compare(scenario, params, angles, imu, reference)
    assert row > 0
    assert named == leg


def test_on_a_deck_that_rolls_the_sensor_on_the_base_is_needed():
    deck = {"sensors": {"kind": "encoders", "imu": {"position": [0.02, 0.01, 0.01]}}, "duration": 1.5}
    deck = load_scenario("rolling_deck").replace({**deck, "base.motion.fade_in": 0.2})
    with pytest.raises(ConfigurationError, match=r"base\.motion: expected less than 0\.01745 rad.*base_compensation"):
        run(deck.replace({"base_compensation": "none"}))
    log = run(deck)
    assert log.status == "completed"
    assert np.abs(log["base_motion"][:, 9:]).max() > 0.05
    unknown = run(deck.replace({"base_compensation": "none"}), check=False)
    assert (unknown.safety["monitor"], unknown.safety["leg"]) == ("parity", None)


def test_without_gravity_nothing_can_be_compared():
    scenario = load_scenario("exact_breathing").replace({**LOOP, "sensors": SENSORS, "gravity": 0.0})
    with pytest.raises(ConfigurationError, match=r"safety\.parity: expected null, without gravity"):
        run(scenario, check=False)


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "leg"), [(0.3, 2), (0.1, 5)])
def test_the_safety_layer_stops_a_robot_whose_encoder_drifts_and_names_it(rate, leg):
    fault = {"kind": "drift", "size": rate, "leg": leg, "time": 1.0}
    scenario = load_scenario("exact_breathing").replace({**LOOP, "sensors": {**SENSORS, "faults": [fault]}})
    trip = run(scenario, check=False).safety
    assert (trip["monitor"], trip["leg"]) == ("parity", leg)
    assert (trip["time"] - 1.0) * rate < 0.06  # [rad]
    unseen = run(scenario.replace({"safety.parity": None}), check=False)
    assert (unseen.safety or {}).get("monitor") != "parity"


@pytest.mark.slow
def test_healthy_readings_do_not_trip():
    log = run(load_scenario("exact_breathing").replace({**LOOP, "sensors": SENSORS}))
    assert log.status == "completed"
