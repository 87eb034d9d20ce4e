"""A class of the user's own: where it comes from, and when its code may run.

A file is run only where it lies beside the scenario or below, see `named_files`; a module only where it is part of an
installed package. Nothing is imported before the class is needed.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import linecache
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import WrapValidator

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.installed import distribution_of
from stewart_drake.files.user_errors import describe
from stewart_drake.files.whole import read_checked

MAX_BYTES = 1_000_000
"""Of a file with a class."""
_FILE, _NAME = r".+\.py", r"[A-Za-z_]\w*"
CLASS_PATH = rf"^({_FILE}|{_NAME}(\.{_NAME})*):{_NAME}$"
CLASS_WORDS = "module:Class or path/to/file.py:Class"
_FILES = "stewart_drake_user"
"""Name of the package that holds modules made from a user's files; it is not on disk."""


def split_path(path: str) -> tuple[str, str] | None:
    """File and class of path/to/file.py:Class; None for any other text."""
    found = re.fullmatch(rf"({_FILE}):({_NAME})", path)
    return None if found is None else (found[1], found[2])


class GivenPath(str):
    """An import path with the class or object that was given in Python: of two objects the paths are not equal."""

    given: Any = None

    def __eq__(self, other: object) -> bool:
        return super().__eq__(other) and (not isinstance(other, GivenPath) or self.given is other.given)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = str.__hash__


KEEP_GIVEN = WrapValidator(lambda value, check: value if isinstance(value, GivenPath) else check(value))
"""Beside the type of a key that may be a `GivenPath`."""


def path_of(given: Any) -> str:
    """What stands in a file for a class or an object that was given in Python."""
    kind = given if isinstance(given, type) else type(given)
    return f"{kind.__module__}:{kind.__name__}"


def given_path(kind: Any) -> str:
    """An import path as it is; for a class or an object its path, with it."""
    if isinstance(kind, str):
        return kind
    made = GivenPath(path_of(kind))
    made.given = kind
    return made


@dataclass(frozen=True)
class UserClass:
    """A class by import path, or itself.

    Attributes:
        path: module:Class, or path/to/file.py:Class.
        key: Key of the scenario that has the path, for messages.
    """

    path: str
    key: str

    @property
    def given(self) -> Any:
        """The class, or an object in its place, where it was given in Python; None for one by its path."""
        return getattr(self.path, "given", None)

    @property
    def file(self) -> Path | None:
        """The file that the class is in; None where it is in a module to import."""
        found = None if self.given is not None else split_path(self.path)
        return None if found is None else Path(found[0])

    @property
    def code(self) -> str:
        """What is run: the path of the file, or the module with the installed package that it is part of.

        Raises:
            ConfigurationError: The module is part of none.
        """
        if self.given is not None or self.file is not None:
            return self.path if self.file is None else str(self.file)
        distribution = distribution_of(self._module)
        if distribution is None:
            own = f"{self._module.rpartition('.')[2]}.py:{self.path.rpartition(':')[2]}"
            allowed = f"a class of an installed package; for a file of your own write {own}"
            raise ConfigurationError(self.key, self.path, allowed)
        return f"{self._module} (installed with {distribution})"

    @property
    def own_module(self) -> str:
        """Package that the user's frames in a traceback are of."""
        if self.given is not None:
            return self._module
        return _FILES if self.file is not None else self._module.partition(".")[0]

    @property
    def _module(self) -> str:
        return self.path.rpartition(":")[0]

    def named(self) -> Any:
        """What the path names, whatever it is.

        Raises:
            ConfigurationError: Its module is no file of the user's and of no installed package, and then not imported;
                it cannot be imported; it does not have the name.
        """
        _, _, name = self.path.rpartition(":")
        source = self.code
        with self._refused(f"a module that can be imported, with a class {name}"):
            module = importlib.import_module(self._module) if self.file is None else _load_file(Path(source))
            return getattr(module, name)

    def load(self) -> type:
        """The class; it is not called.

        Raises:
            ConfigurationError: See `named`; it is not a class.
        """
        if self.given is not None:
            return self.given if isinstance(self.given, type) else type(self.given)
        found = self.named()
        if not isinstance(found, type):
            name = self.path.rpartition(":")[2]
            raise ConfigurationError(self.key, self.path, f"a class; {name} is a {type(found).__name__}")
        return found

    def construct(self, arguments: Mapping[str, Any], offered: Mapping[str, Any]) -> Any:
        """An object of the class, made with `arguments` and with those of `offered` that the constructor names.

        Raises:
            ConfigurationError: See `load`; the constructor raises.
        """
        kind = self.load()
        if self.given is not None and not isinstance(self.given, type):
            return self.given
        section = self.key.rpartition(".")[0]
        keywords = dict(arguments)
        with self._refused(f"a constructor that takes {section}.arguments and does not raise"):
            for name, parameter in inspect.signature(kind).parameters.items():
                if name in offered and parameter.kind is not inspect.Parameter.VAR_KEYWORD:
                    keywords.setdefault(name, offered[name])
            return kind(**keywords)

    @contextmanager
    def _refused(self, allowed: str) -> Iterator[None]:
        try:
            yield
        except (ConfigurationError, KeyboardInterrupt):
            raise
        except BaseException as error:
            what, _ = describe(error, error.__traceback__, self.own_module)
            raise ConfigurationError(self.key, self.path, f"{allowed} ({what})") from error


def source_of(made: Any) -> str:
    """Source of a function, class or module, to tell whether it has changed; else a function's compiled code."""
    try:
        return inspect.getsource(made)
    except (OSError, TypeError):
        return repr(getattr(getattr(made, "__code__", None), "co_code", None))


def _load_file(path: Path) -> ModuleType:
    content = read_checked(path, f"code file {path}", MAX_BYTES)
    # By content: an edited file is another module, and two files of one name are two.
    name = f"{_FILES}.{path.stem}_{hashlib.sha256(bytes(path.absolute()) + content).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    try:
        # What was read is what runs; the lines of a traceback are its lines too.
        code = compile(content, str(path), "exec")
        text = content.decode(errors="replace")
        linecache.cache[str(path)] = (len(text), None, text.splitlines(keepends=True), str(path))
        exec(code, vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module
