"""Commands on moves of Reachy Mini: `moves check`, `moves fix`, `moves export`."""

from __future__ import annotations

import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stewart_drake.base.atomic_files import write_together
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, say, shown_compiling, tell
from stewart_drake.references.moves import Move, move_json, moves_of
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.runs.moves import check_move, fix_move, shaped_move
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario.scenario import load_driven

ROBOT = "reachy_mini"
DEGREE = math.degrees(1.0)
SHOWN = {"crank_range": ("deg to stops", DEGREE), "crank_speed": ("deg/s", DEGREE), "torque": ("N m", 1.0)}
SHOWN |= {"clearance": ("mm clear", 1e3)}
HEADER = ("no solution", *(unit for unit, _ in SHOWN.values()), "also broken")
SOURCE = {"metavar": "FILE|FOLDER|dance:NAME|dances"}
OUT = opt.option("Folder for NAME.json of each.", opt.OUT_FOLDER, default="runs/moves")


@command("moves", kind=opt.Group)
def moves() -> None:
    """Each takes a recorded move FILE.json, a FOLDER of them, dance:NAME, or all `dances` of the maker's library."""


def _number(value: float) -> str:
    return f"{float(f'{value:.3g}'):.6g}"


def _cells(move: Move) -> tuple[bool, list[str], dict[str, Any]]:
    """Whether a move can be done; what it needs most of, and when; and the same as data."""
    report, unreachable = check_move(load_robot(ROBOT), move)
    cells = [f"{_number(100.0 * unreachable)} %"]
    for name, (_, scale) in SHOWN.items():
        # A limit that could be checked nowhere has no margin.
        worst = report.smallest.get(name)
        size = 0.0 if worst is None else scale * (worst.margin if name == "crank_range" else worst.value)
        broken = "broken " if worst is not None and worst.margin < 0.0 else ""
        cells.append("-" if worst is None else f"{broken}{_number(size)} @{worst.time:.2f}s")
    others = [each for name, each in report.smallest.items() if name not in SHOWN and each.margin < 0.0]
    cells.append(", ".join(f"{each.limit} {_number(each.value)} @{each.time:.2f}s" for each in others))
    margins = {name: asdict(each) | {"unit": each.unit} for name, each in report.smallest.items()}
    return report.feasible, cells, {"feasible": report.feasible, "no_solution": unreachable, **margins}


@command("moves check", source=SOURCE)
def check(source: str) -> None:
    """A line a move: what it needs most of, and when. Exit status 2: one of them cannot be done."""
    with shown_compiling():
        found = {name: _cells(move) for name, move in moves_of(source).items()}
    rows = [(name, "yes" if can else "no", *cells) for name, (can, cells, _) in found.items()]
    data = {name: numbers for name, (_, _, numbers) in found.items()}
    print_table(f"{source} on {ROBOT}", rows, ("move", "can be done", *HEADER), numbers=(), data=data)
    if wrong := sum(not can for can, _, _ in found.values()):
        say(f"{wrong} of {len(rows)} cannot be done; try: stewart-drake moves fix {source}")
        sys.exit(opt.EXIT_BAD_INPUT)


@command("moves fix", source=SOURCE, out=OUT)
def fix(source: str, out: Path) -> None:
    """Where a move breaks a limit it comes nearer to home, or is averaged; as a last resort all of it is slowed."""
    robot, given = load_robot(ROBOT), moves_of(source)
    folder = prepare_folder(out)
    with shown_compiling():
        fixed = {name: fix_move(robot, move) for name, move in given.items()}
    rows = [(name, *map(_number, changes.values()), *_cells(move)[1]) for name, (move, changes) in fixed.items()]
    changes = next(iter(fixed.values()))[1]
    print_table(f"{source} on {ROBOT}, changed", rows, ("move", *changes, *HEADER), range(1, 1 + len(changes)))
    _write(folder, {name: move for name, (move, _) in fixed.items()})


@command(
    "moves export",
    source=SOURCE,
    out=OUT,
    shaped=opt.option("Shape it for the servos that a scenario or a controller's file believes in.", metavar="FILE"),
)
def export(source: str, out: Path, shaped: str | None, overrides: tuple[str, ...]) -> None:
    """As it is, or as poses from which any player sends what the servos need to follow the move."""
    given, scenario = moves_of(source), None if shaped is None else load_driven(shaped, overrides)
    folder = prepare_folder(out)
    if scenario is not None:
        for name, move in given.items():
            with shown_compiling():
                given[name], shares = shaped_move(scenario, move)
            if less := int((shares < 1.0).sum()):
                tell(f"{name}: {less} of {len(shares)} poses do not exist as the servos need them")
    _write(folder, given)


def _write(folder: Path, given: dict[str, Move]) -> None:
    write_together({folder / f"{name}.json": move_json(move) for name, move in given.items()})
    tell(f"{len(given)} moves in {folder}")
