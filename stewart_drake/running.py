"""The parts of a loop at work outside of a Diagram: their states side by side in one vector, called in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from stewart_drake.errors import RunFailure
from stewart_drake.part import Part


class Running:
    """Parts with their states.

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
        calls = [
            partial(part.tick, *self._inputs(part), state) for part, state in zip(parts, self._states, strict=True)
        ]
        self._tick = [call for part, call in zip(parts, calls, strict=True) if not part.late]
        self._between = [call for part, call in zip(parts, calls, strict=True) if part.every_step]
        self._late = [call for part, call in zip(parts, calls, strict=True) if part.late]
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
