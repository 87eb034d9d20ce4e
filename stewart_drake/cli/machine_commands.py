"""Commands for real robots: `drive` and `export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from stewart_drake.base.registry import DANCES
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.run_commands import exit_unless_completed, load_learnt, save_learnt, write_results
from stewart_drake.cli.terminal import print_error, print_line, print_table, progress_bar, shown_compiling
from stewart_drake.logs.signals import SCALES
from stewart_drake.runs.outputs import begin_journal, check_run_folder, new_run_folder, prepare_file
from stewart_drake.scenario.scenario import Scenario, load_driven

if TYPE_CHECKING:
    from stewart_drake.machines.machine import Machine
    from stewart_drake.runs.drive import Start


@command(
    "drive",
    machine=opt.option(
        "What to drive: reachy://HOST:PORT, udp://HOST:PORT, serial:DEVICE, sim: or mine.py:MyMachine.", required=True
    ),
    seconds=opt.option("Seconds of the motion [default: the scenario's duration].", opt.SECONDS, "--for"),
    dance=opt.option("Play this dance of Reachy Mini, or move FILE.json, fixed if need be.", metavar="NAME"),
    mcap=opt.switch("Also write run.mcap, for Foxglove and Rerun."),
    dry=opt.switch("Connect, read and plan; move nothing."),
    out=opt.option("Folder for the results [default: runs/NAME, or runs/NAME-2, ...].", opt.PATH),
)
def drive(
    scenario: str,
    machine: str,
    overrides: tuple[str, ...],
    seconds: float | None,
    dance: str | None,
    mcap: bool,
    dry: bool,
    out: Path | None,
    force: bool,
    keep_model: Path | None,
    trust_code: bool,
) -> None:
    """SCENARIO, or a file of a controller alone, moves a machine: to the start of the motion, along it, and to rest.

    The machine stops on its path and holds after Ctrl-C, when a reading is too old, or when a crank angle is far from
    its command; a second Ctrl-C releases it at once. Results are those of `run`; a killed process leaves them up to
    its last rows.
    """
    from stewart_drake.logs.mcap_file import check_mcap
    from stewart_drake.machines.machine import open_machine
    from stewart_drake.runs.checks import check_scenario
    from stewart_drake.runs.drive import Drive, as_logged, connected, drive_controller

    loaded = load_learnt(load_driven, scenario, overrides, keep_model, trust_code)
    if dance is not None:
        loaded = DANCES["reachy_mini"](loaded, dance, force)
    if out is not None:
        check_run_folder(as_logged(loaded), out, force, duration=False)
    if mcap:
        check_mcap()
    if keep_model is not None:
        prepare_file(keep_model, "--keep-model")
    opened, driven = open_machine(machine, loaded, trust_code), None
    with shown_compiling():
        check_scenario(loaded)
        drive_controller(loaded, loaded.start()[0])
    try:
        start = connected(loaded, opened, seconds)
        _print_plan(loaded, machine, opened, start)
        if dry:
            print_line("nothing was moved")
            return
        with new_run_folder(as_logged(loaded), out, force, duration=False) as claimed:
            journal = begin_journal(as_logged(loaded), claimed)
            with progress_bar(loaded.name, start.duration) as advance:
                driven = Drive(loaded, opened, start, journal)
                log = driven.run(advance)
            place = write_results(log, claimed, machine=machine)
            save_learnt(log, keep_model)
            if mcap:
                log.save(place / "run.mcap")
    finally:
        opened.disconnect()
        if driven is not None:
            print_line(f"{driven.ending}{opened.after and f'; {opened.after}'}")
    exit_unless_completed(log, place == claimed)


def _print_plan(loaded: Scenario, url: str, machine: Machine, start: Start) -> None:
    """Prints the pose of a machine and its approach to the motion."""
    from stewart_drake.runs.drive import measured_home
    from stewart_drake.safety.stream import UdpTargets

    model = loaded.controller_model
    home = measured_home(model.robot, start.angles, model.home).tolist()
    rows = [
        ("present angles [rad]", "  ".join(f"{angle:.4f}" for angle in start.angles)),
        ("present pose [deg, mm]", "  ".join(f"{value:.2f}" for value in SCALES * start.pose)),
        ("model.home, if this is the home pose", str(home)),
        ("control period", "-" if machine.period is None else f"{1e3 * machine.period:.2f} ms"),
        ("approach to the motion", f"{start.motion.approach:.1f} s"),
        ("duration until rest", f"{start.duration:.1f} s"),
    ]
    if isinstance(source := start.motion.source, UdpTargets):
        rows.append(("listens for targets at", source.address))
    print_table(f"{loaded.name} on {url}", rows)
    joints = None if model.friction is None else model.friction.joints
    if url == "sim:" and joints is not None and not loaded.plant.joints_rub:
        print_line("sim: has ball joints without friction, but the model has friction there: tracking will be poor")


@command(
    "export",
    c=opt.option("Folder for the controller as C99.", opt.OUT_FOLDER, "--c"),
    fmu=opt.option("Folder for controller and robot as units of co-simulation.", opt.OUT_FOLDER, "--fmu"),
    fmi=opt.option(
        "Version of FMI of these units; in 2 all variables are scalars.", click.Choice(["2", "3"]), default="3"
    ),
    sketch=opt.option("Folder for the program of a board with six hobby servos.", opt.OUT_FOLDER, "--sketch"),
    board=opt.option(
        "Board of the sketch: computer, pca9685, rp2040, sts or dynamixel; computer needs no hardware.",
        default="computer",
    ),
)
def export(
    scenario: str,
    c: Path | None,
    fmu: Path | None,
    fmi: str,
    sketch: Path | None,
    board: str,
    overrides: tuple[str, ...],
    trust_code: bool,
) -> None:
    """SCENARIO, or a file of a controller alone, becomes a header and a source of C99 that needs only math.h.

    The folder also has the reference as a table, a replay with which `make check` compares commands, and an example for
    a microcontroller. Code that cannot be translated, such as a controller of yours in Python, is refused with file and
    line. Units for co-simulation have the same source, and the closed form of the robot; they are compiled if there is
    a cc. A sketch turns angles, or poses, from a serial line into pulses of servos: docs/hobby_hexapod.md.
    """
    from stewart_drake.export.controller_c import export_controller
    from stewart_drake.export.fmu import write_units
    from stewart_drake.export.sketch import export_sketch

    if c is None and fmu is None and sketch is None:
        raise click.UsageError("export needs a folder, --c, --fmu or --sketch")
    loaded = load_driven(scenario, overrides, trust_code)
    with shown_compiling():
        written = [] if c is None else export_controller(loaded, loaded.name, c)
        written += [] if fmu is None else write_units(loaded, loaded.name, fmu, 2 if fmi == "2" else 3)
        written += [] if sketch is None else export_sketch(loaded, loaded.name, sketch, board)
    print_table(loaded.name, [(str(path), f"{path.stat().st_size / 1024.0:.0f} KB") for path in written])
    if c is not None:
        if c / "board.c" not in written:
            no_ball = "a packet has no place of a ball"
            no_pose = "the controller needs a pose, but packets have angles; use --set sensors=encoders"
            print_line(f"no board.c: {no_pose if loaded.ball_control is None else no_ball}")
        print_line(f"try: make -C {c} check")
    if sketch is not None:
        _print_servos(loaded, sketch, board)


def _print_servos(loaded: Scenario, sketch: Path, board: str) -> None:
    """Prints what each servo is sent, and what comes next."""
    from stewart_drake.export.sketch import MEANS, angles_only, wiring_of
    from stewart_drake.mechanics.kinematics import inverse_kinematics

    wiring, robot = wiring_of(loaded, board), loaded.controller_model.robot
    cranks = np.degrees(inverse_kinematics(robot, robot.home_pose)) + 0.0
    rows = [
        (leg, f"{wiring.commands(wiring.home)[leg]:.0f}", f"{cranks[leg]:.1f}", f"{least:.0f} to {most:.0f}")
        for leg, (least, most) in enumerate(wiring.within.T)
    ]
    header = ("leg", "at home", "its crank there [deg]", "limits")
    print_table(f"servos, {MEANS[wiring.kind or 'rc']}", rows, header)
    free = ", ".join(map(str, np.flatnonzero(~np.isfinite(robot.crank_angle_ranges).all(axis=1))))
    if free:
        allowed = "columns low, high of its table, or crank_angle_range of its legs"
        print_error(f"warning: the robot has no stops at legs {free}: their servos may turn to the ends; add {allowed}")
    if (why := angles_only(loaded)) is not None:
        print_line(f"the board takes angles and no poses: {why}")
    print_line(f"try: make -C {sketch}" if board == "computer" else f"open {sketch} in Arduino's tools")
