"""Source of the reference motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.references import Reference
from stewart_drake.sampling import on_grid

_ROWS = 256


class ReferenceSource(LeafSystem):
    """A reference motion as a signal.

    Args:
        reference: The motion.
        period: [s] at whose multiples the signal is mostly asked for; they are evaluated some hundred at a time, which
            costs a tenth. Other times are answered too.
        ahead: [s] by which it is ahead of its time.

    Ports:
        reference: out (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
    """

    def __init__(self, reference: Reference, period: float | None = None, ahead: float = 0.0) -> None:
        super().__init__()
        self._reference, self._ahead = reference, ahead
        self._period = None if period is None else on_grid(period)
        # What was computed last, a memory of a pure function; two runs of one Diagram may share it.
        self._table: tuple[int, np.ndarray, np.ndarray] = (-1, np.empty(0), np.empty(0))
        self.reference = self.DeclareVectorOutputPort(
            "reference", 18, self._calc, prerequisites_of_calc={self.time_ticket()}
        )

    def _calc(self, context: Context, output: Any) -> None:
        time = context.get_time() + self._ahead
        if self._period is None:
            output.SetFromVector(np.concatenate(self._reference.evaluate(time)))
            return
        block, row = divmod(round(time / self._period), _ROWS)
        # Read once: another thread's run may replace it meanwhile.
        kept, times, values = self._table
        if block != kept:
            times = np.arange(block * _ROWS, (block + 1) * _ROWS) * self._period
            values = np.concatenate(self._reference.evaluate(times), axis=-1)
            self._table = block, times, values
        if times[row] == time:
            output.SetFromVector(values[row])
        else:
            output.SetFromVector(np.concatenate(self._reference.evaluate(time)))
