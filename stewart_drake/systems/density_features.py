"""Density features of errors and torques."""

from __future__ import annotations

from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.control.density import DensityKind, density_part
from stewart_drake.systems.part_system import PartSystem


class DensityFeatures(PartSystem):
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

    error: InputPort
    torque: InputPort
    density: OutputPort

    def __init__(self, window: int, period: float, kind: DensityKind = "magnitude") -> None:
        super().__init__(density_part(window, kind), period)
