"""Commands of many runs, whose rows are kept as they come: `sweep`, `compare`, `tune`, `faults` and `tuner judge`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stewart_drake.cli.options import IN_FILE, cli, out_folder, overrides, sized_option, study_options, under_way
from stewart_drake.cli.terminal import console, print_table, say

if TYPE_CHECKING:
    from stewart_drake.studies.study import Sheet


@cli.command()
@click.argument("sweep")
@out_folder()
@click.option("--runs", type=click.IntRange(1), help="In place of the number in the file; run i stays the same.")
@study_options
def sweep(sweep: str, runs: int | None, restart: bool, **options: Any) -> None:
    """Run SWEEP many times over: a YAML file, or the name of a shipped one such as initial_offset.

    Writes sweep.parquet and .csv: one row a run, with the values drawn, how it went and how well. A run that is
    refused, breaks or kills its worker is a row with its reason. What is done is kept in OUT, and an interrupted sweep
    goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.study import run_study
    from stewart_drake.studies.sweep import load_sweep, summary

    loaded = load_sweep(sweep, runs)
    with under_way(loaded.name, loaded.runs, **options) as (folder, where, progress):
        made = run_study(loaded, folder, where, progress, restart)
    if not options["quiet"]:
        print_table(loaded.name, [*summary(made.rows["sweep"]), ("table in", str(folder / "sweep.parquet"))])
        if made.engine is not None:
            click.echo(made.engine)


@cli.command()
@click.argument("comparison", default="tracking")
@out_folder()
@click.option("--quick", is_flag=True, help="Short runs and few bands: figures to look at, not to quote.")
@sized_option
@study_options
def compare(comparison: str, quick: bool, robot: str | None, restart: bool, **options: Any) -> None:
    """Compare controllers: COMPARISON is a YAML file or one of tracking, controllers, fair, observer.

    Without one it is tracking.

    Writes comparison.parquet, .csv and .md (tables for a README), bands.parquet and .csv, and pictures. A run that
    fails is a row with its reason. What is done is kept in OUT, and an interrupted comparison goes on from it.

    Exit status: 0 all runs have their row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.comparison import load_comparison, write_pictures
    from stewart_drake.studies.study import run_study

    loaded, ending = load_comparison(comparison, quick, robot), "-quick" if quick else ""
    with under_way(f"{loaded.name}{ending}", loaded.runs, **options) as (folder, where, progress):
        result = run_study(loaded, folder, where, progress, restart)
        for line in write_pictures(loaded, result):
            say(line)
    if options["quiet"]:
        return
    print_sheets(loaded.sheets(result.rows))
    if result.engine is not None:
        click.echo(result.engine)
    click.echo(f"tables and pictures in {folder}")


@cli.command()
@click.argument("comparison")
@out_folder()
@click.option("--controller", "controllers", multiple=True, metavar="NAME", help="Of those to search [default: all].")
@click.option("--budget", type=click.IntRange(1), help="Evaluations of each controller, in place of those in the file.")
@click.option("--quick", is_flag=True, help="Short runs and two generations: to see that all is well.")
@study_options
def tune(
    comparison: str, controllers: tuple[str, ...], budget: int | None, quick: bool, restart: bool, **options: Any
) -> None:
    """Search the gains of controllers for the least cost: COMPARISON is a file with `tune` in it, or a name as fair.

    Every controller gets the same search (CMA-ES) over the same runs; then those before and after are compared as the
    file says, in OUT/verdict-*. Writes tuned.yaml (for `tuned` of the comparison), tune.parquet and .csv (a row an
    evaluation), tune.md and tune.png. What is done is kept in OUT, and an interrupted search goes on from it; with
    another --budget or --controller too.

    Exit status: 0 all is searched, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.tune import load_tuning, run_tuning, write_picture

    loaded, ending = load_tuning(comparison, controllers, budget, quick), "-tune-quick" if quick else "-tune"
    with under_way(f"{loaded.name}{ending}", loaded.runs, **options) as (folder, where, progress):
        result = run_tuning(loaded, folder, where, progress, restart)
        line = write_picture(result, folder)
        if line is not None:
            say(line)
    if options["quiet"]:
        return
    print_sheets(result.sheets)
    click.echo(f"settings in {folder / 'tuned.yaml'}, tables of the verdict in {result.verdict.folder}")


@cli.command()
@out_folder("runs/faults")
@click.option("--quick", is_flag=True, help="The held platform alone, a third of the runs.")
@sized_option
@overrides("estimator.kind=observer")
@study_options
def faults(quick: bool, robot: str | None, overrides: tuple[str, ...], restart: bool, **options: Any) -> None:
    """Inject every fault into a running loop and write what the safety layer makes of it: faults.parquet, .csv and .md.

    What is done is kept in OUT, and an interrupted table goes on from it.

    Exit status: 0 every fault has its row, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    from stewart_drake.studies.faults import fault_study, holdable_lines, sheet
    from stewart_drake.studies.study import run_study

    plan = fault_study(quick, robot, overrides)
    with under_way(plan.name, plan.runs, **options) as (folder, where, progress):
        rows = run_study(plan, folder, where, progress, restart).rows["faults"]
    if options["quiet"]:
        return
    print_sheets([sheet(rows)])
    click.echo("with a dead motor, the wrench that the other five hold at rest:")
    for text in (*(f"  {line}" for line in holdable_lines(rows)), f"table in {folder / 'faults.md'}"):
        click.echo(text)


def print_sheets(sheets: Sequence[Sheet]) -> None:
    """Tables on the terminal, with as many of their columns as it has room for; their files have all."""
    for each in sheets:
        lengths = [max(map(len, column)) + 3 for column in zip(each.header, *each.rows, strict=True)]
        shown = max(2, sum(end < console().width for end in itertools.accumulate(lengths)))
        print_table(each.title, [row[:shown] for row in each.rows], each.header[:shown])


@cli.group()
def tuner() -> None:
    """Look at the tuners of settings, and assess them."""


@tuner.command("show")
@click.argument("file", required=False, type=IN_FILE)
def show(file: Path | None) -> None:
    """Print the card of a policy: its box, what it hears, and where it comes from. FILE [default: the shipped one].

    Exit status: 0 shown, 2 no policy file, or not as it was written.
    """
    from stewart_drake.control.policy import BOX_HEADER, default_policy_path, load_policy

    path = default_policy_path() if file is None else file
    policy = load_policy(path)
    print_table(f"{path.name}: settings, decades above the base", policy.box_rows(), BOX_HEADER)
    print_table(path.name, policy.facts(), numbers=())


@tuner.command()
@click.argument("file", required=False, type=IN_FILE)
@out_folder("runs/tuner-verdict")
@click.option("--seeds", type=click.IntRange(2), default=14, help="Of each kind of each robot.")
@click.option(
    "--engine",
    type=click.Choice(["drake", "reduced"]),
    default="drake",
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
    runs = len(entered) * len(cells_for()) * seeds
    with under_way("tuner verdict", runs, **options) as (folder, where, progress):
        verdict = assess(entered, folder, seeds, engine, where, progress, restart)
        line = write_picture(verdict, folder)
        if line is not None:
            say(line)
    if not options["quiet"]:
        click.echo((folder / "verdict.md").read_text(), nl=False)
