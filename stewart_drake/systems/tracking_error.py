"""Tracking error of controllers that do not tell theirs."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.systems.ticked import TickedSystem


class TrackingError(TickedSystem):
    """Measured pose minus reference at the tick, and an integral state of zeros; answers within the tick.

    Args:
        period: [s] tick period.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        error: out (6,) [rad, m].
        integral: out (6,) zeros.
    """

    def __init__(self, period: float) -> None:
        super().__init__(period, np.zeros(12))
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self._declare_result()
        self.error = self._declare_output("error", 0, 6)
        self.integral = self._declare_output("integral", 6, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:  # noqa: ARG002 - it remembers nothing
        """Pose minus reference, then zeros."""
        error = self.measurement.Eval(context)[:6] - self.reference.Eval(context)[:6]
        return np.concatenate([error, np.zeros(6)])
