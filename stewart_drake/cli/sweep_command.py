"""The command `sweep`: parse, call, print."""

from __future__ import annotations

from pathlib import Path

import click

from stewart_drake.cli.common_options import campaign, out_folder, under_way, workplace
from stewart_drake.runs.terminal import print_table


@click.command()
@click.argument("sweep")
@out_folder()
@click.option("--runs", type=click.IntRange(1), help="In place of the number in the file; run i stays the same.")
@campaign
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

    Writes sweep.parquet and .csv: one row a run, with the values drawn, how it went and how well. A run that is
    refused, breaks or kills its worker is a row with its reason. What is done is kept in OUT, and an interrupted sweep
    goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.campaigns.sweep_file import load_sweep
    from stewart_drake.runs.outputs import SPACE, prepare_folder

    loaded = load_sweep(sweep, runs)
    where = workplace(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / loaded.name, SPACE)

    from stewart_drake.campaigns.sweep import run_sweep
    from stewart_drake.campaigns.sweep_table import summary

    with under_way(loaded.name, loaded.runs, folder, quiet) as progress:
        result = run_sweep(loaded, folder, where, progress, restart)
    if not quiet:
        print_table(loaded.name, [*summary(result.rows), ("table in", str(result.path))])
