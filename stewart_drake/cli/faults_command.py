"""The command `faults`: parse, call, print."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from stewart_drake.cli.common_options import out_folder
from stewart_drake.runs.terminal import ProgressBar, console


@click.command()
@out_folder("runs/faults")
@click.option("--quick", is_flag=True, help="The held platform alone, a third of the runs.")
@click.option("--workers", type=click.IntRange(1, 1024), help="Processes [default: one per core, at most 8].")
@click.option("--restart", is_flag=True, help="Throw away the rows that an earlier call left in the folder.")
@click.option("--quiet", is_flag=True, help="No progress bar and no table.")
def faults(out: Path, quick: bool, workers: int | None, restart: bool, quiet: bool) -> None:
    """Inject every fault into a running loop and write what the safety layer makes of it: faults.parquet, faults.md.

    What is done is kept in OUT, and an interrupted table goes on from it.

    Exit status: 0 every fault has its row, 2 bad input, 3 a worker ended by itself, 130 interrupted.
    """
    from stewart_drake.campaigns.fault_rows import all_rows
    from stewart_drake.campaigns.fault_table import (
        QUICK_MOTIONS,
        TERSE_HEADERS,
        holdable_lines,
        make_table,
        terse_rows,
    )
    from stewart_drake.runs.outputs import SPACE, prepare_folder

    total = sum(1 for _, motion in all_rows() if not quick or motion in QUICK_MOTIONS)
    prepare_folder(out, SPACE)
    try:
        with ProgressBar("faults", float(total), quiet, unit="runs") as advance:
            table = make_table(out, quick, workers, advance, restart)
    except KeyboardInterrupt:
        click.echo(f"stewart-drake: interrupted; the rows so far are kept in {out}", err=True)
        sys.exit(130)
    if quiet:
        return

    from rich.markup import escape
    from rich.table import Table

    motions = ", ".join(dict.fromkeys(row.motion for row in table.rows))
    shown = Table(title=f"faults during {motions}: latency, peak error, peak torque", title_justify="left")
    for name in TERSE_HEADERS:
        shown.add_column(name, justify="right" if name in ("ms", "deg", "mm", "N m") else "left", overflow="fold")
    shown.columns[0].no_wrap = True
    for line in terse_rows(table.rows):
        shown.add_row(*map(escape, line))
    terminal = console()
    terminal.print(shown)
    terminal.print("with a dead motor, the wrench that the other five hold at rest:")
    for text in holdable_lines(table.rows):
        terminal.print(f"  {escape(text)}", highlight=False)
    terminal.print(f"table in {escape(str(table.markdown))}", highlight=False)
