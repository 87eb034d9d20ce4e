"""Density features of errors and torques."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.control.density import DensityKind, density, push
from stewart_drake.errors import ConfigurationError
from stewart_drake.systems.ticked import TickedSystem

_SIGNALS = 12
_Tick = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class DensityFeatures(TickedSystem):
    """Density of each input over a sliding window, (35), (36).

    The window lives in the Context: two runs of one Diagram never share it.

    Args:
        window: m of (35) [ticks]; means run over m + 1 samples.
        period: [s] tick period.
        kind: See `density.density`.
        compiled: See `Scenario.compiled`.

    Ports:
        error: in (6,) [rad, m].
        torque: in (6,) [N m].
        density: out (12,) [-], of the errors, then of the torques; answers within the tick.
    """

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude", compiled: bool = False) -> None:
        if window < 1:
            raise ConfigurationError("window", window, "at least 1 tick")
        # Result: density, then rows filled, then the window.
        super().__init__(period, np.concatenate([np.ones(_SIGNALS), [0.0], np.zeros((window + 1) * _SIGNALS)]))
        self._tick = _compiled_tick(kind) if compiled else _tick(kind)
        self.error = self.DeclareVectorInputPort("error", 6)
        self.torque = self.DeclareVectorInputPort("torque", 6)
        self._declare_result()
        self.density = self._declare_output("density", 0, _SIGNALS)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `density.density`."""
        return self._tick(previous, self.error.Eval(context), self.torque.Eval(context))


def _tick(kind: DensityKind) -> _Tick:
    def tick(previous: np.ndarray, error: np.ndarray, torque: np.ndarray) -> np.ndarray:
        old = previous[_SIGNALS + 1 :].reshape(-1, _SIGNALS)
        window, filled = push(old, int(previous[_SIGNALS]), np.concatenate([error, torque]))
        return np.concatenate([density(window[-filled:], kind), [filled], window.ravel()])

    return tick


def _compiled_tick(kind: DensityKind) -> _Tick:
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled.tuner import density_tick

    def tick(previous: np.ndarray, error: np.ndarray, torque: np.ndarray) -> np.ndarray:
        result = np.empty_like(previous)
        density_tick(previous, error, torque, kind == "signed", result)
        return result

    return tick
