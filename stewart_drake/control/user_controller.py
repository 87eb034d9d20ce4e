"""A controller of the user's own: where its class comes from."""

from __future__ import annotations

import sys
from typing import Any, ClassVar, Literal

from pydantic import Field

from stewart_drake.control.controller_options import ControllerOptions
from stewart_drake.control.function_part import function_part
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import UserMade, user_parts
from stewart_drake.files.code_path import UserCodePath
from stewart_drake.files.user_errors import UserCode
from stewart_drake.part import AnyPart, Setup, SystemPart
from stewart_drake.section import Positive


class PythonOptions(UserMade, ControllerOptions):
    """A controller of the user's own by import path; `kind` may be that path itself.

    A function `torque = f(measurement, setpoint, time)`, or a class of objects that are called so, runs on both
    engines: measurement has pose [rad, m] and pose_rate, setpoint pose, pose_rate and pose_acceleration, all (6,);
    time is in seconds, torque (6,) [N m]. A System of pydrake runs on Drake.

    Ports that it must have: inputs measurement (12,) and reference (18,), output torque (6,), as in `LqiController`.
    Ports that it may have: input weights, (2,) or (4,) as the tuner gives; outputs error (6,) and integral (6,), both
    or none.

    Its continuous state, if any, is integrated by Runge and Kutta's method of third order in tenths of the plant's time
    step; time constants below a 25th of that step diverge.
    """

    path_key: ClassVar[str] = "system"
    kind: Literal["python"] = "python"  # type: ignore[assignment]
    system: UserCodePath
    """path/to/file.py:Class, from the folder of the file that names it, or module:Class. Its code is run."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values. `robot` (as the controller believes it), `period` and
    `gravity` are added where the constructor names them."""
    period: Positive = 0.001
    """[s] period of the log, of a delay and of the tuner; the controller should tick with it."""

    def load(self) -> Any:
        """The class, function or object.

        Raises:
            ConfigurationError: It cannot be loaded; it is no System of pydrake, and nothing that is called.
        """
        found = self.code.load(self.code_key)
        called = "__call__" in dir(found) if isinstance(found, type) else callable(found)
        if not (_is_system(found) or called):
            raise ConfigurationError(self.code_key, self.code, _EXPECTED)
        return found

    def parts(self, setup: Setup) -> tuple[AnyPart, ...]:
        """The user's LeafSystem, or a function that is called at every tick."""
        made = self.load()
        if isinstance(made, type):
            made = self.construct({"robot": setup.robot, "period": self.period, "gravity": setup.gravity})
        if _is_system(made):
            return (self._system_part(made, len(setup.weights)),)
        return (function_part(made),)

    def _system_part(self, system: Any, weights: int) -> SystemPart:
        """A System of pydrake as a part of a loop, its ports checked.

        Raises:
            ConfigurationError: A port is missing or of the wrong size.
        """
        from pydrake.systems.framework import PortDataType

        weighted = {"weights": weights} if system.HasInputPort("weights") else {}
        answers = {"error": 6, "integral": 6}
        inputs = {"measurement": 12, "reference": 18, **weighted}
        outputs = {"torque": 6, **(answers if any(map(system.HasOutputPort, answers)) else {})}
        for side, ports in (("Input", inputs), ("Output", outputs)):
            for name, size in ports.items():
                expected = f"a LeafSystem with the {side.lower()} port {name} ({size},)"
                if not getattr(system, f"Has{side}Port")(name):
                    raise ConfigurationError(self.code_key, self.code, f"{expected}; it has no such port")
                port = getattr(system, f"Get{side}Port")(name)
                if port.get_data_type() != PortDataType.kVectorValued:
                    raise ConfigurationError(self.code_key, self.code, f"{expected}; its own is abstract")
                if port.size() != size:
                    raise ConfigurationError(self.code_key, self.code, f"{expected}; its own is ({port.size()},)")
        return SystemPart("controller", inputs, tuple(outputs), system)


_EXPECTED = "a LeafSystem of pydrake, or what is called as torque = f(measurement, setpoint, time)"


def _is_system(found: Any) -> bool:
    """Whether something is a System of pydrake, or a class of them; what is one has imported pydrake."""
    framework = sys.modules.get("pydrake.systems.framework")
    if framework is None:
        return False
    return issubclass(found, framework.System) if isinstance(found, type) else isinstance(found, framework.System)


def user_code(section: Any) -> UserCode:
    """The guard around what may call a user's code, see `UserCode`: of a scenario or of a part of it."""
    return UserCode(*(part.code.own_module for part in user_parts(section)))
