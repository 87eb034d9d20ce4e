"""Random numbers by tick: the same seed and tick give the same number, however often and in which order it is asked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.scalars import is_finite

MAX_SEED = 2**63 - 1
_BLOCK = 1024


def tick_normal(seed: int, stream: int, tick: int, size: int) -> np.ndarray:
    """Standard normal numbers (size,) of a tick.

    Args:
        seed: Of the scenario, 0 to `MAX_SEED`.
        stream: Number of who asks; different streams of one seed are independent.
        tick: 0, 1, ...
        size: How many.
    """
    return _block(seed, stream, tick // _BLOCK, size, True)[tick % _BLOCK]


def tick_uniform(seed: int, stream: int, tick: int, size: int) -> np.ndarray:
    """Numbers (size,) in [0, 1) of a tick; see `tick_normal`."""
    return _block(seed, stream, tick // _BLOCK, size, False)[tick % _BLOCK]


@lru_cache(maxsize=64)
def _block(seed: int, stream: int, block: int, size: int, normal: bool) -> np.ndarray:
    # Philox counts: a block is reached without drawing those before it. The low counter words run within the block.
    generator = np.random.Generator(np.random.Philox(key=[seed, stream], counter=[0, 0, 0, block]))
    values = generator.standard_normal((_BLOCK, size)) if normal else generator.random((_BLOCK, size))
    values.flags.writeable = False
    return values


def check_seed(key: str, seed: object) -> None:
    """Raises a `ConfigurationError` for what is no seed."""
    if type(seed) is not int or not 0 <= seed <= MAX_SEED:
        raise ConfigurationError(key, seed, f"a whole number from 0 to {MAX_SEED}")


def check_leg(key: str, leg: object) -> None:
    """Raises a `ConfigurationError` for what is no leg."""
    if type(leg) is not int or not 0 <= leg <= 5:
        raise ConfigurationError(key, leg, "a leg, 0 to 5")


def check_real(key: str, value: object, low: float = 0.0, allowed: str = "a finite number, zero or positive") -> None:
    """Raises a `ConfigurationError` for what is not a finite number of at least `low`."""
    if not (is_finite(value) and value >= low):  # type: ignore[operator]
        raise ConfigurationError(key, value, allowed)


def check_positive(key: str, *values: object) -> None:
    """Raises a `ConfigurationError` for what is not a finite number above 0."""
    for value in values:
        check_real(key, value, float(np.finfo(float).tiny), "a positive number")
