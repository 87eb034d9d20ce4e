"""The command `workspace`: parse, call, print."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

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

    Writes workspace.json and figures/: positions at a fixed orientation and orientations at a fixed position, within
    reach, joint swing, clearance, conditioning and motor torque, with serial and parallel singularities told apart; and
    the region of states and torques that motions visit.

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
    from stewart_drake.paper.reproduce import Study
    from stewart_drake.paper.workspace import motion_numbers
    from stewart_drake.planning.workspace import KINDS, slices, study_poses
    from stewart_drake.plotting import save_figure
    from stewart_drake.plotting.workspace_plots import plot_capability, plot_slices

    of_base = base.robot, base.limits, base.gravity
    with ProgressBar("workspace", 100.0, quiet, unit="%") as advance:
        numbers, surveys = study_poses(*of_base, center, samples, 20_000, lambda share: advance(60.0 * share))
        motions, draw = motion_numbers(Study(base=base, progress=lambda share: advance(60.0 + 40.0 * share)))
    numbers |= {"motions": motions}
    write_atomically(out / "workspace.json", (json.dumps(numbers, indent=1, allow_nan=False) + "\n").encode())
    figures = out / "figures"
    figures.mkdir(exist_ok=True)
    save_figure(draw(), figures / "torques.png")
    for kind, shown in zip(KINDS, (-1, 2), strict=True):
        cuts = slices(*of_base, surveys[kind], 220)
        save_figure(plot_slices(cuts), figures / f"{kind}-slices.png")
        save_figure(plot_capability(cuts[shown]), figures / f"{kind}-capability.png")
    if not quiet:
        print_table(f"numbers and figures in {out}", _rows(numbers))


def _rows(numbers: dict[str, Any]) -> list[tuple[str, str]]:
    rows = []
    for kind, scale, unit in (("position", 1e3, "L"), ("orientation", 100.0, "% of all")):
        found = numbers["workspaces"][kind]
        rows += [
            (f"{kind}s that the mechanism can reach", f"{scale * found['regular']:.3g} {unit}"),
            (f"{kind}s within all limits", f"{scale * found['connected']:.3g} {unit}"),
            (f"first limit on straight ways through {kind}s", next(iter(found["first"]), "none").replace("_", " ")),
        ]
    way, turn = (numbers["workspaces"][kind]["inscribed_radius"] for kind in ("position", "orientation"))
    rows.append(("free in every direction", f"{1e3 * way:.0f} mm, {math.degrees(turn):.0f} deg"))
    motions = numbers["motions"].items()
    return rows + [(f"torque of {name}", f"{of['peak_torque']:.3f} N m, {of['status']}") for name, of in motions]
