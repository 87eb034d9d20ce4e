"""The commands `robots`, `write-sdf` and `write-mjcf`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stewart_drake.cli.common_options import OutPath, out_file, overrides, trust_flag
from stewart_drake.runs.terminal import ProgressBar, print_columns

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario

_PASSES = 16
"""Pictures under different lights that are averaged."""


@click.group(invoke_without_command=True)
@click.option("--out", type=OutPath(file_okay=False), help="Folder for a picture of each, NAME.png.")
@click.pass_context
def robots(context: click.Context, out: Path | None) -> None:
    """List the robots that a scenario can name, `robot: NAME`; with --out a picture of each."""
    if context.invoked_subcommand is not None:
        return
    from stewart_drake.robot.robot_files import load_robot, robot_about, robot_names

    rows = []
    for name in robot_names():
        robot = load_robot(name)
        picture = "" if out is None else _draw(name, out / f"{name}.png")
        size = f"{2e3 * robot.base_radius:.0f} mm across, {1e3 * (robot.home_height - robot.base_height):.0f} mm high"
        rows.append((name, robot_about(name), size, f"{robot.platform_mass:.3g} kg", picture))
    header = ("robot", "what it is", "size", "platform", "picture")
    shown = len(header) - (out is None)
    print_columns("robots", header[:shown], [row[:shown] for row in rows], numbers=())


@robots.command("show")
@click.argument("robot")
@click.option("--picture", type=OutPath(dir_okay=False), help="Draw it at home to this PNG.")
def show(robot: str, picture: Path | None) -> None:
    """Print the numbers of ROBOT with their units: a name, or a YAML file; with what follows from them at home."""
    from stewart_drake.planning.robot_sheet import robot_sheets
    from stewart_drake.robot.robot_files import load_robot

    for title, header, rows in robot_sheets(load_robot(robot)):
        print_columns(f"{robot}: {title}", header, rows, numbers=())
    if picture is not None:
        click.echo(f"picture in {_draw(robot, picture)}")


_OWN = ("platform_mass", "rod_mass", "crank_mass", "rotor_inertia", "effort_limit")
"""What no table says and no robot shares with another."""


@robots.command("from-table")
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--unit", default="m", show_default=True, help="Of all lengths, in the table and after --set: m or mm.")
@click.option(
    "--cranks",
    default="outwards",
    show_default=True,
    help="Where level cranks point, if the table does not say: outwards, towards the partner, away from it.",
)
@overrides("crank_length=0.025")
@click.option("--about", default="", help="One line on the robot.")
@out_file("robot.yaml")
def from_table(table: Path, unit: str, cranks: str, overrides: tuple[str, ...], about: str, out: Path) -> None:
    """Make a robot's YAML file from TABLE, a CSV file with a row a leg: shaft_x, shaft_y, shaft_z, joint_x, ..."""
    from stewart_drake.errors import ConfigurationError
    from stewart_drake.files.yaml_files import parse_yaml
    from stewart_drake.robot import RobotParameters
    from stewart_drake.robot.robot_files import save_robot

    parameters = {}
    for text in overrides:
        key, separator, value = text.partition("=")
        if not separator:
            raise ConfigurationError("--set", text, "key=value, such as crank_length=0.025")
        parameters[key.strip()] = parse_yaml(value, f"--set {key.strip()}")
    choices: Any = {"unit": unit, "cranks": cranks}
    robot = RobotParameters.from_table(table, **choices, **parameters)
    save_robot(robot, out, about)
    click.echo(f"robot in {out}: home at Z = {robot.home_height:.4g} m")
    unsaid = [f"{name} = {getattr(robot, name):g}" for name in _OWN if name not in parameters]
    if unsaid:
        click.echo(f"not given, so taken from the paper's robot [kg, kg m^2, N m]: {', '.join(unsaid)}")


@robots.command("table")
@click.argument("names", nargs=-1)
@out_file("robots.md")
@click.option("--quiet", is_flag=True, help="No progress bar and no table.")
def table(names: tuple[str, ...], out: Path, quiet: bool) -> None:
    """Compare robots in a table: workspace, conditioning, tracking, torque; Markdown. NAMES or files [default: all]."""
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.robot.robot_files import load_robot, robot_names
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.studies.robots import HEADER, robot_rows, robots_page

    chosen = {name: load_robot(name) for name in names or robot_names()}
    prepare_file(out)
    with ProgressBar("robots", float(len(chosen)), quiet, unit="robots") as advance:
        rows = robot_rows(chosen, advance)
    write_atomically(out, robots_page(rows).encode())
    if not quiet:
        print_columns("robots", HEADER, rows, numbers=())
        click.echo(f"table in {out}")


def _draw(name: str, path: Path) -> str:
    """Draws a robot at home, and says where."""
    from stewart_drake.robot.robot_files import load_robot
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.runs.picture import render_png

    robot = load_robot(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    prepare_file(path)
    render_png(robot, robot.home_pose, path, width=800, height=600, passes=_PASSES)
    return str(path)


def _loaded(scenario: str | None, robot: str | None, overrides: tuple[str, ...]) -> Scenario:
    from stewart_drake.scenario import load_scenario

    named = () if robot is None else (f"robot={robot}",)
    return load_scenario("hold" if scenario is None else scenario, (*named, *overrides))


_ROBOT = click.option("--robot", help="Name or YAML file [default: that of the scenario].")
_SCENARIO = click.option("--scenario", help="Take robot and plant of this scenario [default: the paper's].")


@click.command("write-sdf")
@click.argument("out", type=OutPath(dir_okay=False))
@_ROBOT
@_SCENARIO
@overrides("robot.rod_length=0.42")
@trust_flag
@click.option("--collision/--no-collision", default=True, show_default=True, help="With collision geometry.")
def write_sdf_command(
    out: Path, robot: str | None, scenario: str | None, overrides: tuple[str, ...], collision: bool
) -> None:
    """Write a robot, with the scenario's plant.rod_joint, as an SDF file."""
    from stewart_drake.plant.sdf_model import write_sdf

    loaded = _loaded(scenario, robot, overrides)
    write_sdf(loaded.robot, out, rod_joint=loaded.plant.rod_joint, collision=collision)


@click.command("write-mjcf")
@click.argument("out", type=OutPath(dir_okay=False))
@_ROBOT
@_SCENARIO
@overrides("plant.motor_damping=0.01")
@trust_flag
def write_mjcf_command(out: Path, robot: str | None, scenario: str | None, overrides: tuple[str, ...]) -> None:
    """Write a robot as an MJCF file for MuJoCo, with the scenario's time step, gravity and friction of the motors."""
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.mujoco_model import mjcf_text

    loaded = _loaded(scenario, robot, overrides)
    write_atomically(out, mjcf_text(loaded.robot, loaded.gravity, loaded.plant).encode())
