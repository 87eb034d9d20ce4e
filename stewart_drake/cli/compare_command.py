"""The command `compare`: parse, call, print."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stewart_drake.cli.common_options import out_folder
from stewart_drake.runs.terminal import ProgressBar, console

if TYPE_CHECKING:
    from stewart_drake.campaigns.comparison_table import Sheet

EXIT_INTERRUPTED = 130
WIDE = 150
"""Characters of a terminal that has room for all columns; a narrower one shows the main ones."""


@click.command()
@click.argument("comparison", default="tracking")
@out_folder()
@click.option(
    "--workers", type=click.IntRange(1, 1024), help="Processes on this machine [default: one per core, at most 8]."
)
@click.option("--quick", is_flag=True, help="Short runs and few bands: figures to look at, not to quote.")
@click.option("--restart", is_flag=True, help="Throw away what an earlier comparison left in the folder.")
@click.option("--quiet", is_flag=True, help="No progress bar and no tables.")
def compare(comparison: str, out: Path | None, workers: int | None, quick: bool, restart: bool, quiet: bool) -> None:
    """Compare controllers: COMPARISON is a YAML file, or a shipped one: tracking, controllers [default: tracking].

    Writes comparison.parquet, .csv and .md (tables for a README), bands.parquet and .csv, and pictures. A run that
    fails is a row with its reason. What is done is kept in OUT, and an interrupted comparison goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.campaigns.comparison_file import load_comparison
    from stewart_drake.runs.outputs import prepare_folder

    loaded = load_comparison(comparison, quick)
    folder = prepare_folder(out if out is not None else Path("runs") / f"{loaded.name}{'-quick' if quick else ''}")

    from stewart_drake.campaigns.comparison import run_comparison, write_pictures
    from stewart_drake.campaigns.executors import LocalProcesses

    done = 0.0
    try:
        with ProgressBar(loaded.name, float(loaded.runs), quiet, unit="runs") as advance:

            def progress(count: float) -> None:
                nonlocal done
                done = count
                advance(count)

            result = run_comparison(loaded, folder, LocalProcesses(workers), progress, restart)
        for line in write_pictures(loaded, result, folder):
            click.echo(f"stewart-drake: {line}", err=True)
    except KeyboardInterrupt:
        kept = f"{done:.0f} of {loaded.runs} runs are kept in {folder}; the same command goes on from there"
        click.echo(f"stewart-drake: interrupted; {kept}", err=True)
        sys.exit(EXIT_INTERRUPTED)
    if not quiet:
        _print(result.sheets)
        click.echo(f"tables and pictures in {folder}")


def _print(sheets: list[Sheet]) -> None:
    from rich.markup import escape
    from rich.table import Table

    for sheet in sheets:
        terminal = console()
        columns = range(len(sheet.header)) if terminal.width >= WIDE else sheet.brief
        table = Table(title=escape(sheet.title), title_justify="left")
        for column in columns:
            table.add_column(escape(sheet.header[column]), justify="right" if column else "left")
        for row in sheet.rows:
            table.add_row(*(escape(row[column]) for column in columns))
        terminal.print(table)
