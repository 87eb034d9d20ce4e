"""A sensor that fails."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.hardware.sensor_faults import EncoderFault, PoseFault, faulty_reading, kept_readings
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
        self._faults, self._width, self._nominal = faults, size, period
        self._rows = kept_readings(faults, period)
        super().__init__(period, np.zeros((1 + self._rows) * size))
        self.reading = self.DeclareVectorInputPort("reading", size)
        self._declare_result()
        self.says = self._declare_output("says", 0, size)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `sensor_faults.faulty_reading`."""
        reading = self.reading.Eval(context)
        memory = previous[self._width :].reshape(self._rows, self._width)
        if context.get_discrete_state(0).value()[-1] == 0.0:
            # A sensor that fails from the start repeats what was there at the start.
            memory = np.tile(reading, (self._rows, 1))
        says, memory = faulty_reading(self._faults, reading, context.get_time(), self._nominal, memory)
        return np.concatenate([says, memory.ravel()])
