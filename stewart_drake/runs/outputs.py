"""The folder that a run leaves behind: written beside its place, and renamed once all is in it."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import stat
import subprocess
import tempfile
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.families import user_parts
from stewart_drake.files.code import read_code, with_texts
from stewart_drake.files.whole import read_checked, write_atomically
from stewart_drake.files.yaml_files import MAX_BYTES, to_yaml
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.scenario import Scenario

_AS_RUN = "# As run by stewart-drake: every key, defaults included.\n"
_CODE = "code"
"""Folder with the files of the user's classes."""
_FILES = (
    *("log.parquet", "metrics.json", "scenario.yaml", _CODE, "diagram.dot", "diagram.svg"),
    *("states.png", "torques.png", "replay.html"),
)
"""All that a results folder may hold; what else is in it is the user's own, and stays."""


class Results(NamedTuple):
    """What a run has left: where, its metrics, and a line for each picture that could not be made."""

    folder: Path
    metrics: dict[str, Any]
    left_out: tuple[str, ...] = ()


def prepare_folder(path: str | Path, named: str | Path | None = None) -> Path:
    """Makes a folder, and sure that it can be written to; `named` is what the user called it, for messages."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        # Unlike `Path.is_file` this never raises, whatever stands in the way.
        why = "this is a file" if os.path.isfile(folder) else error.strerror  # noqa: PTH113
        raise ConfigurationError("--out", str(named or path), f"a folder that can be written to ({why})") from None
    return folder


def prepare_file(path: Path) -> None:
    """Makes sure, before anything is computed, that a file can be written afterwards; its folder is made."""
    prepare_folder(path.parent, path)
    try:
        folder = stat.S_ISDIR(path.stat().st_mode)
    except FileNotFoundError:
        return
    except OSError as error:
        raise ConfigurationError("--out", str(path), f"a file that can be written ({error.strerror})") from None
    if folder:
        raise ConfigurationError("--out", str(path), "a file, not a folder")


def results_place(scenario: Scenario, out: str | Path | None = None, force: bool = False) -> Path:
    """Where the results of a run go: `out`, or the first of runs/NAME, runs/NAME-2 and so on that is free.

    Args:
        scenario: Whose results.
        out: What the user says; what a link points to is meant.
        force: Replace the results of another scenario.
    """
    if out is None:
        names = itertools.chain([scenario.name], (f"{scenario.name}-{number}" for number in itertools.count(2)))
        return next(place for name in names if not os.path.lexists(place := Path("runs") / name))
    place, own = Path(os.path.realpath(out)), _own_files(scenario)["scenario.yaml"]
    try:
        if not place.exists() or not any(place.iterdir()):
            return place
        before = read_checked(place / "scenario.yaml", "scenario.yaml", MAX_BYTES)
    except OSError as error:
        raise ConfigurationError("--out", str(out), f"a folder that can be written to ({error.strerror})") from None
    except ConfigurationError:
        before = b""
    if not before.startswith(_AS_RUN.encode()):
        raise ConfigurationError("--out", str(out), "a new or empty folder, or one with the results of a run")
    if before != own and not force:
        allowed = "a folder without the results of another scenario, or --force to replace them"
        raise ConfigurationError("--out", str(out), allowed)
    return place


def write_run(
    log: SimulationLog,
    out: str | Path | None = None,
    graph: str | None = None,
    pictures: bool = True,
    force: bool = False,
) -> Results:
    """Writes everything about a run into a folder, which appears as a whole; an interrupt costs pictures alone.

    Files: metrics.json (strict JSON), log.parquet, scenario.yaml, states.png, torques.png, replay.html, diagram.dot;
    with classes of the user's from files code/, so that scenario.yaml can be run again.

    Args:
        log: The run.
        out: Where to, see `results_place`.
        graph: Graphviz text of the diagram, or None to leave it out. An SVG beside it where graphviz is installed.
        pictures: Write the plots and the replay too.
        force: Replace the results of another scenario.

    Raises:
        ConfigurationError: See `results_place`; the disk is full, or the like.
    """
    place = results_place(log.scenario, out, force)
    metrics = run_metrics(log)
    beside = Path(tempfile.mkdtemp(".part", f".{place.name}.", prepare_folder(place.parent, out)))
    part = beside / place.name
    left_out: tuple[str, ...] = ()
    try:
        part.mkdir()
        files = {
            "log.parquet": log.to_parquet(),
            "metrics.json": (json.dumps(metrics, indent=2, allow_nan=False) + "\n").encode(),
            **_own_files(log.scenario),
            **({} if graph is None else _graph_files(graph)),
        }
        for name, content in files.items():
            (part / name).parent.mkdir(exist_ok=True)
            write_atomically(part / name, content)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    try:
        if pictures and len(log.time):
            left_out = _draw(log, part)
    finally:
        try:
            place = _put(part, log.scenario, out, force)
        except (ConfigurationError, OSError) as error:
            why = error.allowed if isinstance(error, ConfigurationError) else f"a place to rename to ({error.strerror})"
            raise ConfigurationError("--out", str(place), f"{why}; the results are in {part}") from None
        shutil.rmtree(beside)
    return Results(place, metrics, left_out)


def _put(part: Path, scenario: Scenario, out: str | Path | None, force: bool) -> Path:
    """Renames a folder to its place, or its files into one that is there; other results may be there by now."""
    while True:
        place = results_place(scenario, out, force)
        if out is not None and place.exists():
            break
        try:
            return part.rename(place)
        except OSError:
            # Another run has just taken that number.
            if out is not None or not place.exists():
                raise
    for name in _FILES:
        (shutil.rmtree if (place / name).is_dir() else partial(Path.unlink, missing_ok=True))(place / name)
    for path in part.iterdir():
        path.rename(place / path.name)
    return place


def _draw(log: SimulationLog, folder: Path) -> tuple[str, ...]:
    """Plots and replay; a line for each that cannot be made."""
    # matplotlib and Meshcat take a second to load; a sweep that wants numbers alone does without.
    from stewart_drake.plotting import draw, plot_states, plot_torques
    from stewart_drake.runs.replay import write_replay

    figures = {"states.png": plot_states, "torques.png": plot_torques}
    lines = [draw(partial(plot, log), folder / name) for name, plot in figures.items()]
    try:
        write_replay(log, folder / "replay.html")
    except StewartDrakeError as error:
        lines.append(f"replay.html is left out: {error}")
    return tuple(line for line in lines if line is not None)


def _own_files(scenario: Scenario) -> dict[str, bytes]:
    """The scenario as run, and the files of the user's classes that it runs."""
    files: dict[str, bytes] = {}
    here: dict[str, str] = {}
    for code in [part.code for part in user_parts(scenario) if part.code.in_file]:
        # Of a log from elsewhere the code may be gone; then its results do without.
        with suppress(ConfigurationError):
            content, path = read_code(code.place), f"{_CODE}/{Path(code.place).stem}"
            # Of two files of one name the second gets a number.
            names = (f"{path}.py", *(f"{path}_{number}.py" for number in range(2, len(files) + 2)))
            here[str(code)] = next(name for name in names if files.setdefault(name, content) == content)
            here[str(code)] += f":{code.name}"
    data = with_texts(scenario.to_dict(), lambda _, text: here.get(text, text))
    return {"scenario.yaml": (_AS_RUN + to_yaml(data)).encode(), **files}


def _graph_files(graph: str) -> dict[str, bytes]:
    """The diagram, and a picture of it where graphviz is installed."""
    files, dot = {"diagram.dot": graph.encode()}, shutil.which("dot")
    with suppress(OSError, subprocess.SubprocessError):
        if dot is not None:
            done = subprocess.run([dot, "-Tsvg"], input=graph.encode(), capture_output=True, timeout=60, check=True)
            files["diagram.svg"] = done.stdout
    return files
