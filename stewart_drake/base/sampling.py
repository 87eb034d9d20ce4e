"""Sample times with exact multiples, so that events of different rates coincide to the last bit."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from stewart_drake.base.errors import ConfigurationError

_PER_SECOND = 192_000_000  # Units in a second; a microsecond, a third and a 64th of it (so 1/4096 s) are whole units.
_UNIT = math.ceil(2.0**56 / _PER_SECOND) / 2.0**56  # [s] Rounded up to 29 bits, by a relative 1.4e-10.
_EARLY_UNIT = math.floor(2.0**60 / _PER_SECOND) / 2.0**60  # [s] Rounded down, by a relative 2.7e-11.
_STRETCH = 1.0 + 2.0**-32  # More than the rounding of the unit.
_SAME_TIME = 1e-9  # [s] or share of the time between instants that count as equal.
_TOLERANCE = 1e-11  # Relative difference of decimal numbers that count as the same sample time.


def on_grid(seconds: float) -> float:
    """Sample time near `seconds` with exact multiples: that of n * x is n times that of x, to the last bit.

    Drake triggers a periodic event at k * period. Decimal periods drift apart by rounding (10 k * 0.0001 s and
    k * 0.001 s differ for 384 of the first 2001 k), and a controller that ticks just after the plant sees its state one
    step too late. Here a period (up to 5 s, and any round one beyond) is a whole number of units with so few bits that
    products are exact, so that events coincide. A period is only ever rounded up, by a relative 1.4e-10, so that an
    event at a decimal time still comes before the plant's step at that time. A period that is no whole number of units
    (1/7000 s) is rounded up further: not all its multiples coincide, but ticks never come after the plant's step.

    Raises:
        ConfigurationError: `seconds` is not finite or not positive; Drake would trigger the event only once.
    """
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise ConfigurationError("period", seconds, "a positive number of seconds")
    count = round(seconds * _PER_SECOND)
    if abs(seconds * _PER_SECOND - count) <= _TOLERANCE * count:
        return count * _UNIT
    return math.ceil(seconds * _STRETCH * 2.0**40) / 2.0**40


def decimal(seconds: float) -> float:
    """The inverse of `on_grid` for round sample times; other times stay."""
    near = round(seconds / _UNIT) / _PER_SECOND
    return near if near > 0.0 and on_grid(near) == seconds else seconds


def just_before(seconds: float) -> float:
    """Sample time a little shorter than `seconds`, with multiples just before those of `seconds` and of `on_grid`.

    A system with this period reads a plant just before its step at a decimal time, whatever the rounding, and its
    output is valid for that step. Multiples of such periods coincide like those of `on_grid`.

    Raises:
        ConfigurationError: See `on_grid`.
    """
    count = round(on_grid(seconds) / _UNIT)
    if abs(seconds * _PER_SECOND - count) <= _TOLERANCE * count:
        return count * _EARLY_UNIT
    return math.floor(seconds / _STRETCH * 2.0**40) / 2.0**40


def times_of(steps: np.ndarray, time_step: float) -> np.ndarray:
    """Times (n,) [s] of steps (n,), as decimals for a decimal time step: 0.174 and not 0.17400000000000002."""
    per_second = round(1.0 / time_step)
    if per_second >= 1 and abs(per_second * time_step - 1.0) < 1e-15:
        return steps / per_second
    return steps * time_step


def unwrapped(angles: np.ndarray) -> np.ndarray:
    """Angles (n, k) [rad] without jumps by whole turns; the first ones are within half a turn."""
    angles = np.unwrap(angles, axis=0)
    return angles - 2.0 * math.pi * np.round(angles[0] / (2.0 * math.pi))


def steps_per(key: str, period: float, time_step: float, of: str = "the plant's time step") -> int:
    """Number of steps in a period; refused unless whole. `of` describes the step in the message."""
    ratio = period / time_step if time_step > 0.0 and math.isfinite(time_step) else math.nan
    count = round(ratio) if math.isfinite(ratio) else 0
    if count < 1 or abs(ratio - count) > _TOLERANCE * count:
        raise ConfigurationError(key, period, f"a whole multiple of {of} {time_step:g} s")
    return count


class InBlocks:
    """Values of a function of time, (n,) [s] -> (n, k), at multiples of `on_grid(period)`, computed in blocks.

    A block costs a tenth of single calls. The last block is kept; several runs may share this object.
    """

    _ROWS = 256  # Rows in a block.

    def __init__(self, function: Callable[[np.ndarray], np.ndarray], period: float) -> None:
        self._function, self.period = function, on_grid(period)
        self._table: tuple[int, np.ndarray, np.ndarray] = (-1, np.empty(0), np.empty(0))

    def at(self, step: int) -> np.ndarray:
        """Value (k,) at a multiple of the period."""
        return self._row(step)[1]

    def at_time(self, time: float) -> np.ndarray:
        """Value (k,) at a time [s]; fast at multiples of the period."""
        near, value = self._row(round(time / self.period))
        return value if abs(near - time) < _SAME_TIME * max(1.0, near) else self._function(np.array([time]))[0]

    def rows(self, count: int) -> np.ndarray:
        """Values (count, k) at the first multiples, equal to those of `at`; the function gets no later time."""
        whole, rest = divmod(max(count, 1), self._ROWS)
        parts = [self._block(block)[1] for block in range(whole)]
        kept, _, values = self._table
        if rest:
            parts.append(values[:rest] if kept == whole else self._block(whole, rest)[1])
        return np.concatenate(parts)[:count]

    def _block(self, block: int, rows: int = _ROWS) -> tuple[np.ndarray, np.ndarray]:
        times = np.arange(block * self._ROWS, block * self._ROWS + rows) * self.period
        return times, self._function(times)

    def _row(self, step: int) -> tuple[float, np.ndarray]:
        block, row = divmod(step, self._ROWS)
        # Read once, because another thread may replace it.
        kept, times, values = self._table
        if block != kept:
            times, values = self._block(block)
            self._table = block, times, values
        return times[row], values[row]
