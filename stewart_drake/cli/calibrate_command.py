"""The command `calibrate`: parse, call, print."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stewart_drake.calibration.model import FRAMES, NAMES, FrameName, Name
from stewart_drake.cli.common_options import OutPath, overrides, trust_flag
from stewart_drake.runs.terminal import print_columns, print_table

if TYPE_CHECKING:
    from stewart_drake.calibration.poses import MeasurementNoise
    from stewart_drake.calibration.result import Calibration


@click.command()
@click.argument("poses", required=False, type=click.Path(path_type=Path))
@click.option("--robot", required=True, metavar="GUESS", help="The robot as believed: a YAML file or a name.")
@click.option(
    "--out",
    type=OutPath(dir_okay=False),
    help="File to write [default: runs/calibrated.yaml; with --plan runs/poses.csv].",
)
@click.option("--report", "report_folder", type=OutPath(file_okay=False), help="Folder for tables and a picture.")
@click.option("--plan", type=int, metavar="N", help="Write N poses that tell most; needs no POSES.")
@click.option("--position-noise", type=float, default=2e-5, show_default=True, help="Of the tracker [m].")
@click.option("--rotation-noise", type=float, default=1e-4, show_default=True, help="Of the tracker [rad].")
@click.option("--encoder-bits", type=click.IntRange(4, 40), default=17, show_default=True, help="Counts a turn.")
@click.option("--encoder-noise", type=float, help="Of a reading [rad] [default: that of the bits' steps].")
@click.option(
    "--known-frame",
    "known_frames",
    multiple=True,
    type=click.Choice(FRAMES),
    help="The tracker measures in B (base), or the pose of P itself (platform).",
)
@click.option("--hold", multiple=True, type=click.Choice(NAMES), help="Keep these parameters as they are.")
@overrides("limits.clearance=0.01")
@trust_flag
@click.option("--quiet", is_flag=True, help="No tables.")
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
    from stewart_drake.calibration.poses import MeasurementNoise

    if (poses is None) == (plan is None):
        raise click.UsageError("either POSES or --plan N")
    if encoder_noise is None:
        encoder_noise = 2.0 * math.pi / 2**encoder_bits / math.sqrt(12.0)
    noise = MeasurementNoise(position=position_noise, rotation=rotation_noise, encoder=encoder_noise)
    if poses is not None:
        if overrides:
            raise click.UsageError("--set changes limits of the poses to plan: it goes with --plan")
        _calibrate(poses, robot, out or Path("runs/calibrated.yaml"), report_folder, noise, known_frames, hold, quiet)
    elif plan is not None:
        if report_folder is not None:
            raise click.UsageError("--report goes with POSES")
        _plan(plan, robot, out or Path("runs/poses.csv"), noise, known_frames, hold, overrides, quiet)


def _calibrate(
    poses: Path,
    robot: str,
    out: Path,
    report_folder: Path | None,
    noise: MeasurementNoise,
    known_frames: tuple[FrameName, ...],
    hold: tuple[Name, ...],
    quiet: bool,
) -> None:
    from stewart_drake.calibration.fit import calibrate as fit
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.robot.robot_files import load_robot
    from stewart_drake.runs.outputs import prepare_file, prepare_folder

    found = fit(load_robot(robot), poses, noise, known_frames, hold)
    prepare_file(out)
    if report_folder is not None:
        _report(found, prepare_folder(report_folder))
    write_atomically(out, found.robot_file().encode())
    if not quiet:
        rows = [*found.summary(), ("robot in", str(out))]
        print_table(f"{poses}", rows + ([("report in", str(report_folder))] if report_folder else []))
        header, table = found.table()
        print_columns("change against the guess, 95 % interval", header, table)


def _report(found: Calibration, folder: Path) -> None:
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.plotting.model_plots import plot_calibration

    write_atomically(folder / "parameters.csv", found.to_csv().encode())
    write_atomically(folder / "residuals.csv", found.residuals_csv().encode())
    plot_calibration(found, folder / "calibration.png")
    write_atomically(folder / "report.md", found.to_markdown("calibration.png").encode())


def _plan(
    count: int,
    robot: str,
    out: Path,
    noise: MeasurementNoise,
    known_frames: tuple[FrameName, ...],
    hold: tuple[Name, ...],
    overrides: tuple[str, ...],
    quiet: bool,
) -> None:
    from stewart_drake.calibration.poses import plan_poses
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.robot.robot_files import load_robot
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.scenario import load_scenario

    guess = load_robot(robot)
    limits = load_scenario("paper_fig7", [f"robot={json.dumps(robot)}", *overrides]).limits
    plan = plan_poses(guess, count, limits, noise, known_frames, hold)
    prepare_file(out)
    write_atomically(out, plan.targets.to_csv().encode())
    if not quiet:
        header, rows = plan.table()
        print_columns(f"largest 95 % interval of any leg to expect of {count} poses, +-", header, rows)
        click.echo(f"{count} poses in {out}: put the measured poses and the readings in their place")
