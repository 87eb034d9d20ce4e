"""Units of co-simulation, FMI 3.0, with the printed source in them: a controller, and a robot with its motors."""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from stewart_drake import __version__
from stewart_drake.base.errors import ConfigurationError, Status
from stewart_drake.base.sampling import on_grid
from stewart_drake.export.controller_c import REASONS, c_name, controller_files, readings_along, write_files
from stewart_drake.export.loop import LoopSource
from stewart_drake.export.program import from_template
from stewart_drake.export.types import number
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.kinematics_laws import SERIAL, Legs
from stewart_drake.plant.closed_form import ClosedForm
from stewart_drake.scenario.assembly import command_path, context_of, control_side
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.scenario import Scenario

Numbers = Mapping[str, np.ndarray]


def plant_part(scenario: Scenario) -> Part:
    """The closed form of a scenario's robot as a part at the end of a tick, from the start of the scenario on."""
    plant = ClosedForm(scenario.robot, scenario.plant, scenario.gravity)  # type: ignore[arg-type]
    plant.initial(*scenario.start())
    numbers = dict(zip(("robot", "friction", "params"), plant._fixed, strict=True))
    statuses, inputs = {SERIAL: Status("crank_dead_centre", of_leg=True)}, {"motor_torque": 6, "wrench": 6}
    part = Part("plant", plant._kernel, {}, inputs, (), plant.save(), (Legs,), statuses, parameters=numbers)
    return part._replace(period=scenario.plant.time_step, end_of_tick=True)


def robot_files(scenario: Scenario, name: str) -> dict[str, str]:
    """Header and source of the robot with its motors, by name."""
    step, first = scenario.plant.time_step, scenario.motors.initial_command(context_of(scenario, split=True))
    parts = command_path(scenario, "command", first, step, bus=False)
    outside = {"time": 1, "command": 6, "wrench": 6, "crank_state": 12}
    loop = LoopSource([*parts, plant_part(scenario)], outside, {}, step, step, {})
    words = {"NAME": name, "UPPER": name.upper(), "SCENARIO": scenario.name, "VERSION": __version__}
    words |= {"LOOP": loop.text().rstrip(), "NUMBERS": str(loop.numbers), "UNIT": scenario.motors.unit}
    words |= {"REASONS": REASONS, "PERIOD": number(step).text, "GRID": number(on_grid(step)).text}
    return {f"{name}.{ending}": from_template(f"robot.{ending}", words) for ending in ("h", "c")}


def controller_unit(options: ControlOptions, name: str) -> bytes:
    """The controller as an FMU: inputs `reading`, `reference`, `age`, output `command`; ConfigurationError as in C."""
    prefix, side = c_name(name), control_side(options, split=True, streams=True)
    files = {
        file: text for file, text in controller_files(options, name).items() if file in (f"{prefix}.h", f"{prefix}.c")
    }
    wanted = np.concatenate([source.evaluate(np.zeros(1))[0] for source in side.sources])
    inputs = {"reading": readings_along(options, side, 1)[0], "reference": wanted, "age": np.zeros(1)}
    arguments = "u->reading, u->reference, u->age[0], u->command"
    return _unit("controller", prefix, files, inputs, {"command": np.zeros(6)}, options.reading_period, arguments)


def robot_unit(scenario: Scenario, name: str) -> bytes:
    """The robot with its motors as an FMU: inputs `command`, `wrench`, output `measured`."""
    prefix, plant = f"{c_name(name)}_robot", ClosedForm(scenario.robot, scenario.plant, scenario.gravity)  # type: ignore[arg-type]
    command = scenario.motors.initial_command(context_of(scenario, split=True))
    inputs, outputs = {"command": command, "wrench": np.zeros(6)}, {"measured": plant.initial(*scenario.start())}
    arguments = "u->command, u->wrench, u->measured"
    return _unit("robot", prefix, robot_files(scenario, prefix), inputs, outputs, scenario.plant.time_step, arguments)


def write_units(options: ControlOptions, name: str, folder: Path) -> list[Path]:
    """Writes the FMU of a controller and, of a scenario, that of its robot into a folder; their paths."""
    units = {f"{c_name(name)}.fmu": controller_unit(options, name)}
    if isinstance(options, Scenario):
        units[f"{c_name(name)}_robot.fmu"] = robot_unit(options, name)
    return write_files(folder, units)


def _unit(
    kind: str, prefix: str, files: dict[str, str], inputs: Numbers, outputs: Numbers, period: float, arguments: str
) -> bytes:
    """The archive of a unit, with a library for this machine where there is a C compiler.

    Inputs and outputs are by name, with their numbers at the start; `arguments` are those of its function `step`.
    """
    variables = {**inputs, **outputs}
    words = {
        "WHAT": f"a {kind}",
        "HEADER": f"{prefix}.h",
        "STRUCT": f"{prefix}_{kind}",
        "PERIOD": number(on_grid(period)).text,
    }
    words["STEP"] = f"return {prefix}_step(&u->inner, {arguments}) == 0 && ++u->steps > 0.0;"
    words["FIELDS"] = "\n".join(f"    double {name}[{start.size}];" for name, start in variables.items())
    words |= {"INIT": f"{prefix}_init(&u->inner);", "WHY": f"{prefix}_why"}
    rows = ((name, start.size, "true" if name in inputs else "false") for name, start in variables.items())
    words["TABLE"] = "\n".join(f"    {{offsetof(unit, {name}), {size}, {flag}}}," for name, size, flag in rows)
    starts = ((name, k, number(x).text) for name, start in variables.items() for k, x in enumerate(start))
    words["START"] = "\n".join(f"    u->{name}[{k}] = {text};" for name, k, text in starts)
    sources = {**files, "fmu.c": from_template("fmu.c", words)}
    words |= _described(prefix, sources, inputs, outputs)
    content = {"modelDescription.xml": from_template("modelDescription.xml", words)}
    content |= {f"sources/{file}": text for file, text in sources.items()}
    content["sources/buildDescription.xml"] = from_template("buildDescription.xml", words)
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for file, text in content.items():
            unit.writestr(zipfile.ZipInfo(file), text)
        if (library := _library(prefix, sources)) is not None:
            unit.writestr(zipfile.ZipInfo(library[0]), library[1])
    return archive.getvalue()


def _library(prefix: str, sources: dict[str, str]) -> tuple[str, bytes] | None:
    """Path in the archive and content of the library; None without a compiler: the importer compiles the sources."""
    compiler, system = shutil.which("cc") or shutil.which("gcc"), platform.system().lower()
    if compiler is None or system not in ("linux", "darwin"):
        return None
    machine, ending = platform.machine().replace("arm64", "aarch64"), "so" if system == "linux" else "dylib"
    with tempfile.TemporaryDirectory() as place:
        folder, library = Path(place), Path(place) / f"{prefix}.{ending}"
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-fPIC"]
        names = [file for file in sources if file.endswith(".c")]
        command = [compiler, *flags, "-o", str(library), *names, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            raise ConfigurationError("C compiler", compiler, f"one that compiles C99; {done.stderr[:500]}")
        return f"binaries/{machine}-{system}/{library.name}", library.read_bytes()


def _described(prefix: str, sources: dict[str, str], inputs: Numbers, outputs: Numbers) -> dict[str, str]:
    """Words of the two descriptions of a unit."""
    rows = ['<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>']
    for k, (name, values) in enumerate({**inputs, **outputs}.items(), start=1):
        start = f" start={quoteattr(' '.join(repr(float(x)) for x in values))}" if name in inputs else ""
        kind = f'causality="{"input" if name in inputs else "output"}" variability="discrete"{start}'
        size = f'<Dimension start="{values.size}"/>'
        rows.append(f'<Float64 name="{name}" valueReference="{k}" {kind}>{size}</Float64>')
    places = range(len(inputs) + 1, len(inputs) + len(outputs) + 1)
    structure = "".join(f'<{tag} valueReference="{k}"/>' for tag in ("Output", "InitialUnknown") for k in places)
    compiled = "".join(f'<SourceFile name="{file}"/>' for file in sources if file.endswith(".c"))
    token = hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:32]
    words = {"NAME": prefix, "TOKEN": token, "VERSION": __version__, "COMPILED": compiled}
    return words | {"VARIABLES": "\n".join(rows), "STRUCTURE": structure}
