"""A sensor that fails."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.hardware.sensor_faults import EncoderFault, PoseFault, faulty_sensor
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
        initial, self._tick = faulty_sensor(faults, size, period)
        super().__init__(period, initial)
        self.reading = self.DeclareVectorInputPort("reading", size)
        self._declare_result()
        self.says = self._declare_output("says", 0, size)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `sensor_faults.faulty_reading`."""
        return self._tick(self.reading.Eval(context), context.get_time(), previous)
