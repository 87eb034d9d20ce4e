"""Runs a sweep; its table, and what a reader wants to know of it first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.one_run import RunFunction
from stewart_drake.campaigns.plan import Made, run_plan
from stewart_drake.campaigns.sweep_file import Sweep
from stewart_drake.campaigns.tables import Row
from stewart_drake.logs.outcomes import told


def run_sweep(
    sweep: Sweep,
    folder: Path,
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction | None = None,
) -> Made:
    """Runs what is missing of a sweep and writes sweep.parquet and .csv; see `plan.run_plan`."""
    return run_plan(sweep, folder, where, progress, restart, function)["sweep"]


def summary(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Counts by status and reason, percentiles of the errors: what and how much, as texts."""
    counts = Counter((row["status"], row["reason"]) for row in rows)
    lines = [("runs", str(len(rows)))]
    for (status, reason), count in sorted(counts.items(), key=lambda item: (item[0][0] != "completed", -item[1])):
        lines.append((told(status, reason), str(count)))
    for unit, of in (("deg", "rotation"), ("mm", "position")):
        name = f"rmse_norm_{unit}"
        values = np.array([row[name] for row in rows if row.get(name) is not None])
        if len(values):
            shares = "  ".join(f"{value:.4g}" for value in np.percentile(values, [50, 95, 99, 100]))
            lines.append((f"RMSE of {of}, percentiles 50 95 99, largest", f"{shares} {unit}"))
    return lines
