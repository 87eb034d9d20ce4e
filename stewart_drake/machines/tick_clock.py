"""Estimates the tick of a paced machine from the numbers and times of its readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from statistics import median

from stewart_drake.machines.machine import Reading

WINDOW = 2.0  # [s] of readings over which the tick is averaged. A line fit would be sensitive to one late reading.
SHORT_WINDOW = 0.2  # [s] of readings over which a change of the tick is detected.
CHANGED = 0.25  # Relative change of both mean and median over the short window, above which the tick has changed.
INITIAL_WEIGHT = 0.5  # [s] of readings for which the initial tick counts.
PAUSE = 0.1  # [s] without a reading, beyond the expected ticks, that counts as a pause.
LATE = 1.5  # [ticks] between two readings above which the second is late, or one between them was lost.
TICK_TOLERANCE = 0.02  # Relative difference of the tick that is not reported.
LATE_TOLERANCE = 0.01  # Share of late readings that is not reported.


class _Mean:
    """Mean time per reading over a moving window [s] of gaps; a gap may span several numbers."""

    def __init__(self, window: float, gaps: Iterable[tuple[int, float]] = ()) -> None:
        self._window, self.gaps, self._count, self._span = window, deque[tuple[int, float]](), 0, 0.0
        for count, gap in gaps:
            self.add(count, gap)

    def add(self, count: int, gap: float) -> None:
        self.gaps.append((count, gap))
        self._count, self._span = self._count + count, self._span + gap
        while self._span > self._window and len(self.gaps) > 1:
            count, gap = self.gaps.popleft()
            self._count, self._span = self._count - count, self._span - gap

    @property
    def value(self) -> float:
        """[s] per reading; 0 before the first."""
        return self._span / self._count if self._count else 0.0


class TickClock:
    """Measures the tick of a machine, and counts its pauses and late readings.

    Attributes:
        tick: [s] from one reading to the next: the mean of the last `WINDOW` seconds without pauses.
    """

    def __init__(self, tick: float, known: float = INITIAL_WEIGHT) -> None:
        known_gaps = [(1, tick)] * round(known / tick)
        self.tick, self._last = tick, None  # type: float, Reading | None
        self._long, self._short, self._range = _Mean(WINDOW, known_gaps), _Mean(SHORT_WINDOW, known_gaps), (tick, tick)
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
        # The median keeps one late gap, and the short ones after it, from counting as a change.
        before, most, gaps = self._long.value, CHANGED * self._long.value, self._short.gaps
        if abs(self._short.value - before) > most and abs(median(gap / count for count, gap in gaps) - before) > most:
            self._long = _Mean(WINDOW, self._short.gaps)
        if (tick := self._long.value) > 0.0:
            self.tick, self._range = tick, (min(self._range[0], tick), max(self._range[1], tick))

    def report(self, expected: float) -> str | None:
        """Text on how the readings differ from the expected tick [s]; None if they do not."""
        least, most = self._range
        problems = []
        if least < (1.0 - TICK_TOLERANCE) * expected or most > (1.0 + TICK_TOLERANCE) * expected:
            among = (
                ""
                if most - least < TICK_TOLERANCE * expected
                else f", {1e3 * least:.2f} to {1e3 * most:.2f} ms on the way"
            )
            problems.append(f"its tick was {1e3 * self.tick:.2f} ms{among}, not {1e3 * expected:.4g} ms")
        if self._pauses:
            often = "once" if len(self._pauses) == 1 else f"{len(self._pauses)} times"
            problems.append(f"it paused {often}, for up to {max(self._pauses):.2f} s, and the motion waited")
        if self._late > LATE_TOLERANCE * self._total:
            problems.append(f"{self._late} of {self._total} readings came late, or after one that was lost")
        return "; ".join(problems) or None
