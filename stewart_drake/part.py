"""The type of which a run is made: a part of the loop, with named inputs and outputs, a state, and a law.

A run is an ordered list of parts. Drake's Diagram connects them by name, each in a LeafSystem; the fast engine calls
them in order, each on the fields of the others' states; `Controller` does so without a plant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.errors import RunFailure, failure_code
from stewart_drake.robot import RobotParameters

NOTHING: Mapping[str, Any] = MappingProxyType({})
WELL = (0.0, -1.0)
"""The health of a part whose last tick did not fail: no cause, no leg."""


class Part(NamedTuple):
    """A part of the loop.

    An input is the last signal of its name: of the same instant by a part before it in the list, or of the tick before
    by a part after it, or by a late one.

    Attributes:
        name: In the Diagram and in messages.
        inputs: Port -> size. The port `time` (1,) [s] is given by who runs the part.
        outputs: Fields of its state that are signals; they come first in the state, in this order.
        initial: State before the first tick: a record (1,) of float64 fields, see `jit.fields`.
        tick: Takes the inputs, arrays (size,), in their order, and then the state, which it changes in place. Raises
            RunFailure; the state is then worthless.
        reads: Port -> name of the signal, where that is not the port's own; or an array that stays, for a port that
            this loop has no signal for.
        says: Output -> name of the signal, where that is not its own.
        every_step: Whether it ticks at every step of the plant, not only at the ticks of the controller.
        late: Whether it ticks once all others have, so that what it says acts from the next tick on.
        system: A user's own LeafSystem in the place of state and tick; it runs in a Diagram alone.
    """

    name: str
    inputs: Mapping[str, int]
    outputs: tuple[str, ...]
    initial: np.ndarray = np.zeros(1)
    tick: Callable[..., None] = lambda *_: None
    reads: Mapping[str, str | np.ndarray] = NOTHING
    says: Mapping[str, str] = NOTHING
    every_step: bool = False
    late: bool = False
    system: Any = None

    def source(self, port: str) -> str | np.ndarray:
        """Name of the signal at an input port, or the array that stands there."""
        return self.reads.get(port, port)

    def signal(self, output: str) -> str:
        """Name of the signal that an output is."""
        return self.says.get(output, output)

    def size(self, field: str) -> int:
        """Numbers in a field of its state."""
        return int(np.prod(self.initial.dtype[field].shape, dtype=int))


class Setup(NamedTuple):
    """What the parts of a scenario's kinds are made for: robot, clock and neighbours.

    The sections of sensors, estimators, controllers and tuners have a method `parts(setup)`.
    """

    robot: RobotParameters  # As the controller believes it to be.
    gravity: float  # [m/s^2].
    period: float  # [s] of the ticks.
    time_step: float  # [s] of the plant.
    pose: np.ndarray  # (6,) [rad, m] at the start.
    pose_rate: np.ndarray  # (6,) [rad/s, m/s] likewise.
    still: np.ndarray  # (6,) [N m] at the motors until the first command arrives.
    delay: int  # [ticks] of the commands.
    ahead: int  # [ticks] by which the controller sees state and reference ahead of time.
    latency: float  # [s] from a reading to its torque, as believed.
    sensors: Any  # Options of the sensors.
    reading: int  # Numbers in a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
    noise: float  # [rad] of a reading, as an observer believes it.
    friction: float  # [N m] largest break-away torque that the motors are believed to have.
    viscous: tuple[float, ...]  # (6,) [N m s/rad] likewise, for each.
    tuner: Any  # Options of the tuner, with its file read.
    disturbance: float  # [rad/s^2 per sqrt(s)] that an observer expects; 0 without one.
    guarded: bool  # Whether a tick that fails does not end the run.
    split: bool  # Whether an LQI takes the compiled split solution whatever its options say.


def guarded(part: Part) -> Part:
    """A part whose failing ticks do not end the run: it repeats its last state, and its output `health` says why.

    Health (2,): the cause as `errors.FAILURES` counts it, 0 for none; the leg or -1. The part's state has a field of
    that name.
    """
    before = part.initial.copy()

    def tick(*arguments: Any) -> None:
        state = arguments[-1]
        np.copyto(before, state)
        try:
            part.tick(*arguments)
            state["health"] = WELL
        except RunFailure as error:
            np.copyto(state, before)
            state["health"] = failure_code(error.reason), -1.0 if error.leg is None else error.leg

    return part._replace(outputs=(*part.outputs, "health"), tick=tick)


class Running:
    """Parts with their states, side by side in one vector, called in order outside of a Diagram.

    Args:
        parts: In order.
        outside: Signals that come from elsewhere -> size; whoever has this object writes them.
        inside: Signals that are parts of those -> where in `values` they are.

    Attributes:
        values: (n,) all signals and states. A copy of it is a snapshot of the whole loop.
        places: Name of a signal -> where in `values` it is.
        time: (1,) [s] of the tick; to be written before it.
    """

    def __init__(
        self, parts: Sequence[Part], outside: Mapping[str, int], inside: Mapping[str, slice] | None = None
    ) -> None:
        self._parts = tuple(parts)
        sizes = [*outside.values(), *(part.initial.dtype.itemsize // 8 for part in parts)]
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self.values, self.time = np.zeros(starts[-1]), np.zeros(1)
        self.places = {name: slice(starts[k], starts[k] + size) for k, (name, size) in enumerate(outside.items())}
        self.places |= inside or {}
        self._states: list[np.ndarray] = []
        for part, start, size in zip(parts, starts[len(outside) :], sizes[len(outside) :], strict=False):
            self._states.append(self.values[start : start + size].view(part.initial.dtype))
            for output in part.outputs:
                at = start + part.initial.dtype.fields[output][1] // 8  # type: ignore[index]
                self.places[part.signal(output)] = slice(at, at + part.size(output))
        calls = {
            part.name: partial(part.tick, *self._inputs(part), state)
            for part, state in zip(parts, self._states, strict=True)
        }
        self._tick = [calls[part.name] for part in parts if not part.late]
        self._between = [calls[part.name] for part in parts if part.every_step]
        self._late = [calls[part.name] for part in parts if part.late]
        self.reset()

    def _inputs(self, part: Part) -> list[np.ndarray]:
        sources = [self.time if port == "time" else part.source(port) for port in part.inputs]
        return [self.values[self.places[each]] if isinstance(each, str) else each for each in sources]

    def reset(self) -> None:
        """All states as before the first tick."""
        for part, state in zip(self._parts, self._states, strict=True):
            state[:] = part.initial

    def take_over(self, other: Running) -> None:
        """Goes on where another one is: the plant, and each part that both have, as it is there."""
        self.signal("plant")[:] = other.signal("plant")
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

    def tick(self) -> None:
        """A tick of all parts but the late ones; a RunFailure of a part gets the time."""
        self._call(self._tick)

    def between(self) -> None:
        """A step of the plant between two ticks."""
        self._call(self._between)

    def late(self) -> None:
        """The end of a tick: what acts from the next one on."""
        self._call(self._late)

    def _call(self, calls: Sequence[Callable[[], None]]) -> None:
        try:
            for call in calls:
                call()
        except RunFailure as error:
            error.time = float(self.time[0])
            raise
