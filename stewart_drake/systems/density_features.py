"""Density features of errors and torques."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.density import DensityKind, density, push
from stewart_drake.errors import ConfigurationError
from stewart_drake.systems.ticked import TickedSystem

_SIGNALS = 12


class DensityFeatures(TickedSystem):
    """Density of each input over a sliding window, (35), (36).

    The window lives in the Context: two runs of one Diagram never share it.

    Args:
        window: m of (35) [ticks]; means run over m + 1 samples.
        period: [s] tick period.
        kind: See `density.density`.

    Ports:
        error: in (6,) [rad, m].
        torque: in (6,) [N m].
        density: out (12,) [-], of the errors, then of the torques; answers within the tick.
    """

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude") -> None:
        if window < 1:
            raise ConfigurationError("window", window, "at least 1 tick")
        # Result: density, then rows filled, then the window.
        super().__init__(period, np.concatenate([np.ones(_SIGNALS), [0.0], np.zeros((window + 1) * _SIGNALS)]))
        self._kind: DensityKind = kind
        self.error = self.DeclareVectorInputPort("error", 6)
        self.torque = self.DeclareVectorInputPort("torque", 6)
        self._declare_result()
        self.density = self._declare_output("density", 0, _SIGNALS)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `density.density`."""
        sample = np.concatenate([self.error.Eval(context), self.torque.Eval(context)])
        old = previous[_SIGNALS + 1 :].reshape(-1, _SIGNALS)
        window, filled = push(old, int(previous[_SIGNALS]), sample)
        return np.concatenate([density(window[-filled:], self._kind), [filled], window.ravel()])
