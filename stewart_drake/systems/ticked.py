"""Base of sampled systems whose outputs answer within the tick."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, State, ValueProducer

from stewart_drake.errors import RunFailure
from stewart_drake.sampling import on_grid

_AHEAD = 1.0 + 4e-10
"""A tick's instant begins a little early: decimal times, at which others may ask, come before the stretched ones."""


class TickedSystem(LeafSystem):
    """A sampled system without added delay: at a tick, outputs are computed from the inputs of that very instant.

    A torque kept in discrete state would reach the plant one plant step late, because both update at once from what was
    there before. Here the result of a tick is computed on demand (and cached) as soon as an output is asked for at the
    tick's time, and the update event then stores it; until the next tick outputs repeat it. State, in the Context: the
    result vector, and the number of ticks done.

    Args:
        period: [s] tick period; ticks at 0, period, 2 period, ...
        initial: (n,) result before the first tick.

    Attributes:
        period: [s] as Drake has it, see `sampling.on_grid`; the period for a log of every tick.
    """

    def __init__(self, period: float, initial: np.ndarray) -> None:
        super().__init__()
        self.period = on_grid(period)
        self._result_index = self.DeclareDiscreteState(np.asarray(initial, dtype=float))
        self._ticks_index = self.DeclareDiscreteState([0.0])
        # Drake takes unrestricted updates before discrete ones. So a tick is stored before the plant steps, whether
        # that step is discrete (as `plant.add_plant` makes it) or unrestricted (Drake's default, with sampled outputs).
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._store)

    def _declare_result(self) -> None:
        """Declares the cached result; called once the input ports exist."""
        self._result = self.DeclareCacheEntry(
            description="result of the present tick",
            value_producer=ValueProducer(allocate=lambda: AbstractValue.Make([None]), calc=self._calc),
            prerequisites_of_calc={self.time_ticket(), self.xd_ticket(), self.all_input_ports_ticket()},
        )

    def _declare_output(self, name: str, start: int, size: int) -> Any:
        """A vector output that is a slice of the result."""

        def calc(context: Context, output: Any) -> None:
            output.SetFromVector(self.result(context)[start : start + size])

        return self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self._result.ticket()})

    def result(self, context: Context) -> np.ndarray:
        """(n,) result of the latest tick at or before the context's time."""
        return self._result.Eval(context)[0]

    @abstractmethod
    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """The result (n,) of a tick from the inputs in `context` and the result of the tick before."""

    def _calc(self, context: Context, cache: Any) -> None:
        held = context.get_discrete_state(self._result_index).value()
        if context.get_time() / self.period * _AHEAD + 1e-6 < context.get_discrete_state(self._ticks_index).value()[0]:
            cache.set_value([held.copy()])
            return
        try:
            cache.set_value([self.tick(context, held)])
        except RunFailure as error:
            error.time = context.get_time()
            raise

    def _store(self, context: Context, state: State) -> None:
        discrete_state = state.get_mutable_discrete_state()
        discrete_state.set_value(self._result_index, self.result(context))
        discrete_state.set_value(self._ticks_index, [np.floor(context.get_time() / self.period + 1e-6) + 1.0])
