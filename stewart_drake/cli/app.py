"""The command line: all commands, and how each ends: in an exit status and, where something is wrong, in one line."""

from __future__ import annotations

import errno
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from stewart_drake.cli import (  # noqa: F401 - fill `cli`
    robot_commands,
    run_commands,
    study_commands,
    view_commands,
)
from stewart_drake.cli.options import EXIT_BAD_INPUT, EXIT_INTERNAL, EXIT_INTERRUPTED, EXIT_RUN_FAILED, cli
from stewart_drake.cli.terminal import drop_output, say
from stewart_drake.errors import ConfigurationError, StewartDrakeError, raised_at
from stewart_drake.runs.engine import quiet_libraries

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

TRACEBACK = "STEWART_DRAKE_TRACEBACK"
"""Environment variable: where it is set, an error that nobody expected is shown with its traceback."""
_AGAIN = 0.05  # [s] after which an interrupt that was dropped is raised again.


def main() -> None:
    """Runs a command; it ends in an exit status and, where something is wrong, in one line, never in a traceback.

    Beside what the commands say of themselves, 3 is also for a machine without memory, and 4 for an error that nobody
    expected: a mistake in this package, worth a report. STEWART_DRAKE_TRACEBACK=1 shows all of it.

    SIGTERM and SIGHUP, of a cluster that wants its machine back or a line that breaks, are taken as Ctrl-C.
    """
    with quiet_libraries():
        status = _status()
    try:
        # There is none where the shell has closed it.
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        status = _lost_output(error) or status
    sys.exit(status)


def _status() -> int:
    """Runs a command; what it ends with, for `sys.exit`."""
    try:
        with _interruptible():
            cli(standalone_mode=False)
        return 0
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _end("interrupted", EXIT_INTERRUPTED)
    except click.ClickException as error:
        return _end(error.format_message(), EXIT_BAD_INPUT)
    except ConfigurationError as error:
        return [_end(line, EXIT_BAD_INPUT) for line in str(error).splitlines()][-1]
    except StewartDrakeError as error:
        return _end(f"{error.reason}: {error}", EXIT_RUN_FAILED)
    except MemoryError:
        return _end("out of memory", EXIT_RUN_FAILED)
    except (Exception, SystemExit) as error:  # Drake says SystemExit where one of its checks fails
        if isinstance(error, SystemExit) and isinstance(error.code, int | None):
            return error.code or 0
        if isinstance(error, ImportError) and isinstance(error.__cause__, KeyboardInterrupt):
            # Ctrl-C while a compiled module loads comes out as this.
            return _end("interrupted", EXIT_INTERRUPTED)
        if isinstance(error, OSError) and error.errno in (errno.EPIPE, errno.ENOSPC):
            return _lost_output(error)
        if os.environ.get(TRACEBACK):
            traceback.print_exception(error)
        name = f"{type(error).__name__}: {error}{raised_at(error)}"
        return _end(f"internal error: {name}; set {TRACEBACK}=1 to see all of it", EXIT_INTERNAL)


def _end(text: str, status: int) -> int:
    say(text)
    return status


def _lost_output(error: OSError) -> int:
    """Standard output that nobody reads any more is no failure; one that cannot be written is."""
    drop_output(sys.stdout)
    if error.errno == errno.EPIPE:
        return 0
    return _end(f"standard output: expected one that can be written, got {error.strerror}", EXIT_BAD_INPUT)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Takes SIGTERM and SIGHUP as Ctrl-C, and raises again what Python has dropped of them.

    Python drops what is raised in a `__del__` or in a callback from C, as LLVM calls one when numba has compiled, but
    for a call of `sys.unraisablehook`. Without its callback numba may fail; that error is the interrupt's too.
    """
    dropped, before = False, sys.unraisablehook

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        # What `nohup` has shut out stays out.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)

    def hook(what: UnraisableHookArgs) -> None:
        nonlocal dropped
        if what.exc_type is KeyboardInterrupt:
            dropped = True
            # Raised here it would be dropped too.
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        elif not dropped:
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
        if not dropped:
            sys.unraisablehook = before
