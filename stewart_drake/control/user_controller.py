"""A user's controller: a plain function, or a System of pydrake, by import path or as an object."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import Field

from stewart_drake.base.code import ControllerError, UserCode
from stewart_drake.base.config import Period
from stewart_drake.base.errors import ConfigurationError, NotFiniteError, RunFailure, drake_guard, one_line, raised_at
from stewart_drake.base.families import UserMade, user_parts
from stewart_drake.base.records import Vec1, Vec12, Vec18
from stewart_drake.control.base import ControllerOptions, ControllerState, Measurement, Setpoint
from stewart_drake.loop.part import LoopContext, Part

_EXPECTED = "a LeafSystem of pydrake, or what is called as torque = f(measurement, setpoint, time)"
ControlFunction = Callable[[Measurement, Setpoint, float], object]
"""From a measurement, a setpoint and the time [s] to six torques [N m]."""


class PythonOptions(UserMade, ControllerOptions):  # type: ignore[misc]
    """Your own controller, by its import path.

    A function `torque = f(measurement, setpoint, time)`, or a class of such callables, runs with every plant:
    measurement has pose [rad, m] and pose_rate, setpoint pose, pose_rate and pose_acceleration, all (6,); time is in
    seconds, torque (6,) [N m]. A System of pydrake runs with `plant.kind: drake`.

    A System must have the ports of `LqiController`: inputs measurement (12,) and reference (18,), output torque (6,).
    It may have the input weights, (2,) or (4,) as the tuner gives, and the output integral (6,), which is logged.

    A continuous state is integrated by a third-order Runge-Kutta method in tenths of the plant's time step; time
    constants below a 25th of that step diverge.
    """

    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values. `robot` (the controller's model of it), `period` and
    `gravity` are added where the constructor names them."""
    period: Period = 0.001
    """[s] control period, for log, delay and tuner; the controller should tick with it."""

    @property
    def label(self) -> str:
        return f"controller {self.kind.name}"

    def load(self) -> Any:
        """The class, function or object; a ConfigurationError if it is neither a System of pydrake nor callable."""
        loaded = self.code.load(self.code_key)
        called = "__call__" in dir(loaded) if isinstance(loaded, type) else callable(loaded)
        if not (_is_system(loaded) or called):
            raise ConfigurationError(self.code_key, self.code, _EXPECTED)
        return loaded

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        """A part with the user's LeafSystem, or one that calls the function at every tick."""
        controller = self.load()
        if isinstance(controller, type):
            controller = self.new_object({"robot": context.robot, "period": self.period, "gravity": context.gravity})
        if _is_system(controller):
            return (self._system_part(controller, len(context.tuner.weights)),)
        return (function_part(controller),)

    def _system_part(self, system: Any, weights: int) -> Part:
        """A System of pydrake as a part of a loop, its ports checked."""
        from pydrake.systems.framework import PortDataType

        inputs = {"measurement": 12, "reference": 18} | ({"weights": weights} if system.HasInputPort("weights") else {})
        outputs = {"torque": 6} | ({"integral": 6} if system.HasOutputPort("integral") else {})
        for side, ports in (("Input", inputs), ("Output", outputs)):
            for name, size in ports.items():
                port = getattr(system, f"Get{side}Port")(name) if getattr(system, f"Has{side}Port")(name) else None
                if port is None or port.get_data_type() != PortDataType.kVectorValued or port.size() != size:
                    expected = f"a LeafSystem with the {side.lower()} port {name} ({size},)"
                    raise ConfigurationError(self.code_key, self.code, expected)
        return Part("controller", _nothing, {}, inputs, tuple(outputs), ControllerState.new(), system=system)


def _nothing(*_: object) -> None:
    """Kernel of a part with a LeafSystem."""


def _is_system(loaded: object) -> bool:
    """Whether an object is a System of pydrake or a class of them; then pydrake has been imported."""
    framework = sys.modules.get("pydrake.systems.framework")
    if framework is None:
        return False
    return issubclass(loaded, framework.System) if isinstance(loaded, type) else isinstance(loaded, framework.System)


def user_code(section: object) -> UserCode:
    """Context manager around calls of the user's code in a scenario or a section of it, see `UserCode`."""
    return UserCode(*(part.code.user_module for part in user_parts(section)))


def failure_of(error: BaseException, section: object) -> RunFailure:
    """The RunFailure for any exception that was raised in a loop of a section."""
    try:
        with drake_guard("a step"), user_code(section):
            raise error
    except RunFailure as failure:
        return failure
    except (Exception, SystemExit) as other:
        unexpected = RunFailure(f"{one_line(other)}{raised_at(other)}")
        unexpected.__cause__ = other
        return unexpected


def function_part(function: ControlFunction) -> Part:
    """`torque = function(measurement, setpoint, time)` as a part of a loop.

    A callable object with a state serves one run only. A tick raises ControllerError if the function raises or returns
    something else, NotFiniteError if a torque is not finite.
    """
    guard = UserCode(getattr(function, "__module__", None) or type(function).__module__)
    constants, inputs = {"function": function, "guard": guard}, {"measurement": 12, "reference": 18, "time": 1}
    return Part("controller", _call, constants, inputs, ("torque",), ControllerState.new())


def _call(
    function: ControlFunction,
    guard: UserCode,
    measurement: Vec12,
    reference: Vec18,
    time: Vec1,
    state: ControllerState,
) -> None:
    # Copies, which the function may keep or change.
    pose, target = measurement.copy(), reference.copy()
    with guard:
        result = function(
            Measurement(pose[:6], pose[6:]), Setpoint(target[:6], target[6:12], target[12:]), float(time[0])
        )
    name = getattr(function, "__qualname__", type(function).__qualname__)
    try:
        torque = np.asarray(result, dtype=float)
    except (TypeError, ValueError):
        torque = np.empty(())
    if torque.shape != (6,):
        what = f"an array of shape {torque.shape}" if torque.ndim else repr(result)
        raise ControllerError(f"{name} returned {what}; expected six torques [N m]")
    if not np.isfinite(torque).all():
        raise NotFiniteError(f"torque of {name}", torque)
    state["torque"][0] = torque
