"""The tick of a machine that sets the pace: from the numbers and times of its readings, for as long as it runs."""

from __future__ import annotations

from collections import deque

from stewart_drake.machines.machine import Reading

SPAN = 2.0
"""[s] of readings of which the tick is the mean. No line is fitted to times of arrival: one that is late bends it."""
KNOWN = 0.5
"""[s] of readings that the tick counts for with which it begins."""
PAUSE = 0.1
"""[s] that nothing comes, beyond the ticks that were counted, from which on the machine has paused."""
LATE = 1.5
"""Ticks from one reading to the next of which on that is late, or one between them was lost."""
APART, MANY = 0.02, 0.01
"""Shares by which a tick may differ, and of readings that may be late, before that is told."""


class TickClock:
    """Time goes on by a tick with each number, and a tick is the mean of the last `SPAN` seconds without pauses.

    Attributes:
        tick: [s] from one number to the next, as measured.
    """

    def __init__(self, tick: float, known: float = KNOWN) -> None:
        count = round(known / tick)
        self.tick, self._nominal, self._last = tick, tick, None  # type: float, float, Reading | None
        self._gaps = deque([(count, count * tick)]) if count else deque()
        self._count, self._span, self._range = count, count * tick, (tick, tick)
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
        self._gaps.append((count, gap))
        self._count, self._span = self._count + count, self._span + gap
        while self._span > SPAN:
            count, gap = self._gaps.popleft()
            self._count, self._span = self._count - count, self._span - gap
        if self._span > 0.0:
            self.tick = self._span / self._count
            self._range = min(self._range[0], self.tick), max(self._range[1], self.tick)

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
