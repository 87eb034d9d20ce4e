"""The folder that a run leaves behind."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from stewart_drake.errors import ConfigurationError
from stewart_drake.files import write_atomically
from stewart_drake.log import SimulationLog
from stewart_drake.metrics import run_metrics
from stewart_drake.scenario import Scenario

SPACE = 50_000_000
"""[byte] that a command asks for before it begins; 10 s logged at 1 kHz take 14."""
_AS_RUN = "# As run by stewart-drake: every key, defaults included.\n"
_ROW = 1500
"""[byte] of a row of a log, with its share of the replay."""
_OPTIONAL = ("diagram.dot", "diagram.svg", "states.png", "torques.png", "replay.html")
"""Files that not every run leaves."""


def prepare_folder(path: str | Path, space: int = 0) -> Path:
    """Makes sure, before a run, that its results can be written afterwards.

    Args:
        path: The folder; it is made.
        space: [byte] that must be free on its disk.

    Raises:
        ConfigurationError: The path is a file, the folder cannot be made or written to, or the disk is full.
    """
    folder = Path(path)
    try:
        # A folder that is refused is not made.
        there = next(each for each in (folder, *folder.absolute().parents) if os.path.lexists(each))
        free = shutil.disk_usage(there).free
        if free < space:
            allowed = f"a folder on a disk with {space / 1e6:g} MB free, not {free / 1e6:.3g} MB"
            raise ConfigurationError("--out", str(path), allowed)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        # Unlike `Path.is_file` this never raises, whatever stands in the way.
        why = "this is a file" if os.path.isfile(folder) else error.strerror  # noqa: PTH113
        raise ConfigurationError("--out", str(path), f"a folder that can be written to ({why})") from None
    return folder


def prepare_file(path: Path, space: int = 0) -> None:
    """Makes sure, before anything is computed, that a file can be written afterwards; its folder is made.

    Args:
        path: The file.
        space: [byte] that must be free on its disk.

    Raises:
        ConfigurationError: As `prepare_folder`; the path is a folder, or its name too long.
    """
    try:
        if path.is_dir():
            raise ConfigurationError("--out", str(path), "a file, not a folder")
        path.lstat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise ConfigurationError("--out", str(path), f"a file that can be written ({error.strerror})") from None
    prepare_folder(path.parent, space)


def keep_scenario_file(folder: Path) -> None:
    """Refuses a folder whose `scenario.yaml` is none that a run has left: it would be lost.

    Raises:
        ConfigurationError: Names the folder.
    """
    try:
        with (folder / "scenario.yaml").open("rb") as stream:
            own = stream.readline().rstrip() == _AS_RUN.encode().rstrip()
    except OSError:
        return
    if not own:
        allowed = "a folder without a scenario.yaml of your own, which would be lost"
        raise ConfigurationError("--out", str(folder), allowed)


def space_for(scenario: Scenario) -> int:
    """[byte] that a run's files take at most, and `SPACE` at least."""
    return SPACE + _ROW * int(scenario.duration / scenario.effective_log_period)


def write_run(
    log: SimulationLog, folder: str | Path, graph: str | None = None, pictures: bool = True
) -> dict[str, Any]:
    """Writes everything about a run.

    Files: metrics.json, log.parquet, scenario.yaml, states.png, torques.png, replay.html, diagram.dot. Each appears
    whole or not at all; those of an earlier run in the same folder are replaced or, where this run has none, removed.

    Args:
        log: The run.
        folder: Where to.
        graph: Graphviz text of the diagram, or None to leave it out. An SVG beside it where graphviz is installed.
        pictures: Write the plots and the replay too.

    Returns:
        The metrics.

    Raises:
        ConfigurationError: The folder cannot be written to.
    """
    folder = prepare_folder(folder)
    metrics = run_metrics(log)
    log.save(folder / "log.parquet")
    write_atomically(folder / "metrics.json", (json.dumps(metrics, indent=2) + "\n").encode())
    write_atomically(folder / "scenario.yaml", (_AS_RUN + log.scenario.to_yaml()).encode())
    for name in _OPTIONAL:
        if (folder / name).is_file():
            (folder / name).unlink()
    if graph is not None:
        write_atomically(folder / "diagram.dot", graph.encode())
        svg = _render_graph(graph)
        if svg is not None:
            write_atomically(folder / "diagram.svg", svg)
    if pictures and len(log.time):
        # matplotlib and Meshcat take a second to load; a sweep that wants numbers alone does without.
        from stewart_drake.plotting import plot_states, plot_torques, save_figure
        from stewart_drake.replay import write_replay

        save_figure(plot_states(log), folder / "states.png")
        save_figure(plot_torques(log), folder / "torques.png")
        write_replay(log, folder / "replay.html")
    return metrics


def _render_graph(graph: str) -> bytes | None:
    dot = shutil.which("dot")
    if dot is None:
        return None
    try:
        return subprocess.run([dot, "-Tsvg"], input=graph.encode(), capture_output=True, timeout=60, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return None
