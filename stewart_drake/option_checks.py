"""Checks of values in a scenario: each raises the one line that names the key, the value and what is allowed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.scalars import is_finite, plain

MAX_SEED = 2**63 - 1


def check_real(
    key: str,
    value: Any,
    low: float = 0.0,
    allowed: str = "a finite number, zero or positive",
    high: float = math.inf,
) -> None:
    """Raises a `ConfigurationError` for what is not a finite number from `low` to `high`."""
    if not (is_finite(value) and low <= value <= high):
        raise ConfigurationError(key, value, allowed)


def check_positive(key: str, *values: Any, allowed: str = "a positive number") -> None:
    """Raises a `ConfigurationError` for what is not a finite number above 0."""
    for value in values:
        check_real(key, value, float(np.finfo(float).tiny), allowed)


def check_fraction(key: str, value: Any) -> None:
    """Raises a `ConfigurationError` for what is not a number strictly between 0 and 1."""
    if not (is_finite(value) and 0.0 < value < 1.0):
        raise ConfigurationError(key, value, "a number between 0 and 1")


def check_whole(key: str, value: Any, low: int, high: int, allowed: str | None = None) -> None:
    """Raises a `ConfigurationError` for what is not a whole number from `low` to `high`."""
    if type(value) is not int or not low <= value <= high:
        raise ConfigurationError(key, value, allowed or f"a whole number from {low} to {high}")


def check_seed(key: str, seed: Any) -> None:
    """Raises a `ConfigurationError` for what is no seed."""
    check_whole(key, seed, 0, MAX_SEED)


def check_leg(key: str, leg: Any) -> None:
    """Raises a `ConfigurationError` for what is no leg."""
    check_whole(key, leg, 0, 5, "a leg, 0 to 5")


def check_other_leg(key: str, kind: str, leg: Any, other: Any) -> None:
    """Raises a `ConfigurationError` unless two swapped legs are two, and only they have an `other`."""
    if kind != "swapped":
        if other is not None:
            raise ConfigurationError(key, other, "null, but for kind swapped")
        return
    check_leg(key, other)
    if other == leg:
        raise ConfigurationError(key, other, f"another leg than {leg}")


def check_choice(key: str, value: Any, *choices: str) -> None:
    """Raises a `ConfigurationError` for what is none of at least two choices."""
    if not isinstance(value, str) or value not in choices:
        raise ConfigurationError(key, value, f"{', '.join(choices[:-1])} or {choices[-1]}")


def check_numbers(key: str, values: Any, size: int, allowed: str | None = None) -> None:
    """Raises a `ConfigurationError` for what is not so many finite numbers."""
    if not are_numbers(values, size):
        raise ConfigurationError(key, values, allowed or f"{size} finite numbers")


def check_positive_pair(key: str, pair: Any, allowed: str) -> None:
    """Raises a `ConfigurationError` for what is not two finite numbers above 0."""
    if not (are_numbers(pair, 2) and all(x > 0.0 for x in pair)):
        raise ConfigurationError(key, pair, allowed)


def are_numbers(values: Any, size: int) -> bool:
    """Whether `values` are so many finite numbers."""
    values = plain(values)
    return isinstance(values, tuple) and len(values) == size and all(is_finite(x) for x in values)
