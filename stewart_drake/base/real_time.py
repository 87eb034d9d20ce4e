"""What makes a loop in real time late: other processes, and the garbage collector."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def real_time() -> Iterator[None]:
    """Within it this thread comes before others where the system allows that, and garbage is looked for in new objects.

    A whole collection takes 0.1 s. Threads and processes that are started within are ordinary ones.
    """
    gc.collect()
    gc.freeze()
    # Users may do so with CAP_SYS_NICE, or with `rtprio` in limits.conf.
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    try:
        yield
    finally:
        with suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        gc.unfreeze()
