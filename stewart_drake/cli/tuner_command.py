"""The command group `tuner`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import click

from stewart_drake.cli.common_options import out_folder
from stewart_drake.cli.study_commands import study_options, under_way
from stewart_drake.runs.terminal import print_columns


@click.group()
def tuner() -> None:
    """Look at the tuners of settings, and assess them."""


@tuner.command("show")
@click.argument("file", required=False, type=click.Path(path_type=Path))
def show(file: Path | None) -> None:
    """Print the card of a policy: its box, what it hears, and where it comes from. FILE [default: the shipped one].

    Exit status: 0 shown, 2 no policy file, or not as it was written.
    """
    from stewart_drake.control.policy import BOX_HEADER, default_policy_path, load_policy

    path = default_policy_path() if file is None else file
    policy = load_policy(path)
    print_columns(f"{path.name}: settings, decades above the base", BOX_HEADER, policy.box_rows())
    print_columns(path.name, ("", ""), policy.facts(), numbers=())


class _Runs(NamedTuple):
    name: str
    runs: int


@tuner.command()
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
@study_options
def judge(file: Path | None, seeds: int, engine: Any, restart: bool, **options: Any) -> None:
    """Assess a trained policy against settings that stay and other tuners, in situations that none of them has seen.

    FILE is a policy's weights file [default: the shipped one]. Writes verdict.md, .parquet, .csv and .png. What is done
    is kept in OUT, and an interrupted verdict goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.control.policy import load_policy
    from stewart_drake.training.benchmark import Baselines, assess, candidates, cells_for, write_picture

    load_policy(file)
    baselines = Baselines.load()
    policy = {"kind": "policy", **({} if file is None else {"weights_file": str(file)})}
    entered = candidates(baselines, {"policy": {"tuner": policy}, "schedule": {"tuner": baselines.schedule}})
    runs = _Runs("tuner verdict", len(entered) * len(cells_for()) * seeds)
    with under_way(runs, **options) as (folder, where, progress):
        verdict = assess(entered, folder, seeds, engine, where, progress, restart)
        line = write_picture(verdict, folder)
        if line is not None:
            click.echo(f"stewart-drake: {line}", err=True)
    if not options["quiet"]:
        click.echo((folder / "verdict.md").read_text(), nl=False)
