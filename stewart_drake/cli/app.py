"""Command line: parse, call, print."""

from __future__ import annotations

import errno
import json
import os
import sys
import traceback
from pathlib import Path

import click

from stewart_drake.cli.calibrate_command import calibrate
from stewart_drake.cli.check_command import check
from stewart_drake.cli.common_options import EXIT_INTERRUPTED, OutPath, overrides, quiet_flag, trust_flag
from stewart_drake.cli.identify_command import excite, identify
from stewart_drake.cli.interrupts import interruptible
from stewart_drake.cli.live_command import live
from stewart_drake.cli.margins_command import margins
from stewart_drake.cli.reproduce_command import reproduce
from stewart_drake.cli.robots_command import robots, write_mjcf_command, write_sdf_command
from stewart_drake.cli.study_commands import compare, faults, sweep, tune
from stewart_drake.cli.train_command import collect, train
from stewart_drake.cli.tuner_command import tuner
from stewart_drake.cli.workspace_command import workspace
from stewart_drake.errors import ConfigurationError, StewartDrakeError, raised_at
from stewart_drake.runs.terminal import (
    ProgressBar,
    drop_output,
    print_run,
    quiet_libraries,
    shown_compiling,
)

EXIT_BAD_INPUT, EXIT_RUN_FAILED, EXIT_INTERNAL = 2, 3, 4
TRACEBACK = "STEWART_DRAKE_TRACEBACK"
"""Environment variable: where it is set, an error that nobody expected is shown with its traceback."""

_LONG = 100.0
"""[s] of a run whose check takes more than a second or two."""
_STATUS = {
    "completed": 0,
    "stopped": EXIT_RUN_FAILED,
    "lost": EXIT_RUN_FAILED,
    "failed": EXIT_RUN_FAILED,
    "interrupted": EXIT_INTERRUPTED,
}


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from stewart_drake.logs.versions import package_version

        click.echo(f"stewart-drake {package_version('stewart-drake') or 'not installed'}")
        context.exit()


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120}, invoke_without_command=True
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Show the version."
)
@click.pass_context
def cli(context: click.Context) -> None:
    """Closed-loop torque control of rotary Stewart platforms in Drake."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@cli.command()
@click.argument("scenario")
@click.option("--out", type=OutPath(), help="Folder for the results [default: runs/NAME, or runs/NAME-2, ...].")
@overrides()
@click.option("--force", is_flag=True, help="Replace the results of another scenario in the folder.")
@trust_flag
@click.option("--meshcat", is_flag=True, help="Show the run live in a browser.")
@quiet_flag
def run(scenario: str, out: Path | None, overrides: tuple[str, ...], force: bool, meshcat: bool, quiet: bool) -> None:
    """Simulate SCENARIO: a YAML file, or the name of a shipped one such as paper_fig7.

    Exit status: 0 completed, 2 bad input, 3 stopped, lost or failed (the log is kept), 130 interrupted.
    """
    from stewart_drake.logs.outcomes import told
    from stewart_drake.runs.outputs import prepare_folder, results_place, write_run
    from stewart_drake.scenario import load_scenario

    loaded = load_scenario(scenario, overrides)
    place = results_place(loaded, out, force)

    from stewart_drake.runs.simulation import check_scenario, engine_of, refuse_too_long
    from stewart_drake.runs.simulation import run as simulate

    refuse_too_long(loaded)
    if loaded.duration > _LONG and not quiet:
        click.echo("checking the motion", err=True)
    with shown_compiling(quiet):
        check_scenario(loaded)
    viewer = None
    if meshcat:
        from pydrake.geometry import Meshcat

        viewer = Meshcat()
        click.echo(f"live view: {viewer.web_url()}", err=True)
    engine = engine_of(loaded, viewer)
    graph = engine.graph()
    # Only now, with everything checked, does anything appear on the disk.
    prepare_folder(place.parent, out)
    with shown_compiling(quiet), ProgressBar(loaded.name, loaded.duration, quiet) as advance:
        log = simulate(loaded, progress=advance, check=False, engine=engine)
    results = write_run(log, out, graph, force=force)
    if not quiet:
        print_run(log, results.metrics, results.folder)
    for line in results.left_out:
        click.echo(f"stewart-drake: {line}", err=True)
    if log.status != "completed":
        why = (log.message or "").removeprefix(f"{log.reason}: ")
        click.echo(f"stewart-drake: {told(log.status, log.reason, log.outcome_time)}: {why}", err=True)
    sys.exit(_STATUS[log.status])


@cli.command()
@click.option("--out", type=OutPath(dir_okay=False), help="File to write [default: standard output].")
def schema(out: Path | None) -> None:
    """JSON schema of scenario files, for editors."""
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.scenario import scenario_schema

    text = json.dumps(scenario_schema(), indent=2) + "\n"
    if out is None:
        click.echo(text, nl=False)
    else:
        write_atomically(out, text.encode())


cli.add_command(calibrate)
cli.add_command(collect)
cli.add_command(check)
cli.add_command(compare)
cli.add_command(excite)
cli.add_command(faults)
cli.add_command(live)
cli.add_command(margins)
cli.add_command(identify)
cli.add_command(reproduce)
cli.add_command(robots)
cli.add_command(sweep)
cli.add_command(train)
cli.add_command(tune)
cli.add_command(tuner)
cli.add_command(workspace)
cli.add_command(write_sdf_command)
cli.add_command(write_mjcf_command)


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
    """What a command ends with, for `sys.exit`."""
    try:
        return _expected()
    except MemoryError:
        return _tell("out of memory", EXIT_RUN_FAILED)
    except (Exception, SystemExit) as error:  # Drake says SystemExit where one of its checks fails
        if os.environ.get(TRACEBACK):
            traceback.print_exception(error)
        name = f"{type(error).__name__}: {error}{raised_at(error)}"
        return _tell(f"internal error: {name}; set {TRACEBACK}=1 to see all of it", EXIT_INTERNAL)


def _expected() -> int:
    """The same for what can be expected to go wrong."""
    try:
        with interruptible():
            cli(standalone_mode=False)
    except SystemExit as end:
        if not isinstance(end.code, int | None):
            raise
        return end.code or 0
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _tell("interrupted", EXIT_INTERRUPTED)
    except ImportError as error:
        # Ctrl-C while a compiled module loads comes out as this.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        return _tell("interrupted", EXIT_INTERRUPTED)
    except click.ClickException as error:
        return _tell(error.format_message(), EXIT_BAD_INPUT)
    except ConfigurationError as error:
        return [_tell(line, EXIT_BAD_INPUT) for line in str(error).splitlines()][-1]
    except StewartDrakeError as error:
        return _tell(f"{error.reason}: {error}", EXIT_RUN_FAILED)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC):
            raise
        return _lost_output(error)
    return 0


def _lost_output(error: OSError) -> int:
    """Standard output that nobody reads any more is no failure; one that cannot be written is."""
    drop_output(sys.stdout)
    if error.errno == errno.EPIPE:
        return 0
    return _tell(f"standard output: expected one that can be written, got {error.strerror}", EXIT_BAD_INPUT)


def _tell(text: str, status: int) -> int:
    click.echo(f"stewart-drake: {' '.join(text.split())}", err=True)
    return status
