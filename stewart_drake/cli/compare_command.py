"""The command `compare`: parse, call, print."""

from __future__ import annotations

from pathlib import Path

import click

from stewart_drake.cli.common_options import campaign, out_folder, under_way, workplace
from stewart_drake.runs.terminal import console, print_columns

WIDE = 150
"""Characters of a terminal that has room for all columns; a narrower one shows the main ones."""


@click.command()
@click.argument("comparison", default="tracking")
@out_folder()
@click.option("--quick", is_flag=True, help="Short runs and few bands: figures to look at, not to quote.")
@campaign
def compare(
    comparison: str,
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
    quick: bool,
    restart: bool,
    quiet: bool,
) -> None:
    """Compare controllers: COMPARISON is a YAML file, or a shipped one: tracking, controllers [default: tracking].

    Writes comparison.parquet, .csv and .md (tables for a README), bands.parquet and .csv, and pictures. A run that
    fails is a row with its reason. What is done is kept in OUT, and an interrupted comparison goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.campaigns.comparison_file import load_comparison
    from stewart_drake.runs.outputs import prepare_folder

    loaded = load_comparison(comparison, quick)
    where = workplace(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / f"{loaded.name}{'-quick' if quick else ''}")

    from stewart_drake.campaigns.comparison import run_comparison, write_pictures

    with under_way(loaded.name, loaded.runs, folder, quiet) as progress:
        result = run_comparison(loaded, folder, where, progress, restart)
        for line in write_pictures(loaded, result, folder):
            click.echo(f"stewart-drake: {line}", err=True)
    if quiet:
        return
    for sheet in result.sheets:
        columns = range(len(sheet.header)) if console().width >= WIDE else sheet.brief
        rows = ([row[column] for column in columns] for row in sheet.rows)
        print_columns(sheet.title, [sheet.header[column] for column in columns], rows)
    click.echo(f"tables and pictures in {folder}")
