import numpy as np
import pytest
from conftest import field_of
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.faults import EncoderFault, PoseFault
from stewart_drake.hardware.sensors import faulty_sensor_part

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


def test_a_frozen_encoder_repeats_its_last_good_reading_until_it_is_well():
    told = says(EncoderFault(kind="freeze", leg=2, time=0.003, duration=0.004))
    expected = READINGS.copy()
    expected[3:7, 2] = READINGS[2, 2]
    np.testing.assert_array_equal(told, expected)
    # From the start it shows the start; one that is well says what is.
    np.testing.assert_array_equal(says(EncoderFault(kind="freeze", leg=0))[:, 0], READINGS[0, 0])
    np.testing.assert_array_equal(says(), READINGS)


def test_a_pose_sensor_fails_as_a_whole():
    told = says(PoseFault(kind="freeze", time=0.002, duration=0.002), PoseFault(kind="nan", time=0.006))
    np.testing.assert_array_equal(told[:2], READINGS[:2])
    np.testing.assert_array_equal(told[2:4], READINGS[[1, 1]])
    np.testing.assert_array_equal(told[4:6], READINGS[4:6])
    assert np.isnan(told[6:]).all()


@pytest.mark.parametrize("leg", [2, None])
@given(delay=st.integers(1, 12), first=st.integers(0, 9))
def test_a_late_encoder_says_what_it_read_before(leg, delay, first):
    told = says(EncoderFault(kind="late", leg=leg, delay=PERIOD * delay, time=PERIOD * first))
    before = np.maximum(np.arange(10) - delay, 0)
    expected, legs = READINGS.copy(), slice(None) if leg is None else leg
    expected[first:, legs] = READINGS[before[first:]][:, legs]
    np.testing.assert_array_equal(told, expected)
    if leg is None:
        # So is a pose, as a whole; part of a tick late is a tick late.
        told = says(PoseFault(kind="late", delay=PERIOD * (delay - 0.6), time=PERIOD * first))
        np.testing.assert_array_equal(told, expected)


def test_drift_grows_from_when_it_began():
    error = says(EncoderFault(kind="drift", leg=3, size=2.0, time=0.004)) - READINGS
    np.testing.assert_allclose(error[:, 3], 2.0 * np.maximum(PERIOD * np.arange(10) - 0.004, 0.0), atol=1e-12)
    assert not np.delete(error, 3, axis=1).any()


def test_an_encoder_that_counts_backwards_begins_where_it_was_and_comes_back_where_it_would_be():
    told = says(EncoderFault(kind="reversed", leg=5, time=0.003, duration=0.004))
    steps, true = np.diff(told[:, 5]), np.diff(READINGS[:, 5])
    np.testing.assert_array_equal(steps[2:6], -true[2:6])
    np.testing.assert_array_equal(told[7:], READINGS[7:])
    np.testing.assert_array_equal(told[:3], READINGS[:3])
    # From the start it begins there.
    wrong = says(EncoderFault(kind="reversed", leg=5))[:, 5]
    np.testing.assert_array_equal(wrong + READINGS[:, 5], 2.0 * READINGS[0, 5])


def test_inverted_and_swapped_readings():
    told = says(EncoderFault(kind="inverted", leg=0, time=0.002), EncoderFault(kind="swapped", leg=1, other=4))
    expected = READINGS[:, [0, 4, 2, 3, 1, 5]]
    expected[2:, 0] *= -1.0
    np.testing.assert_array_equal(told, expected)


@given(st.lists(st.sampled_from(["freeze", "late", "drift", "reversed", "inverted", "swapped", "jump"]), max_size=5))
def test_whatever_faults_come_together_a_sensor_that_is_well_again_says_what_is(kinds):
    more = {"late": {"delay": 0.002}, "swapped": {"other": 5}, "drift": {"size": 1.0}, "jump": {"size": 0.1}}
    told = says(
        *(EncoderFault(kind=k, leg=i, time=0.002, duration=0.003, **more.get(k, {})) for i, k in enumerate(kinds))
    )
    assert np.isfinite(told).all()
    np.testing.assert_array_equal(told[[0, 1, *range(5, 10)]], READINGS[[0, 1, *range(5, 10)]])


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: EncoderFault(kind="late", leg=0), "delay"),
        (lambda: EncoderFault(kind="drift", leg=0, delay=0.1), "delay"),
        (lambda: PoseFault(kind="late", delay=0.0), "delay"),
        (lambda: EncoderFault(kind="swapped", leg=0), "other"),
        (lambda: EncoderFault(kind="swapped", leg=3, other=3), "other"),
        (lambda: EncoderFault(kind="swapped", leg=None, other=3), "leg"),
        (lambda: EncoderFault(kind="freeze", leg=0, other=3), "other"),
    ],
)
def test_a_bad_value_is_named(make, key):
    with pytest.raises(ConfigurationError) as caught:
        make()
    assert field_of(caught.value) == f"sensors.faults.{key}"
