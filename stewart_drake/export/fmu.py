"""Units of co-simulation, FMI 3.0 or 2.0, with the printed source in them: a controller, and a robot with motors."""

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
from typing import Literal
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
from stewart_drake.scenario.assembly import command_path
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.control_side import context_of, control_side
from stewart_drake.scenario.scenario import Scenario

Numbers = Mapping[str, np.ndarray]
Fmi = Literal[2, 3]
"""Version of FMI; in 2.0 all variables are scalars: `reading[1]` to `reading[6]`."""


def plant_part(scenario: Scenario) -> Part:
    """The closed form of a scenario's robot as a part at the end of a tick, from the start of the scenario on."""
    plant = ClosedForm(scenario.robot, scenario.plant, scenario.gravity_in_base)  # type: ignore[arg-type]
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


def controller_unit(options: ControlOptions, name: str, fmi: Fmi = 3) -> bytes:
    """The controller as an FMU: inputs `reading`, `reference`, `age`, output `command`; ConfigurationError as in C."""
    prefix, side = c_name(name), control_side(options, split=True, streams=True)
    files = {
        file: text for file, text in controller_files(options, name).items() if file in (f"{prefix}.h", f"{prefix}.c")
    }
    wanted = np.concatenate([source.evaluate(np.zeros(1))[0] for source in side.sources])
    inputs = {"reading": readings_along(options, side, 1)[0], "reference": wanted, "age": np.zeros(1)}
    arguments = "u->reading, u->reference, u->age[0], u->command"
    return _unit(fmi, "controller", prefix, files, inputs, {"command": np.zeros(6)}, options.reading_period, arguments)


def robot_unit(scenario: Scenario, name: str, fmi: Fmi = 3) -> bytes:
    """The robot with its motors as an FMU: inputs `command`, `wrench`, output `measured`."""
    scenario.base.refuse_motion("the FMU of a robot")
    if scenario.ball is not None:
        raise ConfigurationError("ball", "a section", "null, for the FMU of a robot")
    prefix, plant = f"{c_name(name)}_robot", ClosedForm(scenario.robot, scenario.plant, scenario.gravity_in_base)  # type: ignore[arg-type]
    command = scenario.motors.initial_command(context_of(scenario, split=True))
    inputs, outputs = {"command": command, "wrench": np.zeros(6)}, {"measured": plant.initial(*scenario.start())}
    arguments, files = "u->command, u->wrench, u->measured", robot_files(scenario, prefix)
    return _unit(fmi, "robot", prefix, files, inputs, outputs, scenario.plant.time_step, arguments)


def write_units(options: ControlOptions, name: str, folder: Path, fmi: Fmi = 3) -> list[Path]:
    """Writes the FMU of a controller and, of a scenario, that of its robot into a folder; their paths."""
    units = {f"{c_name(name)}.fmu": controller_unit(options, name, fmi)}
    if isinstance(options, Scenario):
        units[f"{c_name(name)}_robot.fmu"] = robot_unit(options, name, fmi)
    return write_files(folder, units)


_Variable = tuple[str, str, np.ndarray, bool]  # Name, place in the unit's struct, start, whether it is an input.


def _unit(
    fmi: Fmi,
    kind: str,
    prefix: str,
    files: dict[str, str],
    inputs: Numbers,
    outputs: Numbers,
    period: float,
    arguments: str,
) -> bytes:
    """The archive of a unit, with a library for this machine where there is a C compiler.

    Inputs and outputs are by name, with their numbers at the start; `arguments` are those of its function `step`.
    """
    arrays = {**inputs, **outputs}
    variables: list[_Variable] = [(name, name, start, name in inputs) for name, start in arrays.items()]
    if fmi == 2:
        variables = [
            (f"{name}[{k + 1}]", f"{name}[{k}]", start[k : k + 1], is_input)
            for name, _, start, is_input in variables
            for k in range(start.size)
        ]
    words = {
        "FMI": str(fmi),
        "NAME": prefix,
        "WHAT": f"a {kind}",
        "HEADER": f"{prefix}.h",
        "STRUCT": f"{prefix}_{kind}",
        "PERIOD": number(on_grid(period)).text,
    }
    words["STEP"] = f"return {prefix}_step(&u->inner, {arguments}) == 0 && ++u->steps > 0.0;"
    words["FIELDS"] = "\n".join(f"    double {name}[{start.size}];" for name, start in arrays.items())
    words |= {"INIT": f"{prefix}_init(&u->inner);", "WHY": f"{prefix}_why"}
    rows = ((place, start.size, str(is_input).lower()) for _, place, start, is_input in variables)
    words["TABLE"] = "\n".join(f"    {{offsetof(unit, {place}), {size}, {flag}}}," for place, size, flag in rows)
    starts = ((name, k, number(x).text) for name, start in arrays.items() for k, x in enumerate(start))
    words["START"] = "\n".join(f"    u->{name}[{k}] = {text};" for name, k, text in starts)
    words["API"] = from_template(f"fmi{fmi}.c", words)
    sources = {**files, "fmu.c": from_template("fmu.c", words)}
    words |= _described(fmi, sources, variables)
    content = {"modelDescription.xml": from_template(f"modelDescription{fmi}.xml", words)}
    content |= {f"sources/{file}": text for file, text in sources.items()}
    if fmi == 3:
        content["sources/buildDescription.xml"] = from_template("buildDescription.xml", words)
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for file, text in content.items():
            unit.writestr(zipfile.ZipInfo(file), text)
        if (library := _library(fmi, prefix, sources)) is not None:
            unit.writestr(zipfile.ZipInfo(library[0]), library[1])
    return archive.getvalue()


def _library(fmi: Fmi, prefix: str, sources: dict[str, str]) -> tuple[str, bytes] | None:
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
        place_of = f"{system}64" if (fmi, machine) == (2, "x86_64") else f"{machine}-{system}"
        return f"binaries/{place_of}/{library.name}", library.read_bytes()


def _described(fmi: Fmi, sources: dict[str, str], variables: list[_Variable]) -> dict[str, str]:
    """Words of the descriptions of a unit."""
    time = 'name="time" valueReference="0" causality="independent" variability="continuous"'
    rows = [f"<Float64 {time}/>" if fmi == 3 else f"<ScalarVariable {time}><Real/></ScalarVariable>"]
    for k, (name, _, values, is_input) in enumerate(variables, start=1):
        start = f" start={quoteattr(' '.join(repr(float(x)) for x in values))}" if is_input else ""
        way = "input" if is_input else "output"
        kind = f'name="{name}" valueReference="{k}" causality="{way}" variability="discrete"'
        if fmi == 3:
            rows.append(f'<Float64 {kind}{start}><Dimension start="{values.size}"/></Float64>')
        else:
            rows.append(f"<ScalarVariable {kind}><Real{start}/></ScalarVariable>")
    outputs = [k for k, (*_, is_input) in enumerate(variables, start=1) if not is_input]
    if fmi == 3:
        structure = "".join(f'<{tag} valueReference="{k}"/>' for tag in ("Output", "InitialUnknown") for k in outputs)
    else:
        # By its place in the list, which begins with the time.
        unknown = "".join(f'<Unknown index="{k + 1}"/>' for k in outputs)
        structure = "".join(f"<{tag}>{unknown}</{tag}>" for tag in ("Outputs", "InitialUnknowns"))
    tag = "SourceFile" if fmi == 3 else "File"
    compiled = "".join(f'<{tag} name="{file}"/>' for file in sources if file.endswith(".c"))
    token = hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:32]
    words = {"TOKEN": token, "VERSION": __version__, "COMPILED": compiled}
    return words | {"VARIABLES": "\n".join(rows), "STRUCTURE": structure}
