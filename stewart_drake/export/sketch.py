"""The last inch to hobby servos: a folder with a board's program, for Arduino's tools, or for this computer."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from stewart_drake import __version__
from stewart_drake.base.config import choices_text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.controller_c import controller_files, write_files
from stewart_drake.export.program import from_template
from stewart_drake.export.types import number
from stewart_drake.hardware.wiring import ServoOptions, Wiring
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.scenario import Scenario

BOARDS = {"computer": ("rc", "sts", "dynamixel"), "pca9685": ("rc",), "rp2040": ("rc",)} | {
    bus: (bus,) for bus in ("sts", "dynamixel")
}
"""Boards, and the servos that they have: of pulses, or of Feetech's or Dynamixel's bus."""
MEANS = {"rc": "microseconds of a pulse", "sts": "counts of a turn", "dynamixel": "counts of a turn"}
SLOW = 0.5  # [rad/s] of the fastest crank on the way to the first command, and home.
LONGEST = 0.05  # [s] between two pulses.


def wiring_of(options: ControlOptions, board: str) -> Wiring:
    """The wiring of the servos of a scenario; ConfigurationError for what a board cannot do."""
    model = options.controller_model
    if board not in BOARDS:
        raise ConfigurationError("--board", board, choices_text(board, list(BOARDS)))
    if model.motors.command_quantity != "angle":
        allowed = "position: a board sends angles to servos, as of motors={kind: position, preset: mg996r}"
        raise ConfigurationError("motors.kind", model.motors.kind, allowed)
    if any(model.home):
        allowed = "zeros: a board's trim is model.servos.offset, and its angles are those of the robot's file"
        raise ConfigurationError("model.home", list(model.home), allowed)
    wiring = (model.servos or ServoOptions()).wiring(model.robot, model.motors)
    if wiring.kind is not None and wiring.kind not in BOARDS[board]:
        boards = [name for name, kinds in BOARDS.items() if wiring.kind in kinds]
        raise ConfigurationError("--board", board, f"{' or '.join(boards)}, for servos that take {MEANS[wiring.kind]}")
    period = options.reading_period
    if not 1.0 / wiring.rate <= period * (1.0 + 1e-9) <= LONGEST:
        allowed = f"{1.0 / wiring.rate:.4g} to {LONGEST:g} s between two commands of such servos"
        raise ConfigurationError("controller.period", period, allowed)
    return wiring


def angles_only(options: ControlOptions) -> str | None:
    """Why the board takes angles alone, and no poses; None where it takes both."""
    if options.adaptation is not None:
        return "its controller learns, which a computer has to do"
    if options.controller.feedback:
        return f"its controller, {options.controller.kind}, needs measured angles; kind feedforward needs none"
    return None


def sketch_files(options: ControlOptions, name: str, folder: str, board: str) -> dict[str, str]:
    """The files of a sketch in a folder of that name.

    Raises:
        ConfigurationError: As `wiring_of`; a folder's name that Arduino refuses.
    """
    wiring, poses = wiring_of(options, board), angles_only(options) is None
    if board != "computer" and not re.fullmatch(r"\w[\w.-]{0,62}", folder, re.ASCII):
        raise ConfigurationError("--sketch", folder, "a folder's name of letters, digits and _, as Arduino asks for")
    beyond = [np.nextafter(wiring.angles[k].astype(np.float32), np.float32((-9.0, 9.0)[k])) for k in (0, 1)]
    rest = (options.controller_model.servos or ServoOptions()).rest_after
    words = {"SCENARIO": name, "VERSION": __version__, "BOARD": board, "MEANS": MEANS[wiring.kind or BOARDS[board][0]]}
    words |= {"POSES": str(int(poses)), "PROTOCOL": str(1 + (board == "dynamixel")), "SLOW": number(SLOW).text}
    words |= {"PERIOD": str(round(1e6 * options.reading_period)), "REST": str(round(1e6 * (rest or 0.0)))}
    words |= {"FASTEST": number(wiring.speed).text, "MIDDLE": number(wiring.middle).text}
    words |= {"ZERO": _row(wiring.zero), "PER_RAD": _row(wiring.per_rad), "HOME": _row(wiring.home)}
    words |= {"LOW": _row(beyond[0], "f"), "HIGH": _row(beyond[1], "f")}
    words |= {word: ", ".join(f"{int(k)}" for k in row) for word, row in zip(("LEAST", "MOST"), wiring.within)}
    bus = board in ("sts", "dynamixel")
    templates = {"hexapod.c": "sketch_hexapod.c", "board.h": "sketch_board.h", "servos.h": "sketch_servos.h"}
    templates |= {file: file for file in ("robot_side.h", "robot_side.c")}
    templates |= {"bus.h": "sketch_bus.h", "bus.c": "sketch_bus.c"} if bus else {}
    if board == "computer":
        templates |= {"board.c": "sketch_computer.c", "Makefile": "sketch_Makefile"}
    else:
        templates |= {f"{folder}.ino": f"sketch_{'bus' if bus else board}.ino"}
    files = {file: from_template(template, words) for file, template in templates.items()}
    if poses:
        control = options.control() if isinstance(options, Scenario) else options
        printed = controller_files(control.replace({"model.reading": "angles"}), name, "pose")
        files |= {"pose.h": printed["pose.h"]}
        files["pose.c"] = f'#include "servos.h"\n\n#if SERVOS_POSES\n{printed["pose.c"]}#endif\n'
    return files


def _row(values: Iterable[float], suffix: str = "") -> str:
    return ", ".join(number(float(value)).text + suffix for value in values)


def export_sketch(options: ControlOptions, name: str, folder: Path, board: str) -> list[Path]:
    """Writes `sketch_files` into a folder; their paths."""
    files = sketch_files(options, name, folder.resolve().name, board)
    return write_files(folder, {file: text.encode() for file, text in files.items()})
