"""A user's plain function in the place of the controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.errors import NotFiniteError
from stewart_drake.files.user_errors import ControllerError, UserCode
from stewart_drake.jit import fields, new_record
from stewart_drake.part import Part

FUNCTION_STATE = fields(torque=6, error=6, integral=6, health=2)
Function = Callable[[Measurement, Setpoint, float], Any]


def function_part(function: Function) -> Part:
    """`torque = function(measurement, setpoint, time)` as a part of a loop.

    Args:
        function: Of a `Measurement`, a `Setpoint` and the time [s]; returns six torques [N m]. An object that is called
            likewise may remember what it likes: then each run needs one of its own.

    Returns:
        Its tick raises ControllerError where the function raises or returns something else, NotFiniteError where a
        torque is not finite. Its outputs `error` and `integral` are pose minus setpoint and zeros.
    """
    module = getattr(function, "__module__", None) or type(function).__module__
    name = getattr(function, "__qualname__", type(function).__qualname__)
    guard = UserCode(module)

    def tick(measurement: np.ndarray, reference: np.ndarray, time: np.ndarray, state: np.ndarray) -> None:
        # Copies: what it keeps or changes is its own.
        pose, wanted = measurement.copy(), reference.copy()
        with guard:
            answer = function(
                Measurement(pose[:6], pose[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:]), float(time[0])
            )
        try:
            torque = np.asarray(answer, dtype=float)
        except (TypeError, ValueError):
            raise ControllerError(f"{name} returned {answer!r}; expected six torques [N m]") from None
        if torque.shape != (6,):
            what = f"an array of shape {torque.shape}" if torque.ndim else repr(answer)
            raise ControllerError(f"{name} returned {what}; expected six torques [N m]")
        if not np.isfinite(torque).all():
            raise NotFiniteError(f"torque of {name}", torque)
        state["torque"][0] = torque
        state["error"][0] = measurement[:6] - reference[:6]

    inputs = {"measurement": 12, "reference": 18, "time": 1}
    return Part("controller", inputs, ("torque", "error", "integral"), new_record(FUNCTION_STATE), tick)
