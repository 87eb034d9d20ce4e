"""What makes a loop in real time late: other processes, other threads, and the garbage collector."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

TURN = 0.0005  # [s] after which a thread that has Python's lock gives it to one that waits.


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
