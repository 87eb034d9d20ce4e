"""A controller of the user's own: where its class comes from."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import linecache
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal

from pydantic import Field

from stewart_drake.control.controller_options import ControllerOptions
from stewart_drake.control.installed import distribution_of
from stewart_drake.control.user_errors import UserCode, describe
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import read_checked
from stewart_drake.section import Positive, Text

MAX_BYTES = 1_000_000
"""Of a file with a controller."""
_NAME = r"[A-Za-z_]\w*"
_PATH = re.compile(rf"(?P<file>.+\.py):{_NAME}|(?P<module>{_NAME}(?:\.{_NAME})*):{_NAME}")
CLASS_PATH = r"^(.+\.py|[A-Za-z_]\w*(\.[A-Za-z_]\w*)*):[A-Za-z_]\w*$"
CLASS_WORDS = "module:Class or path/to/file.py:Class"
_FILES = "stewart_drake_user"
"""Package that modules made from a user's files count to; there is none of this name."""


class PythonOptions(ControllerOptions):
    """A user's LeafSystem by import path.

    Ports that it must have: inputs measurement (12,) and reference (18,), output torque (6,), as in `LqiController`.
    Ports that it may have: input weights, (2,) or (4,) as the tuner gives; outputs error (6,) and integral (6,), both
    or none.

    Its continuous state, if any, is integrated by Runge and Kutta's method of third order in tenths of the plant's time
    step; time constants below a 25th of that step diverge.
    """

    kind: Literal["python"] = "python"
    system: Annotated[Text, Field(pattern=CLASS_PATH), CLASS_WORDS]
    """path/to/file.py:Class, in the folder of the scenario file or below; or module:Class of an installed package. The
    class is a System of pydrake, and its code is run."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values. `robot` (as the controller believes it), `period` and
    `gravity` are added where the constructor names them."""
    period: Positive = 0.001
    """[s] period of the log, of a delay and of the tuner; the controller should tick with it."""

    def rules(self) -> None:
        """See `Section.rules`."""
        try:
            json.dumps(self.arguments, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise ConfigurationError("arguments", self.arguments, f"plain, finite values ({error})") from None

    @property
    def file(self) -> Path | None:
        """The file that the class is in; None where it is in a module to import."""
        match = _PATH.fullmatch(self.system)
        assert match is not None
        return Path(match["file"]) if match["file"] else None

    @property
    def code(self) -> str:
        """What is run: the path of the file, or the module with the installed package that it is part of.

        Raises:
            ConfigurationError: The module is part of none.
        """
        if self.file is not None:
            return str(self.file)
        module = self._module
        distribution = distribution_of(module)
        if distribution is None:
            own = f"{module.rpartition('.')[2]}.py:{self.system.rpartition(':')[2]}"
            allowed = f"a class of an installed package, or for a file of your own {own}"
            raise ConfigurationError("controller.system", self.system, allowed)
        return f"{module} (installed with {distribution})"

    @property
    def _module(self) -> str:
        return self.system.rpartition(":")[0]

    @property
    def own_module(self) -> str:
        """See `ControllerOptions`."""
        return _FILES if self.file is not None else self._module.partition(".")[0]


def load_class(options: PythonOptions) -> type:
    """The class that `options.system` names; it is not called.

    Raises:
        ConfigurationError: Its module is no file of the user's and of no installed package, and then not imported; it
            cannot be imported; the class is not there, or no System of pydrake.
    """
    from pydrake.systems.framework import System

    _, _, name = options.system.rpartition(":")
    source = options.code
    with _refused(options, f"a module that can be imported, with a class {name}"):
        module = importlib.import_module(options._module) if options.file is None else _load_file(Path(source))
        found = getattr(module, name)
    if not isinstance(found, type):
        raise ConfigurationError("controller.system", options.system, f"a class; {name} is a {type(found).__name__}")
    if not issubclass(found, System):
        raise ConfigurationError("controller.system", options.system, "a LeafSystem of pydrake")
    return found


def construct(options: PythonOptions, offered: Mapping[str, Any]) -> Any:
    """An object of the class, made with `options.arguments` and with those of `offered` that the constructor names.

    Raises:
        ConfigurationError: See `load_class`; the constructor raises.
    """
    kind = load_class(options)
    arguments = dict(options.arguments)
    with _refused(options, "a constructor that takes controller.arguments and does not raise"):
        for name, parameter in inspect.signature(kind).parameters.items():
            if name in offered and parameter.kind is not inspect.Parameter.VAR_KEYWORD:
                arguments.setdefault(name, offered[name])
        return kind(**arguments)


def user_code(options: ControllerOptions) -> UserCode:
    """The guard around what may call a controller of the user's, see `UserCode`; none for `options` of other kinds."""
    return UserCode(options.own_module)


@contextmanager
def _refused(options: PythonOptions, allowed: str) -> Iterator[None]:
    try:
        yield
    except (ConfigurationError, KeyboardInterrupt):
        raise
    except BaseException as error:
        what, _ = describe(error, error.__traceback__, options.own_module)
        raise ConfigurationError("controller.system", options.system, f"{allowed} ({what})") from error


def _load_file(path: Path) -> ModuleType:
    content = read_checked(path, f"controller file {path}", MAX_BYTES)
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
