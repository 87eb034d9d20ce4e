"""The folder that a run leaves behind: whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.families import user_parts
from stewart_drake.files.named_files import file_digests, with_texts
from stewart_drake.files.whole import read_checked, sync_folder, take_lock, write_atomically
from stewart_drake.files.yaml_files import MAX_BYTES, to_yaml
from stewart_drake.logs.log import UNFINISHED, SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.scenario import Scenario

if TYPE_CHECKING:
    from filelock import FileLock

SPACE = 50_000_000
"""[byte] that a command asks for before it begins."""
_AS_RUN = "# As run by stewart-drake: every key, defaults included.\n"
_ROW = 2 * 1100
"""[byte] of a row of a log; it is there twice before a run is done."""
_MARK = ".stewart-drake"
"""File in a folder under construction: says that it is one, and is locked while a process works there."""
_CODE = "code"
"""Folder with the files of the user's classes."""
# Earlier versions kept a user's controller beside the rest.
_DATA = {"log.parquet", "metrics.json", "scenario.yaml", _CODE, "controller.py"}
_FILES = {_MARK, *_DATA, "diagram.dot", "diagram.svg", "states.png", "torques.png", "replay.html"}
"""All that a results folder may hold."""


def prepare_folder(path: str | Path, space: int = 0, named: str | None = None) -> Path:
    """Makes sure, before a run, that its results can be written afterwards.

    Args:
        path: The folder; it is made.
        space: [byte] that must be free on its disk.
        named: What the user called it, for messages; None for the path.

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
            raise ConfigurationError("--out", named or str(path), allowed)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        # Unlike `Path.is_file` this never raises, whatever stands in the way.
        why = "this is a file" if os.path.isfile(folder) else error.strerror  # noqa: PTH113
        raise ConfigurationError("--out", named or str(path), f"a folder that can be written to ({why})") from None
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


def space_for(scenario: Scenario) -> int:
    """[byte] that a run's files take at most, and `SPACE` at least."""
    return SPACE + _ROW * int(scenario.duration / scenario.effective_log_period)


class ResultsFolder:
    """A results folder under construction: beside its place, and renamed to it once all is in it.

    A context manager. While one is open, no other process can open one for the same place. What a process that was
    killed has left beside the place is cleared away by the next. A block that raises leaves the rows of the log, if
    there are any, in the folder under construction, and otherwise nothing.

    Args:
        place: Where the results will be.
        scenario: Whose they will be.
        force: Replace the results of another scenario.

    Raises:
        ConfigurationError: The place is a file, the current folder or a disk of its own; it holds files that are no
            results, or the results of another scenario; another process works there; it cannot be written to, or the
            disk is full.

    Attributes:
        folder: Where to write meanwhile.
        left_out: After `finish` a line for each picture that could not be made.
    """

    def __init__(self, place: str | Path, scenario: Scenario, force: bool = False) -> None:
        # Where links lead: what a link points to is replaced, not the link.
        self.place, self._scenario, self._force = Path(os.path.realpath(place)), scenario, force
        if not self.place.name:
            raise ConfigurationError("--out", str(place), "a folder of its own: the whole folder is replaced")
        self.folder = self.place.with_name(f".{self.place.name}.unfinished")
        self._before = self.place.with_name(f".{self.place.name}.before")
        self._named = str(place)
        self.left_out: list[str] = []
        self._lock: FileLock | None = None
        self._done = False
        self._files = _own_files(scenario)
        # Nothing is made as long as something may be refused.
        self._refuse_loss()

    def __enter__(self) -> Self:
        place = self.place
        prepare_folder(place.parent, space_for(self._scenario), self._named)
        try:
            self._take()
            try:
                if self._before.is_dir() and not place.exists():
                    # Killed between the two renames of `finish`.
                    self._before.rename(place)
                self._refuse_loss()
                for each in self.folder.iterdir():
                    if each.name != _MARK:
                        _remove(each)
                _remove(self._before)
            except BaseException:
                self.__exit__(None, None, None)
                raise
        except OSError as error:
            why = error.strerror or str(error)
            raise ConfigurationError("--out", self._named, f"a folder that can be written to ({why})") from None
        return self

    def finish(self, log: SimulationLog, graph: str | None = None, pictures: bool = True) -> dict[str, Any]:
        """Writes what `write_run` says but for the log itself, and puts the folder in its place.

        Raises:
            ConfigurationError: The disk is full, or the like.
        """
        metrics = run_metrics(log)
        text = json.dumps(metrics, indent=2, allow_nan=False) + "\n"
        write_atomically(self.folder / "metrics.json", text.encode())
        for name, content in self._files.items():
            path = self.folder / name
            path.parent.mkdir(exist_ok=True)
            write_atomically(path, content)
        if graph is not None:
            write_atomically(self.folder / "diagram.dot", graph.encode())
            svg = _render_graph(graph)
            if svg is not None:
                write_atomically(self.folder / "diagram.svg", svg)
        if pictures and len(log.time):
            # matplotlib and Meshcat take a second to load; a sweep that wants numbers alone does without.
            from stewart_drake.plotting import draw, plot_states, plot_torques

            figures = {"states.png": plot_states, "torques.png": plot_torques}
            lines = [draw(partial(plot, log), self.folder / name) for name, plot in figures.items()]
            self.left_out = [line for line in (*lines, _replay(log, self.folder / "replay.html")) if line is not None]
        try:
            self._put()
        except OSError as error:
            why = error.strerror or str(error)
            raise ConfigurationError("--out", self._named, f"a folder that can be written to ({why})") from None
        return metrics

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        kept = (self.folder / UNFINISHED).is_dir() or (self.folder / "log.parquet").is_file()
        if not self._done and not kept:
            shutil.rmtree(self.folder, ignore_errors=True)
        if self._lock is not None:
            self._lock.release()

    def _take(self) -> None:
        """Makes the folder under construction, or takes over one that nobody works in."""
        # One that is empty may be of a process that was killed before it could say whose it is.
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()
        for path, own in ((self.folder, (self.folder / _MARK).is_file()), (self._before, _is_run(self._before))):
            if os.path.lexists(path) and not own:
                allowed = f"a folder that has no {path.name} of your own beside it"
                raise ConfigurationError("--out", self._named, allowed)
        self.folder.mkdir(exist_ok=True)
        # Another process may finish there meanwhile: the mark that it deletes is no lock.
        taken = ConfigurationError("--out", self._named, "a folder that no other process is writing")
        self._lock = take_lock(self.folder / _MARK, taken)

    def _refuse_loss(self) -> None:
        """Refuses a place that cannot be, or where something would be lost."""
        here, place = Path.cwd(), self.place
        try:
            if not os.path.lexists(place):
                return
            if not place.is_dir():
                raise ConfigurationError("--out", self._named, "a folder that can be written to (this is a file)")
            if place == here or place in here.parents or place.is_mount():
                raise ConfigurationError("--out", self._named, "a folder of its own: the whole folder is replaced")
            names = {path.name for path in place.iterdir()}
        except OSError as error:
            why = error.strerror or str(error)
            raise ConfigurationError("--out", self._named, f"a folder that can be written to ({why})") from None
        others = sorted((names - _FILES) | _strange_code(place) if _is_run(place) else names)
        if others:
            allowed = f"a folder with nothing but results: it is replaced as a whole, and {others[0]} would be lost"
            raise ConfigurationError("--out", self._named, allowed)
        if names and not self._force and not self._same():
            allowed = "a folder without the results of another scenario, or --force to replace them"
            raise ConfigurationError("--out", self._named, allowed)

    def _same(self) -> bool:
        """Whether results that are there are of the same scenario, with the same files by content."""
        try:
            scenario, text = (
                read_checked(self.place / name, name, MAX_BYTES) for name in ("scenario.yaml", "metrics.json")
            )
            before = Counter(json.loads(text)["files"].values())
        except (ConfigurationError, ValueError, KeyError, TypeError, AttributeError):
            return False
        now = Counter(file_digests(self._scenario.to_dict()).values())
        return scenario == self._files["scenario.yaml"] and before == now

    def _put(self) -> None:
        for path in self.folder.rglob("*"):
            if path.is_dir():
                sync_folder(path)
                continue
            with path.open("rb") as stream:
                os.fsync(stream.fileno())
        sync_folder(self.folder)
        # The run may have taken hours.
        self._refuse_loss()
        place = self.place
        if place.exists():
            place.rename(self._before)
        # The mark goes last: a kill in between leaves what the next process knows for what it is.
        self.folder.rename(place)
        (place / _MARK).unlink()
        self._done = True
        sync_folder(place.parent)
        _remove(self._before)


def write_run(
    log: SimulationLog, folder: str | Path, graph: str | None = None, pictures: bool = True, force: bool = False
) -> dict[str, Any]:
    """Writes everything about a run into a folder, which appears as a whole.

    Files: metrics.json (strict JSON), log.parquet, scenario.yaml, states.png, torques.png, replay.html, diagram.dot;
    with classes of the user's from files code/, so that scenario.yaml can be run again. Results of the
    same scenario that are there are replaced.

    Args:
        log: The run.
        folder: Where to.
        graph: Graphviz text of the diagram, or None to leave it out. An SVG beside it where graphviz is installed.
        pictures: Write the plots and the replay too.
        force: Replace the results of another scenario.

    Returns:
        The metrics.

    Raises:
        ConfigurationError: See `ResultsFolder`.
    """
    with ResultsFolder(folder, log.scenario, force) as results:
        log.save(results.folder / "log.parquet")
        return results.finish(log, graph, pictures)


def _is_run(folder: Path) -> bool:
    """Whether a run has left this folder: then its scenario.yaml says so. Otherwise all in it is the user's own."""
    try:
        return read_checked(folder / "scenario.yaml", "scenario.yaml", MAX_BYTES).startswith(_AS_RUN.encode())
    except ConfigurationError:
        return False


def _strange_code(folder: Path) -> set[str]:
    """What lies beside the code of a run and is not named in its scenario."""
    code = folder / _CODE
    if not code.is_dir():
        return set()
    text = read_checked(folder / "scenario.yaml", "scenario.yaml", MAX_BYTES).decode(errors="replace")
    named = (f"{_CODE}/{path.name}" for path in code.iterdir())
    return {name for name in named if f"{name}:" not in text}


def _replay(log: SimulationLog, path: Path) -> str | None:
    """Writes the replay; where there is nothing to show, or Drake cannot, a line that says so."""
    from stewart_drake.runs.replay import write_replay

    try:
        write_replay(log, path)
    except StewartDrakeError as error:
        return f"{path.name} is left out: {error}"
    return None


def _own_files(scenario: Scenario) -> dict[str, bytes]:
    """The scenario as run, and the files of the user's classes that it runs."""
    files: dict[str, bytes] = {}
    here: dict[str, str] = {}
    for code, key in [(part.code, part.code_key) for part in user_parts(scenario) if part.code.in_file]:
        # Of a log from elsewhere the code may be gone; then its results do without.
        with suppress(ConfigurationError):
            content, path = code.read(key), f"{_CODE}/{code.files[-1].stem}"
            # Of two files of one name the second gets a number.
            names = (f"{path}.py", *(f"{path}_{number}.py" for number in range(2, len(files) + 2)))
            here[str(code)] = next(name for name in names if files.setdefault(name, content) == content)
            here[str(code)] += f":{code.name}"
    data = with_texts(scenario.to_dict(), lambda _, text: here.get(text, text))
    return {"scenario.yaml": (_AS_RUN + to_yaml(data)).encode(), **files}


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _render_graph(graph: str) -> bytes | None:
    dot = shutil.which("dot")
    if dot is None:
        return None
    try:
        return subprocess.run([dot, "-Tsvg"], input=graph.encode(), capture_output=True, timeout=60, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return None
