"""Source of the reference motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.references import Reference, in_blocks


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
        self._blocks = None if period is None else in_blocks(reference, period)
        self.reference = self.DeclareVectorOutputPort(
            "reference", 18, self._calc, prerequisites_of_calc={self.time_ticket()}
        )

    def _calc(self, context: Context, output: Any) -> None:
        time = context.get_time() + self._ahead
        if self._blocks is not None:
            at, value = self._blocks.at(round(time / self._blocks.period))
            if at == time:
                output.SetFromVector(value)
                return
        output.SetFromVector(np.concatenate(self._reference.evaluate(time)))
