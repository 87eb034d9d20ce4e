"""The controller of a scenario as a folder of C99: header, source, reference, a replay, and an example for a board."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stewart_drake import __version__
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.errors import FAILURES, ConfigurationError, RunFailure
from stewart_drake.base.sampling import InBlocks, on_grid
from stewart_drake.control.user_controller import PythonOptions
from stewart_drake.export.loop import LoopSource
from stewart_drake.export.program import from_template
from stewart_drake.export.types import number
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_rate_to_twist, rotation_matrix
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.control_side import ControlSide, control_side
from stewart_drake.scenario.controller import Controller, controller_parts

REASONS = ", ".join(f'"{reason}"' for reason in FAILURES)
REPLAYED = 1.0  # [s] of readings in `replay.csv`, at most.
SWING = 1e-4  # [rad, m] by which those readings are off the reference, so that there is something to control.
_COPIED = """
    for (int k = 0; k < {size}; k++) {{
        loop->{signal}[k] = {source}[{first} + k];
    }}"""
_FURTHER = {
    "imu": ("imu", 6, "six of the inertial sensor [rad/s, m/s^2]"),
    "ball_reading": ("ball", 2, "the ball's place on the plate [m]"),
}
"""Readings that follow those of the angles: argument of `Controller.step`, size, and what they are."""
MOST_ROWS = 100_000  # Largest number of rows in the table of a reference.


def c_name(name: str) -> str:
    """A name of a scenario as one of C."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    return name if name[:1].isalpha() else f"robot_{name}"


def controller_files(options: ControlOptions, name: str, prefix: str = "") -> dict[str, str]:
    """The files of a folder by their names; `name` is that of the scenario, `prefix` by default the same as one of C.

    Raises:
        ConfigurationError: A part that cannot be printed, with file and line; as `Controller`.
    """
    if options.adaptation is not None:
        allowed = (
            "null: what learns is not printed; run with --keep-model FILE, and export with the `model` that it leaves"
        )
        raise ConfigurationError("adaptation.kind", options.adaptation.kind, allowed)
    if isinstance(options.controller, PythonOptions):
        allowed = "a kind with compiled laws, see docs/export.md; a class or function of Python is not printed"
        raise ConfigurationError(options.controller.code_key, options.controller.code, allowed)
    prefix, side, age = prefix or c_name(name), control_side(options, split=True, streams=True), np.zeros(1)
    parts = controller_parts(options, side, age)
    further = [name for name in _FURTHER if name in side.outside]
    reading_size = side.context.reading + sum(side.outside[name] for name in further)
    loop = LoopSource(parts, {"time": 1, **side.outside}, {}, side.context.period, options.reading_period, {"age": age})
    command = "safe_torque" if side.safety is not None else side.command
    limit = side.context.robot.effort_limits if side.command == side.torque else np.full(6, np.inf)
    for helper in ("minimum", "maximum"):
        loop.program.helper(helper)
    ticks = min(round(getattr(options, "duration", 10.0) / options.reading_period) + 1, MOST_ROWS)
    size, all_size = side.sources[0].size, sum(source.size for source in side.sources)
    given = _copied({source.signal: source.size for source in side.sources}, "reference", 0)
    reads_angles, period = side.context.reading == 6, options.reading_period
    words = {"NAME": prefix, "UPPER": prefix.upper(), "SCENARIO": name, "VERSION": __version__, "REASONS": REASONS}
    words |= {"PERIOD": number(period).text, "GRID": number(on_grid(period)).text, "UNIT": side.unit}
    words |= {"TICK": number(side.context.period).text, "READING": str(reading_size), "READS": side.reading}
    words |= {"REFERENCE": str(all_size), "NUMBERS": str(loop.numbers), "GIVEN": given.lstrip("\n")}
    later = {"reference_ahead": f" ({options.preview:g} s later)"}
    motions = ", then of ".join(f"`{of.signal}`{later.get(of.signal, '')}" for of in side.sources if of.size == size)
    if size != side.sources[-1].size:
        motions += ", then ten of the ball's target: x and y of its place [m] and of four derivatives"
    words["SAMPLE"] = f"18 of {motions}" if size == 18 else "a target pose"
    words["MEANING"] = f"pose [rad, m], rate and acceleration, six numbers each, of {motions}"
    if size == 6:
        words["MEANING"] = "the newest target, a pose [rad, m], which is kept within the limits; NaN for none"
    words |= {"TAKES": str({"rad": 0, "N m": 1, "A": 2}[side.unit]), "ROWS": str(ticks)}
    words |= {"NEEDS": "READING | MEASURED" if side.context.feedback or side.safety else "READING"}
    words |= _machine_words(options, reads_angles)
    words["MEANS"] = "angles of the cranks [rad]" if reads_angles else "pose [rad, m] and its rate"
    words |= {"BOUND": f"{prefix.upper()}_READING", "INERTIAL": ""}
    if further:
        words["MEANS"] += "".join(f", then {_FURTHER[name][2]}, NaN where not new" for name in further)
        copied = _copied({name: _FURTHER[name][1] for name in further}, "reading", side.context.reading)
        words |= {"BOUND": str(side.context.reading), "INERTIAL": copied}
    words |= {"LIMIT": loop.program.table("command_limit", limit).base, "COMMAND": loop.signals[command].pointer}
    words |= {"PARTS": ", ".join(f'"{part.name}"' for part in parts), "LOOP": loop.text().rstrip()}
    words |= {"TABLE": _reference(side, period, ticks)}
    wanted = {"controller.h": f"{prefix}.h", "controller.c": f"{prefix}.c", "reference.c": f"{prefix}_reference.c"}
    boards = ["board.c"] if reads_angles and "ball_reading" not in further else []
    wanted |= {name: name for name in ("main.c", "Makefile", *boards)}
    files = {file: from_template(template, words) for template, file in wanted.items()}
    return {**files, "replay.csv": _replay(options, side)}


def _copied(signals: Mapping[str, int], source: str, first: int) -> str:
    """Loops that copy numbers of an array, from the first on, to signals by name, with their sizes."""
    text = ""
    for signal, size in signals.items():
        text += _COPIED.format(signal=signal, size=size, source=source, first=first)
        first += size
    return text


def _machine_words(options: ControlOptions, reads_angles: bool) -> dict[str, str]:
    """Words of board.c: how angles of the machine become those of the model, and commands those of the machine."""
    model = options.controller_model
    if not reads_angles or not (any(model.home) or (model.robot.servo_gains != 1.0).any()):
        return {"MACHINE": "", "ANGLE": "(double)value", "ANGLES": ""}
    rows = (", ".join(number(value).text for value in values) for values in (model.robot.servo_gains, model.home))
    tables = "\nstatic const double gain[6] = {{{}}}; /* of each servo: angle of its crank over what it reads */"
    tables += "\nstatic const double home[6] = {{{}}}; /* [rad] of the cranks where the machine reads zero */"
    back = "\n    for (int k = 0; k < 6; k++) {\n        command[k] = (command[k] - home[k]) / gain[k];\n    }"
    angle = "gain[k] * (double)value + home[k]"
    return {"MACHINE": tables.format(*rows), "ANGLE": angle, "ANGLES": back if model.motors.holds else ""}


def write_files(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Writes files, by name, into a folder; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in files.items():
        write_atomically(folder / file, content)
    return [folder / file for file in files]


def export_controller(options: ControlOptions, name: str, folder: Path) -> list[Path]:
    """Writes `controller_files` into a folder; their paths."""
    return write_files(folder, {file: text.encode() for file, text in controller_files(options, name).items()})


def _reference(side: ControlSide, period: float, ticks: int) -> str:
    """Rows of a C array: the reference, and what is ahead beside it, at each step."""
    times = np.arange(ticks) * on_grid(period)
    rows = np.concatenate([source.evaluate(times) for source in side.sources], axis=1)
    return ",\n".join("    {" + ", ".join(number(value).text for value in row) + "}" for row in rows)


def readings_along(options: ControlOptions, side: ControlSide, ticks: int) -> np.ndarray:
    """Readings (ticks, n) near the reference, as a robot gives them that follows it."""
    times = np.arange(ticks) * on_grid(options.reading_period)
    motion = np.concatenate(options.reference.evaluate(times)[:2], axis=1)
    rows = motion
    if side.context.reading == 6:
        rows = np.unwrap(inverse_kinematics(side.context.robot, motion[:, :6]), axis=0)
    if (imu := side.context.imu) is not None and "imu" in side.outside:
        axes = rotation_matrix(motion[:, :3]) @ imu.mounting
        turning = pose_rate_to_twist(motion[:, :6], motion[:, 6:])[:, None, :3] @ axes
        rows = np.concatenate([rows, turning[:, 0], side.context.gravity * axes[:, 2]], axis=1)
    if "ball_reading" in side.outside:
        rows = np.concatenate([rows, np.zeros((ticks, 2))], axis=1)
    swing: np.ndarray = rows + SWING * np.sin(7.0 * times[:, None] + np.arange(rows.shape[1]))
    return swing


def _replay(options: ControlOptions, side: ControlSide) -> str:
    """Rows of reading, reference, age and the command that `Controller` gives for them."""
    targets = {of.signal: InBlocks(of.evaluate, options.reading_period).at_time for of in side.sources if of.size == 6}
    controller, out = Controller(options, targets), np.empty(6)
    ticks = round(min(getattr(options, "duration", REPLAYED), REPLAYED) / options.reading_period) + 1
    names = [source.signal for source in side.sources]
    further = {argument: size for name, (argument, size, _) in _FURTHER.items() if name in side.outside}
    rows = []
    for k, reading in enumerate(readings_along(options, side, ticks)):
        try:
            read, *others = np.split(reading, np.cumsum([controller.reading, *further.values()])[:-1])
            of = dict(zip(further, others, strict=True))
            time = k * on_grid(options.reading_period)
            controller.step(read, time, out, imu=of.get("imu"), ball=of.get("ball"))
        except RunFailure:
            break
        wanted = [controller.signal(name) for name in names]
        rows.append(np.concatenate([reading, *wanted, [0.0], out]))
    return "".join(",".join(repr(float(value)) for value in row) + "\n" for row in rows)
