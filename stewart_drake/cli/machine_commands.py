"""Commands that move a machine: `drive`."""

from __future__ import annotations

from pathlib import Path

import click

from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.run_commands import begin_with, end, keep, leave
from stewart_drake.cli.terminal import print_table, progress_bar, shown_compiling, tell
from stewart_drake.logs.signals import SCALES
from stewart_drake.runs.outputs import begin_journal, check_place, claimed_place, prepare_file
from stewart_drake.scenario.scenario import load_driven


@command(
    "drive",
    machine=opt.option(
        "What to drive: reachy://HOST:PORT, udp://HOST:PORT, serial:DEVICE, sim: or mine.py:MyMachine.", required=True
    ),
    seconds=opt.option("Seconds of the motion [default: the scenario's duration].", opt.SECONDS, "--for"),
    mcap=opt.switch("Also write run.mcap, for Foxglove."),
    dry=opt.switch("Connect, read and plan; move nothing."),
    out=opt.option("Folder for the results [default: runs/NAME, or runs/NAME-2, ...].", opt.PATH),
)
def drive(
    scenario: str,
    machine: str,
    overrides: tuple[str, ...],
    seconds: float | None,
    mcap: bool,
    dry: bool,
    out: Path | None,
    force: bool,
    keep_model: Path | None,
) -> None:
    """SCENARIO, or a file of a controller alone, drives a machine: to the motion, along it, and to rest.

    It stops on its path, and holds, after Ctrl-C, when a reading is too old or a crank is far from where it should be;
    a second Ctrl-C lets go at once. The results are those of a run; a process that is killed leaves them until then.
    """
    from stewart_drake.logs.mcap_file import check_mcap
    from stewart_drake.machines.machine import open_machine
    from stewart_drake.runs.checks import check_scenario
    from stewart_drake.runs.drive import Drive, as_logged, connected, held_controller, measured_home

    loaded = begin_with(load_driven, scenario, overrides, keep_model)
    if out is not None:
        check_place(as_logged(loaded), out, force, duration=False)
    if mcap:
        check_mcap()
    if keep_model is not None:
        prepare_file(keep_model, "--keep-model")
    opened, driven = open_machine(machine, loaded), None
    with shown_compiling():
        check_scenario(loaded)
        held_controller(loaded, loaded.start()[0])
    try:
        start = connected(loaded, opened, seconds)
        belief = loaded.controller_model
        planned = [
            ("angles now [rad]", "  ".join(f"{angle:.4f}" for angle in start.angles)),
            ("pose now [deg, mm]", "  ".join(f"{value:.2f}" for value in SCALES * start.pose)),
            (
                "model.home, if this is its home pose",
                str(measured_home(belief.robot, start.angles, belief.home).tolist()),
            ),
            ("its tick", "-" if opened.period is None else f"{1e3 * opened.period:.2f} ms"),
            ("way to the motion", f"{start.motion.approach:.1f} s"),
            ("until it rests again", f"{start.duration:.1f} s"),
        ]
        print_table(f"{loaded.name} on {machine}", planned)
        if (
            machine == "sim:"
            and not loaded.plant.joints_rub
            and belief.friction is not None
            and belief.friction.joints is not None
        ):
            tell("sim: has ball joints that turn freely, and the model believes that they rub: it will not follow well")
        if dry:
            tell("nothing was moved")
            return
        with claimed_place(as_logged(loaded), out, force, duration=False) as claimed:
            journal = begin_journal(as_logged(loaded), claimed)
            with progress_bar(loaded.name, start.duration) as advance:
                driven = Drive(loaded, opened, start, journal)
                log = driven.run(advance)
            place = leave(log, claimed, machine=machine)
            keep(log, keep_model)
            if mcap:
                log.save(place / "run.mcap")
    finally:
        opened.disconnect()
        if driven is not None:
            tell(f"{driven.ending}{opened.after and f'; {opened.after}'}")
    end(log, place == claimed)


@command(
    "export",
    c=opt.option("Folder for the controller as C99.", opt.OUT_FOLDER, "--c"),
    fmu=opt.option("Folder for controller and robot as FMI 3.0 units.", opt.OUT_FOLDER, "--fmu"),
)
def export(scenario: str, c: Path | None, fmu: Path | None, overrides: tuple[str, ...]) -> None:
    """SCENARIO, or a file of a controller alone, becomes a header and a source of C99 that needs math.h alone.

    The folder has its reference as a table, a replay with which `make check` compares commands, and an example for a
    microcontroller. What cannot be printed, such as your own controller in Python, is refused with file and line. Units
    for co-simulation have the same source, and the closed form of the robot; they are compiled here if there is a cc.
    """
    from stewart_drake.export.controller_c import export_controller
    from stewart_drake.export.fmu import write_units

    if c is None and fmu is None:
        raise click.UsageError("export needs --c or --fmu, a folder each")
    loaded = load_driven(scenario, overrides)
    with shown_compiling():
        written = [] if c is None else export_controller(loaded, loaded.name, c)
        written += [] if fmu is None else write_units(loaded, loaded.name, fmu)
    print_table(loaded.name, [(str(path), f"{path.stat().st_size / 1024.0:.0f} KB") for path in written])
    if c is not None:
        if c / "board.c" not in written:
            tell(
                "no board.c: the controller reads a pose, and packets have angles; --set sensors=encoders gives it one"
            )
        tell(f"try: make -C {c} check")
