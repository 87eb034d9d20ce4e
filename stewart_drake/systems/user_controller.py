"""A user's own LeafSystem in the place of the controller."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import PortDataType

from stewart_drake.control.parts import ControllerSite
from stewart_drake.control.user_controller import PythonOptions
from stewart_drake.errors import ConfigurationError

_INPUTS = {"measurement": 12, "reference": 18}
_ANSWERS = {"error": 6, "integral": 6}


def load_user_controller(options: PythonOptions, site: ControllerSite) -> Any:
    """The System that `options` names, its ports checked.

    Args:
        options: Where it comes from.
        site: Robot and gravity, for constructors that want them; size that a port `weights` must have.

    Raises:
        ConfigurationError: It cannot be loaded or made, or a port is missing or of the wrong size.
    """
    system = options.construct({"robot": site.robot, "period": options.period, "gravity": site.gravity})
    inputs = {**_INPUTS, "weights": site.weights} if system.HasInputPort("weights") else _INPUTS
    has = [name for name in _ANSWERS if system.HasOutputPort(name)]
    outputs = {"torque": 6, **(_ANSWERS if has else {})}
    for name, size in inputs.items():
        found = system.GetInputPort(name) if system.HasInputPort(name) else None
        _check(options, "input", name, size, found)
    for name, size in outputs.items():
        found = system.GetOutputPort(name) if system.HasOutputPort(name) else None
        _check(options, "output", name, size, found)
    return system


def _check(options: PythonOptions, side: str, name: str, size: int, port: Any) -> None:
    wanted = f"a LeafSystem with the {side} port {name} ({size},)"
    if port is None:
        raise ConfigurationError("controller.system", options.system, f"{wanted}; it has no such port")
    if port.get_data_type() != PortDataType.kVectorValued:
        raise ConfigurationError("controller.system", options.system, f"{wanted}; its own is abstract")
    if port.size() != size:
        raise ConfigurationError("controller.system", options.system, f"{wanted}; its own is ({port.size()},)")
