"""The command line, and how each command ends: in an exit status and, where something is wrong, in lines."""

from __future__ import annotations

import signal
import sys
import traceback
from io import StringIO, TextIOWrapper

import click

from stewart_drake.base.atomic_files import DISK_FULL
from stewart_drake.base.errors import ConfigurationError, StewartDrakeError, quiet_libraries, raised_at
from stewart_drake.cli.options import EXIT_BAD_INPUT, EXIT_INTERNAL, EXIT_INTERRUPTED, EXIT_RUN_FAILED, cli
from stewart_drake.cli.terminal import drop_output, say

DEBUG = "--debug"
"""Anywhere among the arguments: the traceback of whatever goes wrong."""


def main() -> None:
    """Runs a command; it ends in an exit status and, where something is wrong, in lines without a traceback.

    SIGTERM and SIGHUP, of a cluster that wants its machine back or a line that breaks, are taken as Ctrl-C.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        # What `nohup` has shut out stays out.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    # A closed stream is None.
    sys.stdout, sys.stderr = (stream or StringIO() for stream in (sys.stdout, sys.stderr))
    for stream in (sys.stdout, sys.stderr):
        # A sign that the terminal's encoding does not have is a question mark there.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    arguments = [argument for argument in sys.argv[1:] if argument != DEBUG]
    try:
        with quiet_libraries():
            cli(arguments, prog_name="stewart-drake", standalone_mode=False)
        sys.stdout.flush()
        status = 0
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else "")
        status = 0
    except (SystemExit, BrokenPipeError) as error:
        # click and rich make a SystemExit of it where nobody reads any more, as with `| head`.
        if isinstance(error, BrokenPipeError) or isinstance(error.__context__, BrokenPipeError):
            drop_output()
            status = 0
        else:
            status = error.code if isinstance(error.code, int) else _end(error)
    except (Exception, KeyboardInterrupt) as error:
        status = _end(error)
    sys.exit(status)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _end(error: BaseException) -> int:
    """Says what went wrong, and gives the exit status."""
    if isinstance(error, click.Abort):
        # click makes one of Ctrl-C, and of the end of any file too.
        error = error.__cause__ or error
    # Ctrl-C while a compiled module loads comes out as an ImportError.
    if isinstance(error, KeyboardInterrupt) or isinstance(error.__cause__, KeyboardInterrupt):
        # Nothing is left that a second one could end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        say("interrupted")
        return EXIT_INTERRUPTED
    if DEBUG in sys.argv:
        traceback.print_exception(error)
    if isinstance(error, click.ClickException):
        say(error.format_message())
        return EXIT_BAD_INPUT
    if isinstance(error, ConfigurationError):
        for line in str(error).splitlines():
            say(line)
        return EXIT_BAD_INPUT
    if isinstance(error, StewartDrakeError):
        say(f"{error.reason}: {error}")
        return EXIT_RUN_FAILED
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        # Files raise a DiskError: this is what the command prints.
        drop_output()
        say(f"disk: standard output: {error.strerror}")
        return EXIT_RUN_FAILED
    if isinstance(error, MemoryError):
        say("out of memory")
        return EXIT_RUN_FAILED
    # Drake says SystemExit where one of its checks fails.
    say(f"internal error: {type(error).__name__}: {error}{raised_at(error)}; {DEBUG} shows where")
    return EXIT_INTERNAL
