"""Parts of a loop: a kernel with parameters, inputs, outputs and a state; and what runs them.

A run is an ordered list of parts. Drake's Diagram connects them by name, one LeafSystem per part; `LoopRunner` calls
them in order on one vector of all signals and states, for the fast engine and for `Controller`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RunFailure, Status, failure, failure_code
from stewart_drake.base.jit import specialised
from stewart_drake.base.keys import join_or
from stewart_drake.base.records import Record, TickResult
from stewart_drake.base.sampling import steps_per
from stewart_drake.robot import Gravity, RobotParameters

if TYPE_CHECKING:
    from stewart_drake.control.friction_compensation import FrictionCompensation
    from stewart_drake.control.tuners import Tuner
    from stewart_drake.hardware.imu import ImuOptions
    from stewart_drake.hardware.motors import MotorOptions
    from stewart_drake.mechanics.ball import KnownBall

_Signal = TypeVar("_Signal")
Kernel = Callable[..., TickResult | None]
NOTHING: Mapping[str, Any] = MappingProxyType({})
HEALTHY = (0.0, -1.0)
"""Health of a part after a good tick: no cause, no leg."""
_HEALTHY = np.array(HEALTHY)


class Part(NamedTuple):
    """A part of a loop.

    Its kernel is called as `kernel(*parameters, *constants, *inputs, *scratch, state)`, and changes the state in place.
    It returns nothing, or status, leg or -1, and margin. Status 0 is success; for another one the error of `statuses`
    is raised, and the state is undefined. Kernels of this package are compiled; a user's may be plain Python, and may
    raise RunFailure.

    An input is the latest value of its signal: from the same tick if the part that gives it comes earlier in the list,
    from the tick before if it comes later or runs at the end of a tick.

    A Context may change parameters, and a signal of the same size may replace one. After a failed tick a fault tolerant
    part repeats its last state, and its output `health` (2,) has the cause as `errors.FAILURES` counts it, 0 for none,
    and the leg or -1.
    """

    name: str  # In the Diagram and in messages.
    kernel: Kernel
    constants: Mapping[str, object]  # Name -> value; any object for a kernel in plain Python.
    inputs: Mapping[str, int]  # Port -> size; the kernel gets arrays. The port `time` (1,) [s] is always available.
    outputs: tuple[str, ...]  # Fields of the state that are signals.
    initial: Record  # State before the first tick.
    scratch: tuple[type[Record], ...] = ()  # Records that the kernel overwrites.
    # Status other than 0 -> its error, which may refer to parameters, constants, inputs and `state`.
    statuses: Mapping[int, Status] = MappingProxyType({})
    # Replaces `statuses`: from result and arguments to the error.
    error: Callable[[TickResult, Mapping[str, np.ndarray]], RunFailure] | None = None
    # Port or parameter -> name of its signal, by default the same; or a constant array, for a port without a signal.
    connections: Mapping[str, str | np.ndarray] = NOTHING
    output_names: Mapping[str, str] = NOTHING  # Output -> name of its signal, by default the same.
    period: float | None = None  # [s] between two ticks; None for the controller's.
    end_of_tick: bool = False  # Whether it runs after all others; its outputs then act from the next tick on.
    fault_tolerant: bool = False
    system: Any = None  # A user's LeafSystem, which replaces kernel and state; for a Diagram only.
    parameters: Mapping[str, np.ndarray] = NOTHING  # Name -> initial numbers, a record or an array of float64.

    @property
    def leading(self) -> dict[str, object]:
        """Parameters and constants, the first arguments of the kernel, in order."""
        return {**self.parameters, **self.constants}

    def source(self, port: str) -> str | np.ndarray:
        """Name of the signal at an input port, or a constant array."""
        return self.connections.get(port, port)

    def signal_in(self, signals: Mapping[str, _Signal], port: str) -> _Signal:
        """The signal at an input port; raises a ConfigurationError if the loop has none of its name."""
        if (name := str(self.source(port))) not in signals:
            known = sorted(signal for signal in signals if "." not in signal)
            raise ConfigurationError(f"{self.name}.{port}", name, f"a signal of the loop: {join_or(known)}")
        return signals[name]

    def signal(self, output: str) -> str:
        """Name of the signal of an output."""
        return self.output_names.get(output, output)

    @property
    def replaced(self) -> tuple[str, ...]:
        """Parameters that a signal replaces."""
        return tuple(name for name in self.parameters if name in self.connections)

    def check_signal(self, name: str, kind: np.dtype) -> None:
        """Raises a ConfigurationError if a signal of that dtype does not fit a parameter."""
        expected = self.parameters[name]
        fits = kind == expected.dtype if kind.names else kind.base == np.float64
        if not fits or kind.itemsize != expected.nbytes:
            given = f"a record of {', '.join(kind.names)}" if kind.names else f"{math.prod(kind.shape)} of {kind.base}"
            allowed = f"a signal of {expected.nbytes // 8} numbers of float64"
            raise ConfigurationError(f"{self.name}.{name}", given, allowed)

    def size(self, field: str) -> int:
        """Size of a field of the state."""
        return self.initial.dtype[field].itemsize // 8

    def tick(self, *inputs: np.ndarray) -> None:
        """Runs one tick on the inputs, in order, and the state, the last argument, which is changed in place."""
        BoundPart(self, inputs[:-1], inputs[-1])()

    def connected(self, **sources: str | np.ndarray) -> Part:
        """The part with these signals or arrays at its ports and parameters of these names; others are ignored."""
        known = {port: source for port, source in sources.items() if port in self.inputs or port in self.parameters}
        return self._replace(connections={**self.connections, **known})

    def named(self, **signals: str) -> Part:
        """The part with other names for the signals of its outputs."""
        return self._replace(output_names={**self.output_names, **signals})


class LoopContext(NamedTuple):
    """The rest of the loop, for the method `parts(context)` of estimators, controllers, tuners and adaptive laws."""

    robot: RobotParameters  # The controller's model.
    gravity: Gravity  # [m/s^2].
    period: float  # [s] of the ticks.
    pose: np.ndarray  # (6,) [rad, m] at the start.
    pose_rate: np.ndarray  # (6,) [rad/s, m/s] likewise.
    initial_torque: np.ndarray  # (6,) [N m] at the motors until the first command arrives.
    delay: int  # [ticks] of the commands.
    reading_age: float  # [s] of a reading when the controller gets it, in the model.
    latency: float  # [s] from a measurement to its torque, in the model.
    reading: int  # Size of a reading: 6 crank angles [rad], or 12 of pose [rad, m] and its rate.
    noise: float  # [rad] of a reading, for an observer.
    friction: FrictionCompensation  # Model of the motors' friction; zeros for none.
    motors: MotorOptions  # Model of the motors.
    tuner: Tuner  # With its file read.
    disturbance: float  # [rad/s^2 per sqrt(s)] expected by an observer; 0 without one.
    feedback: bool  # Whether the controller uses the measurement.
    split: bool  # Whether an LQI uses the compiled split solution for any `solver`.
    imu: ImuOptions | None = None  # Model of the inertial sensor on the platform, None for none.
    ball: KnownBall | None = None  # Model of the ball on the platform, None for none.

    def ticking(self, period: float | None) -> LoopContext:
        """The context of a part of another period [s], with the delay in its ticks; None for the controller's."""
        if period is None:
            return self
        return self._replace(period=period, delay=round(self.delay * self.period / period))


class BoundPart:
    """A part bound to the arrays of its inputs and its state; a call runs a tick.

    `signals` replace parameters of their names.
    """

    def __init__(
        self,
        part: Part,
        inputs: Sequence[np.ndarray | None],
        state: np.ndarray,
        signals: Mapping[str, np.ndarray] = NOTHING,
    ) -> None:
        self.part = part
        self._scratch = tuple(kind.new() for kind in part.scratch)
        self._before = np.empty(part.initial.nbytes // 8)
        for name, array in signals.items():
            part.check_signal(name, np.dtype((array.dtype, array.shape)))
        # Copies, because kernels are compiled for writable arrays.
        numbers = [signals.get(name, value.copy()).view(value.dtype) for name, value in part.parameters.items()]
        self._constants = tuple(part.constants.values())
        self.bind(numbers, inputs, state)

    def bind(self, parameters: Sequence[np.ndarray], inputs: Sequence[np.ndarray | None], state: np.ndarray) -> None:
        """Replaces the arrays."""
        self._kernel: Kernel = self.part.kernel
        self.state = state
        if self.part.fault_tolerant:
            # Plain arrays, because numpy copies records field by field.
            self._numbers, self._health = state.view(np.float64), state["health"][0]
        self.arguments = (*parameters, *self._constants, *inputs, *self._scratch, state)

    def __call__(self) -> None:
        """Runs a tick; raises its error if the part is not fault tolerant."""
        if not self.part.fault_tolerant:
            result = self._kernel(*self.arguments)
            if result is not None and result[0] != 0:
                raise self._error(result)
            return
        self._before[:] = self._numbers
        try:
            result = self._kernel(*self.arguments)
            if result is not None and result[0] != 0:
                raise self._error(result)
            self._health[:] = _HEALTHY
        except RunFailure as error:
            self._numbers[:] = self._before
            self._health[:] = failure_code(error.reason), -1.0 if error.leg is None else error.leg

    def _error(self, result: TickResult) -> RunFailure:
        named: dict[str, Any] = dict(zip((*self.part.leading, *self.part.inputs), self.arguments, strict=False))
        named["state"] = self.state
        if self.part.error is not None:
            return self.part.error(result, named)
        return failure(self.part.statuses[result[0]], result[1], result[2], named)

    def fixed(self) -> Callable[[], object]:
        """The same tick, faster, for the arrays that are bound now."""
        self._kernel = specialised(self.part.kernel, self.arguments)
        plain = self.part.error is None and not self.part.statuses and not self.part.fault_tolerant
        return partial(self._kernel, *self.arguments) if plain else self


class LoopRunner:
    """Runs parts in order without a Diagram, with all signals and states in one vector.

    Kernels are compiled here, not in the first tick.

    Args:
        parts: In order.
        outside: Signals from outside -> size; the caller writes them.
        inside: Signals that are slices of these -> their slice of `values`.
        period: [s] of parts without a period.
        step: [s] between two calls of `run`; None for `period`.

    Attributes:
        values: (n,) all signals and states; a copy is a snapshot of the loop.
        places: Name of a signal -> its slice of `values`.
        time: (1,) [s] of the step; the caller writes it before `run`.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        outside: Mapping[str, int],
        inside: Mapping[str, slice] | None = None,
        period: float = 1.0,
        step: float | None = None,
    ) -> None:
        self._parts = tuple(parts)
        sizes = [*outside.values(), *(part.initial.dtype.itemsize // 8 for part in parts)]
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self.values, self.time = np.zeros(starts[-1]), np.zeros(1)
        self.places = {name: slice(starts[k], starts[k] + size) for k, (name, size) in enumerate(outside.items())}
        self.places |= inside or {}
        self._states: list[np.ndarray] = []
        self._outside = set(outside)
        for part, start, size in zip(parts, starts[len(outside) :], sizes[len(outside) :], strict=False):
            self._states.append(self.values[start : start + size].view(part.initial.dtype))
            for output in part.outputs:
                at = start + part.initial.dtype.fields[output][1] // 8  # type: ignore[index]
                self.places[part.signal(output)] = slice(at, at + part.size(output))
        bound = (BoundPart(part, *self._sources(part, state)) for part, state in zip(parts, self._states, strict=True))
        calls = [tick.fixed() for tick in bound]
        steps = [steps_per(f"{part.name}.period", part.period or period, step or period) for part in parts]
        self._cycle = math.lcm(*steps)
        self._rows = list(zip(self._parts, calls, steps, strict=True))
        self._due: dict[tuple[int, bool], list[Callable[[], object]]] = {}
        self.reset()

    def _sources(self, part: Part, state: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, dict[str, np.ndarray]]:
        inputs = [self.time if port == "time" else self._array(part, port) for port in part.inputs]
        for (port, size), array in zip(part.inputs.items(), inputs, strict=True):
            if array.size != size:
                raise ConfigurationError(f"{part.name}.{port}", f"{array.size} numbers", f"a signal of {size} numbers")
        return inputs, state, {name: self._array(part, name) for name in part.replaced}

    def _array(self, part: Part, port: str) -> np.ndarray:
        source = part.source(port)
        return self.values[part.signal_in(self.places, port)] if isinstance(source, str) else source

    def reset(self) -> None:
        """Sets all states to those before the first tick."""
        for part, state in zip(self._parts, self._states, strict=True):
            state[:] = part.initial

    def take_over(self, other: LoopRunner) -> None:
        """Continues from another runner: copies outside signals and states of parts that both have in one size."""
        for name in self._outside & other._outside:
            if self.signal(name).size == other.signal(name).size:
                self.signal(name)[:] = other.signal(name)
        states = {part.name: state for part, state in zip(other._parts, other._states, strict=True)}
        for part, state in zip(self._parts, self._states, strict=True):
            if part.name in states and states[part.name].dtype == state.dtype:
                state[:] = states[part.name]

    def signal(self, name: str) -> np.ndarray:
        """Present value of a signal; a view."""
        return self.values[self.places[name]]

    def state(self, name: str) -> np.ndarray:
        """State of a part, by its name; a view."""
        return next(state for part, state in zip(self._parts, self._states, strict=True) if part.name == name)

    def run(self, step: int = 0) -> None:
        """Runs the parts due at a step, without those of the end of a tick; adds the time to a RunFailure."""
        self._run(step, False)

    def end(self, step: int = 0) -> None:
        """Runs the parts due at the end of a step, whose outputs act from the next one on."""
        self._run(step, True)

    def _run(self, step: int, end: bool) -> None:
        key = step % self._cycle, end
        calls = self._due.get(key)
        if calls is None:
            calls = [call for part, call, every in self._rows if part.end_of_tick == end and step % every == 0]
            self._due[key] = calls
        try:
            for call in calls:
                call()
        except RunFailure as error:
            error.time = float(self.time[0])
            raise
