"""What a run costs: its errors and the unrest of its torques in one number, for searches and for training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import fmean
from typing import Any

from stewart_drake.section import Positive, Section

FAILED = 1000.0
"""Cost of a run that was not completed; no other costs more."""


class CostScales(Section, key="cost"):
    """What counts as one in the cost of a run."""

    rotation: Positive = 0.03
    """[deg] of the error's RMS length."""
    position: Positive = 0.03
    """[mm] likewise."""
    torque_change: Positive = 0.03
    """[N m] RMS change of a motor's torque in a millisecond."""


def cost(rotation: Any, position: Any, torque_change: Any, scales: CostScales) -> Any:
    """J = sqrt((rotation / its scale)^2 + (position / its scale)^2 + (torque_change / its scale)^2).

    Args:
        rotation: [deg] RMS length of the error; a number, or an array of numpy or torch of any shape.
        position: [mm] likewise.
        torque_change: [N m] RMS change of a motor's torque in a millisecond.
        scales: What counts as one.

    Returns:
        [-] like the arguments, broadcast together.
    """
    squares = (rotation / scales.rotation) ** 2 + (position / scales.position) ** 2
    return (squares + (torque_change / scales.torque_change) ** 2) ** 0.5


def run_cost(figures: Mapping[str, Any], status: str, period: float, scales: CostScales) -> float:
    """`cost` of a run from its metrics, at most `FAILED`, and that for a run that was not completed.

    Args:
        figures: Metrics by name; of them rmse_norm_deg, rmse_norm_mm and torque_change_rms, of a tick.
        status: Of the run.
        period: [s] of a tick.
        scales: What counts as one.
    """
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
