"""Units behind numbers in texts."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.units import UNITS, in_unit
from stewart_drake.references import SineReference


@given(st.floats(-1e6, 1e6), st.sampled_from([*UNITS]))
def test_a_number_with_a_unit_is_that_many_of_it(number, unit):
    base, size = UNITS[unit]
    assert in_unit(f"{number!r} {unit}", base) == pytest.approx(number * size, rel=1e-12)


def test_each_number_of_a_list_has_the_unit_of_its_place():
    given = ["30 deg", 0.1, 0, 0, 0, "50 mm"]
    assert SineReference(amplitude=given).amplitude == pytest.approx((math.radians(30), 0.1, 0.0, 0.0, 0.0, 0.05))
    with pytest.raises(ConfigurationError, match=r"amplitude: expected a number \[rad\], or one with .*deg"):
        SineReference(amplitude=["30 mm", 0, 0, 0, 0, 0])
