"""The type of which a loop is made, a part: a kernel with parameters, inputs, outputs and a state; what runs parts.

A run is an ordered list of parts. Drake's Diagram connects them by name, each in a LeafSystem; `LoopRunner` calls them
in order on one vector of all signals and states, for the fast engine and for `Controller`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RunFailure, Status, failure, failure_code
from stewart_drake.base.jit import specialised
from stewart_drake.base.records import Record
from stewart_drake.base.sampling import steps_per
from stewart_drake.robot import RobotParameters

NOTHING: Mapping[str, Any] = MappingProxyType({})
HEALTHY = (0.0, -1.0)
"""The health of a part whose last tick did not fail: no cause, no leg."""
_HEALTHY = np.array(HEALTHY)


class Part(NamedTuple):
    """A part of the loop.

    Its kernel is called as `kernel(*parameters, *constants, *inputs, *scratch, state)`, and changes the state in place.
    It returns nothing, or status, leg or -1, and margin; the status is 0 where all is well, and of another `statuses`
    gives the error that is raised. The state is then worthless. A kernel of our own is compiled; a user's may be plain
    Python, and may raise RunFailure.

    An input is the last signal of its name: of the same instant by a part before it in the list, or of the tick before
    by a part after it, or by one that runs at the end of a tick.

    Attributes:
        name: In the Diagram and in messages.
        kernel: See above.
        constants: Name -> what does not change; for a kernel in Python anything.
        inputs: Port -> size; the kernel gets arrays (size,). The port `time` (1,) [s] is given by who runs the part.
        outputs: Fields of its state that are signals; they come first in the state, in this order.
        initial: State before the first tick: a record (1,) of float64 fields, see `jit.fields`.
        scratch: Records that the kernel overwrites.
        statuses: Status other than 0 -> what it means. The arguments have the names of parameters, constants and
            inputs, and `state`.
        error: In the place of `statuses`: result and arguments -> the error.
        connections: Port or parameter -> name of the signal, where that is not the port's own; or an array that stays,
            for a port that this loop has no signal for.
        output_names: Output -> name of the signal, where that is not its own.
        period: [s] between two ticks; None for that of the controller.
        end_of_tick: Whether it runs once all others have, so that its outputs act from the next tick on.
        fault_tolerant: Whether a tick that fails does not end the run: its last state is repeated, and its output
            `health` (2,) has the cause as `errors.FAILURES` counts it, 0 for none, and the leg or -1.
        system: A user's own LeafSystem in the place of kernel and state; it runs in a Diagram alone.
        parameters: Name -> numbers with which the part begins, a record (1,) or an array of float64. A Context may
            change them, and a signal of as many numbers may take the place of one, see `connections`.
    """

    name: str
    kernel: Callable[..., Any]
    constants: Mapping[str, Any]
    inputs: Mapping[str, int]
    outputs: tuple[str, ...]
    initial: np.ndarray
    scratch: tuple[type[Record], ...] = ()
    statuses: Mapping[int, Status] = MappingProxyType({})
    error: Callable[[Any, Mapping[str, Any]], RunFailure] | None = None
    connections: Mapping[str, str | np.ndarray] = NOTHING
    output_names: Mapping[str, str] = NOTHING
    period: float | None = None
    end_of_tick: bool = False
    fault_tolerant: bool = False
    system: Any = None
    parameters: Mapping[str, np.ndarray] = NOTHING

    @property
    def leading(self) -> dict[str, Any]:
        """Parameters and constants, which the kernel gets first, in their order."""
        return {**self.parameters, **self.constants}

    def source(self, port: str) -> str | np.ndarray:
        """Name of the signal at an input port, or the array that stands there."""
        return self.connections.get(port, port)

    def signal(self, output: str) -> str:
        """Name of the signal that an output is."""
        return self.output_names.get(output, output)

    @property
    def replaced(self) -> tuple[str, ...]:
        """Parameters whose place a signal takes."""
        return tuple(name for name in self.parameters if name in self.connections)

    def check_signal(self, name: str, kind: np.dtype) -> None:
        """Refuses a signal of that kind in the place of a parameter that it does not fit."""
        wanted = self.parameters[name]
        fits = kind == wanted.dtype if kind.names else kind.base == np.float64
        if not fits or kind.itemsize != wanted.nbytes:
            given = f"a record of {', '.join(kind.names)}" if kind.names else f"{math.prod(kind.shape)} of {kind.base}"
            allowed = f"a signal of {wanted.nbytes // 8} numbers of float64"
            raise ConfigurationError(f"{self.name}.{name}", given, allowed)

    def size(self, field: str) -> int:
        """Numbers in a field of its state."""
        return self.initial.dtype[field].itemsize // 8

    def tick(self, *inputs: Any) -> None:
        """A tick by hand: the inputs in their order and then the state, which is changed in place."""
        BoundPart(self, inputs[:-1], inputs[-1])()

    def connected(self, **sources: str | np.ndarray) -> Part:
        """The part with these signals, or arrays, at those of its ports and parameters that have such a name."""
        known = {port: source for port, source in sources.items() if port in self.inputs or port in self.parameters}
        return self._replace(connections={**self.connections, **known})

    def named(self, **signals: str) -> Part:
        """The part with other names of its outputs."""
        return self._replace(output_names={**self.output_names, **signals})


class LoopContext(NamedTuple):
    """What the parts of a scenario's kinds are made for: robot, clock and neighbours.

    The sections of estimators, controllers, tuners and adaptive laws have a method `parts(context)`.
    """

    robot: RobotParameters  # As the controller believes it to be.
    gravity: float  # [m/s^2].
    period: float  # [s] of the ticks.
    pose: np.ndarray  # (6,) [rad, m] at the start.
    pose_rate: np.ndarray  # (6,) [rad/s, m/s] likewise.
    initial_torque: np.ndarray  # (6,) [N m] at the motors until the first command arrives.
    delay: int  # [ticks] of the commands.
    reading_age: float  # [s] of a reading when the controller gets it, as believed.
    latency: float  # [s] from what is read to its torque, as believed.
    reading: int  # Numbers in a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
    noise: float  # [rad] of a reading, as an observer believes it.
    friction: Any  # Options of the friction of the motors, as believed; zeros for none.
    motors: Any  # Options of the motors, as believed.
    tuner: Any  # Options of the tuner, with its file read.
    disturbance: float  # [rad/s^2 per sqrt(s)] that an observer expects; 0 without one.
    feedback: bool  # Whether the controller uses what is measured.
    split: bool  # Whether an LQI takes the compiled split solution whatever its options say.

    def ticking(self, period: float | None) -> LoopContext:
        """The same for a part of another period [s], with the delay in its ticks; None for the controller's."""
        if period is None:
            return self
        return self._replace(period=period, delay=round(self.delay * self.period / period))


class BoundPart:
    """A part with its arguments: a call of it is a tick.

    Args:
        part: The part.
        inputs: Its inputs, in their order.
        state: Its state.
        signals: Signals in the place of parameters, by their names.
    """

    def __init__(
        self, part: Part, inputs: Sequence[Any], state: np.ndarray, signals: Mapping[str, np.ndarray] = NOTHING
    ) -> None:
        self.part = part
        self._scratch = tuple(np.zeros(1, getattr(kind, "layout", kind)) for kind in part.scratch)
        self._before = np.empty(part.initial.nbytes // 8)
        for name, array in signals.items():
            part.check_signal(name, np.dtype((array.dtype, array.shape)))
        # Copies: a kernel is compiled for arrays that may be written, as a signal or a Context's numbers are.
        numbers = [signals.get(name, value.copy()).view(value.dtype) for name, value in part.parameters.items()]
        self._constants = tuple(part.constants.values())
        self.bind(numbers, inputs, state)

    def bind(self, parameters: Sequence[np.ndarray], inputs: Sequence[Any], state: np.ndarray) -> None:
        """Other arrays in the place of those that were given."""
        self._kernel: Callable[..., Any] = self.part.kernel
        self.state = state
        if self.part.fault_tolerant:
            # Plain arrays: numpy copies records field by field.
            self._numbers, self._health = state.view(np.float64), state["health"][0]
        self.arguments = (*parameters, *self._constants, *inputs, *self._scratch, state)

    def __call__(self) -> None:
        """A tick; raises the named error of a part that is not fault tolerant."""
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

    def _error(self, result: Any) -> RunFailure:
        named = dict(zip((*self.part.leading, *self.part.inputs), self.arguments, strict=False))
        named["state"] = self.state
        if self.part.error is not None:
            return self.part.error(result, named)
        return failure(self.part.statuses[result[0]], result[1], result[2], named)

    def fixed(self) -> Callable[[], Any]:
        """The same tick with the arguments that are bound now and no others, by the shortest way."""
        self._kernel = specialised(self.part.kernel, self.arguments)
        plain = self.part.error is None and not self.part.statuses and not self.part.fault_tolerant
        return partial(self._kernel, *self.arguments) if plain else self


class LoopRunner:
    """Parts with their states, side by side in one vector, called in order outside of a Diagram.

    Laws of this package are compiled here, not in the first tick.

    Args:
        parts: In order.
        outside: Signals that come from elsewhere -> size; whoever has this object writes them.
        inside: Signals that are parts of those -> where in `values` they are.
        period: [s] of the parts that name none.
        step: [s] between two calls of `run`; None for `period`.

    Attributes:
        values: (n,) all signals and states. A copy of it is a snapshot of the whole loop.
        places: Name of a signal -> where in `values` it is.
        time: (1,) [s] of the step; to be written before it.
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
        bound = (BoundPart(each, *self._sources(each, state)) for each, state in zip(parts, self._states, strict=True))
        calls = [each.fixed() for each in bound]
        steps = [steps_per(f"{part.name}.period", part.period or period, step or period) for part in parts]
        self._cycle = math.lcm(*steps)
        self._rows = list(zip(self._parts, calls, steps, strict=True))
        self._due: dict[tuple[int, bool], list[Callable[[], Any]]] = {}
        self.reset()

    def _sources(self, part: Part, state: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, dict[str, np.ndarray]]:
        inputs = [self.time if port == "time" else self._array(part.source(port)) for port in part.inputs]
        for (port, size), array in zip(part.inputs.items(), inputs, strict=True):
            if array.size != size:
                raise ConfigurationError(f"{part.name}.{port}", f"{array.size} numbers", f"a signal of {size} numbers")
        return inputs, state, {name: self._array(part.source(name)) for name in part.replaced}

    def _array(self, source: str | np.ndarray) -> np.ndarray:
        return self.values[self.places[source]] if isinstance(source, str) else source

    def reset(self) -> None:
        """All states as before the first tick."""
        for part, state in zip(self._parts, self._states, strict=True):
            state[:] = part.initial

    def take_over(self, other: LoopRunner) -> None:
        """Goes on where another one is: each signal from outside, and each part, that both have is as it is there."""
        for name in self._outside & other._outside:
            self.signal(name)[:] = other.signal(name)
        states = {part.name: state for part, state in zip(other._parts, other._states, strict=True)}
        for part, state in zip(self._parts, self._states, strict=True):
            if part.name in states and states[part.name].dtype == state.dtype:
                state[:] = states[part.name]

    def signal(self, name: str) -> np.ndarray:
        """A signal as it is now; a view."""
        return self.values[self.places[name]]

    def state(self, name: str) -> np.ndarray:
        """The record (1,) of a part, by its name; a view."""
        return next(state for part, state in zip(self._parts, self._states, strict=True) if part.name == name)

    def run(self, step: int = 0) -> None:
        """The parts that are due at a step, but those of the end of a tick; a RunFailure of a part gets the time."""
        self._run(step, False)

    def end(self, step: int = 0) -> None:
        """The parts that are due at the end of a step: what acts from the next one on."""
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
