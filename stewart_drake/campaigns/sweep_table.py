"""The table of a sweep: one row a run, one Parquet file."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.campaigns.distributions import column_of
from stewart_drake.campaigns.one_run import Row, not_finite
from stewart_drake.campaigns.sweep_file import Sweep
from stewart_drake.files.whole import plain_json
from stewart_drake.logs.log import AXES

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT_KEY = b"stewart_drake.sweep"
VERSION = 1

_HALF = "over the second half of the planned duration; null where the run did not get there"


NOT_FINITE_COLUMN = ("text", "", "figures that are null because they are no finite numbers, with what they are")


def _errors(figure: str, text: str) -> dict[str, tuple[str, str, str]]:
    units = ["deg"] * 3 + ["mm"] * 3
    columns = {
        f"{figure}_{axis}_{unit}": ("number", unit, f"{text} of {axis}, {_HALF}")
        for axis, unit in zip(AXES, units, strict=True)
    }
    columns[f"{figure}_deg"] = ("number", "deg", f"{text} of the norm of roll, pitch, yaw, {_HALF}")
    columns[f"{figure}_mm"] = ("number", "mm", f"{text} of the norm of X, Y, Z, {_HALF}")
    return columns


BEFORE: Mapping[str, tuple[str, str, str]] = {
    "index": ("whole", "", "number of the run, from 0"),
    "seed": ("whole", "", "of the run; its draws follow from it"),
}
"""Columns before those of the varied keys: name -> (kind, unit, explanation)."""

OUTCOME: Mapping[str, tuple[str, str, str]] = {
    "status": (
        "text",
        "",
        "completed: the controller was in charge to the end and the motion was followed; stopped: the safety layer "
        "held the robot at the end; lost: the motion was not followed; failed: broke midway, and what was measured "
        "until then is there; rejected: refused before the run; raised: an exception that is no verdict on the run; "
        "crashed: took its worker process with it",
    ),
    "reason": ("text", "", "stable name of what happened, null for completed"),
    "message": ("text", "", "one line on it"),
    "outcome_time": ("number", "s", "when that was decided, null for completed"),
    "safety": ("text", "", "monitor of the safety layer that tripped first, null for none"),
    "safety_time": ("number", "s", "when it did"),
    "safety_level": ("text", "", "how far the safety layer went: hold, ramp, safe_hold or end"),
    "warnings": ("text", "", "names of the warnings, null for none"),
    "end_time": ("number", "s", "simulated time reached"),
    "leg": ("whole", "", "leg 0..5 to which a failure belongs"),
    **_errors("rmse", "root mean square error"),
    **_errors("peak", "largest error"),
    "error_max_deg": ("number", "deg", "largest angle from the reference while the controller was in charge"),
    "error_max_mm": ("number", "mm", "largest distance from the reference while the controller was in charge"),
    "motion_ratio": ("number", "1", "size of the platform's motion over that of its reference, second half"),
    "torque_rms": ("number", "N m", "of all motors, within their limits, over the whole run"),
    "torque_peak": ("number", "N m", "of all motors, within their limits, over the whole run"),
    "saturated_fraction": ("number", "1", "share of torques at the limit, of ticks and motors"),
    "loop_gap_max_m": ("number", "m", "largest distance from a rod end to its platform joint"),
    "omega_ratio": ("number", "1", "geometric mean of omega_Q / omega_R"),
    "finite": ("flag", "", "every number of the log is finite"),
    "not_finite": NOT_FINITE_COLUMN,
}
"""Columns after them."""

INCIDENTAL: Mapping[str, tuple[str, str, str]] = {
    "wall_s": ("number", "s", "wall-clock time of the run in its worker: diagram, simulation, figures"),
    "simulation_s": ("number", "s", "of that, the simulation alone"),
    "host": ("text", "", "machine that the run was on"),
    "worker": ("whole", "", "process that the run was in"),
}
"""Last columns: the only ones that depend on where and when the sweep ran."""


def varied_columns(sweep: Sweep) -> dict[str, tuple[str, str, str]]:
    """Columns of the varied keys: the value as run; of a factor also, as `KEY.factor`, the number drawn."""
    columns: dict[str, tuple[str, str, str]] = {}
    for key, distribution in sweep.distributions.items():
        kind = column_of(distribution)
        if distribution.factor:
            value = sweep.changes({key: 1.0})[key]
            columns[f"{key}.factor"] = (kind, "1", f"what the scenario's {key} is multiplied by")
            kind = "json" if isinstance(value, list) else "number"
        columns[key] = (kind, "", f"scenario key {key} as run{', as JSON' if kind == 'json' else ''}")
    return columns


def to_arrow(sweep: Sweep, rows: Sequence[Row], versions: Mapping[str, str | None]) -> pa.Table:
    """The table, sorted by index; unit and explanation in each field's metadata, the sweep in the table's.

    Args:
        sweep: What was run.
        rows: See `one_run.execute`.
        versions: Of what ran.
    """
    import pyarrow as pa

    types = {"number": pa.float64(), "whole": pa.int64(), "flag": pa.bool_(), "text": pa.string(), "json": pa.string()}
    varied = varied_columns(sweep)
    flat = []
    for row in sorted(rows, key=lambda row: row["index"]):
        drawn: dict[str, Any] = row["values"]
        factors = {f"{key}.factor": value for key, value in drawn.items() if sweep.distributions[key].factor}
        # A factor can take a number out of floating point; its row is one of a run that was rejected.
        varied_values = plain_json({**sweep.changes(drawn), **factors})
        flat.append({**row, **varied_values, "not_finite": not_finite(row)})
    fields, arrays = [], []
    for name, (kind, unit, text) in {**BEFORE, **varied, **OUTCOME, **INCIDENTAL}.items():
        values = [row.get(name) for row in flat]
        if kind == "json":
            values = [json.dumps(value) for value in values]
        elif kind == "number":
            values = [None if value is None else float(value) for value in values]
        fields.append(pa.field(name, types[kind], metadata={"unit": unit, "text": text}))
        arrays.append(pa.array(values, type=types[kind]))
    about = {"version": VERSION, "sweep": sweep.to_dict(), "versions": dict(versions)}
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={FORMAT_KEY: json.dumps(about).encode()}))


def to_parquet(table: pa.Table) -> bytes:
    """The table as a Parquet file."""
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd")
    return stream.getvalue()


def summary(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Counts by status and reason, percentiles of the errors: what and how much, as texts."""
    counts = Counter((row["status"], row["reason"]) for row in rows)
    lines = [("runs", str(len(rows)))]
    for (status, reason), count in sorted(counts.items(), key=lambda item: (item[0][0] != "completed", -item[1])):
        lines.append((status if reason is None else f"{status}: {reason}", str(count)))
    for unit, of in (("deg", "rotation"), ("mm", "position")):
        values = np.array([r[f"rmse_{unit}"] for r in rows if r.get(f"rmse_{unit}") is not None])
        if len(values):
            shares = "  ".join(f"{value:.4g}" for value in np.percentile(values, [50, 95, 99, 100]))
            lines.append((f"RMSE of {of}, percentiles 50 95 99, largest", f"{shares} {unit}"))
    return lines
