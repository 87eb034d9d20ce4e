"""The import path of a user's class or object, wherever it may stand; nothing is imported before `CodePath.load`."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, Self

from pydantic import GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from stewart_drake.config import as_problem
from stewart_drake.errors import UNTRUSTED_CODE, ConfigurationError
from stewart_drake.files.code_trust import is_shipped, is_trusted, may_be_named
from stewart_drake.files.user_errors import describe
from stewart_drake.files.whole import digest, read_checked

MAX_BYTES = 1_000_000
"""Of a file with a class."""
_NAME = r"[A-Za-z_]\w*"
CLASS_PATH = rf"^(.+\.py|{_NAME}(\.{_NAME})*):{_NAME}$"
CLASS_WORDS = "module:Class or path/to/file.py:Class"
_FILES = "stewart_drake_user"
"""Name of the package that holds modules made from a user's files; it is not on disk."""
_IMPORTED: dict[str, str | None] = {}
"""Module -> digest of its code when it was loaded: Python imports it once."""


class _Source(SourceFileLoader):
    """Runs a module's source: bytecode that lies beside it may be of other code."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


class _FromSource(MetaPathFinder):
    """Finds the modules of one package, to be run from their sources."""

    def __init__(self, package: str) -> None:
        self.package = package

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if fullname.partition(".")[0] != self.package:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Source(fullname, spec.loader.path)
        return spec


@dataclass(frozen=True, eq=False, repr=False)
class CodePath(os.PathLike[str]):
    """A class or object by its import path, or itself where it was given in Python.

    As the type of a key it takes a class, or a text whose code is trusted.

    Attributes:
        text: module:Class, or the whole path of a file, a colon and the class.
        given: What was given in Python; None otherwise.
        files: That loading it runs; the last is its own.
        digest: sha256 of what is in them; None where they cannot be read.
        trusted: Whether it may run.
    """

    text: str
    given: Any = None
    files: tuple[Path, ...] = ()
    digest: str | None = None
    trusted: bool = True

    @classmethod
    def of(cls, given: Any) -> Any:
        """A class or object that was given in Python, with its import path; a text as it is."""
        return given if isinstance(given, (str, cls)) else cls(path_of(given), given)

    @classmethod
    def named(cls, text: str) -> Self:
        """What a text names; relative paths are from the current folder."""
        place, _, name = text.rpartition(":")
        if place.endswith(".py"):
            # Without `..`, and not where links lead: this very path is what is opened.
            place = os.path.abspath(place)  # noqa: PTH100
        files = (Path(place),) if place.endswith(".py") else _module_files(place)
        found = _digest(files)
        trusted = found is not None and is_trusted(f"{found} {name}", files)
        return cls(f"{place}:{name}", None, files, found, trusted)

    @property
    def key(self) -> str:
        """What it is known by, wherever its file lies: digest and name."""
        return f"{self.digest} {self.name}"

    @property
    def name(self) -> str:
        """Of the class."""
        return self.text.rpartition(":")[2]

    @property
    def in_file(self) -> bool:
        """Whether it is in a file that is named, not in a module to import."""
        return self.given is None and self._place.endswith(".py")

    @property
    def own_module(self) -> str:
        """Package that the user's frames in a traceback are of."""
        if self.given is not None:
            return self._place
        return _FILES if self.in_file else self._place.partition(".")[0]

    def load(self, key: str) -> Any:
        """What the path names, whatever it is.

        Args:
            key: Where it stands, for messages.
        """
        if self.given is not None:
            return self.given
        if not self.trusted:
            raise self.refusal(key)
        with self.blamed(key, f"a module that can be imported, with a class {self.name}"):
            module = _run_file(self._place, self.read(key)) if self.in_file else self._imported(key)
            found = getattr(module, self.name)
        if is_shipped(self.files) and isinstance(found, type) and found.__module__ != module.__name__:
            raise ConfigurationError(key, self, f"a class that {self._place} itself defines")
        return found

    def read(self, key: str) -> bytes:
        """Content of its file."""
        content = read_checked(self._place, f"code file {self._place}", MAX_BYTES)
        if hashlib.sha256(content).hexdigest() != self.digest:
            raise self.refusal(key)
        return content

    def refusal(self, key: str) -> ConfigurationError:
        """The error that says why it does not run, and what to do."""
        if self.digest is None:
            allowed = f"{CLASS_WORDS}, of a {'file that can be read' if self.in_file else 'module that can be found'}"
        elif self.trusted:
            allowed = "the code as it was when it was named; it has changed since: begin again"
        else:
            remedy = f"read {self.files[-1]}, then say --trust-code (trust_code=True)"
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

    @property
    def _place(self) -> str:
        return self.text.rpartition(":")[0]

    def _imported(self, key: str) -> ModuleType:
        if not _digest(self.files) == self.digest == _IMPORTED.setdefault(self._place, self.digest):
            raise self.refusal(key)
        finder = _FromSource(self._place.partition(".")[0])
        sys.meta_path.insert(0, finder)
        try:
            return importlib.import_module(self._place)
        finally:
            sys.meta_path.remove(finder)

    def __fspath__(self) -> str:
        return self.text

    __str__ = __fspath__

    def __repr__(self) -> str:
        return repr(self.text)

    def __eq__(self, other: object) -> bool:
        # Of two objects of one class the paths are the same.
        same = isinstance(other, CodePath) and (self.text, self.digest) == (other.text, other.digest)
        return same and self.given is getattr(other, "given", None)

    def __hash__(self) -> int:
        return hash(self.text)

    @classmethod
    def _validate(cls, value: Any) -> Any:
        if isinstance(value, (cls, type)):
            return cls.of(value)
        if not isinstance(value, str) or re.fullmatch(CLASS_PATH, value) is None:
            raise as_problem(ConfigurationError("", value, CLASS_WORDS))
        made = cls.named(value)
        if not made.trusted and not may_be_named():
            raise as_problem(made.refusal(""))
        return made

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(cls._validate)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "string", "pattern": CLASS_PATH, "$comment": CLASS_WORDS}


UserCodePath = CodePath
"""Type of a key."""


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


def _digest(files: tuple[Path, ...]) -> str | None:
    """Of one file that of its content; None where one cannot be read, or there is none."""
    each = [found for file in files if (found := digest(file)) is not None]
    if len(each) < max(1, len(files)):
        return None
    return each[0] if len(each) == 1 else hashlib.sha256(" ".join(each).encode()).hexdigest()


def _module_files(module: str) -> tuple[Path, ...]:
    """Files that an import of `module` would run, of its parents too; none where there is no such module."""
    top, *parts = module.split(".")
    try:
        # Of a name without dots this imports nothing; with dots it would import the parents.
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return ()
    found = [spec]
    for part in parts:
        inside = list(getattr(spec, "submodule_search_locations", None) or ())
        spec = PathFinder.find_spec(f"{getattr(spec, 'name', '')}.{part}", inside)
        found.append(spec)
    if spec is None or not spec.has_location:
        return ()
    # A namespace package is no file.
    return tuple(Path(str(each.origin)).absolute() for each in found if each is not None and each.has_location)


def _run_file(path: str, content: bytes) -> ModuleType:
    # By content: an edited file is another module, and two files of one name are two.
    name = f"{_FILES}.{Path(path).stem}_{hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = path
    sys.modules[name] = module
    try:
        # What was read is what runs.
        exec(compile(content, path, "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module
