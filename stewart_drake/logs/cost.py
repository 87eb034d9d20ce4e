"""What a run costs: its errors and the unrest of its torques in one number, for searches and for training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import fmean
from typing import Any

from stewart_drake.control.features import CostScales, cost

FAILED = 1000.0
"""Cost of a run that was not completed; no other costs more."""


def run_cost(figures: Mapping[str, Any], status: str, period: float, scales: CostScales) -> float:
    """`cost` of a run with ticks of `period` [s] from its metrics by name, at most `FAILED`; that if not completed."""
    parts = [figures.get(name) for name in ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")]
    if status != "completed" or None in parts:
        return FAILED
    rotation, position, change = map(float, parts)  # type: ignore[arg-type]
    return min(cost(rotation, position, change * 1e-3 / period, scales), FAILED)


def mean_cost(costs: Iterable[float]) -> float:
    """Mean of the costs of some runs: where errors are large they count for more.

    Not the geometric one, in which a loop that is quiet wherever nothing happens, and gives way to every push, is best.
    """
    return fmean(costs)
