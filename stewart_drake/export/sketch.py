"""The last inch to hobby servos: a folder with a board's program, for Arduino's tools, or for this computer."""

from __future__ import annotations

import re
from pathlib import Path

from stewart_drake import __version__
from stewart_drake.base.config import choices_text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.controller_c import controller_files, write_files
from stewart_drake.export.program import from_template
from stewart_drake.export.types import number
from stewart_drake.hardware.wiring import ServoOptions, Wiring
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.scenario import Scenario

BOARDS = {"computer": "rc sts dynamixel", "pca9685": "rc", "rp2040": "rc", "sts": "sts", "dynamixel": "dynamixel"}
"""Boards, and the kinds of servos that they have: of pulses, or of Feetech's or Dynamixel's bus."""
MEANS = {"rc": "microseconds of a pulse", "sts": "counts of a turn", "dynamixel": "counts of a turn"}
LONGEST = 0.04  # [s] between two pulses, which a PCA9685 can do.


def wiring_of(options: ControlOptions, board: str) -> Wiring:
    """The wiring of the servos of a scenario; ConfigurationError for what a board cannot do."""
    model = options.controller_model
    if board not in BOARDS:
        raise ConfigurationError("--board", board, choices_text(board, list(BOARDS)))
    if model.motors.command_quantity != "angle":
        allowed = "position: a board sends angles to servos, as of motors={kind: position, preset: mg996r}"
        raise ConfigurationError("motors.kind", model.motors.kind, allowed)
    wiring = (model.servos or ServoOptions()).wiring(model.robot, model.motors, model.home)
    if wiring.kind is not None and wiring.kind not in BOARDS[board].split():
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


def export_sketch(options: ControlOptions, name: str, folder: Path, board: str) -> list[Path]:
    """Writes the files of a sketch into a folder; their paths. ConfigurationError as `wiring_of`."""
    wiring, main, bus = wiring_of(options, board), folder.resolve().name, board in ("sts", "dynamixel")
    if board != "computer" and not re.fullmatch(r"\w[\w.-]{0,62}", main, re.ASCII):
        raise ConfigurationError("--sketch", main, "a folder's name of letters, digits and _, as Arduino asks for")
    model = options.controller_model
    rest, kind = (model.servos or ServoOptions()).rest_after or 0.0, BOARDS[board].split()[0]
    words = {"SCENARIO": name, "VERSION": __version__, "BOARD": board, "MEANS": MEANS[wiring.kind or kind]}
    words |= {"POSES": str(int(angles_only(options) is None)), "PROTOCOL": str(1 + (board == "dynamixel"))}
    words |= {"PERIOD": str(round(1e6 * options.reading_period)), "REST": str(round(1e6 * rest))}
    words |= {"FASTEST": number(wiring.speed).text, "MIDDLE": number(wiring.middle).text}
    rows = [
        model.robot.servo_gains,
        model.home,
        wiring.zero,
        wiring.per_rad,
        wiring.home,
        *wiring.angles,
        *wiring.within.astype(int),
    ]
    for word, row in zip(
        ("GAIN", "ZERO_AT", "ZERO", "PER_RAD", "HOME", "LOW", "HIGH", "LEAST", "MOST"), rows, strict=True
    ):
        words[word] = ", ".join(number(value).text for value in row)
    parts = ("hexapod.c", "hexapod.h", "servos.h", *(("bus.h", "bus.c") if bus else ()))
    templates = {part: f"sketch_{part}" for part in parts} | {f"robot_side.{end}": f"robot_side.{end}" for end in "hc"}
    if board == "computer":
        templates |= {"board.c": "sketch_computer.c", "Makefile": "sketch_Makefile"}
    else:
        templates[f"{main}.ino"] = f"sketch_{'bus' if bus else board}.ino"
    files = {file: from_template(template, words) for file, template in templates.items()}
    if angles_only(options) is None:
        control = options.control() if isinstance(options, Scenario) else options
        printed = controller_files(control.replace({"model.reading": "angles"}), name, "pose")
        files["pose.h"] = printed["pose.h"]
        files["pose.c"] = f'#include "servos.h"\n\n#if SERVOS_POSES\n{printed["pose.c"]}#endif\n'
    return write_files(folder, {file: text.encode() for file, text in files.items()})
