"""Commands on robots: `robots`, `write-sdf`, `write-mjcf`, `calibrate`, `identify` and `excite`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.yaml_files import parse_changes, to_yaml
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_error, print_line, print_table, progress_bar, working
from stewart_drake.estimation import geometry, servos, torques
from stewart_drake.estimation.poses import INSTRUMENTS, Instrument, MeasurementNoise
from stewart_drake.hardware.servos import POSITION_PRESETS
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg_table import Cranks, FromTable, Home, Unit
from stewart_drake.robot.leg_table import from_table as read_table
from stewart_drake.robot.robot_files import load_robot, robot_about, robot_names, save_robot
from stewart_drake.runs.outputs import check_ending, prepare_file, prepared_file, write_text
from stewart_drake.scenario.limits import ReferenceLimits, measure_poses
from stewart_drake.scenario.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from stewart_drake.estimation.calibration import Calibration
    from stewart_drake.estimation.identification import Identification
    from stewart_drake.estimation.servos import ServoIdentification

_PASSES = 16  # Averaged renderings of a picture, under different lights.
_POOR = 0.1  # [-] Least conditioning at home without a warning.
_NOT_IN_TABLES = ("platform_mass", "rod_mass", "crank_mass", "rotor_inertia", "effort_limit")


@command("robots", opt.Group, group={"invoke_without_command": True})
def robots() -> None:
    """A scenario names its robot by `robot: NAME`."""
    if click.get_current_context().invoked_subcommand is not None:
        return
    rows = []
    for name in robot_names():
        robot = load_robot(name)
        high = abs(robot.home_height - robot.base_height)
        size = f"{2e3 * robot.base_radius:.0f} mm across, {1e3 * high:.0f} mm high"
        rows.append((name, robot_about(name), size, f"{robot.platform_mass:.3g} kg"))
    print_table("robots", rows, ("robot", "what it is", "size", "platform"), numbers=())


@command(
    "robots show",
    name={"metavar": "ROBOT"},
    plot=opt.option("Draw its numbered legs, and where cranks turn: FILE.png.", opt.OUT_FILE, default=None),
)
def show(name: str, plot: Path | None, picture: Path | None) -> None:
    """ROBOT is a name or a YAML file."""
    from stewart_drake.analysis.robot_sheet import robot_sheets

    loaded = load_robot(name)
    for option, file in (("--plot", plot), ("--picture", picture)):
        if file is not None:
            check_ending(option, file, ".png")
            prepare_file(file)
    for title, header, rows in robot_sheets(loaded):
        print_table(f"{name}: {title}", rows, header, numbers=())
    if picture is not None:
        from stewart_drake.runs.pictures import render_png

        with progress_bar("picture", float(_PASSES), unit="passes") as advance:
            size = {"width": 800, "height": 600, "passes": _PASSES}
            render_png(loaded, loaded.home_pose, picture, **size, progress=advance)
        print_line(f"picture in {picture}")
    if plot is not None:
        from stewart_drake.plotting.robot_plots import plot_robot

        plot_robot(loaded, plot)
        print_line(f"legs in {plot}")


@command("robots from-table", out="robot.yaml", example="crank_length=0.025")
def from_table(
    table: Path, unit: Unit, cranks: Cranks, home: str, overrides: tuple[str, ...], about: str, out: Path
) -> None:
    """TABLE is a CSV file with one row per leg: shaft_x, shaft_y, shaft_z, joint_x, joint_y, joint_z.

    In cylindrical coordinates about z: shaft_radius, shaft_deg, shaft_z, joint_radius, joint_deg, joint_z. Optional:
    crank_deg, pair, crank_length, rod_length.
    """
    parameters = parse_changes(overrides, "crank_length=0.025")
    place: Home = "perpendicular" if home == "perpendicular" else "level"
    if home not in get_args(Home):
        try:
            parameters["home_height"] = float(home)
        except ValueError:
            raise ConfigurationError("--home", home, "level, perpendicular, or a height") from None
    read = read_table(table, unit, cranks, parameters, place)
    if read.pairs:
        print_line(f"pairs of motors: legs {', '.join(f'{one} and {other}' for one, other in read.pairs)}")
    if read.outwards:
        print_line("level cranks point outwards from the centre; for others give --cranks or a column crank_deg")
    _save_read(read, parameters, about, out)


def from_model(file: Path, motors: tuple[str, ...], overrides: tuple[str, ...], about: str, out: Path) -> None:
    """FILE is an MJCF, SDF or URDF with six motors that turn cranks, each with a rod to one platform.

    A rod ends in a joint or constraint, or its end has a frame that meets one of the platform. Shapes, friction and
    damping are not read.
    """
    from stewart_drake.plant.foreign_robot import read_model

    result = read_model(file, motors, parse_changes(overrides, "platform_mass=0.5"))
    _save_read(result.read, result.given, about, out)
    print_table("legs", result.motors, ("leg", "motor", "crank angle where the joint is at zero [deg]"))
    for note in result.notes:
        print_line(note)


_MOTORS = opt.option(
    "Joint of a motor, six times in the order of the legs [default: those on the base].",
    flag="--motor",
    multiple=True,
    metavar="NAME",
)
for _kind in ("urdf", "sdf", "mjcf"):
    command(f"robots from-{_kind}", out="robot.yaml", motors=_MOTORS, example="platform_mass=0.5")(from_model)


def _save_read(read: FromTable, given: Document, about: str, out: Path) -> None:
    """Writes a robot that was read, and prints what is doubtful or missing."""
    if read.warning:
        print_error(f"warning: {read.warning}")
    robot = RobotParameters(**read.parameters)
    (home,) = measure_poses(robot, robot.home_pose[None])
    if home.clearance < 0.0:
        print_error(f"warning: links of {1e3 * robot.link_radius:.3g} mm radius collide at home: is link_radius right?")
    if home.conditioning < _POOR:
        print_error(f"warning: home is near a singularity, conditioning {home.conditioning:.3f}: move the joints")
    save_robot(robot, out, about)
    size = f"shafts {1e3 * robot.base_radius:.4g} mm from the middle"
    print_line(f"robot in {out}: home at Z = {robot.home_height:.4g} m, {size}")
    missing = [f"{name} = {getattr(robot, name):g}" for name in _NOT_IN_TABLES if name not in given]
    if missing:
        print_line(f"taken from the paper's robot, because not given [kg, kg m^2, N m]: {', '.join(missing)}")


_MODEL: opt.Settings = {
    "robot": opt.option("Name or YAML file [default: the scenario's robot]."),
    "scenario": opt.option("Scenario with the robot and plant.", default="hold"),
    "example": "plant.motor_damping=0.01",
    "file": {"type": opt.OUT_FILE, "metavar": "OUT"},
}


def _model_options(write: Callable[[Scenario], str]) -> Callable[..., None]:
    """Function of a command that writes a scenario's robot for another program."""

    def model(file: Path, robot: str | None, scenario: str, overrides: tuple[str, ...], trust_code: bool) -> None:
        named = [] if robot is None else [f"robot={json.dumps(robot)}"]
        loaded = load_scenario(scenario, (*named, *overrides), trust_code)
        write_text(file, write(loaded))
        print_line(f"robot in {file}")
        if (loaded.robot.servo_gains != 1.0).any():
            print_error(f"warning: {file} has no servo_gain of the legs: keep the robot's YAML file")

    model.__doc__ = write.__doc__
    return model


def _note_base(scenario: Scenario, what: str) -> None:
    """Tells what of a scenario's base a model file leaves out."""
    tilted = any(scenario.base.orientation) and "tilt" in what
    if tilted or scenario.base.motion is not None:
        print_line(f"the {what} left out: the file has a robot on a base at rest")


@command("write-sdf", **_MODEL)
@_model_options
def write_sdf(scenario: Scenario) -> str:
    """Uses the scenario's plant.rod_joint and limits.joint_swing."""
    from stewart_drake.plant.model_files import sdf_text

    _note_base(scenario, "tilt and motion of the base are")
    return sdf_text(scenario.robot, rod_joint=scenario.plant.rod_joint, joint_swing=scenario.limits.joint_swing)


@command("write-mjcf", **_MODEL)
@_model_options
def write_mjcf(scenario: Scenario) -> str:
    """Uses the scenario's time step, gravity, motor friction and limits.joint_swing.

    The rods' joints are a little damped, by plant.universal_damping or what stops a free rod in 0.1 s.
    --set limits.joint_swing=null leaves out stops and damping: then it is the model that `plant.kind: mujoco` runs.
    """
    from stewart_drake.plant.model_files import mjcf_text

    _note_base(scenario, "motion of the base is")
    return mjcf_text(scenario.robot, scenario.gravity_in_base, scenario.plant, joint_swing=scenario.limits.joint_swing)


@command(
    "calibrate",
    file={"required": False, "metavar": "[POSES]"},
    robot=opt.GUESS,
    out=opt.option("File to write [default: runs/calibrated.yaml; with --plan runs/poses.csv].", opt.OUT_FILE),
    known_frames=opt.option(
        "Known frame: the tracker measures in B (base), or the pose of P itself (platform).",
        click.Choice(geometry.FRAMES),
        "--known-frame",
        multiple=True,
    ),
    hold={"type": click.Choice(geometry.KINDS)},
    instrument=opt.option(
        "What measures the poses [default: by the columns of POSES; with --plan tracker].",
        click.Choice(tuple(INSTRUMENTS)),
        "--with",
    ),
    fit=opt.option(
        "Estimate homing offsets, with servo gains (servos), or geometry, with offsets [default: chosen by the data].",
        click.Choice(geometry.CHOSEN),
    ),
    example="limits.clearance=0.01",
)
def calibrate(
    file: Path | None,
    robot: str,
    out: Path | None,
    report_folder: Path | None,
    plan: int | None,
    instrument: str | None,
    fit: str | None,
    position_noise: float | None,
    rotation_noise: float | None,
    encoder_bits: int,
    known_frames: tuple[str, ...],
    hold: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """POSES is a CSV file with one row per pose at rest.

    Columns: pose_roll_rad, pose_pitch_rad, pose_yaw_rad, pose_x_m, pose_y_m, pose_z_m (or _deg, _mm), the pose of the
    tracker's marker in the tracker's frame; crank_angle_0_rad to crank_angle_5_rad (or _deg), the encoder readings. The
    positions of the tracker, and of its marker on the platform, need not be known. An IMU has no x, y, z; a level or an
    accelerometer no yaw either. quaternion_w to _z, or acceleration_x to _z, may replace the angles.

    With --plan it writes the most informative poses to measure, in the same form, within the limits of the robot, which
    --set changes, and what --with can tell.
    """
    from stewart_drake.estimation.calibration import calibrate as calibrated
    from stewart_drake.estimation.poses import load_measurements
    from stewart_drake.plotting.model_plots import plot_calibration

    if (file is None) == (plan is None):
        raise click.UsageError("give either POSES or --plan N")
    poses = None if file is None else load_measurements(file)
    used = INSTRUMENTS[instrument or ("tracker" if poses is None else poses.instrument)]
    given = {"position": position_noise, "rotation": rotation_noise}
    given["encoder"] = 2.0 * math.pi / 2**encoder_bits / math.sqrt(12.0)
    noise = MeasurementNoise(**{**used.noise.to_dict(), **{key: of for key, of in given.items() if of is not None}})
    known_frames = tuple({*known_frames, *used.known_frames})
    guess = load_robot(robot)
    if instrument is not None and poses is not None:
        poses.refuse_other(instrument, guess)
    if plan is not None:
        hold = tuple({*hold, *geometry.KINDS} - {*geometry.FITS[fit or used.fit]} | {*hold})
        limits = load_scenario("paper_fig7", [f"robot={json.dumps(robot)}", *overrides]).limits
        out = out or Path("runs/poses.csv")
        _write_plan(guess, plan, limits, noise, known_frames, hold, used, out)
        again = f"{out} --robot {robot}" + (f" --with {instrument}" if instrument else "")
        print_line(f"poses in {out}; once they are measured: stewart-drake calibrate {again}")
    elif poses is not None:
        out = out or Path("runs/calibrated.yaml")
        with working("fitting"):
            result = calibrated(guess, poses, noise, known_frames, hold, fit)
        tables = {"residuals.csv": result.residuals_csv}
        _write_result(result, str(file), out, report_folder, "calibration.png", plot_calibration, tables)
        if fit is None:
            header, rows = result.choice_table()
            print_table("what to fit: the least Akaike information criterion (AIC) is chosen", rows, header)
        header, rows = result.table()
        if rows:
            print_table("change from the guess, 95 % interval", rows, header)
        for warning in result.warnings():
            print_error(f"warning: {warning}")


def _write_plan(
    guess: RobotParameters,
    count: int,
    limits: ReferenceLimits,
    noise: MeasurementNoise,
    known_frames: tuple[str, ...],
    hold: tuple[str, ...],
    instrument: Instrument,
    out: Path,
) -> None:
    """Writes the poses to measure, and prints what they will tell."""
    from stewart_drake.estimation.poses import plan_poses

    with working("choosing poses"):
        planned = plan_poses(guess, count, limits, noise, known_frames, hold, instrument=instrument)
    write_text(out, planned.targets.only(instrument.measured).to_csv())
    header, rows = planned.table()
    print_table(f"expected 95 % intervals with {count} poses, largest of the legs, +-", rows, header)
    place, turn = planned.error
    print_line(f"expected error of other poses (RMS): {1e3 * place:.2g} mm, {math.degrees(turn):.2g} deg")
    for line in planned.unidentifiable:
        print_line(f"not identifiable by these poses: {line}")


def _write_result(
    result: Calibration | Identification | ServoIdentification,
    title: str,
    out: Path,
    folder: Path | None,
    picture: str,
    plot: Callable[..., object],
    tables: dict[str, Callable[[], str]],
) -> None:
    """Writes the robot's file and the report, and prints the summary."""
    write_text(out, result.robot_file())
    facts = [*result.summary(), ("robot in", str(out))]
    if folder is not None:
        for name, text in {"parameters.csv": result.to_csv, **tables}.items():
            write_text(folder / name, text())
        plot(result, folder / picture)
        write_text(folder / "report.md", result.to_markdown(picture))
        facts.append(("report in", str(folder)))
    print_table(title, facts)


_BODIES = click.Choice(tuple(dict.fromkeys((*torques.KINDS, *servos.KINDS))))
_MOTIONS: opt.Settings = {"robot": opt.GUESS, "hold": {"type": _BODIES}}


@command(
    "identify",
    **_MOTIONS,
    logs={"required": True},
    out="runs/identified.yaml",
    ask=opt.option("Parameters that the logs must determine.", _BODIES, multiple=True),
    reading_age=opt.option("Age of an angle in its row, of servos [s].", opt.SECONDS, default=0.0),
)
def identify(
    logs: tuple[Path, ...],
    robot: str,
    out: Path,
    report_folder: Path | None,
    validate: tuple[Path, ...],
    hold: tuple[str, ...],
    ask: tuple[str, ...],
    lag: float,
    reading_age: float,
) -> None:
    """LOGS are results folders or logs of `run`, or CSV files sampled at a constant rate.

    Columns: time_s, crank_angle_0_rad to crank_angle_5_rad (or _deg), torque_0_Nm to torque_5_Nm, or for servos that
    take angles commanded_angle_0_rad to commanded_angle_5_rad. `excite` designs an informative motion. Without --ask
    the logs must determine the platform's mass and all friction; of servos stiffness, damping and delay too.
    """
    from stewart_drake.estimation import identification
    from stewart_drake.plotting.model_plots import plot_identification

    guess = load_robot(robot)
    result: ServoIdentification | Identification
    with working("fitting"):
        if servos.take_angles(logs):
            asked = ask or servos.ASKED
            result = servos.identify_servos(guess, logs, hold, asked, validate, reading_age=reading_age)
            tables = {"model.yaml": result.model_file}
        else:
            asked = ask or identification.ASKED
            result = identification.identify(guess, logs, hold, asked, validate, lag=lag)
            tables = {"friction.yaml": result.friction_file}
    _write_result(
        result, ", ".join(map(str, logs)), out, report_folder, "identification.png", plot_identification, tables
    )
    header, rows = result.table()
    print_table("parameters, 95 % intervals", rows, header, tuple(range(1, len(header) - 1)))


@command(
    "excite",
    **_MOTIONS,
    out="runs/excitation.yaml",
    example="limits.crank_speed=5",
    duration=opt.option("Duration of the run [s] [default: 60, of servos 20].", opt.Seconds(least=5.0), default=None),
    motors=opt.option(
        "Servos that take angles [default: motors that take torque].", click.Choice(POSITION_PRESETS.names)
    ),
)
def excite(
    robot: str,
    out: Path,
    motors: str | None,
    duration: float | None,
    hold: tuple[str, ...],
    overrides: tuple[str, ...],
    trust_code: bool,
) -> None:
    """Writes a scenario for `run`, within the robot's limits. --set changes limits, encoders or controller."""
    from stewart_drake.analysis.feasibility import check_reference
    from stewart_drake.estimation.excitation import MOTIONS, ROOM, SERVO_ROOM
    from stewart_drake.estimation.excitation import excite as design

    guess = load_robot(robot)
    # Unlike an observer, differences need no model of the robot.
    differences = ("estimator={kind: difference, rate_cutoff: 150}", "tuner={kind: block}")
    torque = ("plant.motor_friction=0", "model.friction=null")
    angle = (
        f"motors={{kind: position, preset: {motors}}}",
        "controller={kind: feedforward, period: 0.02}",
        "sensors.resolution_bits=12",
        "estimator={kind: difference}",
        "command_delay=0",
        # Small steps, so that the simulated log has no integration error.
        "plant={kind: closed_form, integrator: rk4, time_step: 0.00025}",
        "model={}",
    )
    duration = duration or (60.0 if motors is None else 20.0)
    keys = (f"robot={json.dumps(robot)}", *differences, *(torque if motors is None else angle))
    scenario = load_scenario("exact_breathing", (*keys, f"duration={duration!r}", *overrides), trust_code)
    room = ROOM if motors is None else SERVO_ROOM
    with prepared_file(out):
        with progress_bar("designing", float(MOTIONS), unit="motions") as advance:
            result = design(guess, scenario.limits, hold, gravity=scenario.gravity_in_base, room=room, progress=advance)
        check_reference(
            guess, scenario.limits, result.reference, duration, scenario.gravity_in_base
        ).raise_if_infeasible()
        designed = scenario.replace({"name": "excitation", "reference": result.reference.to_dict()})
        write_text(out, to_yaml(designed.to_dict()))
    rows = [
        ("condition number", f"{result.condition:.4g}"),
        ("median of random motions", f"{result.random_condition:.4g}"),
        ("scenario in", str(out)),
    ]
    print_table(f"excitation of {robot}", rows)
    print_line(f"next: stewart-drake run {out}")
