"""A controller of the user's own: where its class comes from."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import json
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Literal

from stewart_drake.errors import ConfigurationError, RunFailure, StewartDrakeError
from stewart_drake.option_checks import check_positive
from stewart_drake.scalars import SECTION, Flag, Positive

_PATH = re.compile(r"(?P<file>.+\.py):(?P<class>[A-Za-z_]\w*)|(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)")


class ControllerError(RunFailure):
    """A controller of the user's own raised something in the midst of a run."""

    reason = "controller_raised"


class ControllerStop(RunFailure):
    """A controller of the user's own asked for the end of the run before its time."""

    reason = "controller_stopped"


@dataclass(frozen=True, kw_only=True)
class PythonOptions:
    """A user's LeafSystem by import path.

    Ports that it must have: inputs measurement (12,) and reference (18,), output torque (6,), as in `LqiController`.
    Ports that it may have: input weights, (2,) or (4,) as the tuner gives; outputs error (6,) and integral (6,), both
    or none.

    Its continuous state, if any, is integrated by Runge and Kutta's method of third order in tenths of the plant's time
    step; time constants below a 25th of that step diverge.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {**SECTION, "json_schema_extra": {"required": ["kind", "system"]}}

    kind: Literal["python"] = "python"
    system: str
    """module:Class, or path/to/file.py:Class, relative to the scenario file."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """Keyword arguments of the constructor, plain values. `robot` (as the controller believes it), `period` and
    `gravity` are added where the constructor names them."""
    period: Positive = 0.001
    """[s] period of the log, of a delay and of the tuner; the controller should tick with it."""
    compiled: Flag = False
    """The pose estimator beside the controller is compiled by numba."""

    def __post_init__(self) -> None:
        if not isinstance(self.system, str) or _PATH.fullmatch(self.system) is None:
            raise ConfigurationError("controller.system", self.system, "module:Class or path/to/file.py:Class")
        check_positive("controller.period", self.period)
        try:
            json.dumps(self.arguments, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            allowed = f"plain values, all numbers finite ({error})"
            raise ConfigurationError("controller.arguments", self.arguments, allowed) from None

    @property
    def file(self) -> Path | None:
        """The file that the class is in; None where it is in a module to import."""
        match = _PATH.fullmatch(self.system)
        assert match is not None
        return Path(match["file"]) if match["file"] else None


def load_class(options: PythonOptions) -> type:
    """The class that `options.system` names.

    Raises:
        ConfigurationError: It cannot be imported, or is no class.
    """
    path, _, name = options.system.rpartition(":")
    with _refused(options.system, f"a module that can be imported, with a class {name}"):
        module = importlib.import_module(path) if options.file is None else _load_file(options.file)
        found = getattr(module, name)
    if not isinstance(found, type):
        raise ConfigurationError("controller.system", options.system, f"a class; {name} is a {type(found).__name__}")
    return found


def construct(options: PythonOptions, offered: Mapping[str, Any]) -> Any:
    """An object of the class, made with `options.arguments` and with those of `offered` that the constructor names.

    Raises:
        ConfigurationError: See `load_class`; the constructor raises.
    """
    kind = load_class(options)
    arguments = dict(options.arguments)
    with _refused(options.system, "a constructor that takes controller.arguments and does not raise"):
        for name, parameter in inspect.signature(kind).parameters.items():
            if name in offered and parameter.kind is not inspect.Parameter.VAR_KEYWORD:
                arguments.setdefault(name, offered[name])
        return kind(**arguments)


@contextmanager
def user_code() -> Iterator[None]:
    """Turns what a user's controller raises in a run into `ControllerError`, which ends the run and keeps its log.

    Drake's own verdicts (`SystemExit`, `RuntimeError`) pass to `drake_guard`; Python's kinds of RuntimeError, such as
    RecursionError, are none.

    Raises:
        ControllerError: In place of what was raised.
    """
    try:
        yield
    except (StewartDrakeError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        if type(error) is RuntimeError:
            raise
        raise ControllerError(
            f"the controller raised {type(error).__name__}: {' '.join(str(error).split())}"
        ) from error


@contextmanager
def _refused(system: str, allowed: str) -> Iterator[None]:
    try:
        yield
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise ConfigurationError("controller.system", system, f"{allowed} ({what})") from error


def _load_file(path: Path) -> ModuleType:
    # By content: an edited file is another module, and two files of one name are two.
    content = path.read_bytes()
    name = f"stewart_drake_user_{path.stem}_{hashlib.sha256(bytes(path.absolute()) + content).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
