"""Entry point of the command line: runs a command, prints its errors as lines, and sets the exit status."""

from __future__ import annotations

import signal
import sys
import traceback
from io import StringIO, TextIOWrapper

import click

from stewart_drake.base.atomic_files import DISK_FULL
from stewart_drake.base.errors import ConfigurationError, StewartDrakeError, quiet_libraries, raised_at
from stewart_drake.cli.options import EXIT_BAD_INPUT, EXIT_INTERNAL, EXIT_INTERRUPTED, EXIT_RUN_FAILED, cli
from stewart_drake.cli.terminal import drop_output, print_error

DEBUG = "--debug"  # Anywhere among the arguments; prints the traceback of an error.


def main() -> None:
    """Runs a command and exits with its status; errors are lines without a traceback.

    SIGTERM and SIGHUP, from a cluster or a broken connection, act as Ctrl-C.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        # Under `nohup` SIGHUP stays ignored.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    # A closed stream is None.
    sys.stdout, sys.stderr = (stream or StringIO() for stream in (sys.stdout, sys.stderr))
    for stream in (sys.stdout, sys.stderr):
        # A character that the terminal's encoding does not have is printed as a question mark.
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
        # click and rich turn a broken pipe, as with `| head`, into SystemExit.
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
    """Prints an error and returns the exit status."""
    if isinstance(error, click.Abort):
        # click raises Abort for Ctrl-C, and also at the end of a file.
        error = error.__cause__ or error
    # Ctrl-C while a compiled module loads becomes an ImportError.
    if isinstance(error, KeyboardInterrupt) or isinstance(error.__cause__, KeyboardInterrupt):
        # A second Ctrl-C has nothing to interrupt.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print_error("interrupted")
        return EXIT_INTERRUPTED
    if DEBUG in sys.argv:
        traceback.print_exception(error)
    if isinstance(error, click.ClickException):
        print_error(error.format_message())
        return EXIT_BAD_INPUT
    if isinstance(error, ConfigurationError):
        for line in str(error).splitlines():
            print_error(line)
        return EXIT_BAD_INPUT
    if isinstance(error, StewartDrakeError):
        print_error(f"{error.reason}: {error}")
        return EXIT_RUN_FAILED
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        # Files raise a DiskError, so this is standard output.
        drop_output()
        print_error(f"disk: standard output: {error.strerror}")
        return EXIT_RUN_FAILED
    if isinstance(error, MemoryError):
        print_error("out of memory")
        return EXIT_RUN_FAILED
    # Also a SystemExit of a failed check in Drake.
    print_error(f"internal error: {type(error).__name__}: {error}{raised_at(error)}; {DEBUG} shows where")
    return EXIT_INTERNAL
