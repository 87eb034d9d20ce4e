"""The command `tuner judge`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import click

from stewart_drake.cli.campaign_commands import campaign_options, under_way
from stewart_drake.cli.common_options import out_folder


class _Runs(NamedTuple):
    name: str
    runs: int


@click.command()
@click.argument("file", required=False, type=click.Path(dir_okay=False, path_type=Path))
@out_folder("runs/tuner-verdict")
@click.option("--seeds", type=click.IntRange(2), default=14, show_default=True, help="Of each kind of each robot.")
@click.option(
    "--engine",
    type=click.Choice(["drake", "reduced"]),
    default="drake",
    show_default=True,
    help="The plant: Drake's, or the closed form of the robot, several times faster.",
)
@campaign_options
def judge(file: Path | None, seeds: int, engine: Any, restart: bool, **options: Any) -> None:
    """Judge a trained policy against settings that stay and other tuners, in situations that none of them has seen.

    FILE is a policy's weights file [default: the shipped one]. Writes verdict.md, .parquet, .csv and .png. What is done
    is kept in OUT, and an interrupted verdict goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.training.baselines import Baselines
    from stewart_drake.training.contest import cells_for
    from stewart_drake.training.verdict import contestants, judge, write_picture

    found = Baselines.load()
    policy = {"kind": "policy", **({} if file is None else {"weights_file": str(file)})}
    entered = contestants(found, {"policy": {"tuner": policy}, "schedule": {"tuner": found.schedule}})
    runs = _Runs("tuner verdict", len(entered) * len(cells_for()) * seeds)
    with under_way(runs, **options) as (folder, where, progress):
        verdict = judge(entered, folder, seeds, engine, where, progress, restart)
        line = write_picture(verdict, folder)
        if line is not None:
            click.echo(f"stewart-drake: {line}", err=True)
    if not options["quiet"]:
        click.echo((folder / "verdict.md").read_text(), nl=False)
