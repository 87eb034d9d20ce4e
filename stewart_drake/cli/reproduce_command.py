"""The command `reproduce`: parse, call, print."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from stewart_drake.cli.common_options import OutPath, quiet_flag
from stewart_drake.runs.terminal import ProgressBar, print_columns

EXIT_DIFFERENT = 1


@click.command()
@click.option("--quick", is_flag=True, help="Smaller sizes, a minute or two.")
@click.option("--out", type=OutPath(), help="Folder for numbers.json and figures/ [default: none is written].")
@quiet_flag
def reproduce(quick: bool, out: Path | None, quiet: bool) -> None:
    """Test the paper claim by claim: a table of claim, paper, ours, verdict.

    The table is compared with the one that this package has; what differs is named.

    Exit status: 0 done, 1 a number differs, 2 bad input, 130 interrupted.
    """
    from stewart_drake.runs.outputs import prepare_folder

    if out is not None:
        prepare_folder(out)

    from stewart_drake.paper.reproduce import differences, rows
    from stewart_drake.paper.reproduce import reproduce as results_of

    with ProgressBar("reproduction", 100.0, quiet, unit="%") as advance:
        results = results_of(quick, out, lambda share, name: advance(100.0 * share, name.replace("_", " ")))
    claims = [claim for result in results.values() for claim in result.claims]
    if not quiet:
        print_columns("The paper, claim by claim", ("claim", "paper", "ours", "verdict"), rows(claims))
    different = differences(claims, "quick" if quick else "full")
    for line in different:
        click.echo(f"stewart-drake: {line}", err=True)
    sys.exit(EXIT_DIFFERENT if different else 0)
