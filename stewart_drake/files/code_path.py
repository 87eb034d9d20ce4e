"""The import path of a user's class or object, wherever it may stand: found, digested, and loaded once it is trusted.

Nothing is imported before `load`.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import linecache
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Self

from pydantic import GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from stewart_drake.errors import UNTRUSTED_CODE, ConfigurationError
from stewart_drake.files.code_trust import how_to_trust, is_shipped, is_trusted, may_be_named, naming_code
from stewart_drake.files.user_errors import describe
from stewart_drake.files.whole import digest, read_checked
from stewart_drake.wording import as_problem

MAX_BYTES = 1_000_000
"""Of a file with a class."""
_FILE, _NAME = r".+\.py", r"[A-Za-z_]\w*"
CLASS_PATH = rf"^({_FILE}|{_NAME}(\.{_NAME})*):{_NAME}$"
CLASS_WORDS = "module:Class or path/to/file.py:Class"
_FILES = "stewart_drake_user"
"""Name of the package that holds modules made from a user's files; it is not on disk."""
_IMPORTED: dict[str, str | None] = {}
"""Module -> digest of its code when it was loaded: Python imports it once."""


@dataclass(frozen=True, eq=False, repr=False)
class CodePath(os.PathLike[str]):
    """A class or object by its import path, or itself where it was given in Python.

    As the type of a key it takes a text, refused where its code is not trusted, or a class.

    Attributes:
        text: module:Class, or the whole path of a file, a colon and the class.
        given: What was given in Python; None otherwise.
        files: That loading it runs; the last is its own.
        digest: Of what is in them, sha256; None where they cannot be read.
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
        where, _, name = text.rpartition(":")
        if where.endswith(".py"):
            where = os.path.abspath(where)  # noqa: PTH100 - Path.absolute leaves `..` in
        files = (Path(where),) if where.endswith(".py") else _module_files(where)
        found = _digest(files)
        trusted = found is not None and is_trusted(f"{found} {name}", files)
        return cls(f"{where}:{name}", None, files, found, trusted)

    @property
    def key(self) -> str:
        """What it is known by, wherever its file lies: digest and name."""
        return f"{self.digest} {self.name}"

    @property
    def source(self) -> str:
        """Where its code is."""
        return str(self.files[-1]) if self.files else self._place

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

        Raises:
            ConfigurationError: It is not trusted, has changed since it was named, cannot be imported or does not have
                the name.
        """
        if self.given is not None:
            return self.given
        if not self.trusted:
            raise self.refusal(key)
        with self.blamed(key, f"a module that can be imported, with a class {self.name}"):
            module = self._loaded_file(key) if self.in_file else self._imported(key)
            found = getattr(module, self.name)
        if is_shipped(self.files) and isinstance(found, type) and found.__module__ != module.__name__:
            raise ConfigurationError(key, self, f"a class that {self.source} itself defines")
        return found

    def read(self, key: str) -> bytes:
        """Content of its file.

        Raises:
            ConfigurationError: It cannot be read, or has changed since it was named.
        """
        content = read_checked(self.files[-1], f"code file {self.source}", MAX_BYTES)
        if hashlib.sha256(content).hexdigest() != self.digest:
            raise self._changed(key)
        return content

    def refusal(self, key: str) -> ConfigurationError:
        """The error that says why it may not run, and what to do."""
        allowed = "a file that can be read" if self.in_file else "a module that can be found, or path/to/file.py:Class"
        return _untrusted(key, self, allowed if self.digest is None else how_to_trust(self.source))

    @contextmanager
    def blamed(self, key: str, allowed: str) -> Iterator[None]:
        """Says of whatever the user's code raises that it is no good value of the key.

        Raises:
            ConfigurationError: In place of what was raised.
        """
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

    @property
    def name(self) -> str:
        """Of the class."""
        return self.text.rpartition(":")[2]

    @property
    def in_file(self) -> bool:
        """Whether it is in a file that is named, not in a module to import."""
        return self.given is None and self._place.endswith(".py")

    def _changed(self, key: str) -> ConfigurationError:
        allowed = "the code that was there when this was read; it has changed since: read it again"
        return _untrusted(key, self, allowed)

    def _imported(self, key: str) -> ModuleType:
        if not _digest(self.files) == self.digest == _IMPORTED.setdefault(self._place, self.digest):
            raise self._changed(key)
        return importlib.import_module(self._place)

    def _loaded_file(self, key: str) -> ModuleType:
        content, path = self.read(key), self._place
        # By content: an edited file is another module, and two files of one name are two.
        place = hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]
        name = f"{_FILES}.{self.files[-1].stem}_{place}"
        if name in sys.modules:
            return sys.modules[name]
        module = ModuleType(name)
        module.__file__ = path
        sys.modules[name] = module
        try:
            # What was read is what runs; the lines of a traceback are its lines too.
            code = compile(content, path, "exec")
            text = content.decode(errors="replace")
            linecache.cache[path] = (len(text), None, text.splitlines(keepends=True), path)
            exec(code, vars(module))
        except BaseException:
            del sys.modules[name]
            raise
        return module

    def __fspath__(self) -> str:
        return self.text

    __str__ = __fspath__

    def __repr__(self) -> str:
        return repr(self.text)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, CodePath):
            return NotImplemented
        # Of two objects of one class the paths are the same.
        return (self.text, self.digest) == (other.text, other.digest) and self.given is other.given

    def __hash__(self) -> int:
        return hash(self.text)

    @classmethod
    def _validate(cls, value: Any) -> Self:
        if isinstance(value, (cls, type)):
            made: Self = cls.of(value)
            return made
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
        return {"type": "string", "pattern": CLASS_PATH}


UserCodePath = Annotated[CodePath, CLASS_WORDS]
"""Type of a key; the text is what messages call it."""


def file_of(text: str) -> tuple[str, str] | None:
    """File and class of path/to/file.py:Class; None for any other text."""
    found = re.fullmatch(rf"({_FILE}):({_NAME})", text)
    return None if found is None else (found[1], found[2])


def code_in(texts: set[str]) -> list[CodePath]:
    """What of the user's code some texts name, trusted or not."""
    with naming_code():
        found = [CodePath.named(text) for text in sorted(texts) if re.fullmatch(CLASS_PATH, text)]
    return [code for code in found if code.files]


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


def _untrusted(key: str, code: CodePath, allowed: str) -> ConfigurationError:
    error = ConfigurationError(key, code, allowed)
    error.reason = UNTRUSTED_CODE
    return error


def _digest(files: tuple[Path, ...]) -> str | None:
    """Of one file that of its content."""
    each = [digest(file) for file in files]
    if None in each or not each:
        return None
    return each[0] if len(each) == 1 else hashlib.sha256(" ".join(map(str, each)).encode()).hexdigest()


def _module_files(module: str) -> tuple[Path, ...]:
    """Files that an import of `module` would run, of its parents too; none where there is no such module."""
    files = []
    spec: ModuleSpec | None = None
    parts = module.split(".")
    for count in range(1, len(parts) + 1):
        name = ".".join(parts[:count])
        try:
            # Of a name without dots this imports nothing; with dots it would import the parents.
            spec = importlib.util.find_spec(name) if spec is None else _find_inside(spec, name)
        except (ImportError, ValueError, AttributeError):
            spec = None
        if spec is None:
            return ()
        # A namespace package is no file.
        if spec.has_location and spec.origin is not None:
            files.append(Path(spec.origin).absolute())
    return tuple(files) if spec is not None and spec.has_location else ()


def _find_inside(parent: ModuleSpec, name: str) -> ModuleSpec | None:
    return PathFinder.find_spec(name, list(parent.submodule_search_locations or ()))
