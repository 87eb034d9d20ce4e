"""Ctrl-C ends a command, wherever it arrives."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_AGAIN = 0.05
"""[s] after which an interrupt that was dropped is raised again."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Takes SIGTERM and SIGHUP as Ctrl-C, and raises again what Python has dropped of them.

    Python drops what is raised in a `__del__` or in a callback from C, but for a call of `sys.unraisablehook`. While
    numba compiles many interrupts arrive there: a signal waits for the next line of Python, and what LLVM calls when it
    is done is such a callback. Without it numba may fail; that error is the interrupt's too.

    Raises:
        KeyboardInterrupt: In place of an error after an interrupt that was dropped.
    """
    interrupted = dropped = False

    def interrupt(*_: object) -> None:
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        # What `nohup` has shut out stays out.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    before = sys.unraisablehook

    def hook(what: UnraisableHookArgs) -> None:
        nonlocal dropped
        if what.exc_type is KeyboardInterrupt:
            dropped = True
            # Raised here it would be dropped too.
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        elif not interrupted:
            before(what)

    sys.unraisablehook = hook
    try:
        yield
    except Exception as error:
        if dropped:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        # After an interrupt what is half made complains until the process ends.
        if not interrupted:
            sys.unraisablehook = before
