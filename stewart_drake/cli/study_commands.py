"""The commands `sweep`, `compare`, `tune` and `faults`: many runs, whose rows are kept as they come."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

from stewart_drake.cli.common_options import EXIT_INTERRUPTED, out_folder, overrides, quiet_flag, trust_flag
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.terminal import ProgressBar, console, print_columns, print_table

if TYPE_CHECKING:
    from stewart_drake.studies.study import Sheet
    from stewart_drake.studies.workers import Workers


class Runs(Protocol):
    """What is to be run."""

    @property
    def name(self) -> str:
        """For folders and titles."""

    @property
    def runs(self) -> int:
        """How many, at most."""


def study_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """`--workers`, `--scheduler`, `--restart`, `--quiet` and `--trust-code` of a command of many runs."""
    for option in (
        trust_flag,
        quiet_flag,
        click.option("--restart", is_flag=True, help="Throw away what an earlier call left in the folder."),
        click.option(
            "--scheduler", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler, e.g. tcp://host:8786."
        ),
        click.option(
            "--workers",
            type=click.IntRange(1, 1024),
            help="Processes on this machine [default: one per core, at most 8].",
        ),
    ):
        function = option(function)
    return function


_robot = click.option(
    "--robot", help="Name or YAML file: motions, loads and faults in its size [default: that of the file]."
)


@contextmanager
def under_way(
    plan: Runs, out: Path | None, workers: int | None, scheduler: str | None, quiet: bool, ending: str = ""
) -> Iterator[tuple[Path, Workers, Callable[[float], None]]]:
    """The folder, where the runs go, and what is told how many are done; Ctrl-C ends the command with what is kept."""
    from stewart_drake.runs.outputs import prepare_folder
    from stewart_drake.studies.workers import Workers

    if scheduler is not None and workers is not None:
        allowed = "no value with --scheduler: the cluster sets the number of workers"
        raise ConfigurationError("--workers", workers, allowed)
    where = Workers(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / f"{plan.name}{ending}")
    done = 0.0
    try:
        with where, ProgressBar(plan.name, float(plan.runs), quiet, unit="runs") as advance:

            def progress(count: float) -> None:
                nonlocal done
                done = count
                advance(count)

            yield folder, where, progress
    except KeyboardInterrupt:
        kept = f"{done:.0f} of {plan.runs} runs are kept in {folder}; the same command goes on from there"
        click.echo(f"stewart-drake: interrupted; {kept}", err=True)
        sys.exit(EXIT_INTERRUPTED)


@click.command()
@click.argument("sweep")
@out_folder()
@click.option("--runs", type=click.IntRange(1), help="In place of the number in the file; run i stays the same.")
@study_options
def sweep(sweep: str, runs: int | None, restart: bool, **options: Any) -> None:
    """Run SWEEP many times over: a YAML file, or the name of a shipped one such as initial_offset.

    Writes sweep.parquet and .csv: one row a run, with the values drawn, how it went and how well. A run that is
    refused, breaks or kills its worker is a row with its reason. What is done is kept in OUT, and an interrupted sweep
    goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.study import run_study
    from stewart_drake.studies.sweep import load_sweep, summary

    loaded = load_sweep(sweep, runs)
    with under_way(loaded, **options) as (folder, where, progress):
        made = run_study(loaded, folder, where, progress, restart)
    if not options["quiet"]:
        print_table(loaded.name, [*summary(made.rows["sweep"]), ("table in", str(folder / "sweep.parquet"))])
        if made.engine is not None:
            click.echo(made.engine)


@click.command()
@click.argument("comparison", default="tracking")
@out_folder()
@click.option("--quick", is_flag=True, help="Short runs and few bands: figures to look at, not to quote.")
@_robot
@study_options
def compare(comparison: str, quick: bool, robot: str | None, restart: bool, **options: Any) -> None:
    """Compare controllers: COMPARISON is a YAML file or one of tracking, controllers, fair, observer.

    Without one it is tracking.

    Writes comparison.parquet, .csv and .md (tables for a README), bands.parquet and .csv, and pictures. A run that
    fails is a row with its reason. What is done is kept in OUT, and an interrupted comparison goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.comparison import load_comparison, write_pictures
    from stewart_drake.studies.study import run_study

    loaded = load_comparison(comparison, quick, robot)
    with under_way(loaded, **options, ending="-quick" if quick else "") as (folder, where, progress):
        result = run_study(loaded, folder, where, progress, restart)
        for line in write_pictures(loaded, result):
            click.echo(f"stewart-drake: {line}", err=True)
    if options["quiet"]:
        return
    print_sheets(loaded.sheets(result.rows))
    if result.engine is not None:
        click.echo(result.engine)
    click.echo(f"tables and pictures in {folder}")


@click.command()
@click.argument("comparison")
@out_folder()
@click.option("--controller", "controllers", multiple=True, metavar="NAME", help="Of those to search [default: all].")
@click.option("--budget", type=click.IntRange(1), help="Evaluations of each controller, in place of those in the file.")
@click.option("--quick", is_flag=True, help="Short runs and two generations: to see that all is well.")
@study_options
def tune(
    comparison: str, controllers: tuple[str, ...], budget: int | None, quick: bool, restart: bool, **options: Any
) -> None:
    """Search the gains of controllers for the least cost: COMPARISON is a file with `tune` in it, or a name as fair.

    Every controller gets the same search (CMA-ES) over the same runs; then those before and after are compared as the
    file says, in OUT/verdict-*. Writes tuned.yaml (for `tuned` of the comparison), tune.parquet and .csv (a row an
    evaluation), tune.md and tune.png. What is done is kept in OUT, and an interrupted search goes on from it; with
    another --budget or --controller too.

    Exit status: 0 all is searched, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.tune import load_tuning, run_tuning, write_picture

    loaded = load_tuning(comparison, controllers, budget, quick)
    with under_way(loaded, **options, ending="-tune-quick" if quick else "-tune") as (folder, where, progress):
        result = run_tuning(loaded, folder, where, progress, restart)
        line = write_picture(result, folder)
        if line is not None:
            click.echo(f"stewart-drake: {line}", err=True)
    if options["quiet"]:
        return
    print_sheets(result.sheets)
    click.echo(f"settings in {folder / 'tuned.yaml'}, tables of the verdict in {result.verdict.folder}")


@click.command()
@out_folder("runs/faults")
@click.option("--quick", is_flag=True, help="The held platform alone, a third of the runs.")
@_robot
@overrides("estimator.kind=observer")
@study_options
def faults(quick: bool, robot: str | None, overrides: tuple[str, ...], restart: bool, **options: Any) -> None:
    """Inject every fault into a running loop and write what the safety layer makes of it: faults.parquet, .csv and .md.

    What is done is kept in OUT, and an interrupted table goes on from it.

    Exit status: 0 every fault has its row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.faults import fault_study, holdable_lines, sheet
    from stewart_drake.studies.study import run_study

    plan = fault_study(quick, robot, overrides)
    with under_way(plan, **options) as (folder, where, progress):
        rows = run_study(plan, folder, where, progress, restart).rows["faults"]
    if options["quiet"]:
        return
    print_sheets([sheet(rows)])
    terminal = console()
    terminal.print("with a dead motor, the wrench that the other five hold at rest:")
    for text in (*(f"  {line}" for line in holdable_lines(rows)), f"table in {folder / 'faults.md'}"):
        terminal.print(text, highlight=False, markup=False)


def print_sheets(sheets: Sequence[Sheet]) -> None:
    """Tables on the terminal, with as many of their columns as it has room for; their files have all."""
    for sheet in sheets:
        lengths = [max(map(len, column)) + 3 for column in zip(sheet.header, *sheet.rows, strict=True)]
        shown = max(2, sum(end < console().width for end in itertools.accumulate(lengths)))
        print_columns(sheet.title, sheet.header[:shown], [row[:shown] for row in sheet.rows])
