import numpy as np
import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.section import (
    MAX_SEED,
    check_choice,
    check_fraction,
    check_leg,
    check_numbers,
    check_positive,
    check_positive_pair,
    check_real,
    check_seed,
    check_whole,
)


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1, 1.0, True, None])
def test_a_bad_seed_is_named(seed):
    with pytest.raises(ConfigurationError, match=r"x\.seed"):
        check_seed("x.seed", seed)


@pytest.mark.parametrize("leg", [-1, 6, 1.0, True, None])
def test_a_bad_leg_is_named(leg):
    with pytest.raises(ConfigurationError, match="leg"):
        check_leg("leg", leg)


@pytest.mark.parametrize("value", [-1e-300, np.nan, np.inf, True, "1", None])
def test_a_bad_number_is_named(value):
    with pytest.raises(ConfigurationError, match="key"):
        check_real("key", value)
    with pytest.raises(ConfigurationError, match="key"):
        check_positive("key", value)
    check_real("key", 0)
    with pytest.raises(ConfigurationError):
        check_positive("key", 0)
    with pytest.raises(ConfigurationError):
        check_real("key", 2.0, 0.0, "at most 1", 1.0)
    check_real("key", 1.0, 0.0, "at most 1", 1.0)


@pytest.mark.parametrize("value", [0.0, 1.0, np.nan, True, "0.5", None])
def test_the_ends_are_no_fraction(value):
    with pytest.raises(ConfigurationError, match="between 0 and 1"):
        check_fraction("key", value)
    check_fraction("key", 0.5)


@pytest.mark.parametrize("value", [0, 11, 5.0, True, "5", None])
def test_a_bad_whole_number_is_named(value):
    with pytest.raises(ConfigurationError, match=r"key.*a whole number from 1 to 10"):
        check_whole("key", value, 1, 10)
    for good in (1, 10):
        check_whole("key", good, 1, 10)


@pytest.mark.parametrize("value", ["green", "", None, ["red"], np.array(["red", "blue"])])
def test_what_may_be_chosen_is_named(value):
    with pytest.raises(ConfigurationError, match=r"key.*red, yellow or blue"):
        check_choice("key", value, "red", "yellow", "blue")
    check_choice("key", "blue", "red", "yellow", "blue")


@pytest.mark.parametrize("values", [(1.0,), (1.0, 2.0, 3.0), (1.0, np.inf), (1.0, True), None, 2.0, "12"])
def test_vectors_are_so_many_finite_numbers(values):
    with pytest.raises(ConfigurationError, match="2 finite numbers"):
        check_numbers("key", values, 2)
    with pytest.raises(ConfigurationError, match="two above 0"):
        check_positive_pair("key", values, "two above 0")
    for pair in ((-1.0, 0.0), (1.0, 0.0), [1.0, 0.0], np.array([1.0, 0.0])):
        check_numbers("key", pair, 2)
        with pytest.raises(ConfigurationError):
            check_positive_pair("key", pair, "two above 0")
