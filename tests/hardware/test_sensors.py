import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import vectors

from stewart_drake import ConfigurationError, load_scenario, run
from stewart_drake.analysis.linear_loop import linear_loops
from stewart_drake.hardware.faults import EncoderFault, PoseFault, faulty_sensor_part
from stewart_drake.hardware.sensors import EncoderOptions, encoder_part
from stewart_drake.scenario.assembly import control_side


def read(options, angles, ticks=1):
    """Readings of ticks, the angles being the same."""
    part, readings = encoder_part(options), []
    state = part.initial.copy()
    for _ in range(ticks):
        part.tick(np.concatenate([angles, np.zeros(6)]), state)
        readings.append(state["reading"][0].copy())
    return np.array(readings)


@given(vectors(6, 3.0), st.integers(1, 24), vectors(6, 0.01))
def test_readings_are_whole_counts_of_angle_plus_offset(angles, bits, offset):
    (readings,) = read(EncoderOptions(resolution_bits=bits, offset=tuple(offset)), angles)
    quantum = 2.0 * np.pi / 2**bits
    np.testing.assert_allclose(readings / quantum, np.round(readings / quantum), atol=1e-6)
    assert np.abs(readings - angles - offset).max() <= 0.5 * quantum * (1.0 + 1e-9)
    np.testing.assert_array_equal(
        read(EncoderOptions(resolution_bits=0, offset=tuple(offset)), angles)[0], angles + offset
    )


READINGS = np.arange(60.0).reshape(10, 6)
PERIOD = 0.001


def says(*faults, readings=READINGS):
    """What a sensor says over ten ticks of 1 ms."""
    part = faulty_sensor_part(faults, 6, PERIOD)
    state, said = part.initial.copy(), []
    for tick, reading in enumerate(readings):
        part.tick(reading, np.array([PERIOD * tick]), state)
        said.append(state["reading"][0].copy())
    return np.array(said)


ALL = slice(None)
FAULTS = [
    (EncoderFault(kind="freeze", leg=2, time=0.003, duration=0.004), slice(3, 7), 2, READINGS[2, 2]),
    (EncoderFault(kind="freeze", leg=0), ALL, 0, READINGS[0, 0]),
    (EncoderFault(kind="reversed", leg=5, time=0.003), slice(3, 10), 5, 2.0 * READINGS[2, 5] - READINGS[3:, 5]),
    (EncoderFault(kind="inverted", leg=0, time=0.002), slice(2, 10), 0, -READINGS[2:, 0]),
    (EncoderFault(kind="swapped", leg=1, other=4), ALL, [1, 4], READINGS[:, [4, 1]]),
    (EncoderFault(kind="drift", leg=3, size=2.0), ALL, 3, READINGS[:, 3] + 0.002 * np.arange(10)),
    (PoseFault(kind="freeze", time=0.002, duration=0.002), slice(2, 4), ALL, READINGS[1]),
    (PoseFault(kind="nan", time=0.006), slice(6, 10), ALL, np.nan),
]


@pytest.mark.parametrize(("fault", "rows", "channels", "said"), FAULTS)
def test_a_fault_changes_its_channels_alone_while_it_lasts(fault, rows, channels, said):
    expected = READINGS.copy()
    expected[rows, channels] = said
    np.testing.assert_allclose(says(fault), expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("leg", [2, None])
@given(delay=st.integers(1, 12), first=st.integers(0, 9))
def test_a_late_encoder_gives_earlier_readings(leg, delay, first):
    told = says(EncoderFault(kind="late", leg=leg, delay=PERIOD * delay, time=PERIOD * first))
    before = np.maximum(np.arange(10) - delay, 0)
    expected, legs = READINGS.copy(), slice(None) if leg is None else leg
    expected[first:, legs] = READINGS[before[first:]][:, legs]
    np.testing.assert_array_equal(told, expected)
    if leg is None:
        # So is a pose, as a whole; part of a tick late is a tick late.
        told = says(PoseFault(kind="late", delay=PERIOD * (delay - 0.6), time=PERIOD * first))
        np.testing.assert_array_equal(told, expected)


@pytest.mark.parametrize("kind", ["drake", "closed_form"])
@pytest.mark.parametrize("sensors", [{"kind": "ideal"}, {"kind": "encoders", "resolution_bits": 0}])
def test_an_old_reading_is_that_of_so_many_milliseconds_ago(kind, sensors):
    changes = {"plant": {"kind": kind}, "sensors": {**sensors, "delay": 0.0035}, "plant.time_step": 5e-4}
    loop = {"controller": {"kind": "feedforward", "period": 0.002}, "duration": 0.1, "log_period": 5e-4}
    servos = {
        "motors": {"kind": "position", "stiffness": 50.0},
        "estimator": {"kind": "difference"},
        "tuner": "fixed",
        "safety": None,
    }
    log = run(load_scenario("exact_breathing").replace({**loop, **servos, **changes}), check=False)
    # A row before its tick's reading has the one of the tick before.
    ticks = np.arange(8, len(log.time), 4)
    np.testing.assert_allclose(log["measured_pose"][ticks], log["pose"][ticks - 7], atol=1e-7)
    np.testing.assert_allclose(log["measured_pose"][:8:4], log["pose"][:1].repeat(2, axis=0), atol=1e-7)
    # What was read is in the log beside what is true.
    read, true = ("reading", "crank_angle") if sensors["kind"] == "encoders" else ("pose_reading", "pose")
    np.testing.assert_allclose(log[read][ticks], log[true][ticks - 7], atol=1e-12)


def test_an_observer_that_knows_how_old_its_readings_are_holds_the_robot():
    scenario = load_scenario("exact_breathing").replace({"plant.kind": "closed_form", "sensors.delay": 0.02})
    assert scenario.controller_model.reading_age == scenario.control().controller_model.reading_age == 0.02
    known = scenario.replace({"duration": 2.0})
    log = run(known)
    assert log.status == "completed"
    assert np.abs(log["pose"][500:] - log["pose"][480:-20])[:, 0].max() > 1.5e-3
    np.testing.assert_allclose(log["measured_pose"][500:], log["pose"][500:], atol=3e-4)
    believed_fresh = known.replace({"model.reading_age": 0.0})
    assert run(believed_fresh).status in ("failed", "lost")
    for each, stable in ((known, True), (believed_fresh, False)):
        closed = linear_loops(each, each.start()[0][None]).closed[0]
        assert (np.abs(np.linalg.eigvals(closed)).max() < 1.0) == stable


def test_a_reading_too_old_for_an_observer_is_refused():
    with pytest.raises(ConfigurationError, match=r"^model\.reading_age: expected at most 0\.1 s, "):
        control_side(load_scenario("exact_breathing").replace({"model.reading_age": 0.15}))
