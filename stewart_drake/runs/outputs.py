"""The folder that a run leaves behind: written beside its place, and renamed once all is in it."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from stewart_drake.errors import ConfigurationError
from stewart_drake.families import user_parts
from stewart_drake.files.code import read_code, with_texts
from stewart_drake.files.whole import write_atomically
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.scenario import Scenario

_AS_RUN = "# As run by stewart-drake: every key, defaults included.\n"
_CODE = "code"  # Folder with the files of the user's classes.
_PICTURES = ("diagram.dot", "diagram.svg", "states.png", "torques.png", "replay.html")
"""What a run may leave or not; else what is in a results folder is the user's own, and stays."""


class Results(NamedTuple):
    """What a run has left: where, and its metrics."""

    folder: Path
    metrics: dict[str, Any]


def prepare_folder(path: str | Path, named: str | Path | None = None) -> Path:
    """Makes a folder, and sure that it can be written to; `named` is what the user called it."""
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
    if path.is_dir():
        raise ConfigurationError("--out", str(path), "a file, not a folder")


def write_text(path: Path, text: str) -> None:
    """Writes a file as a whole, and its folder where there is none."""
    prepare_file(path)
    write_atomically(path, text.encode())


def results_place(scenario: Scenario, out: str | Path | None = None, force: bool = False) -> Path:
    """`out`, or the first of runs/NAME, runs/NAME-2 and so on that is free; `force` replaces another scenario's."""
    if out is None:
        names = itertools.chain([scenario.name], (f"{scenario.name}-{number}" for number in itertools.count(2)))
        return next(place for name in names if not os.path.lexists(place := Path("runs") / name))
    place = Path(os.path.realpath(out))
    try:
        if not place.exists() or not any(place.iterdir()):
            return place
        before = (place / "scenario.yaml").read_bytes() if (place / "scenario.yaml").is_file() else b""
    except OSError as error:
        raise ConfigurationError("--out", str(out), f"a folder that can be written to ({error.strerror})") from None
    if not before.startswith(_AS_RUN.encode()):
        raise ConfigurationError("--out", str(out), "a new or empty folder, or one with the results of a run")
    if before != _own_files(scenario)["scenario.yaml"] and not force:
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

    Files: metrics.json (strict JSON), log.parquet, scenario.yaml, states.png, torques.png, replay.html, diagram.dot and
    .svg; with classes of the user's from files code/, so that scenario.yaml can be run again.
    """
    place, metrics = results_place(log.scenario, out, force), run_metrics(log)
    files = {
        "log.parquet": log.to_parquet(),
        "metrics.json": (json.dumps(metrics, indent=2, allow_nan=False) + "\n").encode(),
        **_own_files(log.scenario),
    }
    with tempfile.TemporaryDirectory(".part", f".{place.name}.", prepare_folder(place.parent, out)) as beside:
        part = Path(beside, place.name)
        for name, content in files.items():
            (part / name).parent.mkdir(parents=True, exist_ok=True)
            write_atomically(part / name, content)
        try:
            if graph is not None:
                _draw_graph(graph, part)
            if pictures and len(log.time):
                _draw(log, part)
        finally:
            place = _put(part, place, log.scenario, numbered=out is None)
    return Results(place, metrics)


def _put(part: Path, place: Path, scenario: Scenario, numbered: bool) -> Path:
    """Renames a folder to its place, or its files into the one that is there."""
    while not place.exists() or numbered:
        try:
            return part.rename(place)
        except OSError:
            if not place.exists():
                raise
            # Another run has just taken that number.
            place = results_place(scenario)
    shutil.rmtree(place / _CODE, ignore_errors=True)
    for name in _PICTURES:
        (place / name).unlink(missing_ok=True)
    for path in part.iterdir():
        path.replace(place / path.name)
    return place


def _draw_graph(graph: str, folder: Path) -> None:
    (folder / "diagram.dot").write_text(graph)
    with suppress(OSError, subprocess.SubprocessError):
        command = ["dot", "-Tsvg", "-o", str(folder / "diagram.svg"), str(folder / "diagram.dot")]
        subprocess.run(command, capture_output=True, timeout=60, check=True)


def _draw(log: SimulationLog, folder: Path) -> None:
    # matplotlib takes a second to load; a sweep that wants numbers alone does without.
    from stewart_drake.plotting import plot_states, plot_torques, save_figure
    from stewart_drake.runs.replay import write_replay

    save_figure(plot_states(log), folder / "states.png")
    save_figure(plot_torques(log), folder / "torques.png")
    # Of a run without a finite state there is nothing to replay.
    with suppress(ConfigurationError):
        write_replay(log, folder / "replay.html")


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
