"""The command `sweep`: parse, call, print."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stewart_drake.cli.common_options import out_folder
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.terminal import ProgressBar, print_table

if TYPE_CHECKING:
    from stewart_drake.campaigns.executors import Workplace

EXIT_INTERRUPTED = 130


@click.command()
@click.argument("sweep")
@out_folder()
@click.option(
    "--workers", type=click.IntRange(1, 1024), help="Processes on this machine [default: one per core, at most 8]."
)
@click.option("--scheduler", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler, e.g. tcp://host:8786.")
@click.option("--runs", type=click.IntRange(1), help="In place of the number in the file; run i stays the same.")
@click.option("--restart", is_flag=True, help="Throw away what an earlier sweep left in the folder.")
@click.option("--quiet", is_flag=True, help="No progress bar and no table.")
def sweep(
    sweep: str,
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
    runs: int | None,
    restart: bool,
    quiet: bool,
) -> None:
    """Run SWEEP many times over: a YAML file, or the name of a shipped one such as initial_offset.

    Writes sweep.parquet: one row a run, with the values drawn, how it went and how well. A run that is refused, breaks
    or kills its worker is a row with its reason. What is done is kept in OUT, and an interrupted sweep goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.campaigns.sweep_file import load_sweep
    from stewart_drake.runs.outputs import SPACE, prepare_folder

    if workers is not None and scheduler is not None:
        raise ConfigurationError("--workers", workers, "nothing beside --scheduler: a cluster has the workers it has")
    loaded = load_sweep(sweep, runs)
    where = _workplace(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / loaded.name, SPACE)

    from stewart_drake.campaigns.sweep import run_sweep
    from stewart_drake.campaigns.sweep_table import summary

    done = 0.0
    try:
        with ProgressBar(loaded.name, float(loaded.runs), quiet, unit="runs") as advance:

            def progress(count: float) -> None:
                nonlocal done
                done = count
                advance(count)

            result = run_sweep(loaded, folder, where, progress, restart)
    except KeyboardInterrupt:
        kept = f"{done:.0f} of {loaded.runs} runs are kept in {folder}; the same command goes on from there"
        click.echo(f"stewart-drake: interrupted; {kept}", err=True)
        sys.exit(EXIT_INTERRUPTED)
    if not quiet:
        print_table(loaded.name, [*summary(result.rows), ("table in", str(result.path))])


def _workplace(workers: int | None, scheduler: str | None) -> Workplace:
    from stewart_drake.campaigns.executors import DaskCluster, LocalProcesses

    if scheduler is None:
        return LocalProcesses(workers)
    cluster = DaskCluster(scheduler)
    cluster.connect()
    return cluster
