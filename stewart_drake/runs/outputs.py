"""The folder that a run leaves behind: taken before the run, its log and metrics written first, then pictures."""

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

_AS_RUN = "# As run by stewart-drake: every key, defaults included.\n"
_ROOM = 10_000  # [byte] that a disk has at least
_CODE = "code"  # Folder with the files of the user's classes.
_RESULTS = ("log.parquet", "metrics.json", "run.mcap")
_PLOTS = ("states.png", "torques.png", "learnt.png")
_PICTURES = ("diagram.dot", "diagram.svg", "replay.html", *_PLOTS)
"""What a run may leave or not; else what is in a results folder is the user's own, and stays."""


def prepare_folder(path: str | Path, named: str | Path | None = None, key: str = "--out") -> Path:
    """Makes a folder, and sure that something can be written to it; `named` is what the user called it."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(bytes(_ROOM))
    except OSError as error:
        # Unlike `Path.is_file` this never raises, whatever stands in the way.
        why = "this is a file" if os.path.isfile(folder) else error.strerror  # noqa: PTH113
        raise ConfigurationError(key, str(named or path), f"a folder that can be written to ({why})") from None
    return folder


def prepare_file(path: Path, key: str = "--out") -> None:
    """Makes sure, before anything is computed, that a file can be written afterwards; its folder is made."""
    prepare_folder(path.parent, path, key)
    if path.is_dir():
        raise ConfigurationError(key, str(path), "a file, not a folder")


@contextmanager
def prepared_file(path: Path) -> Iterator[None]:
    """As `prepare_file`; a folder that was made for it and is empty at the end is removed."""
    made = [folder for folder in path.absolute().parents if not folder.exists()]
    prepare_file(path)
    try:
        yield
    finally:
        with suppress(OSError):
            for folder in made:
                folder.rmdir()


def check_ending(key: str, path: Path, *endings: str) -> None:
    """Raises a `ConfigurationError` for a file whose name ends otherwise: the ending says what is written."""
    if path.suffix not in endings:
        raise ConfigurationError(key, str(path), f"a name that ends in {' or '.join(endings)}")


def write_text(path: Path, text: str) -> None:
    """Writes a file as a whole, and its folder where there is none."""
    prepare_file(path)
    write_atomically(path, text.encode())


def check_place(scenario: Scenario, out: str | Path, force: bool = False, duration: bool = True) -> Path:
    """The folder `out`, which has no content but results of the same scenario, or of any with `force`.

    Without `duration` that may differ: on a machine it depends on where that stands.
    """
    place = Path(os.path.realpath(out))
    try:
        # A killed run leaves no more than these.
        if not place.exists() or all(path.name.endswith((".lock", ".part")) for path in place.iterdir()):
            return place
        before = (place / "scenario.yaml").read_bytes() if (place / "scenario.yaml").is_file() else b""
    except OSError as error:
        raise ConfigurationError("--out", str(out), f"a folder that can be written to ({error.strerror})") from None
    if not before.startswith(_AS_RUN.encode()):
        raise ConfigurationError("--out", str(out), "a new or empty folder, or one with the results of a run")
    own = _own_files(scenario)["scenario.yaml"]
    if not duration:
        before, own = (re.sub(rb"(?m)^duration: .*$", b"", text) for text in (before, own))
    if before != own and not force:
        allowed = "a folder without the results of another scenario, or --force to replace them"
        raise ConfigurationError("--out", str(out), allowed)
    return place


@contextmanager
def claimed_place(
    scenario: Scenario, out: str | Path | None = None, force: bool = False, duration: bool = True
) -> Iterator[Path]:
    """A folder that is this process's alone within: `out`, or the first of runs/NAME, runs/NAME-2 and so on.

    A folder that was made for it and is empty at the end is removed.
    """
    if out is None:
        place, made = prepare_folder("runs") / scenario.name, True
        for number in itertools.count(2):
            try:
                place.mkdir()
                break
            except FileExistsError:
                place = place.with_name(f"{scenario.name}-{number}")
    else:
        place = Path(os.path.realpath(out))
        made = not place.exists()
    try:
        prepare_folder(place, out)
        with locked_folder(place):
            if out is not None:
                check_place(scenario, out, force, duration)
            yield place
    finally:
        if made:
            with suppress(OSError):
                place.rmdir()


def save_run(log: SimulationLog, place: Path) -> tuple[Path, str | None]:
    """Writes log.parquet, metrics.json and scenario.yaml, and in code/ the user's classes, in place of an earlier run.

    No signal comes between. Where the disk is full they go to a new folder for temporary files. Where they are, and
    what is to be said of it.
    """
    with signals_held():
        metrics = json.dumps(run_metrics(log), indent=2, allow_nan=False) + "\n"
        files = {"log.parquet": log.to_parquet(), "metrics.json": metrics.encode(), **_own_files(log.scenario)}
        try:
            _put(files, place)
        except DiskError as error:
            other = Path(tempfile.mkdtemp(prefix=f"{place.name}-"))
            try:
                _put(files, other)
            except DiskError:
                shutil.rmtree(other)
                raise error from None
            (place / JOURNAL).unlink(missing_ok=True)
            return other, f"{error}; the results are in {other}"
        (place / JOURNAL).unlink(missing_ok=True)
    return place, None


def begin_journal(scenario: Scenario, place: Path) -> Path:
    """Where the rows of a run on a machine are to go; what the folder has of an earlier run is removed.

    A killed run leaves them with its scenario, and `load_log` opens the folder.
    """
    with signals_held():
        _put(_own_files(scenario), place, (*_RESULTS, JOURNAL))
    return place / JOURNAL


def _put(files: Mapping[str, bytes], place: Path, old: tuple[str, ...] = ()) -> None:
    paths = {place / name: content for name, content in files.items()}
    for path in paths:
        path.parent.mkdir(exist_ok=True)
    before = {*(place / _CODE).glob("*.py"), *(place / name for name in (*_PICTURES, *old))}
    write_together(paths, before - set(paths))
    with suppress(OSError):
        (place / _CODE).rmdir()


def draw_run(log: SimulationLog, place: Path, graph: str | None = None, plots: bool = True) -> str | None:
    """Writes diagram.dot, diagram.svg, replay.html, and as plots states.png, torques.png, learnt.png of what it learns.

    Returns what is missing and why, or None.
    """
    try:
        if graph is not None:
            _draw_graph(graph, place)
        if len(log.time):
            _draw(log, place, plots)
    except (StewartDrakeError, OSError, MemoryError) as error:
        wanted = [*_PLOTS[: 2 + log.learns], "replay.html"] if plots else ["replay.html"]
        missing = ", ".join(name for name in wanted if not (place / name).exists())
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
        # matplotlib takes as long as a run of seconds.
        from stewart_drake.plotting import plot_learnt, plot_states, plot_torques, save_figure

        for name, plot in zip(_PLOTS[: 2 + log.learns], (plot_states, plot_torques, plot_learnt), strict=False):
            save_figure(plot(log), folder / name)
    # Of a run without a finite state there is nothing to replay.
    if np.isfinite(log.signals.get("plant_state", log["pose"])).all(axis=1).any():
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
