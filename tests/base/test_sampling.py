import math
from fractions import Fraction

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.sampling import decimal, on_grid, steps_per

FAMILIES = (
    [1e-6, 1e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.125, 0.25, 0.5, 1.0, 2.0],
    [2.0**-k for k in range(1, 13)],
    [1.0 / 3000.0, 1.0 / 1500.0, 1.0 / 600.0, 1.0 / 300.0, 1.0 / 30.0, 1.0 / 3.0],
)
PAIRS = [
    (fast, slow, round(slow / fast))
    for family in FAMILIES
    for fast in family
    for slow in family
    if slow > fast and math.isclose(slow / fast, round(slow / fast), rel_tol=1e-12)
]


def test_a_multiple_of_a_period_is_the_same_multiple_on_the_grid():
    assert len(PAIRS) > 200
    assert [pair for pair in PAIRS if Fraction(on_grid(pair[1])) != pair[2] * Fraction(on_grid(pair[0]))] == []


@given(st.floats(1e-6, 0.1), st.integers(1, 1000))
@example(1.0 / 7000.0, 700)
@example(0.0333333, 3)
@example(2.0**-9, 8)
def test_off_the_grid_too_a_tick_never_comes_after_the_plants_step(time_step, ratio):
    # A tick that comes after the step of its own time would see the plant one step too late.
    period = ratio * time_step
    assume(period <= 10.0)
    assert on_grid(period) <= ratio * on_grid(time_step)


@given(st.floats(1e-6, 0.1), st.integers(1, 10**5))
def test_a_whole_multiple_is_counted_however_it_was_rounded(time_step, count):
    period = count * time_step
    for neighbour in (period, math.nextafter(period, math.inf), math.nextafter(period, 0.0)):
        assert steps_per("key", neighbour, time_step) == count


@pytest.mark.parametrize("bad", [0.0, -0.001, math.nan, math.inf, -math.inf])
def test_what_drake_would_fire_once_is_no_period(bad):
    for ask in (lambda: on_grid(bad), lambda: steps_per("log_period", bad, 0.001), lambda: steps_per("p", 0.005, bad)):
        with pytest.raises(ConfigurationError, match=r"positive|multiple"):
            ask()


@pytest.mark.parametrize("seconds", [0.001, 0.0005, 0.00025, 0.0007, 1.0 / 192.0, 1.0 / 4096.0, 5.0])
def test_the_decimal_time_of_a_period_on_the_grid(seconds):
    assert decimal(on_grid(seconds)) == pytest.approx(seconds, rel=1e-15)
    assert decimal(0.0012345678901) == 0.0012345678901
    assert decimal(on_grid(1.0 / 7000.0)) == on_grid(1.0 / 7000.0)
