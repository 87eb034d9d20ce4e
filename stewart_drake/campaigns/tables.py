"""Tables of campaigns: for programs with unit and text of each column, as Parquet and CSV; for readers as Markdown."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stewart_drake.files.tables import to_csv, to_parquet
from stewart_drake.files.whole import NOT_FINITE, write_atomically
from stewart_drake.logs.metric_table import Column

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]
"""Column -> plain value, and `index`."""
INCIDENTAL = (
    Column("wall_s", "s", "wall-clock time of the run in its worker: diagram, simulation, metrics"),
    Column("simulation_s", "s", "of that, the simulation alone"),
    Column("host", "", "machine that the run was on", "text"),
    Column("worker", "", "process that the run was in", "whole"),
)
"""Last columns of a sweep: the only ones that depend on where and when it ran."""


def flat(row: Row, **more: Any) -> Row:
    """A row with further columns, and with what of it is no finite number as a text."""
    found = {name: value for name, value in row.get(NOT_FINITE, {}).items() if "." not in name}
    named = ", ".join(f"{name} {value}" for name, value in found.items())
    return {**row, **more, NOT_FINITE: named or None}


def to_arrow(
    columns: Sequence[Column], rows: Iterable[Mapping[str, Any]], key: str, about: Mapping[str, Any]
) -> pa.Table:
    """A table with unit and text in each field's metadata; nothing in it depends on where or when it was made.

    Args:
        columns: In order.
        rows: Column -> plain value; what is not there is null.
        key: Of the table's metadata, under which `about` stands, as `stewart_drake.KEY`.
        about: What it is a table of, in plain values.
    """
    import pyarrow as pa

    types = {"number": pa.float64(), "whole": pa.int64(), "flag": pa.bool_(), "text": pa.string(), "json": pa.string()}
    fields, arrays, rows = [], [], list(rows)
    for column in columns:
        values = [row.get(column.name) for row in rows]
        if column.kind == "json":
            values = [json.dumps(value) for value in values]
        elif column.kind == "number":
            values = [None if value is None else float(value) for value in values]
        metadata = {"unit": column.unit, "text": column.text}
        fields.append(pa.field(column.name, types[column.kind], metadata=metadata))
        arrays.append(pa.array(values, type=types[column.kind]))
    text = json.dumps(about)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={f"stewart_drake.{key}": text}))


def write_table(table: pa.Table, folder: Path, name: str) -> None:
    """Writes NAME.parquet and NAME.csv.

    Raises:
        ConfigurationError: The disk is full, or the like.
    """
    write_atomically(folder / f"{name}.parquet", to_parquet(table))
    write_atomically(folder / f"{name}.csv", to_csv(table))


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table as GitHub shows it."""
    return [f"| {' | '.join(each)} |" for each in (header, ["---"] * len(header), *rows)]
