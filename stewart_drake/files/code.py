"""Code of the user's own that a file names: where it is, whether it may run, and what it raises.

A class or object stands as `module:Class` or `path/to/file.py:Class`, and nothing is imported before `CodePath.load`.
What the user has said to trust is known again by its digest, from a file that whoever writes a scenario has no say in.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import os
import re
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from pathlib import Path
from types import FrameType, ModuleType, TracebackType
from typing import Any, Literal, Self

from pydantic_core import CoreSchema, core_schema

from stewart_drake.config import as_problem, meant
from stewart_drake.errors import UNTRUSTED_CODE, ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.files.whole import PACKAGE, digest, read_checked
from stewart_drake.files.yaml_files import shipped_folder

_PACKAGE = __name__.partition(".")[0]
_LARGEST = 1_000_000
"""[byte] of a file with a class, and of the user's file of what is trusted."""
_NAME = r"[A-Za-z_]\w*"
CLASS_PATH = rf"^(.+\.py|{_NAME}(\.{_NAME})*):{_NAME}$"
_WORDS = "module:Class or path/to/file.py:Class"
_FILES = "stewart_drake_user"
"""Name of the package that holds modules made from a user's files; it is not on disk."""
_IMPORTED: dict[str, str | None] = {}
"""Module -> digest of its code when it was loaded: Python imports it once."""

# --- whose code may run ---

Rule = Literal["ask", "trust", "name"] | frozenset[str]
"""ask: code that is not trusted is refused. trust: it is trusted from now on. name: it may be named, and is not run.
Keys: this code runs and no other, as a study has one version of it."""
_RULE: ContextVar[Rule] = ContextVar("rule", default="ask")
_TRUSTED: set[str] = set()
"""Keys of code that was trusted in this process."""


@contextmanager
def code_rule(rule: Rule) -> Iterator[None]:
    """Within it this rule holds for code that files name."""
    before = _RULE.set(rule)
    try:
        yield
    finally:
        _RULE.reset(before)


def trusting_code(trust: bool = True) -> AbstractContextManager[None]:
    """Within it code that files name is trusted, now and whenever it is the same; `trust` off changes nothing."""
    return code_rule("trust" if trust else _RULE.get())


def store() -> Path:
    """The file with the keys, a line each; of one that is deleted the user is asked again."""
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    # A relative one would be in the folder of whoever wrote the scenario.
    state = state if state.is_absolute() else Path("~/.local/state").expanduser()
    return state / "stewart-drake" / "trusted_code"


def _is_trusted(key: str, file: Path) -> bool:
    rule = _RULE.get()
    if isinstance(rule, frozenset):
        return key in rule
    if key in _TRUSTED or _is_shipped(file):
        return True
    # RuntimeError: nobody's home. Where nothing can be written, it is trusted in this process and its workers.
    with suppress(ConfigurationError, RuntimeError):
        if key in read_checked(store(), "trusted code", _LARGEST).decode(errors="replace").splitlines():
            return True
    if rule == "trust":
        _TRUSTED.add(key)
        with suppress(OSError, RuntimeError):
            store().parent.mkdir(parents=True, exist_ok=True)
            with store().open("a", encoding="utf-8") as stream:
                stream.write(f"{key}\n")
    return rule == "trust"


def _is_shipped(file: Path) -> bool:
    """Whether a file belongs to the package; in a checkout `diagrams` does."""
    own = (PACKAGE, shipped_folder("scenarios").parent)
    return any(Path(os.path.realpath(file)).is_relative_to(each) for each in own)


# --- the import path ---


@dataclass(frozen=True, repr=False)
class CodePath(os.PathLike[str]):
    """A class or object by its import path, or itself where it was given in Python.

    As the type of a key it takes a class, or a text whose code is trusted.

    Attributes:
        place: Its module, or the whole path of its file.
        name: Of the class.
        given: What was given in Python; None otherwise.
        digest: sha256 of its file; None where that cannot be read.
        file: That loading it runs.
        trusted: Whether it may run.
    """

    place: str
    name: str
    given: Any = field(default=None, hash=False)
    digest: str | None = None
    file: Path | None = field(default=None, compare=False)
    trusted: bool = field(default=True, compare=False)

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
        if place.endswith(".py"):
            # Without `..`, and not where links lead: this very path is what is opened.
            place = os.path.abspath(place)  # noqa: PTH100
        file = Path(place) if place.endswith(".py") else _module_file(place)
        known = None if file is None else digest(file)
        trusted = file is not None and known is not None and _is_trusted(f"{known} {name}", file)
        return cls(place, name, None, known, file, trusted)

    @property
    def key(self) -> str:
        """What it is known by, wherever its file lies: digest and name."""
        return f"{self.digest} {self.name}"

    @property
    def in_file(self) -> bool:
        """Whether it is in a file that is named, not in a module to import."""
        return self.given is None and self.place.endswith(".py")

    @property
    def own_module(self) -> str:
        """Package that the user's frames in a traceback are of."""
        if self.given is not None:
            return self.place
        return _FILES if self.in_file else self.place.partition(".")[0]

    def load(self, key: str) -> Any:
        """What the path names, whatever it is; `key` is where it stands, for messages."""
        if self.given is not None:
            return self.given
        if not self.trusted:
            raise self.refusal(key)
        with self.blamed(key, "code that can be imported"):
            module = _run_file(self.place, self.read(key)) if self.in_file else self._imported(key)
        found = getattr(module, self.name, None)
        if found is None:
            names = [name for name in vars(module) if not name.startswith("_")]
            raise ConfigurationError(key, self, f"a name that {self.place} defines{meant(self.name, names)}")
        if (
            self.file is not None
            and _is_shipped(self.file)
            and isinstance(found, type)
            and found.__module__ != module.__name__
        ):
            raise ConfigurationError(key, self, f"a class that {self.place} itself defines")
        return found

    def read(self, key: str) -> bytes:
        """Content of its file."""
        content = read_checked(self.place, f"code file {self.place}", _LARGEST)
        if hashlib.sha256(content).hexdigest() != self.digest:
            raise self.refusal(key)
        return content

    def refusal(self, key: str) -> ConfigurationError:
        """The error that says why it does not run, and what to do."""
        if self.digest is None:
            allowed = f"{_WORDS}, of a {'file that can be read' if self.in_file else 'module that can be found'}"
        elif self.trusted:
            allowed = "the code as it was when it was named; it has changed since: begin again"
        else:
            remedy = f"read {self.file}, then say --trust-code (trust_code=True)"
            allowed = f"code that you trust; it is new or has changed: {remedy}"
        error = ConfigurationError(key, self, allowed)
        error.reason = UNTRUSTED_CODE
        return error

    @contextmanager
    def blamed(self, key: str, allowed: str) -> Iterator[None]:
        """Says of whatever the user's code raises that it is no good value of the key."""
        try:
            yield
        except (ConfigurationError, KeyboardInterrupt):
            raise
        except BaseException as error:
            what, _ = describe(error, error.__traceback__, self.own_module)
            raise ConfigurationError(key, self, f"{allowed} ({what})") from error

    def _imported(self, key: str) -> ModuleType:
        if not CodePath.named(str(self)).digest == self.digest == _IMPORTED.setdefault(self.place, self.digest):
            raise self.refusal(key)
        return importlib.import_module(self.place)

    def __fspath__(self) -> str:
        return f"{self.place}:{self.name}"

    __str__ = __fspath__

    def __repr__(self) -> str:
        return repr(str(self))

    @classmethod
    def _validate(cls, value: Any) -> Any:
        if isinstance(value, (cls, type)):
            return cls.of(value)
        if not isinstance(value, str) or re.fullmatch(CLASS_PATH, value) is None:
            raise as_problem(ConfigurationError("", value, _WORDS))
        made = cls.named(value)
        if not made.trusted and _RULE.get() != "name":
            raise as_problem(made.refusal(""))
        return made

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(cls._validate)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return {"type": "string", "pattern": CLASS_PATH, "$comment": _WORDS}


def path_of(given: Any) -> str:
    """What stands in a file for a class or an object that was given in Python."""
    kind = given if isinstance(given, type) else type(given)
    return f"{kind.__module__}:{kind.__name__}"


def source_of(made: Any) -> str:
    """Source of a function, class or module, to tell whether it has changed; else a function's compiled code."""
    try:
        return inspect.getsource(made)
    except (OSError, TypeError):
        return repr(getattr(getattr(made, "__code__", None), "co_code", None))


def _module_file(module: str) -> Path | None:
    """The file that an import of `module` would run, found without an import; None if there is none."""
    top, *parts = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    for part in parts:
        if spec is not None:
            spec = PathFinder.find_spec(f"{spec.name}.{part}", list(spec.submodule_search_locations or ()))
    return Path(str(spec.origin)).absolute() if spec is not None and spec.has_location else None


def _run_file(path: str, content: bytes) -> ModuleType:
    # By content: an edited file is another module, and two files of one name are two.
    name = f"{_FILES}.{Path(path).stem}_{hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]}"
    if name not in sys.modules:
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = path
        try:
            # What was read is what runs.
            exec(compile(content, path, "exec"), vars(module))
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


# --- what it raises ---


class ControllerError(RunFailure):
    """A controller of the user's own raised something in a run; `traceback` begins with its first frame."""

    reason = "controller_raised"

    def __init__(self, message: str, traceback: str = "") -> None:
        self.traceback = traceback
        super().__init__(message)


class UserCode(AbstractContextManager[None]):
    """Turns what a user's controller raises in a run into `ControllerError`, which ends the run and keeps its log.

    What ends a run by itself passes, and so does Ctrl-C; so do, where no frame of the traceback is the user's, Drake's
    own verdicts (`SystemExit`, `RuntimeError`, see `drake_guard`) and mistakes in this package.

    A class: a generator under `contextmanager` would let StopIteration pass.

    Args:
        own: Names of the user's modules, or of the packages that they are in; none where no code is the user's.
    """

    def __init__(self, *own: str) -> None:
        self._own = own

    def __exit__(self, kind: Any, error: BaseException | None, trace: TracebackType | None) -> None:
        if not self._own or trace is None or error is None or isinstance(error, (RunFailure, KeyboardInterrupt)):
            return
        # The first frame is the one that has this guard.
        inner = trace.tb_next
        if not _frames_of(inner, self._own):
            verdict = type(error) is RuntimeError or isinstance(error, (StewartDrakeError, SystemExit))
            if verdict or (inner is not None and _is_of(inner.tb_frame, (_PACKAGE,))):
                return
        line, lines = describe(error, inner, *self._own)
        raise ControllerError(f"the user's code raised {line}", lines) from error


def describe(error: BaseException, trace: TracebackType | None, *own: str) -> tuple[str, str]:
    """An error in the user's code in one line, with file and line, and the user's part of its traceback."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # a __str__ of the user's own
        text = "its text cannot be shown"
    line = f"{type(error).__name__}: {text}" if text else type(error).__name__
    frames = _frames_of(trace, own)
    if not frames:
        return line, ""
    code = frames[-1].tb_frame.f_code
    # Of an endless recursion the first frames say enough.
    lines = "".join(traceback.format_exception(type(error), error, frames[0], limit=20)).rstrip()
    return f"{line} ({Path(code.co_filename).name}, line {frames[-1].tb_lineno}, in {code.co_name})", lines


def _frames_of(trace: TracebackType | None, packages: tuple[str, ...]) -> list[TracebackType]:
    """Those of a traceback that are in one of some packages."""
    frames = []
    while trace is not None:
        if _is_of(trace.tb_frame, packages):
            frames.append(trace)
        trace = trace.tb_next
    return frames


def _is_of(frame: FrameType, packages: tuple[str, ...]) -> bool:
    module = str(frame.f_globals.get("__name__"))
    return any(module == each or module.startswith(f"{each}.") for each in packages)


# --- files and code among plain values ---

FILE_KEYS = ("weights_file", "motion_file")
ROBOT_KEYS = ("robot", "model_robot")
"""At these a text is a file where it has a folder or an ending, else the name of a robot."""


def anchored(data: Any, folder: Path) -> Any:
    """A copy of plain values in which paths of weights, motions, robots and code are absolute, from `folder`.

    That is where the file lies that they come from; for a command line the current folder.
    """

    def absolute(key: str, text: str) -> str:
        named = _is_file(key, text) or (_is_code(text) and ".py:" in text)
        return str((folder / text).absolute()) if named and not Path(text).is_absolute() else text

    return with_texts(data, absolute)


def file_digests(data: Any, code: Iterable[CodePath] | None = None) -> dict[str, str | None]:
    """Path of each file that is named in plain values -> sha256 of its content, None where it cannot be read.

    `code` is what is named in them, as it was; None for as it is.
    """
    own = {str(each.file): each.digest for each in (code_named(data) if code is None else code)}
    return own | {path: digest(path) for path in sorted({text for key, text in _texts(data) if _is_file(key, text)})}


def code_named(data: Any) -> list[CodePath]:
    """The user's code that is named in plain values, trusted or not."""
    with code_rule("name"):
        found = [CodePath.named(text) for text in sorted({text for _, text in _texts(data)}) if _is_code(text)]
    return [code for code in found if code.file]


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


def _texts(data: Any) -> set[tuple[str, str]]:
    """Each text with the last part of its key."""
    found: set[tuple[str, str]] = set()
    with_texts(data, lambda *each: found.add(each))
    return found


def _is_code(text: str) -> bool:
    return re.fullmatch(CLASS_PATH, text) is not None


def _is_file(key: str, value: str) -> bool:
    """Whether a text names a file of data, given the last part of its key."""
    if key in ROBOT_KEYS:
        return Path(value).name != value or Path(value).suffix != ""
    return key in FILE_KEYS
