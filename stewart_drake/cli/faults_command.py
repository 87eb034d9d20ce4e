"""The command `faults`: parse, call, print."""

from __future__ import annotations

from pathlib import Path

import click

from stewart_drake.cli.common_options import campaign, out_folder, under_way, workplace
from stewart_drake.runs.terminal import console, print_columns


@click.command()
@out_folder("runs/faults")
@click.option("--quick", is_flag=True, help="The held platform alone, a third of the runs.")
@campaign
def faults(out: Path, quick: bool, workers: int | None, scheduler: str | None, restart: bool, quiet: bool) -> None:
    """Inject every fault into a running loop and write what the safety layer makes of it: faults.parquet, .csv and .md.

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
    where = workplace(workers, scheduler)
    prepare_folder(out, SPACE)
    with under_way("faults", total, out, quiet) as progress:
        table = make_table(out, quick, where, progress, restart)
    if quiet:
        return

    from rich.markup import escape

    motions = ", ".join(dict.fromkeys(row.motion for row in table.rows))
    numbers = [TERSE_HEADERS.index(name) for name in ("ms", "deg", "mm", "N m")]
    title = f"faults during {motions}: latency, peak error, peak torque"
    print_columns(title, TERSE_HEADERS, terse_rows(table.rows), numbers)
    terminal = console()
    terminal.print("with a dead motor, the wrench that the other five hold at rest:")
    for text in holdable_lines(table.rows):
        terminal.print(f"  {escape(text)}", highlight=False)
    terminal.print(f"table in {escape(str(table.markdown))}", highlight=False)
