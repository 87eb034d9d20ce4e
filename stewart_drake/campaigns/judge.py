"""What Drake's plant says of a campaign on the reduced engine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from stewart_drake.campaigns.one_run import RunFunction
from stewart_drake.campaigns.tables import Row
from stewart_drake.errors import StewartDrakeError
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.outcomes import told

if TYPE_CHECKING:
    from stewart_drake.campaigns.plan import Plan

COMPARED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
"""Metrics."""


def verdict(plan: Plan, rows: Mapping[int, Row], function: RunFunction | None = None) -> str | None:
    """One line that a table of runs on the reduced engine has: its first completed run again, on Drake's plant.

    Args:
        plan: What was run.
        rows: Index -> row.
        function: Simulates a scenario, in place of `plan.simulation`.

    Returns:
        None where no run is on that engine.
    """
    if not any(variant.plant.engine == "reduced" for variant in plan.variants()):
        return None
    line = "Engine: reduced, the exact closed form of the robot in place of Drake's plant"
    for index, row in rows.items():
        if row["status"] != "completed":
            continue
        scenario = plan.scenario(index)
        if scenario.plant.engine == "reduced":
            try:
                log = (function or plan.simulation(index))(scenario.replace({"plant.engine": "drake"}))
            except StewartDrakeError as error:
                return f"{line}. Run {index} does not run on Drake: {error}"
            return f"{line}. Run {index} on Drake: {_compared(row, run_metrics(log), told(log.status, log.reason))}."
    return line + "; no run completed to compare."


def _compared(row: Row, drake: Mapping[str, object], ending: str) -> str:
    """Metrics there, and by how much the row's are off."""
    found = [ending]
    for name in COMPARED:
        mine, other = row.get(name), drake.get(name)
        if isinstance(mine, float) and isinstance(other, float) and other != 0.0:
            found.append(f"{name} {other:.3g} (here {100.0 * (mine / other - 1.0):+.2g} %)")
    return ", ".join(found)
