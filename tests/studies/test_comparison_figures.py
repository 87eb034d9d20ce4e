import numpy as np
import pytest

from stewart_drake.studies.comparison_table import settling_time, sine_response


@pytest.mark.parametrize("rate", [0.5, 2.0])
@pytest.mark.parametrize("start", [0.0, 3.0])
def test_settling_of_an_exponential_decay_is_known(rate, start):
    time = 0.001 * np.arange(12001)
    size = np.where(time < start, 9.0, np.exp(-rate * (time - start)))
    assert settling_time(time, size, 0.05, start) == pytest.approx(np.log(20.0) / rate, abs=2e-3)


def test_settling_counts_the_last_time_outside_the_band():
    time = np.arange(6.0)
    assert settling_time(time, np.array([5.0, 0.0, 5.0, 0.0, 0.0, 0.0]), 1.0) == 3.0
    assert settling_time(time, np.zeros(6), 1.0) == 0.0
    assert settling_time(time, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 5.0]), 1.0) is None
    assert settling_time(time, np.full(6, np.nan), 1.0) is None
    assert settling_time(time, np.zeros(6), 1.0, start=9.0) is None


@pytest.mark.parametrize(("ratio", "lag"), [(1.0, 0.0), (0.25, 2.0), (1.3, -0.4)])
def test_the_response_to_a_sine_is_found_in_spite_of_offset_and_harmonics(ratio, lag):
    time = 0.001 * np.arange(2000)
    angle = 2.0 * np.pi * 5.0 * time
    reference = 0.3 + 0.01 * np.sin(angle + 0.7)
    response = 0.31 + 0.01 * ratio * (np.sin(angle + 0.7 - lag) + 0.1 * np.sin(3.0 * angle))
    got, rest = sine_response(time, reference, response, 5.0)
    assert abs(got) == pytest.approx(ratio, rel=1e-9)
    assert np.angle(got) == pytest.approx(-lag, abs=1e-9)
    assert rest == pytest.approx(0.1, rel=1e-9)
