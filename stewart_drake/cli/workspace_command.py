"""The command `workspace`: parse, call, print."""

from __future__ import annotations

import json
from pathlib import Path

import click

from stewart_drake.cli.common_options import out_folder, overrides, quiet_flag, trust_flag
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.terminal import ProgressBar, print_table


@click.command()
@out_folder("runs/workspace")
@click.option(
    "--samples",
    type=click.IntRange(1_000, 10_000_000),
    default=1_000_000,
    show_default=True,
    help="Poses in each of the two workspaces.",
)
@click.option(
    "--pose",
    type=float,
    nargs=6,
    metavar="ROLL PITCH YAW X Y Z",
    help="Fixed orientation [rad] and fixed position [m] [default: home].",
)
@click.option("--scenario", help="Take robot, limits and controller of this scenario [default: the paper's].")
@overrides("limits.clearance=0.01")
@trust_flag
@quiet_flag
def workspace(
    out: Path,
    samples: int,
    pose: tuple[float, ...] | None,
    scenario: str | None,
    overrides: tuple[str, ...],
    quiet: bool,
) -> None:
    """Where the robot can go, what it can do there, and what controlled motions visit.

    Writes report.html, report.md, workspace.json and figures/: positions at a fixed orientation and orientations at a
    fixed position, within reach, joint swing, clearance, conditioning and motor torque, with serial and parallel
    singularities told apart; and the region of states and torques that motions visit. Finished runs are kept in OUT.

    Exit status: 0 done, 2 bad input, 130 interrupted.
    """
    from stewart_drake.runs.outputs import prepare_folder
    from stewart_drake.scenario import load_scenario

    base = load_scenario("paper_fig7" if scenario is None else scenario, overrides)

    import numpy as np

    from stewart_drake.planning.workspace import check_center
    from stewart_drake.runs.simulation import check_scenario

    center = base.robot.home_pose if pose is None else np.array(pose)
    check_center(base.robot, center)
    base.load_tuner_network()
    try:
        check_scenario(base)
    except ConfigurationError as error:
        # A region of poses needs no motion.
        click.echo(f"stewart-drake: left out is the scenario's own motion: {error}", err=True)
    prepare_folder(out)

    from stewart_drake.files.whole import write_atomically
    from stewart_drake.paper.report import write_report
    from stewart_drake.paper.study import Study
    from stewart_drake.paper.workspace_section import make_section, summary

    with ProgressBar("workspace", 100.0, quiet, unit="%") as advance:
        study = Study(out, base=base, progress=lambda share: advance(100.0 * share))
        with study.locked("figures"):
            section = make_section(study, samples, center)
            preface = f"Made by `stewart-drake workspace` for the scenario {base.name}."
            write_report(out, section.title, preface, [section])
            numbers = json.dumps(section.numbers, indent=1, allow_nan=False) + "\n"
            write_atomically(out / "workspace.json", numbers.encode())
    if not quiet:
        print_table(f"report in {out / 'report.html'}", summary(section.numbers))
