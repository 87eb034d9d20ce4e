"""Tracking error of controllers that do not tell theirs."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.sampling import Sampled
from stewart_drake.systems.ticked import SampledSystem


class TrackingError(SampledSystem):
    """Measured pose minus reference at the tick, and an integral state of zeros; answers within the tick.

    Args:
        period: [s] tick period.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        error: out (6,) [rad, m].
        integral: out (6,) zeros.
    """

    measurement: InputPort
    reference: InputPort
    error: OutputPort
    integral: OutputPort

    def __init__(self, period: float) -> None:
        inputs, outputs = {"measurement": 12, "reference": 18}, {"error": 6, "integral": 6}
        super().__init__(period, Sampled(np.zeros(12), _difference), inputs, outputs)


def _difference(measured: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> np.ndarray:  # noqa: ARG001
    """Pose minus reference, then zeros; it remembers nothing."""
    return np.concatenate([measured[:6] - wanted[:6], np.zeros(6)])
