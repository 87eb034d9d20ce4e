"""Commands on moves of Reachy Mini: `moves check`, `moves fix`, `moves export`, `moves play`."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import click
import numpy as np

from stewart_drake.base.atomic_files import Document, write_together
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.cli import options as opt
from stewart_drake.cli.machine_commands import drive
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_error, print_line, print_table, shown_compiling
from stewart_drake.reachy.moves import HEAD_HEIGHT, Move, files_of, move_json, moves_of
from stewart_drake.reachy.possible_moves import check_move, fix_move, motion_of, shaped_move
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.runs.checks import plant_report
from stewart_drake.runs.outputs import prepare_folder, write_text
from stewart_drake.scenario.scenario import Scenario, load_driven

ROBOT = "reachy_mini"
DEGREE = math.degrees(1.0)
DEMANDS = {"crank_range": ("deg to stops", DEGREE), "crank_speed": ("deg/s", DEGREE), "torque": ("N m", 1.0)}
DEMANDS |= {"clearance": ("mm clear", 1e3)}
HEADER = ("no solution", *(unit for unit, _ in DEMANDS.values()), "also broken")
SOURCE = {"metavar": "FILE|FOLDER|dance:NAME|dances"}
OUT = opt.option("Folder for NAME.json of each.", opt.OUT_FOLDER, default="runs/moves")
FORCE = opt.switch("Replace files that are there; never those that are read.")


LONG_GAP = 0.1  # [s] between rows.
PLAYED = Path("runs/moves")  # Folder for the moves that are played.
SLOWDOWNS = (1.05 ** np.arange(24)).tolist()  # Of a move, until the motors can follow it.


@command("moves", kind=opt.Group)
def moves() -> None:
    """All take a recorded move FILE.json, a FOLDER of them, dance:NAME, or all `dances` of Pollen Robotics."""


def _number(value: float) -> str:
    return f"{round(float(f'{value:.3g}'), 4) + 0.0:.6g}"


def _cells(move: Move) -> tuple[bool, list[str], Document]:
    """Whether a move is feasible; its largest demands and when they occur; and the same as data."""
    report, unreachable = check_move(load_robot(ROBOT), move)
    cells = [f"{_number(100.0 * unreachable)} %"]
    for name, (_, scale) in DEMANDS.items():
        # A limit without any valid sample has no margin.
        worst = report.smallest.get(name)
        size = 0.0 if worst is None else scale * (worst.margin if name == "crank_range" else worst.value)
        broken = "broken " if worst is not None and worst.margin < 0.0 else ""
        cells.append("-" if worst is None else f"{broken}{_number(size)} @{worst.time:.2f}s")
    others = [each for name, each in report.smallest.items() if name not in DEMANDS and each.margin < 0.0]
    cells.append(", ".join(f"{each.limit} {_number(each.value)} @{each.time:.2f}s" for each in others))
    margins = {name: asdict(each) | {"unit": each.unit} for name, each in report.smallest.items()}
    return report.feasible, cells, {"feasible": report.feasible, "no_solution": unreachable, **margins}


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Adds the name of the move to an error about it."""
    try:
        yield
    except ConfigurationError as error:
        if error.key != "move":
            raise
        raise ConfigurationError(f"move {name}", error.value, error.allowed) from None


@command("moves check", source=SOURCE)
def check(source: str) -> None:
    """One line per move: its largest demands and when they occur. Exit status 2: a move is infeasible or invalid."""
    bad: dict[str, ConfigurationError] = {}
    given = moves_of(source, bad)
    with shown_compiling():
        found = {name: _cells(move) for name, move in given.items()}
    rows = [(name, "yes" if can else "no", *cells) for name, (can, cells, _) in found.items()]
    data = {name: numbers for name, (_, _, numbers) in found.items()}
    for name, error in bad.items():
        why = str(error).removeprefix(f"{error.key}: ")
        rows.append((name, f"no move: {why}", *["-"] * len(HEADER)))
        data[name] = {"feasible": False, "no_move": why}
    print_table(f"{source} on {ROBOT}", rows, ("move", "can be done", *HEADER), numbers=(), data=data)
    _tell_notes(given)
    if wrong := sum(not can for can, _, _ in found.values()):
        print_error(f"{wrong} of {len(rows)} cannot be done; try: stewart-drake moves fix {source}")
    if bad:
        print_error(f"{len(bad)} of {len(rows)} are no moves: {', '.join(f'{name}.json' for name in bad)}")
    if wrong or bad:
        sys.exit(opt.EXIT_BAD_INPUT)


@command("moves fix", source=SOURCE, out=OUT, force=FORCE)
def fix(source: str, out: Path, force: bool) -> None:
    """Moves a move that breaks a limit nearer to home there, or averages it; as a last resort slows all of it.

    Moves that cannot be fixed are left out. Exit status 2: there were some.
    """
    bad: dict[str, ConfigurationError] = {}
    robot, given = load_robot(ROBOT), moves_of(source, bad)
    folder, fixed = _place(source, given, out, force), {}
    with shown_compiling():
        for name, move in given.items():
            try:
                with _named(name):
                    fixed[name] = fix_move(robot, move)
            except ConfigurationError as error:
                bad[name] = error
    rows = [(name, *map(_number, changes.values()), *_cells(move)[1]) for name, (move, changes) in fixed.items()]
    if fixed:
        changes = next(iter(fixed.values()))[1]
        print_table(f"{source} on {ROBOT}, changed", rows, ("move", *changes, *HEADER), range(1, 1 + len(changes)))
        _tell_notes({name: given[name] for name in fixed})
        _write(folder, {name: move for name, (move, _) in fixed.items()})
    for problem in bad.values():
        print_error(str(problem))
    if bad:
        sys.exit(opt.EXIT_BAD_INPUT)


@command(
    "moves export",
    source=SOURCE,
    out=OUT,
    force=FORCE,
    shaped=opt.option("Shape it for the servos in the model of a scenario or a controller's file.", metavar="FILE"),
)
def export(
    source: str, out: Path, force: bool, shaped: str | None, overrides: tuple[str, ...], trust_code: bool
) -> None:
    """The move itself, or poses for which a player sends the commands that the servos need to follow the move."""
    given, scenario = moves_of(source), None if shaped is None else load_driven(shaped, overrides, trust_code)
    folder = _place(source, given, out, force)
    if scenario is not None:
        for name, move in given.items():
            with shown_compiling(), _named(name):
                given[name], shares = shaped_move(scenario, move)
            _tell_notes({name: move})
            if less := int((shares < 1.0).sum()):
                print_line(f"{name}: {less} of {len(shares)} poses do not exist as the servos need them")
    _write(folder, given)


@command(
    "moves play",
    source={"metavar": "NAME|FILE"},
    machine=opt.option("What plays it: sim:, reachy://HOST:PORT, or another of `drive`.", default="sim:"),
    scenario=opt.option("Controller's file or scenario for these servos.", default="reachy_servos"),
    dry=opt.switch("Connect, read and plan; move nothing."),
    out=opt.option("Folder for the results [default: runs/NAME, or runs/NAME-2, ...].", opt.PATH),
)
def play(source: str, machine: str, scenario: str, dry: bool, out: Path | None, force: bool) -> None:
    """A dance by its name, or a recorded move; a move that breaks a limit is fixed first.

    The same as `drive SCENARIO --machine MACHINE --dance NAME`, which has more options.
    """
    given = {"machine": machine, "scenario": scenario, "dance": source, "dry": dry, "out": out, "force": force}
    click.get_current_context().invoke(drive, **given)


def scenario_to_play(scenario: Scenario, name: str, force: bool) -> Scenario:
    """The scenario with a dance, or a move's file, as its motion: fixed, and slowed for its motors, where it must be.

    A dance, or a fixed move, is written to the folder `PLAYED`, as a scenario names a file.
    """
    source, robot = name if Path(name).suffix == ".json" else f"dance:{name.removeprefix('dance:')}", scenario.robot
    given = moves_of(source)
    if abs(robot.home_height - HEAD_HEIGHT) > 0.1 * HEAD_HEIGHT:
        allowed = f"a scenario of {ROBOT}, home at Z = {HEAD_HEIGHT:g} m, not {robot.home_height:.4g} m"
        raise ConfigurationError("--dance", name, allowed)
    ((label, move),) = given.items()
    with shown_compiling(), _named(label):
        report, _ = check_move(robot, move)
        played, changes = (move, {}) if report.feasible else fix_move(robot, move)
    text, path = move_json(played), Path(source)
    if changes or path.suffix != ".json":
        path = PLAYED / f"{label}.json"
        same = path.is_file() and path.read_bytes() == text
        write_text(_place(source, given, PLAYED, force or same) / path.name, text.decode())
    reference = {"kind": "recorded", "motion_file": str(path.absolute())}
    begun = {"name": re.sub(r"[^\w.-]", "_", label)[:100], "initial_offset": [0.0] * 6}
    for slowdown in SLOWDOWNS:
        length = motion_of(played._replace(time=slowdown * played.time)).end
        made = scenario.replace({**begun, "duration": length, "reference": {**reference, "time_scale": slowdown}})
        if not plant_report(made).first_violation:
            break
    else:
        raise ConfigurationError("--dance", name, "a move that the motors can follow at a third of its speed")
    how = "as it is"
    if changes:
        how = f"fixed, by up to {_number(changes['change mm'])} mm and {_number(changes['change deg'])} deg"
    how += f", {slowdown:.3g} times as long, for its motors" * (slowdown > 1.0)
    print_line(f"{label}: {how}; {length:.3g} s")
    if np.ptp(played.antennas, axis=0).any() or np.ptp(played.body_yaw):
        print_line("only the head moves: antennas and the body keep their angles")
    return made


def _tell_notes(given: dict[str, Move]) -> None:
    """Prints by how much the recorded rows were changed as they were read, and long gaps between them."""
    for name, move in given.items():
        if note := motion_of(move).note:
            print_line(f"{name}: {note}")
        gaps = np.diff(move.time)
        if (gap := gaps.max()) > max(LONG_GAP, 5.0 * np.median(gaps)):
            at = move.time[int(gaps.argmax())]
            print_line(f"{name}: no rows for {gap:.3g} s after {at:.3g} s, where the motion is a guess")


def _place(source: str, names: Iterable[str], out: Path, force: bool) -> Path:
    """The folder for moves, created; refuses to overwrite a source file, or without `force` any file."""
    folder, read = prepare_folder(out), files_of(source)
    there = [path for name in names if (path := folder / f"{name}.json").exists()]
    for path in there:
        if any(path.samefile(file) for file in read):
            raise ConfigurationError("--out", str(out), f"another folder than that of {path.name}, which is read")
    if there and not force:
        raise ConfigurationError("--out", str(out), f"a folder without {there[0].name}, or --force to replace it")
    return folder


def _write(folder: Path, given: dict[str, Move]) -> None:
    write_together({folder / f"{name}.json": move_json(move) for name, move in given.items()})
    print_line(f"{len(given)} moves in {folder}")
