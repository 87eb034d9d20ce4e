import numpy as np
import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.sensor_faults import EncoderFault, PoseFault, faulty_reading

READINGS = np.arange(60.0).reshape(10, 6)


def says(*faults):
    """What a sensor says over ten ticks of 1 ms."""
    good, told = READINGS[0], []
    for tick, reading in enumerate(READINGS):
        spoilt, good = faulty_reading(faults, reading, 0.001 * tick, good)
        told.append(spoilt)
    return np.array(told)


def test_a_sensor_that_is_well_says_what_is():
    np.testing.assert_array_equal(says(), READINGS)


def test_a_frozen_encoder_repeats_its_last_good_reading_until_it_is_well():
    told = says(EncoderFault(kind="freeze", leg=2, time=0.003, duration=0.004))
    expected = READINGS.copy()
    expected[3:7, 2] = READINGS[2, 2]
    np.testing.assert_array_equal(told, expected)


def test_one_that_is_frozen_from_the_start_shows_the_start():
    np.testing.assert_array_equal(says(EncoderFault(kind="freeze", leg=0))[:, 0], READINGS[0, 0])


def test_nan_and_jump_last_as_long_as_they_say():
    told = says(
        EncoderFault(kind="nan", leg=1, time=0.002, duration=0.001),
        EncoderFault(kind="jump", leg=4, time=0.005, size=0.3),
    )
    assert np.isnan(told[2, 1])
    told[2, 1] = READINGS[2, 1]
    expected = READINGS.copy()
    expected[5:, 4] += 0.3
    np.testing.assert_array_equal(told, expected)


def test_a_pose_sensor_fails_as_a_whole():
    told = says(PoseFault(kind="freeze", time=0.002, duration=0.002), PoseFault(kind="nan", time=0.006))
    np.testing.assert_array_equal(told[:2], READINGS[:2])
    np.testing.assert_array_equal(told[2:4], READINGS[[1, 1]])
    np.testing.assert_array_equal(told[4:6], READINGS[4:6])
    assert np.isnan(told[6:]).all()


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: EncoderFault(kind="melt", leg=0), "kind"),
        (lambda: PoseFault(kind="jump"), "kind"),
        (lambda: EncoderFault(kind="nan", leg=6), "leg"),
        (lambda: EncoderFault(kind="nan", leg=0, time=-1.0), "time"),
        (lambda: PoseFault(kind="nan", duration=0.0), "duration"),
        (lambda: EncoderFault(kind="jump", leg=0, size=np.inf), "size"),
    ],
)
def test_a_bad_value_is_named(make, key):
    with pytest.raises(ConfigurationError) as caught:
        make()
    assert caught.value.key == f"sensors.faults.{key}"
