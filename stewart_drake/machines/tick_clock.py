"""The tick of a machine that sets the pace: from the numbers and times of its readings, for as long as it runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from statistics import median

from stewart_drake.machines.machine import Reading

SPAN, RECENT, CHANGED = 2.0, 0.2, 0.25
"""[s] of readings of which the tick is the mean; [s] of the latest ones, and share by which their mean and median may
differ: from there on they alone count. No line is fitted to times of arrival: one that is late bends it."""
KNOWN = 0.5
"""[s] of readings that the tick counts for with which it begins."""
PAUSE = 0.1
"""[s] that nothing comes, beyond the ticks that were counted, from which on the machine has paused."""
LATE = 1.5
"""Ticks from one reading to the next of which on that is late, or one between them was lost."""
APART, MANY = 0.02, 0.01
"""Shares by which a tick may differ, and of readings that may be late, before that is told."""


class _Mean:
    """Of the last gaps of so many numbers each, of some seconds [s] in sum."""

    def __init__(self, most: float, gaps: Iterable[tuple[int, float]] = ()) -> None:
        self._most, self.gaps, self._count, self._span = most, deque[tuple[int, float]](), 0, 0.0
        for count, gap in gaps:
            self.add(count, gap)

    def add(self, count: int, gap: float) -> None:
        self.gaps.append((count, gap))
        self._count, self._span = self._count + count, self._span + gap
        while self._span > self._most and len(self.gaps) > 1:
            count, gap = self.gaps.popleft()
            self._count, self._span = self._count - count, self._span - gap

    @property
    def value(self) -> float:
        """[s] of a number; 0 before the first."""
        return self._span / self._count if self._count else 0.0


class TickClock:
    """Counts a machine's pauses and late readings, and measures its tick.

    Attributes:
        tick: [s] from one number to the next: the mean of the last `SPAN` seconds without pauses.
    """

    def __init__(self, tick: float, known: float = KNOWN) -> None:
        known_gaps = [(1, tick)] * round(known / tick)
        self.tick, self._last = tick, None  # type: float, Reading | None
        self._long, self._short, self._range = _Mean(SPAN, known_gaps), _Mean(RECENT, known_gaps), (tick, tick)
        self._pauses: list[float] = []
        self._late = self._total = 0

    def take(self, reading: Reading) -> None:
        """Counts a reading, if it is a new one."""
        last, self._last = self._last, reading
        if last is None or reading.number <= last.number:
            return
        count, gap = reading.number - last.number, reading.time - last.time
        if gap > count * self.tick + PAUSE:
            self._pauses.append(gap)
            return
        self._total += 1
        self._late += gap > (count - 1 + LATE) * self.tick
        self._long.add(count, gap)
        self._short.add(count, gap)
        # Not for one gap that was late, nor for those that make up for it.
        before, most, gaps = self._long.value, CHANGED * self._long.value, self._short.gaps
        if abs(self._short.value - before) > most and abs(median(gap / count for count, gap in gaps) - before) > most:
            self._long = _Mean(SPAN, self._short.gaps)
        if (tick := self._long.value) > 0.0:
            self.tick, self._range = tick, (min(self._range[0], tick), max(self._range[1], tick))

    def report(self, expected: float) -> str | None:
        """How it differs from the tick [s] that was expected, in words; None where it does not."""
        least, most = self._range
        told = []
        if least < (1.0 - APART) * expected or most > (1.0 + APART) * expected:
            among = "" if most - least < APART * expected else f", {1e3 * least:.2f} to {1e3 * most:.2f} ms on the way"
            told.append(f"its tick was {1e3 * self.tick:.2f} ms{among}, not {1e3 * expected:.4g} ms")
        if self._pauses:
            often = "once" if len(self._pauses) == 1 else f"{len(self._pauses)} times"
            told.append(f"it paused {often}, for up to {max(self._pauses):.2f} s, and the motion waited")
        if self._late > MANY * self._total:
            told.append(f"{self._late} of {self._total} readings came late, or after one that was lost")
        return "; ".join(told) or None
