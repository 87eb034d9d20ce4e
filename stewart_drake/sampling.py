"""Sample times on which events of different rates coincide bit for bit."""

from __future__ import annotations

import math

from stewart_drake.errors import ConfigurationError

_GRID = 2.0**40


def on_grid(seconds: float) -> float:
    """The first multiple of 2^-40 s at or after `seconds`.

    Drake fires a periodic event at k * period. With decimal periods that drift apart by rounding (10 k * 0.0001 s and k * 0.001 s differ
    for 384 of the first 2001 k) a controller ticks just before or just after the plant, and in the second case sees it one step too late.
    Multiples of a power of two are exact up to 8192 s, so events coincide always. A period grows by less than 1e-12 s; it never
    shrinks, so that an event at a decimal time still comes before the plant's step of that time, as it should.
    """
    return math.ceil(seconds * _GRID) / _GRID


def steps_per(key: str, period: float, time_step: float) -> int:
    """Whole number of plant steps in `period`.

    Raises:
        ConfigurationError: `period` is not a positive whole multiple of `time_step`.
    """
    ratio = period / time_step if time_step > 0.0 and math.isfinite(time_step) else math.nan
    count = round(ratio) if math.isfinite(ratio) else 0
    if count < 1 or abs(ratio - count) > 1e-6:
        raise ConfigurationError(key, period, f"a whole multiple of the plant's time step {time_step:g} s")
    return count
