"""A loop in real time: its clock, and its priority over other processes, threads and the garbage collector."""

from __future__ import annotations

import gc
import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SWITCH_INTERVAL = 0.0005  # [s] after which a thread releases Python's lock for a waiting one.


class Pace:
    """Ticks with a constant period on the monotonic clock, from now; a late tick does not delay later ones.

    A loop that is more than `max_lateness` [s] late does not catch up: all further ticks are shifted.
    """

    def __init__(self, period: float, max_lateness: float = math.inf) -> None:
        self.period, self.tick = period, 0
        self._max_lateness, self._start = max_lateness, time.monotonic()

    @property
    def due(self) -> float:
        """Time of the present tick on the monotonic clock [s]."""
        return self._start + self.tick * self.period

    def advance(self, skip: bool = False) -> None:
        """Goes to the next tick, or with `skip` to the latest of several that are due."""
        now = time.monotonic()
        self.tick = max(self.tick + 1, int((now - self._start) / self.period) if skip else 0)
        if now - self.due > self._max_lateness:
            self._start += now - self.due

    def wait(self) -> float:
        """Waits until the present tick is due; returns its lateness [s]."""
        if (rest := self.due - time.monotonic()) > 0.0:
            time.sleep(rest)
        return time.monotonic() - self.due


@contextmanager
def real_time() -> Iterator[None]:
    """Gives this thread priority over other processes, if the system allows it, and garbage collection little work.

    Other threads of the process get the next lower priority, because this one may wait for Python's lock in one of
    them. The collector checks new objects only; checking all of them takes 0.1 s.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    _set_priorities("SCHED_RR", 1, 2)
    try:
        yield
    finally:
        _set_priorities("SCHED_OTHER", 0, 0)
        gc.unfreeze()
        sys.setswitchinterval(before)


def _set_priorities(policy: str, others: int, this: int) -> None:
    """Sets priorities of threads on Linux; it needs CAP_SYS_NICE, or `rtprio` in limits.conf."""
    with suppress(AttributeError, OSError):
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), getattr(os, policy), os.sched_param(others))
        os.sched_setscheduler(0, getattr(os, policy), os.sched_param(this))
