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
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, progress_bar, tell, working
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.yaml_files import parse_yaml, to_yaml
from stewart_drake.identification.parameters import KINDS, Kind
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_files import load_robot, robot_about, robot_names, save_robot
from stewart_drake.runs.outputs import prepare_file, write_text
from stewart_drake.scenario import Scenario, load_scenario

_PASSES = 16  # Pictures under different lights that are averaged.
_OWN = ("platform_mass", "rod_mass", "crank_mass", "rotor_inertia", "effort_limit")
"""What no table says and no robot shares with another."""

report_option = click.option(
    "--report", "report_folder", type=opt.OUT_FOLDER, help="Folder for a report with tables and a plot."
)
hold_option = click.option("--hold", multiple=True, type=click.Choice(KINDS), help="Do not estimate these parameters.")


@command("robots", kind=opt.Group, invoke_without_command=True)
@click.pass_context
def robots(context: click.Context) -> None:
    """A scenario names its robot by `robot: NAME`."""
    if context.invoked_subcommand is not None:
        return
    rows = []
    for name in robot_names():
        robot = load_robot(name)
        size = f"{2e3 * robot.base_radius:.0f} mm across, {1e3 * (robot.home_height - robot.base_height):.0f} mm high"
        rows.append((name, robot_about(name), size, f"{robot.platform_mass:.3g} kg"))
    print_table("robots", rows, ("robot", "what it is", "size", "platform"), numbers=())


@command("robots show")
@click.argument("robot")
@click.option("--picture", type=opt.OUT_FILE, help="Write a picture of it at home: FILE.png.")
def show(robot: str, picture: Path | None) -> None:
    """ROBOT is a name or a YAML file."""
    from stewart_drake.planning.robot_sheet import robot_sheets

    loaded = load_robot(robot)
    for title, header, rows in robot_sheets(loaded):
        print_table(f"{robot}: {title}", rows, header, numbers=())
    if picture is not None:
        from stewart_drake.runs.pictures import render_png

        prepare_file(picture)
        render_png(loaded, loaded.home_pose, picture, width=800, height=600, passes=_PASSES)
        tell(f"picture in {picture}")


@command("robots from-table")
@click.argument("table", type=opt.PATH)
@click.option("--unit", default="m", help="Unit of all lengths, in the table and after --set: m or mm.")
@click.option(
    "--cranks",
    default="outwards",
    help="Direction of level cranks, if the table has none: outwards, towards the partner, away from it.",
)
@opt.overrides("crank_length=0.025")
@click.option("--about", default="", help="One line on the robot.")
@opt.out_file("robot.yaml")
def from_table(table: Path, unit: Any, cranks: Any, overrides: tuple[str, ...], about: str, out: Path) -> None:
    """TABLE is a CSV file with one row per leg: shaft_x, shaft_y, shaft_z, joint_x, joint_y, joint_z."""
    parameters = {}
    for text in overrides:
        key, separator, value = text.partition("=")
        if not separator:
            raise ConfigurationError("--set", text, "key=value, such as crank_length=0.025")
        parameters[key.strip()] = parse_yaml(value, f"--set {key.strip()}")
    robot = RobotParameters.from_table(table, unit=unit, cranks=cranks, **parameters)
    save_robot(robot, out, about)
    tell(f"robot in {out}: home at Z = {robot.home_height:.4g} m")
    missing = [f"{name} = {getattr(robot, name):g}" for name in _OWN if name not in parameters]
    if missing:
        tell(f"taken from the paper's robot, because not given [kg, kg m^2, N m]: {', '.join(missing)}")


@command("robots table")
@click.argument("names", nargs=-1)
@opt.out_file("robots.md")
def table(names: tuple[str, ...], out: Path) -> None:
    """NAMES are robots or YAML files [default: all]. Also compares conditioning and size; writes Markdown."""
    from stewart_drake.studies.robots import HEADER, robot_rows, robots_page

    chosen = {name: load_robot(name) for name in names or robot_names()}
    prepare_file(out)
    with progress_bar("robots", float(len(chosen)), unit="robots") as advance:
        rows = robot_rows(chosen, advance)
    write_text(out, robots_page(rows))
    print_table("robots", rows, HEADER, numbers=())
    tell(f"table in {out}")


def _model_options(write: Callable[[Scenario], str]) -> Callable[..., None]:
    """Options and end of a command that writes a scenario's robot for another program."""

    @click.argument("out", type=opt.OUT_FILE)
    @click.option("--robot", help="Name or YAML file [default: the scenario's robot].")
    @click.option("--scenario", default="hold", help="Scenario with the robot and plant.")
    @opt.overrides("plant.motor_damping=0.01")
    def model(out: Path, robot: str | None, scenario: str, overrides: tuple[str, ...]) -> None:
        own = [] if robot is None else [f"robot={json.dumps(robot)}"]
        write_text(out, write(load_scenario(scenario, (*own, *overrides))))
        tell(f"robot in {out}")

    model.__doc__ = write.__doc__
    return model


@command("write-sdf")
@_model_options
def write_sdf(scenario: Scenario) -> str:
    """Uses the scenario's plant.rod_joint."""
    from stewart_drake.plant.sdf_model import sdf_text

    return sdf_text(scenario.robot, rod_joint=scenario.plant.rod_joint)


@command("write-mjcf")
@_model_options
def write_mjcf(scenario: Scenario) -> str:
    """Uses the scenario's time step, gravity and motor friction."""
    from stewart_drake.mujoco_model import mjcf_text

    return mjcf_text(scenario.robot, scenario.gravity, scenario.plant)


@command("calibrate")
@click.argument("poses", required=False, type=opt.PATH)
@opt.guess_option
@click.option(
    "--out", type=opt.OUT_FILE, help="File to write [default: runs/calibrated.yaml; with --plan runs/poses.csv]."
)
@report_option
@click.option("--plan", type=int, metavar="N", help="Write the N most informative poses to measure; without POSES.")
@click.option("--position-noise", type=float, default=2e-5, help="Standard deviation of the tracker [m].")
@click.option("--rotation-noise", type=float, default=1e-4, help="Standard deviation of the tracker [rad].")
@click.option("--encoder-bits", type=click.IntRange(4, 40), default=17, help="Encoder resolution, bits per turn.")
@click.option(
    "--known-frame",
    "known_frames",
    multiple=True,
    type=click.Choice(FRAMES),
    help="Known frame: the tracker measures in B (base), or the pose of P itself (platform).",
)
@click.option("--hold", multiple=True, type=click.Choice(NAMES), help="Do not estimate these parameters.")
@opt.overrides("limits.clearance=0.01")
def calibrate(
    poses: Path | None,
    robot: str,
    out: Path | None,
    report_folder: Path | None,
    plan: int | None,
    position_noise: float,
    rotation_noise: float,
    encoder_bits: int,
    known_frames: tuple[FrameName, ...],
    hold: tuple[Name, ...],
    overrides: tuple[str, ...],
) -> None:
    """POSES is a CSV file with one row per pose at rest.

    Columns: pose_roll_rad, pose_pitch_rad, pose_yaw_rad, pose_x_m, pose_y_m, pose_z_m (or _deg, _mm), the pose of the
    tracker's marker in the tracker's frame; crank_angle_0_rad to crank_angle_5_rad (or _deg), the encoder readings. The
    positions of the tracker, and of its marker on the platform, need not be known.

    With --plan it writes the most informative poses to measure, in the same form. They are within the limits of the
    robot, which --set changes.
    """
    from stewart_drake.calibration.fit import calibrate as fit
    from stewart_drake.calibration.poses import MeasurementNoise, plan_poses
    from stewart_drake.plotting.model_plots import plot_calibration

    if (poses is None) == (plan is None):
        raise click.UsageError("give either POSES or --plan N")
    encoder = 2.0 * math.pi / 2**encoder_bits / math.sqrt(12.0)
    noise = MeasurementNoise(position=position_noise, rotation=rotation_noise, encoder=encoder)
    guess = load_robot(robot)
    if plan is not None:
        limits = load_scenario("paper_fig7", [f"robot={json.dumps(robot)}", *overrides]).limits
        out = out or Path("runs/poses.csv")
        with working("choosing poses"):
            planned = plan_poses(guess, plan, limits, noise, known_frames, hold)
        write_text(out, planned.targets.to_csv())
        header, rows = planned.table()
        print_table(f"expected 95 % intervals with {plan} poses, largest of the legs, +-", rows, header)
        tell(f"poses in {out}; once they are measured: stewart-drake calibrate {out} --robot {robot}")
    elif poses is not None:
        out = out or Path("runs/calibrated.yaml")
        with working("fitting"):
            found = fit(guess, poses, noise, known_frames, hold)
        tables = {"residuals.csv": found.residuals_csv}
        _write_result(found, str(poses), out, report_folder, "calibration.png", plot_calibration, tables)
        header, rows = found.table()
        print_table("change from the guess, 95 % interval", rows, header)


def _write_result(
    found: Any,
    title: str,
    out: Path,
    folder: Path | None,
    picture: str,
    plot: Callable[..., Any],
    tables: dict[str, Callable[[], str]],
) -> None:
    """Writes the robot's file and the report, and prints the summary."""
    write_text(out, found.robot_file())
    facts = [*found.summary(), ("robot in", str(out))]
    if folder is not None:
        for name, text in {"parameters.csv": found.to_csv, **tables}.items():
            write_text(folder / name, text())
        plot(found, folder / picture)
        write_text(folder / "report.md", found.to_markdown(picture))
        facts.append(("report in", str(folder)))
    print_table(title, facts)


@command("identify")
@click.argument("logs", nargs=-1, required=True, type=opt.PATH)
@opt.guess_option
@opt.out_file("runs/identified.yaml")
@report_option
@click.option("--validate", multiple=True, type=opt.PATH, help="A log that is predicted, but not fitted.")
@hold_option
@click.option("--ask", multiple=True, type=click.Choice(KINDS), help="Parameters that the logs must determine.")
@click.option("--torque-lag", "lag", type=float, default=0.0, help="Delay of the torques in a CSV file [s].")
def identify(logs: tuple[Path, ...], robot: str, out: Path, report_folder: Path | None, **options: Any) -> None:
    """LOGS are results folders or logs of `run`, or CSV files sampled at a constant rate.

    Columns: time_s, crank_angle_0_rad to crank_angle_5_rad (or _deg), torque_0_Nm to torque_5_Nm. `excite` designs an
    informative motion. Without --ask the logs must determine the platform's mass and all friction.
    """
    from stewart_drake.identification.estimate import ASKED
    from stewart_drake.identification.identified import identify as fit
    from stewart_drake.plotting.model_plots import plot_identification

    with working("fitting"):
        found = fit(load_robot(robot), logs, **options | {"ask": options["ask"] or ASKED})
    title, tables = ", ".join(map(str, logs)), {"friction.yaml": found.friction_file}
    _write_result(found, title, out, report_folder, "identification.png", plot_identification, tables)
    header, rows = found.table()
    print_table("parameters, 95 % intervals", rows, header, (1, 2))


@command("excite")
@opt.guess_option
@opt.out_file("runs/excitation.yaml")
@click.option("--duration", type=click.FloatRange(min=5.0), default=60.0, help="Duration of the run [s].")
@hold_option
@opt.overrides("limits.crank_speed=5")
def excite(robot: str, out: Path, duration: float, hold: tuple[Kind, ...], overrides: tuple[str, ...]) -> None:
    """Writes a scenario for `run`, within the robot's limits. --set changes limits, encoders or controller."""
    from stewart_drake.identification.excitation import excite as design
    from stewart_drake.planning.feasibility import check_reference

    guess = load_robot(robot)
    # Readings are logged as they are without an observer.
    differences = ("estimator.kind=difference", "friction_compensation=null", "tuner={kind: block}")
    own = (f"robot={json.dumps(robot)}", "plant.motor_friction=0", *differences, f"duration={duration!r}")
    scenario = load_scenario("exact_breathing", (*own, *overrides))
    with working("designing"):
        found = design(guess, scenario.limits, hold, gravity=scenario.gravity)
    check_reference(guess, scenario.limits, found.reference, duration, scenario.gravity).raise_if_infeasible()
    designed = scenario.replace({"name": "excitation", "reference": found.reference.to_dict()})
    write_text(out, to_yaml(designed.to_dict()))
    rows = [
        ("condition number", f"{found.condition:.4g}"),
        ("median of random motions", f"{found.random_condition:.4g}"),
        ("scenario in", str(out)),
    ]
    print_table(f"excitation of {robot}", rows)
    tell(f"next: stewart-drake run {out}")
