"""The command `margins`: parse, call, print."""

from __future__ import annotations

import json
from pathlib import Path

import click

from stewart_drake.cli.common_options import out_folder, overrides, quiet_flag, trust_flag
from stewart_drake.runs.terminal import print_columns, print_table, shown_compiling


@click.command()
@click.argument("scenario", default="exact_breathing")
@out_folder("runs/margins")
@click.option(
    "--poses", type=click.IntRange(1, 100_000), default=1000, show_default=True, help="Drawn from the near box."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the poses.")
@overrides("estimator.kind=observer")
@trust_flag
@quiet_flag
def margins(scenario: str, out: Path, poses: int, seed: int, overrides: tuple[str, ...], quiet: bool) -> None:
    """Stability margins of the linear loop of SCENARIO, a file or a shipped name [default: exact_breathing].

    At poses at rest the loop, with sensors, estimator, controller and delay, is broken at the six motors' torques:
    gain, phase, delay and disk margins, one motor at a time and all at once. The poses are drawn from the near box: up
    to 30 deg about each axis, 60 mm in X and Y and 50 mm in Z about home, shifts by the robot's size, within the
    scenario's limits. Friction, saturation and counts of encoders are not linear, and left out; weights stay as at the
    start.

    Writes margins.json, margins.parquet (a row for each pose) and margins.png.

    Exit status: 0 done, 2 bad input.
    """
    from stewart_drake.runs.outputs import prepare_folder
    from stewart_drake.scenario import load_scenario

    loaded = load_scenario(scenario, overrides)

    from stewart_drake.stability.linear_loop import linear_loops, poses_to_stand_at

    with shown_compiling(quiet):
        loops = linear_loops(loaded, poses_to_stand_at(loaded, poses, seed))
    folder = prepare_folder(out)

    import pyarrow.parquet as pq

    from stewart_drake.files.whole import write_atomically
    from stewart_drake.plotting.margin_plots import plot_margins
    from stewart_drake.stability import margins as report

    found = report.loop_margins(loops)
    numbers = json.dumps(report.document(loops, found), indent=1, allow_nan=False) + "\n"
    write_atomically(folder / "margins.json", numbers.encode())
    pq.write_table(report.rows(loops, found), folder / "margins.parquet")
    plot_margins(found, folder / "margins.png")
    if not quiet:
        title = f"{loaded.name}: margins at {len(loops.poses)} poses, beside {loaded.command_delay} ticks of delay"
        print_columns(title, report.HEADER, report.table(found, loops.period))
        print_table("", [*report.facts(loops, found), ("results in", str(folder))])
