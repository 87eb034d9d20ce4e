"""The observer with an inertial sensor: its filter, and what it promises."""

import imu_study
import numpy as np
import pytest
from random_robots import random_robot
from setups import setup_for

from stewart_drake import Controller, load_scenario, run
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.imu_model import imu_model
from stewart_drake.control.inertial import BIAS, DISTANCE, PUSH, SPEED, measure_chain, predict_chain
from stewart_drake.control.observer import WHITE_SHARE, ObserverOptions, bandwidth, kalman_gains
from stewart_drake.hardware.imu import ImuOptions
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop

NOISE, DENSITY, PERIOD = 2e-5, 16.0, 0.001


def test_without_inertial_readings_a_chain_has_the_gains_of_the_observer():
    speed, chain, whole = bandwidth(NOISE, DENSITY, PERIOD), np.diag([1e-8, 1e-4, 1.0, 1e-4]), np.empty((5, 5))
    white = (WHITE_SHARE * NOISE * speed**2) ** 2
    for _ in range(500):
        predict_chain(chain, PERIOD, white, DENSITY**2 * PERIOD, 0.0, whole)
        correction = np.zeros(5)
        measure_chain(whole, np.array([1.0, 0.0, 0.0, 0.0, 0.0]), 1.0, NOISE**2, np.empty(5), correction)
        chain = whole[:4, :4].copy()
    np.testing.assert_allclose(correction[[DISTANCE, SPEED, PUSH]], kalman_gains(NOISE, DENSITY, PERIOD), rtol=1e-6)
    assert correction[BIAS] == 0.0


def test_measurements_in_turn_are_those_of_one_least_squares_problem():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((5, 5))
    before, by, errors, variances = root @ root.T, rng.standard_normal((2, 5)), [0.3, -0.7], [0.5, 2.0]
    after, correction = before.copy(), np.zeros(5)
    for row, error, variance in zip(by, errors, variances, strict=True):
        measure_chain(after, row, error, variance, np.empty(5), correction)
    information = np.linalg.inv(before) + by.T @ np.diag(1.0 / np.array(variances)) @ by
    np.testing.assert_allclose(after, np.linalg.inv(information), atol=1e-10)
    np.testing.assert_allclose(
        correction, np.linalg.solve(information, by.T @ (errors / np.array(variances))), atol=1e-10
    )


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["closed_form", "mujoco", "drake"])
def test_on_a_deck_whose_motion_is_measured_the_sensor_makes_rates_better(plant):
    deck = {"plant": plant, "duration": 1.0, "base.motion.fade_in": 0.2, "safety": None, "estimator": "observer"}
    deck, errors = load_scenario("rolling_deck").replace(deck), []
    for imu in (None, {"position": [0.02, 0.01, 0.01]}):
        log = run(deck.replace({"sensors": {"kind": "encoders", "resolution_bits": 12, "imu": imu}}))
        off = (log["measured_pose_rate"] - log["pose_rate"])[len(log["time"]) // 2 :]
        errors.append([np.linalg.norm(off[:, :3]), np.linalg.norm(off[:, 3:])])
    assert (np.array(errors[1]) < 0.95 * np.array(errors[0])).all()


@pytest.mark.parametrize(("age", "delay", "every", "expected"), [
    (0.0, 0.0, None, (0, 1, 0, 0.0005)),  # the middle of the last tick
    (0.0, 0.003, None, (3, 1, 0, 0.0005)),
    (0.0, 0.0, 0.004, (0, 4, 0, 0.0005)),
    (0.0, 0.0, 0.0005, (0, 1, 0, 0.00025)),
    (0.002, 0.0, None, (0, 1, 2, 0.0005)),  # readings wait for those of the encoders
    (0.002, 0.0025, None, (0, 1, 0, 0.001)),
])  # fmt: skip
def test_ages_are_whole_ticks_and_a_rest(age, delay, every, expected):
    model = imu_model(ImuOptions(delay=delay, period=every), PERIOD, age)
    *ticks, rest = (model[name][0] for name in ("lag", "ticks", "early", "rest"))
    assert (*ticks, pytest.approx(rest, abs=1e-9)) == expected


def test_a_sensor_that_is_much_too_late_is_one_line():
    with pytest.raises(ConfigurationError, match=r"model\.imu\.delay.*20 of an observer's ticks"):
        ObserverOptions().parts(setup_for(reading=6, imu=ImuOptions(delay=0.05)))


def errors_of(imu, seed=1, **changes):
    """Velocity error at 12 bits and 100 Hz, and the loop at the end."""
    scenario = imu_study.scenario_of(random_robot(seed), 12, 0.01, imu, seed)
    return imu_study.velocity_error(scenario.replace(changes) if changes else scenario)[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_velocity_error_is_less_by_a_third_and_never_more(seed):
    without = errors_of(None, seed)
    assert errors_of(imu_study.SENSORS["BMI088"], seed) < 0.67 * without
    for imu in ({"period": 0.02}, {"delay": 0.01}, {"preset": "mpu6050", "delay": 0.03, "period": 0.05}):
        assert errors_of(imu, seed) < 1.02 * without


def test_readings_that_arrive_before_those_of_the_encoders_help_too():
    late = {"sensors.delay": 0.02}
    assert errors_of({}, **late) < 0.8 * errors_of(None, **late)


def test_a_push_is_felt_within_two_ticks():
    for bits, period in ((12, 0.01), (17, 0.001)):
        scenarios = (imu_study.scenario_of(random_robot(seed), bits, period, {}, seed) for seed in (1, 2, 3))
        assert np.median([imu_study.ticks_until_felt(scenario) for scenario in scenarios]) <= 2


def test_the_torque_against_a_push_is_that_of_the_observer_without_the_sensor():
    """So the loop keeps its margins: on the same readings both ask for the same torque."""
    scenario = imu_study.scenario_of(random_robot(1), 17, 0.001, {}, 1).replace({"reference": {"kind": "hold"}})
    push = {"kind": "step", "wrench": [0.0, 0.0, 0.0, 1.0, 0.0, -1.0], "time": 0.05}
    loop = SteppedLoop(scenario.replace({"disturbances": [push]}))
    plain = Controller(scenario.replace({"sensors.imu": None}).control())
    loop.begin()
    own, other = [], []
    for _ in range(150):
        loop.run_parts()
        plain.step(loop.runner.signal("reading"), loop.time, np.empty(6))
        # Its commands are not those of the loop, which are what both have to know.
        plain.signal("net_torque")[:] = loop.runner.signal("torque")
        own.append(loop.runner.signal("disturbance_torque").copy())
        other.append(plain.signal("disturbance_torque").copy())
        loop.move()
    assert np.ptp(other, axis=0).max() > 0.01
    np.testing.assert_allclose(own, other, atol=0.02 * np.ptp(other, axis=0).max())


def test_biases_are_found():
    imu = {"gyro_bias": 0.1, "accelerometer_bias": 0.5, "noise_seed": 3}
    scenario = imu_study.scenario_of(random_robot(1), 14, 0.01, imu, 1).replace({"sensors.imu.scale_error": 0.0})
    loop = SteppedLoop(scenario)
    loop.begin()
    for _ in range(4000):
        loop.run_parts()
        loop.move()
    error = loop.runner.state("observer")["bias"][0] - loop.runner.state("imu")["offset"][0]
    assert np.abs(loop.runner.state("imu")["offset"][0]).max() > 0.1
    assert np.abs(error[:3]).max() < 0.005
    assert np.abs(error[3:]).max() < 0.05


def test_readings_beyond_the_range_are_ignored():
    free, cut = ({"gyro_range": size, "accelerometer_range": size} for size in (30.0, 0.05))
    # Every reading is saturated, and so none is used.
    assert errors_of(cut) == pytest.approx(errors_of(None), rel=0.1)
    assert errors_of(free) < 0.5 * errors_of(cut)


def test_an_observer_may_leave_the_sensor_out():
    with_sensor, without = (
        SteppedLoop(Scenario.from_dict({
            "sensors": {"kind": "encoders", "imu": imu},
            "estimator": {"kind": "observer", "imu": False},
            "plant": "closed_form",
        }))
        for imu in ({}, None)
    )  # fmt: skip
    for loop in (with_sensor, without):
        loop.begin()
        for _ in range(50):
            loop.run_parts()
            loop.move()
    np.testing.assert_array_equal(with_sensor.measured, without.measured)
    assert np.isfinite(with_sensor.runner.signal("imu")).all()
