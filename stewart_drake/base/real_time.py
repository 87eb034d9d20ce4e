"""A loop in real time: its clock, and what makes it late: other processes and threads, and the garbage collector."""

from __future__ import annotations

import gc
import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

TURN = 0.0005  # [s] after which a thread that has Python's lock gives it to one that waits.


class Pace:
    """Equal ticks on the monotonic clock; tick 0 is now, and one that is late makes no other late.

    A loop that is more than `most_late` [s] late need not catch up: all further ticks are that much later.
    """

    def __init__(self, period: float, most_late: float = math.inf) -> None:
        self.period, self.tick = period, 0
        self._most_late, self._begun = most_late, time.monotonic()

    @property
    def due(self) -> float:
        """[s] of the monotonic clock, of the present tick."""
        return self._begun + self.tick * self.period

    def advance(self, leave_out: bool = False) -> None:
        """To the next tick, or with `leave_out` to the latest one that is due, where several are."""
        now = time.monotonic()
        self.tick = max(self.tick + 1, int((now - self._begun) / self.period) if leave_out else 0)
        if now - self.due > self._most_late:
            self._begun += now - self.due

    def wait(self) -> float:
        """Until the present tick is due; how late it is then [s]."""
        if (rest := self.due - time.monotonic()) > 0.0:
            time.sleep(rest)
        return time.monotonic() - self.due


@contextmanager
def real_time() -> Iterator[None]:
    """Within it this thread comes before other processes, where the system allows that, and garbage costs little.

    The other threads come right after it: one that has Python's lock and has to wait would keep this one waiting too.
    The collector looks at new objects alone; to look at all of them takes 0.1 s.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(TURN)
    gc.collect()
    gc.freeze()
    _come_first("SCHED_RR", 1, 2)
    try:
        yield
    finally:
        _come_first("SCHED_OTHER", 0, 0)
        gc.unfreeze()
        sys.setswitchinterval(before)


def _come_first(policy: str, others: int, this: int) -> None:
    """Sets priorities of threads on Linux; who may do so has CAP_SYS_NICE, or `rtprio` in limits.conf."""
    with suppress(AttributeError, OSError):
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), getattr(os, policy), os.sched_param(others))
        os.sched_setscheduler(0, getattr(os, policy), os.sched_param(this))
