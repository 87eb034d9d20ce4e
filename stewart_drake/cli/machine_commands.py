"""Commands that move a machine: `drive`."""

from __future__ import annotations

from pathlib import Path

from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.run_commands import end, leave
from stewart_drake.cli.terminal import print_table, progress_bar, shown_compiling, tell
from stewart_drake.logs.signals import SCALES
from stewart_drake.runs.outputs import begin_journal, check_place, claimed_place
from stewart_drake.scenario.scenario import load_driven


@command(
    "drive",
    machine=opt.option(
        "What to drive: reachy://HOST:PORT, udp://HOST:PORT, serial:DEVICE, sim: or mine.py:MyMachine.", required=True
    ),
    seconds=opt.option("Seconds of the motion [default: the scenario's duration].", float, "--for"),
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
) -> None:
    """SCENARIO, or a file of a controller alone, drives a machine: to the motion, along it, and to rest.

    It stops on its path, and holds, after Ctrl-C, when a reading is too old or a crank is far from where it should be;
    a second Ctrl-C lets go at once. The results are those of a run; a process that is killed leaves them until then.
    """
    from stewart_drake.machines.machine import open_machine
    from stewart_drake.runs.checks import check_scenario
    from stewart_drake.runs.drive import Drive, as_logged, connected, measured_home

    loaded = load_driven(scenario, overrides)
    if out is not None:
        check_place(as_logged(loaded), out, force, duration=False)
    opened = open_machine(machine, loaded)
    with shown_compiling():
        check_scenario(loaded)
    try:
        start = connected(loaded, opened, seconds)
        belief = loaded.belief
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
        if dry:
            tell("nothing was moved")
            return
        with claimed_place(as_logged(loaded), out, force, duration=False) as claimed:
            journal = begin_journal(as_logged(loaded), claimed)
            with progress_bar(loaded.name, start.duration) as advance:
                log = Drive(loaded, opened, start, journal).run(advance)
            place = leave(log, claimed, machine=machine)
            if mcap:
                log.save(place / "run.mcap")
    finally:
        opened.disconnect()
    end(log, place == claimed)
