"""A controller of the user's own: where its class comes from."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from stewart_drake.control.controller_options import ControllerOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import UserMade, user_parts
from stewart_drake.files.code_path import UserCodePath
from stewart_drake.files.user_errors import UserCode
from stewart_drake.section import Positive


class PythonOptions(UserMade, ControllerOptions):
    """A user's LeafSystem by import path; `kind` may be that path itself.

    Ports that it must have: inputs measurement (12,) and reference (18,), output torque (6,), as in `LqiController`.
    Ports that it may have: input weights, (2,) or (4,) as the tuner gives; outputs error (6,) and integral (6,), both
    or none.

    Its continuous state, if any, is integrated by Runge and Kutta's method of third order in tenths of the plant's time
    step; time constants below a 25th of that step diverge.
    """

    path_key: ClassVar[str] = "system"
    kind: Literal["python"] = "python"  # type: ignore[assignment]
    system: UserCodePath
    """path/to/file.py:Class, from the folder of the file that names it, or module:Class. The class is a System of
    pydrake, and its code is run."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values. `robot` (as the controller believes it), `period` and
    `gravity` are added where the constructor names them."""
    period: Positive = 0.001
    """[s] period of the log, of a delay and of the tuner; the controller should tick with it."""

    def load(self) -> Any:
        """See `UserMade.load`; it must be a System of pydrake."""
        from pydrake.systems.framework import System

        found = super().load()
        if not issubclass(found, System):
            raise ConfigurationError(self.code_key, self.code, "a LeafSystem of pydrake")
        return found


def user_code(section: Any) -> UserCode:
    """The guard around what may call a user's code, see `UserCode`: of a scenario or of a part of it."""
    return UserCode(*(part.code.own_module for part in user_parts(section)))
