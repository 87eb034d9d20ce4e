"""A user's class with four methods as a machine."""

from __future__ import annotations

import inspect
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

import numpy as np

from stewart_drake.base.code import CodePath, ControllerError, UserCode
from stewart_drake.base.config import Positive, check_value
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.machines import machine
from stewart_drake.machines.machine import MachineError, Reading, Takes
from stewart_drake.scenario.scenario import Scenario

METHODS = ("connect", "read", "command", "disconnect")
_OPTIONAL = ("pose", "arrived", "imu")  # Optional arrays (6,) of a reading.
_T = TypeVar("_T")
_Calls = queue.SimpleQueue[tuple[Future[Any], Callable[..., Any], tuple[object, ...]]]


class UserMachine:
    """An object of a user's class as a `Machine`; its attributes `period`, `takes`, `reads` and `paced` are optional.

    Its `read` returns six angles [rad], or `(angles, time)` with the time [s] by its clock, or a `Reading`, or None if
    there is no new reading. Its constructor may have parameters `scenario` and `robot`.
    """

    def __init__(self, scenario: Scenario, url: str, trust_code: bool = False) -> None:
        code, offered = CodePath.of(url, trust_code), {"scenario": scenario, "robot": scenario.controller_model.robot}
        kind = code.load("machine")
        with code.blamed("machine", "a class that can be constructed, of scenario and robot where it names them"):
            names = inspect.signature(kind).parameters
            self._object = kind(**{name: value for name, value in offered.items() if name in names})
        if missing := [name for name in METHODS if not callable(getattr(self._object, name, None))]:
            raise ConfigurationError("machine", code, f"a class with {', '.join(METHODS)}; {missing[0]} is missing")
        self.name, self._guard, self._limits = str(code), UserCode(code.user_module), machine.command_limits(scenario)
        self.takes: Takes = getattr(self._object, "takes", None) or scenario.controller_model.motors.command_quantity  # type: ignore[assignment]
        machine.check_takes(scenario, self.takes, self.name)
        self._last: Reading | None = None
        self._arrived, self.after = 0.0, "its disconnect was called"
        self._calls: _Calls = queue.SimpleQueue()
        threading.Thread(target=_serve, args=(self._calls,), daemon=True).start()
        self._read_attributes()

    def connect(self) -> None:
        """Connects, and reads once."""
        self._call(self._object.connect)
        self._read_attributes()
        self.read()

    def read(self) -> Reading:
        """The reading of the user's object, checked."""
        given, now = self._call(self._call_with_timeout, self._object.read), time.monotonic()
        if given is not None:
            reading, last = self._checked(given, now), self._last
            if last is not None and reading.time < last.time:
                raise MachineError(self.name, f"its clock goes back from {last.time:g} to {reading.time:g} s")
            # A reading with the time of the last one is that one again.
            if last is None or reading.time > last.time:
                if last is not None and reading.number <= last.number:
                    raise MachineError(self.name, f"a newer reading has number {reading.number} after {last.number}")
                self._last, self._arrived = reading, now
        if self._last is None:
            raise MachineError(self.name, "read gave no reading yet")
        if now - self._arrived > machine.LOST_AFTER:
            raise MachineError(self.name, f"read has given no new reading for {now - self._arrived:.1f} s")
        return self._last._replace(age=self._last.age + now - self._arrived)

    def command(self, values: np.ndarray) -> None:
        """Sends a copy of commands (6,)."""
        self._call(
            self._call_with_timeout, self._object.command, machine.within_limits(values, self._limits, self.name)
        )

    def disconnect(self) -> None:
        """Disconnects; an error of the user's object goes into `after`."""
        try:
            self._object.disconnect()
        except (Exception, SystemExit) as error:
            self.after = f"its disconnect raised {type(error).__name__}: {' '.join(str(error).split())}".removesuffix(
                ": "
            )

    def _read_attributes(self) -> None:
        self.period: float | None = getattr(self._object, "period", None)
        if self.period is not None:
            check_value(f"period of {self.name}", self.period, Positive, "s")
        self.reads, self.paced = (bool(getattr(self._object, *each)) for each in (("reads", True), ("paced", False)))

    def _call(self, method: Callable[..., _T], *arguments: object) -> _T:
        try:
            with self._guard:
                return method(*arguments)
        except (OSError, ControllerError) as error:
            raise MachineError(self.name, error) from error

    def _call_with_timeout(self, method: Callable[..., _T], *arguments: object) -> _T:
        """Result of a method that may hang; MachineError after `machine.LOST_AFTER`."""
        called: Future[_T] = Future()
        self._calls.put((called, method, arguments))
        try:
            return called.result(machine.LOST_AFTER)
        except TimeoutError:
            if called.done():
                raise
            raise MachineError(
                self.name, f"its {getattr(method, '__name__', method)} has not returned for {machine.LOST_AFTER:g} s"
            ) from None

    def _checked(self, given: Any, now: float) -> Reading:
        if not isinstance(given, Reading):
            angles, at = given if isinstance(given, tuple) and len(given) == 2 else (given, now)
            given = Reading(angles, at, 0.0, 1 if self._last is None else self._last.number + 1)
        try:
            more = {
                name: each if (each := getattr(given, name)) is None else np.array(each, dtype=float)
                for name in _OPTIONAL
            }
            numbers = {name: float(getattr(given, name)) for name in ("time", "age", "command_age")}
            reading = given._replace(
                angles=np.array(given.angles, dtype=float), number=int(given.number), **more, **numbers
            )
        except (TypeError, ValueError, OverflowError):
            raise MachineError(self.name, f"read gave {str(given)[:200]}, no reading of six angles") from None
        if reading.angles.shape != (6,) or not np.isfinite([*reading.angles, *numbers.values()]).all():
            raise MachineError(self.name, f"read gave {reading.angles}, no six finite angles [rad], or no finite time")
        if min(reading.age, reading.command_age) < 0.0:
            raise MachineError(self.name, f"read gave an age of {min(reading.age, reading.command_age):g} s")
        for name, each in more.items():
            # An inertial reading that is not new is NaN.
            bad = np.isinf if name == "imu" else lambda values: ~np.isfinite(values)
            if each is not None and (each.shape != (6,) or bad(each).any()):
                raise MachineError(self.name, f"read gave {name} {each}, no six finite numbers")
        return reading


def _serve(calls: _Calls) -> None:
    while True:
        called, method, arguments = calls.get()
        try:
            called.set_result(method(*arguments))
        except BaseException as error:
            called.set_exception(error)
