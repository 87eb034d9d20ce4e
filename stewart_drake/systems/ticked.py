"""Base of sampled systems whose outputs answer within the tick."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem, OutputPort

from stewart_drake.errors import RunFailure
from stewart_drake.sampling import WELL, Sampled, ill, on_grid

_AHEAD = 1.0 + 4e-10
"""A tick's instant begins a little early: decimal times, at which others may ask, come before the stretched ones."""


class TickedSystem(LeafSystem):
    """A sampled system without added delay: at a tick, outputs are computed from the inputs of that very instant.

    A torque kept in discrete state would reach the plant one plant step late, because both update at once from what was
    there before. Here the result of a tick is computed on demand (and cached) as soon as an output is asked for at the
    tick's time, and the discrete update then stores it; until the next tick outputs repeat it. State, in the Context:
    the result vector, and last in it the number of ticks done.

    The plant must step in a discrete update too, as `plant.add_plant` makes it: a `MultibodyPlant` with sampled outputs
    (Drake's default) steps before all discrete updates of its instant, and what is stored would see it one step late.

    Args:
        period: [s] tick period; ticks at 0, period, 2 period, ...
        initial: (n,) result before the first tick.
        guarded: A tick that fails does not end the run: the result stays that of the tick before, and two more entries
            after it say what was wrong, as `errors.FAILURES` counts it (0: nothing), and at which leg (-1: none). For
            systems behind a safety layer.

    Attributes:
        guarded: See above.
        period: [s] as Drake has it, see `sampling.on_grid`; the period for a log of every tick.
        result: Port (n + 1,) or, guarded, (n + 3,): all of the result and the number of ticks done. Each port that is a
            part of it costs a call of Python where it is asked for; a Demultiplexer on this one does not.
    """

    result: OutputPort

    def __init__(self, period: float, initial: np.ndarray, guarded: bool = False) -> None:
        super().__init__()
        self.period = on_grid(period)
        self.guarded, self._memory = guarded, len(initial)
        state = np.concatenate([np.asarray(initial, dtype=float), WELL if guarded else [], [0.0]])
        self._size = len(state)
        self.DeclareDiscreteState(state)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._store)

    def _declare_result(self) -> None:
        """Declares the port `result`; called once the input ports exist."""
        self.result = self.DeclareVectorOutputPort(
            "result",
            self._size,
            self._calc,
            prerequisites_of_calc={self.time_ticket(), self.xd_ticket(), self.all_input_ports_ticket()},
        )

    def _declare_output(self, name: str, start: int, size: int) -> OutputPort:
        """A vector output that is a slice of the result."""

        def calc(context: Context, output: Any) -> None:
            output.SetFromVector(self.result.Eval(context)[start : start + size])

        ticket = self.get_output_port(self.result.get_index()).cache_entry().ticket()
        return self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={ticket})

    @abstractmethod
    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """The result (n,) of a tick from the inputs in `context` and the result of the tick before."""

    def _calc(self, context: Context, output: Any) -> None:
        held = context.get_discrete_state(0).value()
        now = context.get_time() / self.period
        values = output.get_mutable_value()
        if now * _AHEAD + 1e-6 < held[-1]:
            values[:] = held
            return
        try:
            values[: self._memory] = self.tick(context, held[: self._memory])
            if self.guarded:
                values[self._memory : -1] = WELL
        except RunFailure as error:
            values[self._memory : -1] = ill(error, self.guarded, context.get_time())
            values[: self._memory] = held[: self._memory]
        values[-1] = int(now + 1e-6) + 1.0

    def _store(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(0, self.result.Eval(context))


class SampledSystem(TickedSystem):
    """A part as a system: its inputs and outputs as ports, by name; its memory is the result.

    Args:
        period: [s] tick period.
        part: What it does.
        inputs: Name -> size, as `part.tick` takes them.
        outputs: Name -> size, as its memory begins with them.
        guarded: See `TickedSystem`.
    """

    def __init__(
        self, period: float, part: Sampled, inputs: Mapping[str, int], outputs: Mapping[str, int], guarded: bool = False
    ) -> None:
        super().__init__(period, part.initial, guarded)
        self._tick = part.tick
        self._seen = [self.DeclareVectorInputPort(name, size) for name, size in inputs.items()]
        self._declare_result()
        start = 0
        for name, size in outputs.items():
            setattr(self, name, self._declare_output(name, start, size))
            start += size
        for port in self._seen:
            setattr(self, port.get_name(), port)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `Sampled.tick`."""
        return self._tick(*(port.Eval(context) for port in self._seen), previous)
