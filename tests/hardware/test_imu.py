"""The inertial sensor: its equation against a motion that is known in closed form, and what a data sheet adds to it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stewart_drake import ConfigurationError, Controller, load_scenario, run
from stewart_drake.hardware.faults import ImuFault, faulty_sensor_part
from stewart_drake.hardware.imu import ImuOptions, imu_part
from stewart_drake.hardware.moving_base import base_signal
from stewart_drake.references import SineReference
from stewart_drake.scenario.assembly import sensor_parts
from stewart_drake.scenario.scenario import Scenario

STEP, GRAVITY = 0.001, 9.81
NAMES = ("noise", "bias", "drift")
PERFECT = {f"{what}_{name}": 0.0 for what in ("gyro", "accelerometer") for name in NAMES}
PERFECT |= {"scale_error": 0.0, "bits": 32, "position": [0.05, -0.02, 0.03], "rotation": [0.4, -0.3, 1.2]}
AT_REST = SineReference(center=(0.0,) * 6, amplitude=(0.0,) * 6, angular_frequency=(1.0,) * 6)
ROLLING = SineReference(
    center=(0.0,) * 6, amplitude=(0.3, 0.2, 0.1, 0.05, 0.2, 0.1), angular_frequency=(5.0, 4.0, 3.0, 4.0, 5.0, 6.0)
)
SIZES = np.array([0.2, -0.15, 0.3, 0.02, 0.03, -0.02])
RATES = np.array([7.0, 5.0, 6.0, 9.0, 4.0, 8.0])


def motion(times):
    """Pose and rate (n, 12)."""
    phase = np.multiply.outer(times, RATES) + np.arange(6)
    return np.concatenate([SIZES * np.sin(phase), SIZES * RATES * np.cos(phase)], axis=1)


def readings(options, seconds=0.2, period=STEP, moving=motion, base=AT_REST):
    part = imu_part(ImuOptions.from_dict(options), GRAVITY, STEP, period)
    state, rows, times = part.initial.copy(), [], STEP * np.arange(round(seconds / STEP))
    for row, base_motion in zip(moving(times), base_signal(base, GRAVITY, times), strict=True):
        part.tick(row, base_motion, state)
        rows.append(state["imu"][0].copy())
    return np.array(rows)


def at_rest(times):
    return np.tile([0.1, -0.2, 0.3, 0.0, 0.0, 0.2, *np.zeros(6)], (len(times), 1))


def true_values(times, base=AT_REST):
    """Rate and specific force in the sensor's axes, by differences of its place and axes in the world."""
    place, turn = np.array(PERFECT["position"]), Rotation.from_euler("xyz", PERFECT["rotation"])

    def base_axes(t):
        return Rotation.from_euler("xyz", base.evaluate(t)[0][:, :3])

    def axes(t):
        return base_axes(t) * Rotation.from_euler("xyz", motion(t)[:, :3])

    def position(t):
        return base.evaluate(t)[0][:, 3:] + base_axes(t).apply(motion(t)[:, 3:6]) + axes(t).apply(place)

    h = 1e-4
    acceleration = (position(times + h) - 2.0 * position(times) + position(times - h)) / h**2
    sensor = axes(times) * turn
    rate = ((axes(times - h) * turn).inv() * (axes(times + h) * turn)).as_rotvec() / (2.0 * h)
    return np.concatenate([rate, sensor.inv().apply(acceleration + [0.0, 0.0, GRAVITY])], axis=1)


@pytest.mark.parametrize(("base", "error"), [(AT_REST, 2e-4), (ROLLING, 5e-4)])
def test_a_reading_is_rate_and_specific_force_of_its_place_in_the_middle_of_its_period(base, error):
    found, middles = readings(PERFECT, base=base)[1:], STEP * np.arange(0.5, 198.6)
    np.testing.assert_allclose(found, true_values(middles, base), atol=error)
    assert np.ptp(found, axis=0).min() > 0.1  # all six move


def test_a_slower_sensor_gives_the_mean_of_its_period_once_and_nan_between():
    fast, slow = readings(PERFECT), readings({**PERFECT, "period": 0.004})
    fresh = np.isfinite(slow).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(fresh), np.arange(0, 200, 4))
    np.testing.assert_allclose(slow[4::4], fast[1:197].reshape(-1, 4, 6).mean(axis=1), atol=1e-6)
    # A controller that ticks more rarely gets the newest reading at its tick.
    rare = readings({**PERFECT, "period": 0.002}, period=0.01)
    np.testing.assert_allclose(rare[10::10], readings({**PERFECT, "period": 0.002})[10::10], atol=1e-9)


def test_readings_are_counts_within_the_range():
    options = {**PERFECT, "bits": 10, "gyro_range": 0.5, "accelerometer_range": 9.0}
    found = readings(options)
    quantum = np.repeat([0.5, 9.0], 3) / 2**9
    np.testing.assert_allclose(found / quantum, np.rint(found / quantum), atol=1e-6)
    assert (np.abs(found).max(axis=0) <= [0.5] * 3 + [9.0] * 3).all()
    assert (np.abs(found[:, :3]) == 0.5).any()
    inside = np.abs(readings(PERFECT)) < np.repeat([0.5, 9.0], 3)
    assert np.abs(found - readings(PERFECT))[inside].max() <= 0.5 * quantum[3] * (1.0 + 1e-6)


def test_noise_has_its_density_at_any_period_and_repeats_by_its_seed():
    noisy = {**PERFECT, "gyro_noise": 1e-3, "accelerometer_noise": 0.01}
    for period in (0.001, 0.004):
        found = readings({**noisy, "period": period}, 4.0, moving=at_rest)
        spread = np.nanstd(found, axis=0) * np.sqrt(2.0 * period)
        np.testing.assert_allclose(spread, [1e-3] * 3 + [0.01] * 3, rtol=0.12)
    one, same, other = (readings({**noisy, "noise_seed": seed}, moving=at_rest) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_offsets_differ_by_seed_and_wander():
    seeds = range(40)
    first = np.array(
        [readings({**PERFECT, "gyro_bias": 0.1, "noise_seed": k}, 0.001, moving=at_rest)[0] for k in seeds]
    )
    assert 0.06 < first[:, :3].std() < 0.14
    last = [
        np.ptp(readings({**PERFECT, "gyro_drift": 0.1, "noise_seed": k}, 1.0, moving=at_rest)[[0, -1], :3], axis=0)
        for k in seeds
    ]
    assert 0.07 < np.sqrt(np.square(last).mean()) < 0.13


def scenario(**sensors):
    return Scenario.from_dict({"sensors": {"kind": "encoders", **sensors}, "estimator": "observer"})


def test_a_late_sensor_tells_of_the_motion_before():
    parts = {part.name: part for part in sensor_parts(scenario(imu={**PERFECT, "delay": 0.003}))}
    assert parts["imu"].connections["plant_pose"] == "imu_plant_pose"
    assert parts["imu_plant_pose_delay"].initial["pending"].shape == (1, 3, 12)


@pytest.mark.parametrize(("fault", "expected"), [
    ({"kind": "nan"}, [[1.0, 2.0], [np.nan] * 2, [np.nan] * 2, [np.nan] * 2]),
    ({"kind": "freeze"}, [[1.0, 2.0], [np.nan] * 2, [1.0, 2.0], [1.0, 2.0]]),
    ({"kind": "freeze", "channel": "gyro", "duration": 1.5}, [[1.0, 2.0], [np.nan] * 2, [1.0, 6.0], [7.0, 8.0]]),
    ({"kind": "jump", "channel": "accelerometer_z", "size": 0.5}, [[1.0, 2.0], [np.nan] * 2, [5.0, 6.5], [7.0, 8.5]]),
    ({"kind": "drift", "channel": "gyro_x", "size": 0.5}, [[1.0, 2.0], [np.nan] * 2, [5.5, 6.0], [8.0, 8.0]]),
    ({"kind": "late", "delay": 1.0}, [[1.0, 2.0], [1.0, 2.0], [np.nan] * 2, [5.0, 6.0]]),
])  # fmt: skip
def test_a_sensor_that_fails(fault, expected):
    # Rows of a gyroscope and an accelerometer; there is no new reading at 1 s.
    rows = np.array([[1.0, 2.0], [np.nan, np.nan], [5.0, 6.0], [7.0, 8.0]])
    part = faulty_sensor_part([ImuFault.from_dict({"time": 1.0, **fault})], 6, 1.0)
    state, found = part.initial.copy(), []
    for time, row in enumerate(rows):
        part.tick(row.take([0, 0, 0, 1, 1, 1]), np.array([float(time)]), state)
        found.append(state["reading"][0, [0, 5]].copy())
    np.testing.assert_array_equal(found, expected)


def test_a_model_knows_the_sensor_but_for_its_faults_and_what_it_believes_otherwise():
    imu = {"preset": "mpu6050", "position": [0.01, 0.0, 0.0], "faults": [{"kind": "nan", "time": 1.0}]}
    believed = (
        Scenario.from_dict(
            {"sensors": {"kind": "encoders", "imu": imu}, "model": {"imu": {"rotation": [0.0, 0.0, 0.1]}}}
        )
        .control()
        .controller_model.imu
    )
    assert (believed.rotation, believed.position) == ((0.0, 0.0, 0.1), (0.01, 0.0, 0.0))
    assert believed.gyro_range == ImuOptions.from_dict({"preset": "mpu6050"}).gyro_range
    assert "faults" not in believed.to_dict()
    assert "faults" not in scenario(imu=imu).controller_model.imu.to_dict()


def test_a_preset_sets_the_defaults_of_the_others():
    options = ImuOptions.from_dict({"preset": "mpu6050", "gyro_bias": 0.01})
    assert options.gyro_bias == 0.01
    assert options.accelerometer_noise == pytest.approx(400e-6 * 9.80665)
    assert ImuOptions.from_dict({"preset": "bmi088"}).gyro_noise == ImuOptions().gyro_noise


@pytest.mark.parametrize(("imu", "key"), [
    ({"rotation": [90.0, 0.0, 0.0]}, "sensors.imu.rotation"),
    ({"rotation": "upside down"}, "sensors.imu.rotation"),
    ({"rotation": [0.1, 0.2]}, "sensors.imu.rotation"),
    ({"position": [0.0, 0.0, 40.0]}, "sensors.imu.position"),
    ({"period": 0.0015}, "sensors.imu.period"),
    ({"period": 0.0}, "sensors.imu.period"),
    ({"delay": -0.001}, "sensors.imu.delay"),
    ({"bits": 4}, "sensors.imu.bits"),
    ({"gyro_range": 0.0}, "sensors.imu.gyro_range"),
    ({"preset": "bmi8"}, "sensors.imu.preset"),
    ({"axes": "xyz"}, "sensors.imu.axes"),
    ({"faults": [{"kind": "jump", "size": 0.1}]}, "sensors.imu.faults.0.channel"),
    ({"faults": [{"kind": "drift", "channel": "gyro"}]}, "sensors.imu.faults.0.size"),
    ({"faults": [{"kind": "nan", "channel": "yaw"}]}, "sensors.imu.faults.0.channel"),
    ({"faults": [{"kind": "nan", "leg": 2}]}, "sensors.imu.faults.0.leg"),
    ({"faults": [{"kind": "swapped"}]}, "sensors.imu.faults.0.kind"),
])  # fmt: skip
def test_a_sensor_that_cannot_be_is_one_line(imu, key):
    with pytest.raises(ConfigurationError, match=key.replace(".", r"\.")) as caught:
        scenario(imu=imu)
    assert "\n" not in str(caught.value)


def test_a_model_without_a_sensor_and_readings_of_another_size_are_one_line():
    with pytest.raises(ConfigurationError, match=r"model\.imu.*sensors\.imu"):
        load_scenario("exact_breathing").replace({"model.imu": {}, "sensors": "encoders"})
    controller, out = Controller(scenario(imu={})), np.empty(6)
    with pytest.raises(ConfigurationError, match=r"imu.*shape \(6,\)"):
        controller.step(np.zeros(6), 0.0, out, imu=np.zeros(5))


@pytest.mark.parametrize("kind", ["drake", "mujoco"])
def test_all_engines_give_the_same_readings(kind):
    def inertial(kind):
        plant = {"kind": kind, "time_step": 0.0005}
        loaded = load_scenario("exact_fig7", ["duration=0.2"])
        imu = {**PERFECT, "faults": [{"kind": "jump", "channel": "gyro_z", "size": 0.5, "time": 0.1}]}
        sensors = {"kind": "encoders", "resolution_bits": 0, "imu": imu}
        loaded = loaded.replace({"plant": plant, "sensors": sensors})
        return run(loaded)["imu"]

    one, other = inertial("closed_form"), inertial(kind)
    assert np.ptp(one, axis=0).max() > 0.1
    assert one[100, 2] - one[99, 2] == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(other, one, atol=5e-3)


def test_a_range_that_is_too_small_is_a_warning_and_the_run_goes_on():
    loaded = load_scenario("exact_fig7", ["duration=0.2", "plant.kind=closed_form"])
    imu = {**PERFECT, "gyro_range": 0.3}
    log = run(loaded.replace({"sensors": {"kind": "encoders", "imu": imu}, "estimator": "observer"}))
    (told,) = (each for each in log.warnings if each["name"] == "imu_saturated")
    assert (log.status, 0.0 < told["number"] <= 1.0) == ("completed", True)
