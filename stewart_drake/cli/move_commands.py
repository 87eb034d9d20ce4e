"""Commands on moves of Reachy Mini: `moves check`, `moves fix`, `moves export`."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.atomic_files import write_together
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, say, shown_compiling, tell
from stewart_drake.references.moves import Move, move_json, moves_of
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario.scenario import load_driven

if TYPE_CHECKING:
    from stewart_drake.runs.moves import Checked

ROBOT = "reachy_mini"
SHOWN = {"crank_range": ("deg to stops", 57.29578), "crank_speed": ("deg/s", 57.29578), "torque": ("N m", 1.0)}
SHOWN |= {"clearance": ("mm clear", 1000.0)}
OUT = opt.option("Folder for NAME.json of each.", opt.OUT_FOLDER, default="runs/moves")


@command("moves", kind=opt.Group)
def moves() -> None:
    """Each takes recorded moves, FILE.json or a folder of them, dance:NAME, or all `dances` of the maker's library."""


def _cells(checked: Checked) -> list[str]:
    """What a move needs most of, and where; and other limits that it breaks."""
    smallest = checked.report.smallest
    cells = [f"{100.0 * checked.unreachable:.1f} %"]
    for name, (_, scale) in SHOWN.items():
        # A limit that could be checked nowhere has no margin.
        worst = smallest.get(name)
        value = 0.0 if worst is None else scale * (worst.margin if name == "crank_range" else worst.value)
        broken = " broken" if worst is not None and worst.margin < 0.0 else ""
        cells.append("-" if worst is None else f"{value:.3g} at {worst.time:.2f} s{broken}")
    others = [each for name, each in smallest.items() if name not in SHOWN and each.margin < 0.0]
    return [*cells, ", ".join(f"{each.limit} {each.value:.3g} at {each.time:.2f} s" for each in others)]


HEADER = ("no solution", *(unit for unit, _ in SHOWN.values()), "also broken")


@command("moves check", source={"metavar": "FILE|FOLDER|dance:NAME|dances"})
def check(source: str) -> None:
    """A line a move: what it needs most of, and when. Exit status 2: one of them cannot be done."""
    from stewart_drake.runs.moves import check_move

    robot, rows, data = load_robot(ROBOT), [], {}
    with shown_compiling():
        for name, move in moves_of(source).items():
            checked = check_move(robot, move)
            rows.append((name, "yes" if checked.report.feasible else "no", *_cells(checked)))
            margins = {key: asdict(each) | {"unit": each.unit} for key, each in checked.report.smallest.items()}
            data[name] = {"feasible": checked.report.feasible, "no_solution": checked.unreachable, **margins}
    print_table(f"{source} on {ROBOT}", rows, ("move", "can be done", *HEADER), numbers=(), data=data)
    wrong = sum(row[1] == "no" for row in rows)
    if wrong:
        say(f"{wrong} of {len(rows)} cannot be done; try: stewart-drake moves fix {source}")
        sys.exit(opt.EXIT_BAD_INPUT)


@command("moves fix", source={"metavar": "FILE|FOLDER|dance:NAME|dances"}, out=OUT)
def fix(source: str, out: Path) -> None:
    """Where a limit is broken, a move comes nearer to home, is averaged, and as a last resort all of it is slower."""
    from stewart_drake.runs.moves import check_move, fix_move

    robot, given = load_robot(ROBOT), moves_of(source)
    folder, rows, files = prepare_folder(out), [], {}
    with shown_compiling():
        for name, move in given.items():
            begin = time.perf_counter()
            fixed = fix_move(robot, move)
            took = time.perf_counter() - begin
            files[folder / f"{name}.json"] = move_json(fixed.move)
            shape = [f"{each[0]:.1f}, {each[1]:.1f}" for each in (1e3 * np.array(fixed.position), np.degrees(fixed.rotation))]
            how = (f"{100 * fixed.size:.0f} %", f"{1e3 * fixed.smoothing:.0f} ms", f"{100 * fixed.slowdown - 100:.1f} %")
            rows.append((name, *how, *shape, *_cells(check_move(robot, fixed.move)), f"{took:.2f} s"))
    write_together(files)
    changes = ("least size", "averaged over", "longer by", "moved by [mm], RMS", "turned by [deg], RMS")
    print_table(f"{source} on {ROBOT}, changed", rows, ("move", *changes, *HEADER, "took"), numbers=())
    tell(f"{len(files)} moves in {folder}")


@command(
    "moves export",
    source={"metavar": "FILE|FOLDER|dance:NAME|dances"},
    out=OUT,
    shaped=opt.option("Shape it for the servos that this controller's file or scenario believes in.", metavar="FILE"),
)
def export(source: str, out: Path, shaped: str | None) -> None:
    """As it is, or as poses from which a player that knows nothing of servos sends what they need to follow the move."""
    from stewart_drake.runs.moves import shaped_move

    given: dict[str, Move] = moves_of(source)
    folder = prepare_folder(out)
    if shaped is not None:
        scenario = load_driven(shaped)
        with shown_compiling():
            given = {name: shaped_move(scenario, move) for name, move in given.items()}
    write_together({folder / f"{name}.json": move_json(move) for name, move in given.items()})
    tell(f"{len(given)} moves in {folder}")
