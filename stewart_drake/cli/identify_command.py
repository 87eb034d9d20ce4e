"""The commands `identify` and `excite`: parse, call, print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stewart_drake.cli.common_options import OutPath, out_file, overrides, trust_flag
from stewart_drake.identification.parameters import KINDS, Kind
from stewart_drake.runs.terminal import print_columns, print_table

if TYPE_CHECKING:
    from stewart_drake.identification.identified import Identification

_hold = click.option("--hold", multiple=True, type=click.Choice(KINDS), help="Keep these parameters as they are.")


@click.command()
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--robot", required=True, metavar="GUESS", help="The robot as believed: a YAML file or a name.")
@out_file("runs/identified.yaml")
@click.option("--report", "report_folder", type=OutPath(file_okay=False), help="Folder for a page, tables, a picture.")
@click.option("--validate", multiple=True, type=click.Path(path_type=Path), help="A log that is only predicted.")
@_hold
@click.option("--ask", multiple=True, type=click.Choice(KINDS), help="Refuse logs that do not tell these.")
@click.option("--bandwidth", type=float, help="Of the filter [Hz] [default: a twelfth of the rows' rate, at most 15].")
@click.option("--torque-lag", type=float, default=0.0, show_default=True, help="Of a CSV file's torques [s].")
@click.option("--quiet", is_flag=True, help="No tables.")
def identify(
    logs: tuple[Path, ...],
    robot: str,
    out: Path,
    report_folder: Path | None,
    validate: tuple[Path, ...],
    hold: tuple[Kind, ...],
    ask: tuple[Kind, ...],
    bandwidth: float | None,
    torque_lag: float,
    quiet: bool,
) -> None:
    """Masses, inertias, friction and torque constants of a robot from LOGS of its crank angles and torques.

    A log is a results folder or log of `run`, or a CSV file with a row for each instant, at an even rate: time_s,
    crank_angle_0_rad to crank_angle_5_rad (or _deg), torque_0_Nm to torque_5_Nm. `excite` designs a motion that tells
    most. Without --ask the platform's mass and all friction must be told.

    Exit status: 0 done, 2 bad input, 3 no bodies could have such torques.
    """
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.identification.estimate import ASKED
    from stewart_drake.identification.identified import identify as fit
    from stewart_drake.robot.robot_files import load_robot
    from stewart_drake.runs.outputs import prepare_file, prepare_folder

    found = fit(load_robot(robot), logs, hold, ask or ASKED, validate, bandwidth, torque_lag)
    prepare_file(out)
    if report_folder is not None:
        _report(found, prepare_folder(report_folder))
    write_atomically(out, found.robot_file().encode())
    if not quiet:
        rows = [*found.summary(), ("robot in", str(out))]
        print_table(", ".join(map(str, logs)), rows + ([("report in", str(report_folder))] if report_folder else []))
        header, table = found.table()
        print_columns("parameters, 95 % intervals", header, table, (1, 2))


def _report(found: Identification, folder: Path) -> None:
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.plotting.model_plots import plot_identification

    write_atomically(folder / "parameters.csv", found.to_csv().encode())
    write_atomically(folder / "friction.yaml", found.friction_file().encode())
    plot_identification(found, folder / "identification.png")
    write_atomically(folder / "report.md", found.to_markdown("identification.png").encode())


@click.command()
@click.option("--robot", required=True, metavar="GUESS", help="The robot as believed: a YAML file or a name.")
@out_file("runs/excitation.yaml")
@click.option("--duration", type=click.FloatRange(min=5.0), default=60.0, show_default=True, help="Of the run [s].")
@_hold
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the random motions.")
@overrides("limits.crank_speed=5")
@trust_flag
@click.option("--quiet", is_flag=True, help="No table.")
def excite(
    robot: str, out: Path, duration: float, hold: tuple[Kind, ...], seed: int, overrides: tuple[str, ...], quiet: bool
) -> None:
    """Design a motion within the robot's limits that tells its parameters, as a scenario that `run` runs.

    --set changes the scenario: its limits, encoders, or controller.

    Exit status: 0 done, 2 bad input.
    """
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.files.yaml_files import to_yaml
    from stewart_drake.identification.excitation import excite as design
    from stewart_drake.planning.feasibility import check_reference
    from stewart_drake.robot.robot_files import load_robot
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.scenario import load_scenario

    guess = load_robot(robot)
    # Readings are logged as they are without an observer.
    differences = ("estimator.kind=difference", "friction_compensation=null", "tuner={kind: block}")
    own = ("plant.motor_friction=0", *differences, f"duration={duration!r}")
    changes = (f"robot={json.dumps(robot)}", *own, *overrides)
    scenario = load_scenario("exact_breathing", changes)
    found = design(guess, scenario.limits, hold, gravity=scenario.gravity, seed=seed)
    check_reference(guess, scenario.limits, found.reference, duration, scenario.gravity).raise_if_infeasible()
    scenario = scenario.replace({"name": "excitation", "reference": found.reference.to_dict()})
    prepare_file(out)
    write_atomically(out, to_yaml(scenario.to_dict()).encode())
    if not quiet:
        rows = [
            ("condition number", f"{found.condition:.4g}"),
            ("of motions at random", f"{found.random_condition:.4g}, median"),
            ("scenario in", str(out)),
        ]
        print_table(f"excitation of {robot}", rows)
