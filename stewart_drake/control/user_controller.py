"""A controller of the user's own: where its class comes from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from stewart_drake.control.controller_options import ControllerOptions
from stewart_drake.control.function_part import function_part
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import UserMade, user_sources
from stewart_drake.files.user_code import CLASS_PATH, CLASS_WORDS, KEEP_GIVEN, UserClass
from stewart_drake.files.user_errors import UserCode
from stewart_drake.part import AnyPart, Setup, SystemPart
from stewart_drake.section import Positive, Text


class PythonOptions(ControllerOptions, UserMade):
    """A user's LeafSystem by import path; `kind` may be that path itself.

    Ports that it must have: inputs measurement (12,) and reference (18,), output torque (6,), as in `LqiController`.
    Ports that it may have: input weights, (2,) or (4,) as the tuner gives; outputs error (6,) and integral (6,), both
    or none.

    Its continuous state, if any, is integrated by Runge and Kutta's method of third order in tenths of the plant's time
    step; time constants below a 25th of that step diverge.
    """

    path_key: ClassVar[str] = "system"
    kind: Literal["python"] = "python"
    system: Annotated[Text, Field(pattern=CLASS_PATH), CLASS_WORDS, KEEP_GIVEN]
    """path/to/file.py:Class, in the folder of the scenario file or below; or module:Class of an installed package. The
    class is a System of pydrake, and its code is run."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values. `robot` (as the controller believes it), `period` and
    `gravity` are added where the constructor names them."""
    period: Positive = 0.001
    """[s] period of the log, of a delay and of the tuner; the controller should tick with it."""

    @property
    def source(self) -> UserClass:
        """Where the class comes from."""
        return _SystemClass(self.system, super().source.key)

    def parts(self, setup: Setup) -> tuple[AnyPart, ...]:
        """The user's LeafSystem, or a function that is called at every tick."""
        made = construct(self, {"robot": setup.robot, "period": self.period, "gravity": setup.gravity})
        if callable(made):
            return (function_part(made),)
        return (_system_part(self, made, len(setup.weights)),)

    @property
    def file(self) -> Path | None:
        """See `UserClass.file`."""
        return self.source.file

    @property
    def code(self) -> str:
        """See `UserClass.code`."""
        return self.source.code


class _SystemClass(UserClass):
    """A class that must be a System of pydrake."""

    def load(self) -> type:
        """See `UserClass.load`."""
        from pydrake.systems.framework import System

        found = super().load()
        if not issubclass(found, System):
            raise ConfigurationError(self.key, self.path, "a LeafSystem of pydrake")
        return found


def _system_part(options: PythonOptions, system: Any, weights: int) -> SystemPart:
    """A System of pydrake as a part of a loop, its ports checked.

    Raises:
        ConfigurationError: A port is missing or of the wrong size.
    """
    from pydrake.systems.framework import PortDataType

    inputs = {"measurement": 12, "reference": 18, **({"weights": weights} if system.HasInputPort("weights") else {})}
    answers = {"error": 6, "integral": 6}
    outputs = {"torque": 6, **(answers if any(map(system.HasOutputPort, answers)) else {})}
    for side, ports in (("Input", inputs), ("Output", outputs)):
        for name, size in ports.items():
            has, get = getattr(system, f"Has{side}Port"), getattr(system, f"Get{side}Port")
            expected = f"a LeafSystem with the {side.lower()} port {name} ({size},)"
            if not has(name):
                raise ConfigurationError("controller.system", options.system, f"{expected}; it has no such port")
            if get(name).get_data_type() != PortDataType.kVectorValued:
                raise ConfigurationError("controller.system", options.system, f"{expected}; its own is abstract")
            if get(name).size() != size:
                own = f"{expected}; its own is ({get(name).size()},)"
                raise ConfigurationError("controller.system", options.system, own)
    return SystemPart("controller", inputs, tuple(outputs), system)


def construct(options: PythonOptions, offered: Mapping[str, Any]) -> Any:
    """An object of the class, made with `options.arguments` and with those of `offered` that the constructor names.

    Raises:
        ConfigurationError: See `UserClass.load`; it is not a System of pydrake; the constructor raises.
    """
    return options.source.construct(options.arguments, offered)


def user_code(section: Any) -> UserCode:
    """The guard around what may call a user's code, see `UserCode`: of a scenario or of a part of it."""
    return UserCode(*(source.own_module for source in user_sources(section)))
