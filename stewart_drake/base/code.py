"""Users' code that a file names: where it is, whether it may run, and what it raises.

A class or object is named by `module:Class` or `path/to/file.py:Class`. Naming it is always allowed and runs nothing;
`CodePath.load` runs it, and refuses to unless the file was read with `trust_code=True`.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

from pydantic import ValidationInfo
from pydantic_core import CoreSchema, core_schema

from stewart_drake.base.atomic_files import Document, digest, read_checked
from stewart_drake.base.config import Reading, as_problem, did_you_mean
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.yaml_files import shipped_folder

_MAX_BYTES = 1_000_000
_NAME = r"[A-Za-z_]\w*"
CLASS_PATH = rf"^(.+\.py|{_NAME}(\.{_NAME})*):{_NAME}$"
_FORMS = "module:Class or path/to/file.py:Class"
_PACKAGE_OF_FILES = "stewart_drake_user"
"""Package of the modules that are made from users' files; it exists in memory only."""


@dataclass(frozen=True, repr=False)
class CodePath(os.PathLike[str]):
    """A class or object by its import path, or as it was given in Python; the type of a key."""

    place: str  # Its module, or the whole path of its file.
    name: str
    given: object = field(default=None, hash=False)  # In Python; None otherwise.
    trusted: bool = field(default=True, compare=False)  # Whether it may run.

    @classmethod
    def of(cls, value: object, trust_code: bool = False) -> Self:
        """From a text, relative paths from the current folder, or a class or object that was given in Python."""
        if isinstance(value, cls):
            return value
        place, _, name = (value if isinstance(value, str) else path_of(value)).rpartition(":")
        if not isinstance(value, str):
            return cls(place, name, value)
        if not place.endswith(".py"):
            return cls(place, name, trusted=trust_code)
        # Without `..`, and not where links lead: this very path is what is opened.
        path = os.path.abspath(place)  # noqa: PTH100
        shipped = Path(os.path.realpath(path)).is_relative_to(shipped_folder("scenarios").parent)
        return cls(path, name, trusted=trust_code or shipped)

    @property
    def in_file(self) -> bool:
        """Whether it is in a file that is named, not in a module to import."""
        return self.given is None and self.place.endswith(".py")

    @property
    def user_module(self) -> str:
        """Package of the user's frames in a traceback."""
        if self.in_file:
            return _PACKAGE_OF_FILES
        return self.place if self.given is not None else self.place.partition(".")[0]

    def find(self, key: str) -> None:
        """Raises a `ConfigurationError` if its file is missing; `key` is the key that names it."""
        if self.in_file and not os.path.isfile(self.place):  # noqa: PTH113 - it never raises
            raise ConfigurationError(key, self, f"{_FORMS}, of a file that can be read")

    def check(self, key: str) -> None:
        """Raises a `ConfigurationError` if its file is missing, or it is not trusted."""
        self.find(key)
        if not self.trusted:
            allowed = f"code that you trust; read {self.place}, then add --trust-code (trust_code=True)"
            raise ConfigurationError(key, self, allowed)

    def load(self, key: str) -> Any:
        """The object that the path names, once it is checked, see `check`."""
        if self.given is not None:
            return self.given
        self.check(key)
        with self.blamed(key, "code that can be imported"):
            module = _run_file(self.place) if self.in_file else importlib.import_module(self.place)
        if not hasattr(module, self.name):
            hint = did_you_mean(self.name, vars(module))
            raise ConfigurationError(key, self, f"a name that {self.place} defines{hint}")
        return getattr(module, self.name)

    @contextmanager
    def blamed(self, key: str, allowed: str) -> Iterator[None]:
        """Turns whatever the user's code raises into a `ConfigurationError` for the key."""
        try:
            yield
        except (ConfigurationError, KeyboardInterrupt):
            raise
        except BaseException as error:  # SystemExit too
            text = _in_a_line(error, _frames_of(error.__traceback__, self.user_module))
            raise ConfigurationError(key, self, f"{allowed} ({text})") from error

    def __fspath__(self) -> str:
        return f"{self.place}:{self.name}"

    __str__ = __fspath__

    def __repr__(self) -> str:
        return repr(str(self))

    @classmethod
    def _validate(cls, value: object, info: ValidationInfo) -> Self:
        is_path = isinstance(value, str) and re.fullmatch(CLASS_PATH, value)
        if not is_path and not isinstance(value, (cls, type)):
            raise as_problem(ConfigurationError("", value, _FORMS))
        return cls.of(value, isinstance(info.context, Reading) and info.context.trust_code)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(cls._validate)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: object) -> Document:
        return {"type": "string", "pattern": CLASS_PATH}


def path_of(given: object) -> str:
    """The path, for a file, of a class or an object that was given in Python."""
    kind = given if isinstance(given, type) or inspect.isfunction(given) else type(given)
    return f"{kind.__module__}:{kind.__name__}"


def source_of(thing: Any) -> str:
    """Name and source code of a function, class or module, to see if it has changed; else its compiled code."""
    try:
        # Python 3.13 gives a class that was made by a call the source of its base.
        return f"{getattr(thing, '__qualname__', '')} {inspect.getsource(thing)}"
    except (OSError, TypeError):
        return repr(getattr(getattr(thing, "__code__", None), "co_code", None))


def read_code(path: str) -> bytes:
    """Content of a file with code."""
    return read_checked(path, f"code file {path}", _MAX_BYTES)


def _run_file(path: str) -> ModuleType:
    # By content: an edited file is another module, and two files of one name are two.
    content = read_code(path)
    name = f"{_PACKAGE_OF_FILES}.{Path(path).stem}_{hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]}"
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

    What ends a run by itself passes, and so does Ctrl-C, and what no frame of the user's `modules` is part of: that is
    Drake's verdict (see `drake_guard`), or a mistake in this package.

    A class: a generator under `contextmanager` would let StopIteration pass.
    """

    def __init__(self, *modules: str) -> None:
        self._modules = modules

    def __exit__(self, kind: object, error: BaseException | None, trace: TracebackType | None) -> None:
        if not self._modules or trace is None or error is None or isinstance(error, (RunFailure, KeyboardInterrupt)):
            return
        # The first frame is the one that has this guard; without another, the user's code could not even be called.
        frames = _frames_of(trace.tb_next, *self._modules)
        if frames or trace.tb_next is None:
            # The first frames are enough, of an endless recursion.
            lines = traceback.format_exception(type(error), error, frames[0], limit=20) if frames else []
            text = f"the user's code raised {_in_a_line(error, frames)}"
            raise ControllerError(text, "".join(lines).rstrip()) from error


def _frames_of(trace: TracebackType | None, *modules: str) -> list[TracebackType]:
    """Those of a traceback that are in some modules, or in packages of these names."""
    frames = []
    while trace is not None:
        if f"{trace.tb_frame.f_globals.get('__name__')}.".startswith(tuple(f"{module}." for module in modules)):
            frames.append(trace)
        trace = trace.tb_next
    return frames


def _in_a_line(error: BaseException, frames: list[TracebackType]) -> str:
    """An error, with file and line of the last of the user's frames in its traceback."""
    line = f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
    if frames:
        code = frames[-1].tb_frame.f_code
        line += f" ({Path(code.co_filename).name}, line {frames[-1].tb_lineno}, in {code.co_name})"
    return line


# --- files and code among plain values ---

FILE_KEYS = ("weights_file", "motion_file")
ROBOT_KEY = "robot"
NAME_OR_FILE_KEYS = (ROBOT_KEY, "model_file")
"""At them a text is a file where it has a folder or an ending, else the name of a robot."""


def anchored(data: object, folder: Path) -> Any:
    """A copy of plain values in which paths of weights, motions, robots and code are absolute, from `folder`.

    That is where the file lies that they come from; for a command line the current folder.
    """
    return with_texts(data, lambda key, text: str((folder / text).absolute()) if _file_in(key, text) else text)


def file_digests(data: object) -> dict[str, str | None]:
    """Path of every file named in plain values -> sha256 of its content, None if it cannot be read.

    The file of a module is known once that is imported.
    """
    paths: set[str] = set()

    def note(key: str, text: str) -> str:
        path = _file_in(key, text)
        if path is None and re.fullmatch(CLASS_PATH, text):
            path = getattr(sys.modules.get(text.partition(":")[0]), "__file__", None)
        paths.update([] if path is None else [path])
        return text

    with_texts(data, note)
    return {path: digest(path) for path in sorted(paths)}


def with_texts(data: object, change: Callable[[str, str], str], key: str = "") -> Any:
    """A copy of plain values with every text changed by a function of the last part of its key and the text.

    Of a list it is the key of the list; of `values`, from which a sweep chooses, the key above.
    """
    if isinstance(data, str):
        return change(key, data)
    if isinstance(data, Mapping):
        lasts = {name: str(name).rpartition(".")[2] for name in data}
        return {name: with_texts(data[name], change, key if last == "values" else last) for name, last in lasts.items()}
    return [with_texts(item, change, key) for item in data] if isinstance(data, (list, tuple)) else data


def _file_in(key: str, text: str) -> str | None:
    """The file that a text names, of data or of code, given the last part of its key."""
    if re.fullmatch(CLASS_PATH, text):
        return text.rpartition(":")[0] if ".py:" in text else None
    named = key in NAME_OR_FILE_KEYS
    is_file = Path(text).name != text or Path(text).suffix != "" if named else key in FILE_KEYS
    return text if is_file and not text.startswith("package:") else None
