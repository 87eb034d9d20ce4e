"""Density features of errors and torques."""

from __future__ import annotations

from pydrake.systems.framework import OutputPort

from stewart_drake.control.density import DensityKind, density_part
from stewart_drake.systems.ticked import SampledSystem


class DensityFeatures(SampledSystem):
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

    density: OutputPort

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude", compiled: bool = False) -> None:
        super().__init__(period, density_part(window, kind, compiled), {"error": 6, "torque": 6}, {"density": 12})
