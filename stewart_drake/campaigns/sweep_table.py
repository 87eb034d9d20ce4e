"""The table of a sweep: one row a run, one Parquet file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.campaigns.distributions import column_of
from stewart_drake.campaigns.one_run import not_finite
from stewart_drake.campaigns.row_store import Row
from stewart_drake.campaigns.sweep_file import Sweep
from stewart_drake.campaigns.tables import to_arrow
from stewart_drake.files.whole import NOT_FINITE, plain_json
from stewart_drake.logs.metric_table import Column
from stewart_drake.logs.metric_table import columns as run_columns

if TYPE_CHECKING:
    import pyarrow as pa

BEFORE = (
    Column("index", "", "number of the run, from 0", "whole"),
    Column("seed", "", "of the run; its draws follow from it", "whole"),
)
"""Columns before those of the varied keys."""

INCIDENTAL = (
    Column("wall_s", "s", "wall-clock time of the run in its worker: diagram, simulation, metrics"),
    Column("simulation_s", "s", "of that, the simulation alone"),
    Column("host", "", "machine that the run was on", "text"),
    Column("worker", "", "process that the run was in", "whole"),
)
"""Last columns: the only ones that depend on where and when the sweep ran."""


def varied_columns(sweep: Sweep) -> tuple[Column, ...]:
    """Columns of the varied keys: the value as run; of a factor also, as `KEY.factor`, the number drawn."""
    columns: list[Column] = []
    for key, distribution in sweep.distributions.items():
        kind = column_of(distribution)
        if distribution.factor:
            value = sweep.changes({key: 1.0})[key]
            columns.append(Column(f"{key}.factor", "1", f"what the scenario's {key} is multiplied by", kind))
            kind = "json" if isinstance(value, list) else "number"
        columns.append(Column(key, "", f"scenario key {key} as run{', as JSON' if kind == 'json' else ''}", kind))
    return tuple(columns)


def sweep_table(sweep: Sweep, rows: Sequence[Row], versions: Mapping[str, str | None]) -> pa.Table:
    """The table, sorted by index, the sweep in its metadata.

    Args:
        sweep: What was run.
        rows: See `one_run.execute`.
        versions: Of what ran.
    """
    wide = []
    for row in sorted(rows, key=lambda row: row["index"]):
        drawn: dict[str, Any] = row["values"]
        factors = {f"{key}.factor": value for key, value in drawn.items() if sweep.distributions[key].factor}
        # A factor can take a number out of floating point; its row is one of a run that was rejected.
        varied = plain_json({**sweep.changes(drawn), **factors})
        wide.append({**row, **varied, NOT_FINITE: not_finite(row)})
    columns = (*BEFORE, *varied_columns(sweep), *run_columns(), *INCIDENTAL)
    return to_arrow(columns, wide, "sweep", {"sweep": sweep.to_dict(), "versions": dict(versions)})


def summary(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Counts by status and reason, percentiles of the errors: what and how much, as texts."""
    counts = Counter((row["status"], row["reason"]) for row in rows)
    lines = [("runs", str(len(rows)))]
    for (status, reason), count in sorted(counts.items(), key=lambda item: (item[0][0] != "completed", -item[1])):
        lines.append((status if reason is None else f"{status}: {reason}", str(count)))
    for unit, of in (("deg", "rotation"), ("mm", "position")):
        name = f"rmse_norm_{unit}"
        values = np.array([row[name] for row in rows if row.get(name) is not None])
        if len(values):
            shares = "  ".join(f"{value:.4g}" for value in np.percentile(values, [50, 95, 99, 100]))
            lines.append((f"RMSE of {of}, percentiles 50 95 99, largest", f"{shares} {unit}"))
    return lines
