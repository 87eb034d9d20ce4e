"""A sensor that fails."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.sensor_faults import EncoderFault, PoseFault, faulty_reading
from stewart_drake.systems.ticked import TickedSystem


class FaultySensor(TickedSystem):
    """Passes a reading on at each tick, or what `sensor_faults.faulty_reading` makes of it.

    Args:
        faults: When and how it fails.
        size: Entries of a reading.
        period: [s] tick period.

    Ports:
        reading: in (size,).
        says: out (size,).
    """

    def __init__(self, faults: Sequence[EncoderFault] | Sequence[PoseFault], size: int, period: float) -> None:
        super().__init__(period, np.zeros(2 * size))
        self._faults, self._width = faults, size
        self.reading = self.DeclareVectorInputPort("reading", size)
        self._declare_result()
        self.says = self._declare_output("says", 0, size)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `sensor_faults.faulty_reading`."""
        reading = self.reading.Eval(context)
        # A sensor that is frozen from the start shows what was there at the start.
        good = previous[self._width :] if context.get_discrete_state(0).value()[-1] > 0.0 else reading
        return np.concatenate(faulty_reading(self._faults, reading, context.get_time(), good))
