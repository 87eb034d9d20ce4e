"""Code of the user's own that a file names: where it is, whether it may run, and what it raises.

A class or object stands as `module:Class` or `path/to/file.py:Class`. To name it is always allowed and runs nothing;
`CodePath.load` asks that who read the file has trusted the code in it.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

from pydantic_core import CoreSchema, core_schema

from stewart_drake.config import as_problem, meant
from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.files.whole import digest, read_checked
from stewart_drake.files.yaml_files import shipped_folder

_LARGEST = 1_000_000
"""[byte] of a file with a class."""
_NAME = r"[A-Za-z_]\w*"
CLASS_PATH = rf"^(.+\.py|{_NAME}(\.{_NAME})*):{_NAME}$"
_WORDS = "module:Class or path/to/file.py:Class"
_FILES = "stewart_drake_user"
"""Name of the package that holds modules made from a user's files; it is not on disk."""
_TRUST: ContextVar[bool] = ContextVar("trust", default=False)


@contextmanager
def trusting_code(trust: bool = True) -> Iterator[None]:
    """Context manager: user code named within it may run, then and later; with `trust` off it changes nothing."""
    before = _TRUST.set(trust or _TRUST.get())
    try:
        yield
    finally:
        _TRUST.reset(before)


def code_is_trusted() -> bool:
    """Whether code that is named now may run."""
    return _TRUST.get()


@dataclass(frozen=True, repr=False)
class CodePath(os.PathLike[str]):
    """A class or object by its import path, or itself where it was given in Python; the type of a key."""

    place: str  # Its module, or the whole path of its file.
    name: str
    given: Any = field(default=None, hash=False)  # In Python; None otherwise.
    trusted: bool = field(default=True, compare=False)  # Whether it may run.

    @classmethod
    def of(cls, given: Any) -> Any:
        """A class or object that was given in Python, with its import path; a text as it is."""
        if isinstance(given, (str, cls)):
            return given
        place, _, name = path_of(given).rpartition(":")
        return cls(place, name, given)

    @classmethod
    def named(cls, text: str) -> Self:
        """What a text names; relative paths are from the current folder."""
        place, _, name = text.rpartition(":")
        if not place.endswith(".py"):
            return cls(place, name, trusted=_TRUST.get())
        # Without `..`, and not where links lead: this very path is what is opened.
        path = os.path.abspath(place)  # noqa: PTH100
        shipped = Path(os.path.realpath(path)).is_relative_to(shipped_folder("scenarios").parent)
        return cls(path, name, trusted=_TRUST.get() or shipped)

    @property
    def in_file(self) -> bool:
        """Whether it is in a file that is named, not in a module to import."""
        return self.given is None and self.place.endswith(".py")

    @property
    def file(self) -> Path | None:
        """Where it is, as far as that is known without an import."""
        if self.place.endswith(".py"):
            return Path(self.place)
        path = getattr(sys.modules.get(self.place), "__file__", None)
        return None if path is None else Path(path)

    @property
    def own_module(self) -> str:
        """Package that the user's frames in a traceback are of."""
        if self.given is not None:
            return self.place
        return _FILES if self.in_file else self.place.partition(".")[0]

    def find(self, key: str) -> None:
        """Raises a `ConfigurationError` where its file is missing; `key` is where it stands."""
        if self.in_file and not os.path.isfile(self.place):  # noqa: PTH113 - it never raises
            raise ConfigurationError(key, self, f"{_WORDS}, of a file that can be read")

    def check(self, key: str) -> None:
        """Raises a `ConfigurationError` where its file is missing, or it is not trusted."""
        self.find(key)
        if not self.trusted:
            allowed = f"code that you trust; read {self.place}, then add --trust-code (trust_code=True)"
            raise ConfigurationError(key, self, allowed)

    def load(self, key: str) -> Any:
        """What the path names, whatever it is; see `check`."""
        if self.given is not None:
            return self.given
        self.check(key)
        with self.blamed(key, "code that can be imported"):
            module = _run_file(self.place) if self.in_file else importlib.import_module(self.place)
        if not hasattr(module, self.name):
            raise ConfigurationError(key, self, f"a name that {self.place} defines{meant(self.name, vars(module))}")
        return getattr(module, self.name)

    @contextmanager
    def blamed(self, key: str, allowed: str) -> Iterator[None]:
        """Says of whatever the user's code raises that it is no good value of the key."""
        try:
            yield
        except (ConfigurationError, KeyboardInterrupt):
            raise
        except BaseException as error:  # SystemExit too
            text = _in_a_line(error, _frames(error.__traceback__, (self.own_module,)))
            raise ConfigurationError(key, self, f"{allowed} ({text})") from error

    def __fspath__(self) -> str:
        return f"{self.place}:{self.name}"

    __str__ = __fspath__

    def __repr__(self) -> str:
        return repr(str(self))

    @classmethod
    def _validate(cls, value: Any) -> Any:
        if isinstance(value, (cls, type)):
            return cls.of(value)
        if not isinstance(value, str) or not is_code(value):
            raise as_problem(ConfigurationError("", value, _WORDS))
        return cls.named(value)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(cls._validate)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return {"type": "string", "pattern": CLASS_PATH}


def path_of(given: Any) -> str:
    """What stands in a file for a class or an object that was given in Python."""
    kind = given if isinstance(given, type) or inspect.isfunction(given) else type(given)
    return f"{kind.__module__}:{kind.__name__}"


def is_code(text: str) -> bool:
    """Whether a text has the form of an import path."""
    return re.fullmatch(CLASS_PATH, text) is not None


def source_of(thing: Any) -> str:
    """Name and source of a function, class or module, to tell whether it has changed; else its compiled code."""
    try:
        # Python 3.13 gives a class that was made by a call the source of its base.
        return f"{getattr(thing, '__qualname__', '')} {inspect.getsource(thing)}"
    except (OSError, TypeError):
        return repr(getattr(getattr(thing, "__code__", None), "co_code", None))


def read_code(path: str) -> bytes:
    """Content of a file with code."""
    return read_checked(path, f"code file {path}", _LARGEST)


def _run_file(path: str) -> ModuleType:
    # By content: an edited file is another module, and two files of one name are two.
    content = read_code(path)
    name = f"{_FILES}.{Path(path).stem}_{hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]}"
    if name not in sys.modules:
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = path
        try:
            exec(compile(content, path, "exec"), vars(module))
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


# --- what it raises ---


class ControllerError(RunFailure):
    """A user's code raised something in a run; `traceback` begins with its first frame."""

    reason = "controller_raised"

    def __init__(self, message: str, traceback: str = "") -> None:
        self.traceback = traceback
        super().__init__(message)


class UserCode(AbstractContextManager[None]):
    """Turns what a user's code raises in a run into `ControllerError`, which ends the run and keeps its log.

    What ends a run by itself passes, and so does Ctrl-C, and what no frame of the user's is part of: that is Drake's
    verdict (see `drake_guard`), or a mistake in this package. `own` are the user's modules, or packages of them.

    A class: a generator under `contextmanager` would let StopIteration pass.
    """

    def __init__(self, *own: str) -> None:
        self._own = own

    def __exit__(self, kind: Any, error: BaseException | None, trace: TracebackType | None) -> None:
        if not self._own or trace is None or error is None or isinstance(error, (RunFailure, KeyboardInterrupt)):
            return
        # The first frame is the one that has this guard; without another, the user's code could not even be called.
        frames = _frames(trace.tb_next, self._own)
        if frames or trace.tb_next is None:
            # Of an endless recursion the first frames say enough.
            lines = traceback.format_exception(type(error), error, frames[0], limit=20) if frames else []
            raise ControllerError(
                f"the user's code raised {_in_a_line(error, frames)}", "".join(lines).rstrip()
            ) from error


def _frames(trace: TracebackType | None, packages: tuple[str, ...]) -> list[TracebackType]:
    """Those of a traceback that are in one of some packages."""
    frames, starts = [], tuple(f"{package}." for package in packages)
    while trace is not None:
        if f"{trace.tb_frame.f_globals.get('__name__')}.".startswith(starts):
            frames.append(trace)
        trace = trace.tb_next
    return frames


def _in_a_line(error: BaseException, frames: list[TracebackType]) -> str:
    """An error, with file and line of the last of the user's frames in its traceback."""
    line = f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
    if not frames:
        return line
    code = frames[-1].tb_frame.f_code
    return f"{line} ({Path(code.co_filename).name}, line {frames[-1].tb_lineno}, in {code.co_name})"


# --- files and code among plain values ---

FILE_KEYS = ("weights_file", "motion_file")
ROBOT_KEYS = ("robot", "model_robot")
"""At these a text is a file where it has a folder or an ending, else the name of a robot."""


def anchored(data: Any, folder: Path) -> Any:
    """A copy of plain values in which paths of weights, motions, robots and code are absolute, from `folder`.

    That is where the file lies that they come from; for a command line the current folder.
    """

    def absolute(key: str, text: str) -> str:
        named = _is_file(key, text) or (is_code(text) and ".py:" in text)
        return str((folder / text).absolute()) if named and not Path(text).is_absolute() else text

    return with_texts(data, absolute)


def file_digests(data: Any) -> dict[str, str | None]:
    """Path of each file that is named in plain values -> sha256 of its content, None where it cannot be read.

    The file of a module is known once that is imported.
    """
    paths: set[str] = set()

    def look(key: str, text: str) -> str:
        path = CodePath.named(text).file if is_code(text) else text if _is_file(key, text) else None
        paths.update([] if path is None else [str(path)])
        return text

    with_texts(data, look)
    return {path: digest(path) for path in sorted(paths)}


def with_texts(data: Any, change: Any, key: str = "") -> Any:
    """A copy of plain values with each text changed, by a function of the last part of its key and the text.

    Of a list it is the key of the list; of `values`, from which a sweep chooses, the key above.
    """
    if isinstance(data, str):
        return change(key, data)
    if isinstance(data, Mapping):
        lasts = {name: str(name).rpartition(".")[2] for name in data}
        return {name: with_texts(data[name], change, key if last == "values" else last) for name, last in lasts.items()}
    return [with_texts(each, change, key) for each in data] if isinstance(data, (list, tuple)) else data


def _is_file(key: str, value: str) -> bool:
    """Whether a text names a file of data, given the last part of its key."""
    if key in ROBOT_KEYS:
        return Path(value).name != value or Path(value).suffix != ""
    return key in FILE_KEYS
