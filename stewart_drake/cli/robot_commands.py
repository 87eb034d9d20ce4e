"""Commands on robots: `robots`, `write-sdf`, `write-mjcf`, `calibrate`, `identify` and `excite`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from stewart_drake.calibration.model import FRAMES, NAMES, FrameName, Name
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import cli
from stewart_drake.cli.terminal import print_table, progress_bar
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import write_atomically
from stewart_drake.files.yaml_files import parse_yaml, to_yaml
from stewart_drake.identification.parameters import KINDS, Kind
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_files import load_robot, robot_about, robot_names, save_robot
from stewart_drake.runs.outputs import prepare_file
from stewart_drake.scenario import Scenario, load_scenario

_PASSES = 16  # Pictures under different lights that are averaged.
_OWN = ("platform_mass", "rod_mass", "crank_mass", "rotor_inertia", "effort_limit")
"""What no table says and no robot shares with another."""

robot_option = click.option("--robot", help="Name or YAML file [default: that of the scenario].")
scenario_option = click.option("--scenario", default="hold", help="Take robot and plant of this scenario.")
report_option = click.option(
    "--report", "report_folder", type=opt.OUT_FOLDER, help="Folder for a page, tables, a picture."
)
hold_option = click.option("--hold", multiple=True, type=click.Choice(KINDS), help="Keep these parameters as they are.")


@cli.group(invoke_without_command=True)
@click.option("--out", type=opt.OUT_FOLDER, help="Folder for a picture of each, NAME.png.")
@click.pass_context
def robots(context: click.Context, out: Path | None) -> None:
    """List the robots that a scenario can name, `robot: NAME`; with --out a picture of each."""
    if context.invoked_subcommand is not None:
        return
    rows = []
    for name in robot_names():
        robot = load_robot(name)
        size = f"{2e3 * robot.base_radius:.0f} mm across, {1e3 * (robot.home_height - robot.base_height):.0f} mm high"
        picture = [] if out is None else [_draw(name, out / f"{name}.png")]
        rows.append([name, robot_about(name), size, f"{robot.platform_mass:.3g} kg", *picture])
    header = ("robot", "what it is", "size", "platform", "picture")
    print_table("robots", rows, header[: len(rows[0])], numbers=())


@robots.command("show")
@click.argument("robot")
@click.option("--picture", type=opt.OUT_FILE, help="Draw it at home to this PNG.")
def show(robot: str, picture: Path | None) -> None:
    """Print the numbers of ROBOT with their units: a name, or a YAML file; with what follows from them at home."""
    from stewart_drake.planning.robot_sheet import robot_sheets

    for title, header, rows in robot_sheets(load_robot(robot)):
        print_table(f"{robot}: {title}", rows, header, numbers=())
    if picture is not None:
        click.echo(f"picture in {_draw(robot, picture)}")


def _draw(name: str, path: Path) -> str:
    """Draws a robot at home, and says where."""
    from stewart_drake.runs.pictures import render_png

    robot = load_robot(name)
    prepare_file(path)
    render_png(robot, robot.home_pose, path, width=800, height=600, passes=_PASSES)
    return str(path)


@robots.command("from-table")
@click.argument("table", type=opt.IN_FILE)
@click.option("--unit", default="m", help="Of all lengths, in the table and after --set: m or mm.")
@click.option(
    "--cranks",
    default="outwards",
    help="Where level cranks point, if the table does not say: outwards, towards the partner, away from it.",
)
@opt.overrides("crank_length=0.025")
@click.option("--about", default="", help="One line on the robot.")
@opt.out_file("robot.yaml")
def from_table(table: Path, unit: Any, cranks: Any, overrides: tuple[str, ...], about: str, out: Path) -> None:
    """Make a robot's YAML file from TABLE, a CSV file with a row a leg: shaft_x, shaft_y, shaft_z, joint_x, ..."""
    parameters = {}
    for text in overrides:
        key, separator, value = text.partition("=")
        if not separator:
            raise ConfigurationError("--set", text, "key=value, such as crank_length=0.025")
        parameters[key.strip()] = parse_yaml(value, f"--set {key.strip()}")
    robot = RobotParameters.from_table(table, unit=unit, cranks=cranks, **parameters)
    save_robot(robot, out, about)
    click.echo(f"robot in {out}: home at Z = {robot.home_height:.4g} m")
    unsaid = [f"{name} = {getattr(robot, name):g}" for name in _OWN if name not in parameters]
    if unsaid:
        click.echo(f"not given, so taken from the paper's robot [kg, kg m^2, N m]: {', '.join(unsaid)}")


@robots.command("table")
@click.argument("names", nargs=-1)
@opt.out_file("robots.md")
@opt.quiet_flag
def table(names: tuple[str, ...], out: Path, quiet: bool) -> None:
    """Compare robots in a table: workspace, conditioning, tracking, torque; Markdown. NAMES or files [default: all]."""
    from stewart_drake.studies.robots import HEADER, robot_rows, robots_page

    chosen = {name: load_robot(name) for name in names or robot_names()}
    prepare_file(out)
    with progress_bar("robots", float(len(chosen)), quiet, unit="robots") as advance:
        rows = robot_rows(chosen, advance)
    write_atomically(out, robots_page(rows).encode())
    if not quiet:
        print_table("robots", rows, HEADER, numbers=())
        click.echo(f"table in {out}")


def _loaded(scenario: str, robot: str | None, overrides: tuple[str, ...]) -> Scenario:
    return load_scenario(scenario, (*([] if robot is None else [f"robot={robot}"]), *overrides))


@cli.command("write-sdf")
@click.argument("out", type=opt.OUT_FILE)
@robot_option
@scenario_option
@opt.overrides("robot.rod_length=0.42")
@opt.trust_flag
@click.option("--collision/--no-collision", default=True, help="With collision geometry.")
def write_sdf_command(out: Path, robot: str | None, scenario: str, overrides: tuple[str, ...], collision: bool) -> None:
    """Write a robot, with the scenario's plant.rod_joint, as an SDF file."""
    from stewart_drake.plant.sdf_model import write_sdf

    loaded = _loaded(scenario, robot, overrides)
    write_sdf(loaded.robot, out, rod_joint=loaded.plant.rod_joint, collision=collision)


@cli.command("write-mjcf")
@click.argument("out", type=opt.OUT_FILE)
@robot_option
@scenario_option
@opt.overrides("plant.motor_damping=0.01")
@opt.trust_flag
def write_mjcf_command(out: Path, robot: str | None, scenario: str, overrides: tuple[str, ...]) -> None:
    """Write a robot as an MJCF file for MuJoCo, with the scenario's time step, gravity and friction of the motors."""
    from stewart_drake.mujoco_model import mjcf_text

    loaded = _loaded(scenario, robot, overrides)
    write_atomically(out, mjcf_text(loaded.robot, loaded.gravity, loaded.plant).encode())


@cli.command()
@click.argument("poses", required=False, type=opt.IN_FILE)
@opt.guess_option
@click.option(
    "--out", type=opt.OUT_FILE, help="File to write [default: runs/calibrated.yaml; with --plan runs/poses.csv]."
)
@report_option
@click.option("--plan", type=int, metavar="N", help="Write N poses that tell most; needs no POSES.")
@click.option("--position-noise", type=float, default=2e-5, help="Of the tracker [m].")
@click.option("--rotation-noise", type=float, default=1e-4, help="Of the tracker [rad].")
@click.option("--encoder-bits", type=click.IntRange(4, 40), default=17, help="Counts a turn.")
@click.option("--encoder-noise", type=float, help="Of a reading [rad] [default: that of the bits' steps].")
@click.option(
    "--known-frame",
    "known_frames",
    multiple=True,
    type=click.Choice(FRAMES),
    help="The tracker measures in B (base), or the pose of P itself (platform).",
)
@click.option("--hold", multiple=True, type=click.Choice(NAMES), help="Keep these parameters as they are.")
@opt.overrides("limits.clearance=0.01")
@opt.trust_flag
@opt.quiet_flag
def calibrate(
    poses: Path | None,
    robot: str,
    out: Path | None,
    report_folder: Path | None,
    plan: int | None,
    position_noise: float,
    rotation_noise: float,
    encoder_bits: int,
    encoder_noise: float | None,
    known_frames: tuple[FrameName, ...],
    hold: tuple[Name, ...],
    overrides: tuple[str, ...],
    quiet: bool,
) -> None:
    """Geometry and homing offsets of a robot from measured POSES and its encoders' readings.

    POSES is a CSV file with a row for each pose at rest: pose_roll_rad, pose_pitch_rad, pose_yaw_rad, pose_x_m,
    pose_y_m, pose_z_m of the tracker's marker in the tracker's frame (or _deg, _mm) and crank_angle_0_rad to
    crank_angle_5_rad, the readings (or _deg). Where the tracker stands, and where on the platform its marker is, need
    not be known.

    With --plan it writes poses to measure in that form: within the limits of the robot, and such as tell most.
    --set changes those limits.

    Exit status: 0 done, 2 bad input.
    """
    from stewart_drake.calibration.fit import calibrate as fit
    from stewart_drake.calibration.poses import MeasurementNoise, plan_poses
    from stewart_drake.plotting.model_plots import plot_calibration

    if (poses is None) == (plan is None):
        raise click.UsageError("either POSES or --plan N")
    if poses is not None and overrides:
        raise click.UsageError("--set changes limits of the poses to plan: it goes with --plan")
    if plan is not None and report_folder is not None:
        raise click.UsageError("--report goes with POSES")
    of_bits = 2.0 * math.pi / 2**encoder_bits / math.sqrt(12.0)
    encoder = of_bits if encoder_noise is None else encoder_noise
    noise = MeasurementNoise(position=position_noise, rotation=rotation_noise, encoder=encoder)
    guess = load_robot(robot)
    if plan is not None:
        limits = load_scenario("paper_fig7", [f"robot={json.dumps(robot)}", *overrides]).limits
        planned = plan_poses(guess, plan, limits, noise, known_frames, hold)
        opt.write_text(out or Path("runs/poses.csv"), planned.targets.to_csv())
        header, rows = planned.table()
        title = f"largest 95 % interval of any leg to expect of {plan} poses, +-"
    elif poses is not None:
        found = fit(guess, poses, noise, known_frames, hold)
        out = out or Path("runs/calibrated.yaml")
        more = {"residuals.csv": found.residuals_csv}
        facts = _write_found(found, out, report_folder, "calibration.png", plot_calibration, more)
        if not quiet:
            print_table(f"{poses}", facts)
        header, rows = found.table()
        title = "change against the guess, 95 % interval"
    if not quiet:
        print_table(title, rows, header)


def _write_found(
    found: Any,
    out: Path,
    folder: Path | None,
    picture: str,
    plot: Callable[..., Any],
    more: dict[str, Callable[[], str]],
) -> list[tuple[str, str]]:
    """Writes the robot's file and the report; the summary, and where they are."""
    opt.write_text(out, found.robot_file())
    facts = [*found.summary(), ("robot in", str(out))]
    if folder is not None:
        for name, text in {"parameters.csv": found.to_csv, **more}.items():
            opt.write_text(folder / name, text())
        plot(found, folder / picture)
        opt.write_text(folder / "report.md", found.to_markdown(picture))
        facts.append(("report in", str(folder)))
    return facts


@cli.command()
@click.argument("logs", nargs=-1, required=True, type=opt.IN_FILE)
@opt.guess_option
@opt.out_file("runs/identified.yaml")
@report_option
@click.option("--validate", multiple=True, type=opt.IN_FILE, help="A log that is only predicted.")
@hold_option
@click.option("--ask", multiple=True, type=click.Choice(KINDS), help="Refuse logs that do not tell these.")
@click.option("--bandwidth", type=float, help="Of the filter [Hz] [default: a twelfth of the rows' rate, at most 15].")
@click.option("--torque-lag", "lag", type=float, default=0.0, help="Of a CSV file's torques [s].")
@opt.quiet_flag
def identify(
    logs: tuple[Path, ...], robot: str, out: Path, report_folder: Path | None, quiet: bool, **options: Any
) -> None:
    """Masses, inertias, friction and torque constants of a robot from LOGS of its crank angles and torques.

    A log is a results folder or log of `run`, or a CSV file with a row for each instant, at an even rate: time_s,
    crank_angle_0_rad to crank_angle_5_rad (or _deg), torque_0_Nm to torque_5_Nm. `excite` designs a motion that tells
    most. Without --ask the platform's mass and all friction must be told.

    Exit status: 0 done, 2 bad input, 3 no bodies could have such torques.
    """
    from stewart_drake.identification.estimate import ASKED
    from stewart_drake.identification.identified import identify as fit
    from stewart_drake.plotting.model_plots import plot_identification

    found = fit(load_robot(robot), logs, **options | {"ask": options["ask"] or ASKED})
    more = {"friction.yaml": found.friction_file}
    facts = _write_found(found, out, report_folder, "identification.png", plot_identification, more)
    if not quiet:
        print_table(", ".join(map(str, logs)), facts)
        header, rows = found.table()
        print_table("parameters, 95 % intervals", rows, header, (1, 2))


@cli.command()
@opt.guess_option
@opt.out_file("runs/excitation.yaml")
@click.option("--duration", type=click.FloatRange(min=5.0), default=60.0, help="Of the run [s].")
@hold_option
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Of the random motions.")
@opt.overrides("limits.crank_speed=5")
@opt.trust_flag
@opt.quiet_flag
def excite(
    robot: str, out: Path, duration: float, hold: tuple[Kind, ...], seed: int, overrides: tuple[str, ...], quiet: bool
) -> None:
    """Design a motion within the robot's limits that tells its parameters, as a scenario that `run` runs.

    --set changes the scenario: its limits, encoders, or controller.

    Exit status: 0 done, 2 bad input.
    """
    from stewart_drake.identification.excitation import excite as design
    from stewart_drake.planning.feasibility import check_reference

    guess = load_robot(robot)
    # Readings are logged as they are without an observer.
    differences = ("estimator.kind=difference", "friction_compensation=null", "tuner={kind: block}")
    own = (f"robot={json.dumps(robot)}", "plant.motor_friction=0", *differences, f"duration={duration!r}")
    scenario = load_scenario("exact_breathing", (*own, *overrides))
    found = design(guess, scenario.limits, hold, gravity=scenario.gravity, seed=seed)
    check_reference(guess, scenario.limits, found.reference, duration, scenario.gravity).raise_if_infeasible()
    opt.write_text(
        out, to_yaml(scenario.replace({"name": "excitation", "reference": found.reference.to_dict()}).to_dict())
    )
    if not quiet:
        rows = [
            ("condition number", f"{found.condition:.4g}"),
            ("of motions at random", f"{found.random_condition:.4g}, median"),
            ("scenario in", str(out)),
        ]
        print_table(f"excitation of {robot}", rows)
