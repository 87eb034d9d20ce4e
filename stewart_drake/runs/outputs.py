"""The results folder of a run: locked before the run; log and metrics are written first, then pictures."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from stewart_drake.base.atomic_files import locked_folder, signals_held, write_atomically, write_together
from stewart_drake.base.code import read_code, with_texts
from stewart_drake.base.errors import ConfigurationError, DiskError, StewartDrakeError
from stewart_drake.base.families import user_parts
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.logs.journal import JOURNAL
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.scenario.scenario import Scenario

_HEADER = "# As run by stewart-drake: every key, defaults included.\n"
_MIN_SPACE = 10_000  # [byte] that must fit on the disk.
_CODE = "code"  # Folder for the files of the user's classes.
_RESULTS = ("log.parquet", "metrics.json", "run.mcap")
_PLOTS = ("states.png", "torques.png", "learnt.png")
_PICTURES = ("diagram.dot", "diagram.svg", "replay.html", *_PLOTS)
"""Files that a new run removes; other files in the folder are the user's, and are kept."""


def prepare_folder(path: str | Path, named: str | Path | None = None, key: str = "--out") -> Path:
    """Makes a folder and checks that it can be written to; `named` is the path for messages."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(bytes(_MIN_SPACE))
    except OSError as error:
        # `Path.is_file` may raise.
        why = "this is a file" if os.path.isfile(folder) else error.strerror  # noqa: PTH113
        raise ConfigurationError(key, str(named or path), f"a folder that can be written to ({why})") from None
    return folder


def prepare_file(path: Path, key: str = "--out") -> None:
    """Checks before a computation that its file can be written, and makes the folder."""
    prepare_folder(path.parent, path, key)
    if path.is_dir():
        raise ConfigurationError(key, str(path), "a file, not a folder")


@contextmanager
def prepared_file(path: Path) -> Iterator[None]:
    """As `prepare_file`; new folders that are empty at the end are removed."""
    new_folders = [folder for folder in path.absolute().parents if not folder.exists()]
    prepare_file(path)
    try:
        yield
    finally:
        with suppress(OSError):
            for folder in new_folders:
                folder.rmdir()


def check_ending(key: str, path: Path, *endings: str) -> None:
    """Raises a `ConfigurationError` for a file with another ending."""
    if path.suffix not in endings:
        raise ConfigurationError(key, str(path), f"a name that ends in {' or '.join(endings)}")


def write_text(path: Path, text: str) -> None:
    """Writes a file, complete or not at all; makes its folder."""
    prepare_file(path)
    write_atomically(path, text.encode())


def check_run_folder(scenario: Scenario, out: str | Path, force: bool = False, duration: bool = True) -> Path:
    """Resolves the folder `out` and checks that it is empty or has results of this scenario; of any with `force`.

    Without `duration` the scenarios' durations may differ: on a machine they depend on its pose at the start.
    """
    folder = Path(os.path.realpath(out))
    try:
        # A killed run may leave these files.
        if not folder.exists() or all(path.name.endswith((".lock", ".part")) for path in folder.iterdir()):
            return folder
        old = (folder / "scenario.yaml").read_bytes() if (folder / "scenario.yaml").is_file() else b""
    except OSError as error:
        raise ConfigurationError("--out", str(out), f"a folder that can be written to ({error.strerror})") from None
    if not old.startswith(_HEADER.encode()):
        raise ConfigurationError("--out", str(out), "a new or empty folder, or one with the results of a run")
    new = _scenario_files(scenario)["scenario.yaml"]
    if not duration:
        old, new = (re.sub(rb"(?m)^duration: .*$", b"", text) for text in (old, new))
    if old != new and not force:
        allowed = "a folder without the results of another scenario, or --force to replace them"
        raise ConfigurationError("--out", str(out), allowed)
    return folder


@contextmanager
def new_run_folder(
    scenario: Scenario, out: str | Path | None = None, force: bool = False, duration: bool = True
) -> Iterator[Path]:
    """Makes and locks the results folder of a run: `out`, or the first new one of runs/NAME, runs/NAME-2 and so on.

    It is unlocked afterwards; a new folder that is then empty is removed.
    """
    if out is None:
        folder, is_new = prepare_folder("runs") / scenario.name, True
        for number in itertools.count(2):
            try:
                folder.mkdir()
                break
            except FileExistsError:
                folder = folder.with_name(f"{scenario.name}-{number}")
    else:
        folder = Path(os.path.realpath(out))
        is_new = not folder.exists()
    try:
        prepare_folder(folder, out)
        with locked_folder(folder):
            if out is not None:
                check_run_folder(scenario, out, force, duration)
            yield folder
    finally:
        if is_new:
            with suppress(OSError):
                folder.rmdir()


def save_run(log: SimulationLog, folder: Path) -> tuple[Path, str | None]:
    """Writes log.parquet, metrics.json, scenario.yaml, and in code/ the user's classes; replaces an earlier run.

    Signals wait until all are written. If the disk is full, they go to a new folder for temporary files.

    Returns:
        The folder, and a line on a full disk, or None.
    """
    with signals_held():
        metrics = json.dumps(run_metrics(log), indent=2, allow_nan=False) + "\n"
        files = {"log.parquet": log.to_parquet(), "metrics.json": metrics.encode(), **_scenario_files(log.scenario)}
        used, problem = folder, None
        try:
            _write_files(files, folder)
        except DiskError as error:
            used = Path(tempfile.mkdtemp(prefix=f"{folder.name}-"))
            try:
                _write_files(files, used)
            except DiskError:
                shutil.rmtree(used)
                raise error from None
            problem = f"{error}; the results are in {used}"
        (folder / JOURNAL).unlink(missing_ok=True)
    return used, problem


def begin_journal(scenario: Scenario, folder: Path) -> Path:
    """Writes the scenario, removes the results of an earlier run, and returns the path of the journal.

    `load_log` opens the folder of a killed drive by its journal.
    """
    with signals_held():
        _write_files(_scenario_files(scenario), folder, (*_RESULTS, JOURNAL))
    return folder / JOURNAL


def _write_files(files: Mapping[str, bytes], folder: Path, remove: tuple[str, ...] = ()) -> None:
    """Writes files, all or none, and removes old pictures, old code and the files `remove`."""
    paths = {folder / name: content for name, content in files.items()}
    for path in paths:
        path.parent.mkdir(exist_ok=True)
    old = {*(folder / _CODE).glob("*.py"), *(folder / name for name in (*_PICTURES, *remove))}
    write_together(paths, old - set(paths))
    with suppress(OSError):
        (folder / _CODE).rmdir()


def draw_run(log: SimulationLog, folder: Path, graph: str | None = None, plots: bool = True) -> str | None:
    """Writes diagram.dot, diagram.svg, replay.html, and with `plots` states.png, torques.png and perhaps learnt.png.

    Returns a line on missing pictures, or None.
    """
    try:
        if graph is not None:
            _draw_graph(graph, folder)
        if len(log.time):
            _draw(log, folder, plots)
    except (StewartDrakeError, OSError, MemoryError) as error:
        names = [*_PLOTS[: 2 + log.learns], "replay.html"] if plots else ["replay.html"]
        missing = ", ".join(name for name in names if not (folder / name).exists())
        return f"pictures: {error or 'no memory is left'}; missing: {missing}"
    return None


def _draw_graph(graph: str, folder: Path) -> None:
    write_atomically(folder / "diagram.dot", graph.encode())
    with suppress(FileNotFoundError, PermissionError, subprocess.SubprocessError):
        done = subprocess.run(["dot", "-Tsvg"], input=graph.encode(), capture_output=True, timeout=60, check=True)
        write_atomically(folder / "diagram.svg", done.stdout)


def _draw(log: SimulationLog, folder: Path, plots: bool) -> None:
    from stewart_drake.runs.replay import write_replay

    if plots:
        # Importing matplotlib takes seconds.
        from stewart_drake.plotting import plot_learnt, plot_states, plot_torques, save_figure

        for name, plot in zip(_PLOTS[: 2 + log.learns], (plot_states, plot_torques, plot_learnt), strict=False):
            save_figure(plot(log), folder / name)
    # Only finite states can be replayed.
    if np.isfinite(log.signals.get("plant_state", log["pose"])).all(axis=1).any():
        write_replay(log, folder / "replay.html")


def _scenario_files(scenario: Scenario) -> dict[str, bytes]:
    """scenario.yaml and copies of the user's classes, as content by file name."""
    files: dict[str, bytes] = {}
    copies: dict[str, str] = {}
    for code in [part.code for part in user_parts(scenario) if part.code.in_file]:
        # The code of a log from another computer may be missing.
        with suppress(ConfigurationError):
            content, path = read_code(code.place), f"{_CODE}/{Path(code.place).stem}"
            # A second file of the same name gets a number.
            names = (f"{path}.py", *(f"{path}_{number}.py" for number in range(2, len(files) + 2)))
            copies[str(code)] = next(name for name in names if files.setdefault(name, content) == content)
            copies[str(code)] += f":{code.name}"
    data = with_texts(scenario.to_dict(), lambda _, text: copies.get(text, text))
    return {"scenario.yaml": (_HEADER + to_yaml(data)).encode(), **files}
