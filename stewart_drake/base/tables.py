"""Tables of numbers in CSV and Parquet files, with units in the names of columns, such as `time_s`, `torque_0_Nm`.

Logs, recorded motions, recordings for identification and poses for calibration have the same columns. A column is read
in any of its units, and without a unit in that of SI; `pose_` may be left out, and case does not matter.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from stewart_drake.base.atomic_files import Document, check_file, seal, unseal
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.units import UNITS

if TYPE_CHECKING:
    import pyarrow as pa

_READ = (
    *("s", "ms", "rad", "deg", "m", "mm", "N m", "mN m", "N m s/rad", "N", "kg", "A", "mA", "Hz", "rad/s", "deg/s"),
    *("m/s", "mm/s", "rad/s^2", "m/s^2", "rad s", "m s", "1", ""),
)
_ENDING = {"rad s": "rad_s", "m s": "m_s", "Hz": "hz", "1": ""}
ENDINGS: dict[str, dict[str, float]] = {}
for _unit in _READ:
    _base, _size = UNITS.get(_unit, (_unit, 1.0))
    _name = _ENDING.get(_unit, _unit.replace(" ", "").replace("/", "_per_").replace("^", ""))
    ENDINGS.setdefault(_base, {})[_name] = _size
"""Unit -> ending of a column's name -> size in the unit; the first ending is the one that is written."""

Coordinate = Literal["roll", "pitch", "yaw", "X", "Y", "Z"]
COORDINATES: tuple[Coordinate, ...] = get_args(Coordinate)  # Of a pose.
AXES = tuple(map(str.lower, COORDINATES))  # In names of columns and metrics.
POSE = tuple((f"pose_{axis}", unit) for axis, unit in zip(AXES, ("rad",) * 3 + ("m",) * 3, strict=True))
CRANK_ANGLES = tuple((f"crank_angle_{leg}", "rad") for leg in range(6))
"""Quantities and units of a pose and of the cranks."""
MAX_COLUMNS = 5000
_FACTORS = {f"_{ending}": factor for sizes in ENDINGS.values() for ending, factor in sizes.items() if ending}

Chosen = Mapping[str, tuple[str, float]]
"""Quantity -> name of its column in a file, and the factor to the unit of the result."""


def column_name(quantity: str, unit: str) -> str:
    """Name of the column of a quantity, such as `pose_roll_rad`."""
    return f"{quantity}_{next(iter(ENDINGS[unit]))}".removesuffix("_")


def quantity_of(column: str) -> tuple[str, float]:
    """The quantity of a column, which is its name without the unit, and the size of the unit in SI."""
    ending = max((text for text in _FACTORS if column.lower().endswith(text.lower())), key=len, default="")
    return column[: len(column) - len(ending)], _FACTORS.get(ending, 1.0)


def read_numbers(
    path: str | Path, source: str, quantities: Sequence[tuple[str, str]], max_bytes: int, max_rows: int
) -> np.ndarray:
    """Values (n, k) of k quantities, given with their units, from a .csv or .parquet file with a header.

    Columns may come in any order, and others are ignored. An empty cell is NaN. Missing and repeated columns and cells
    that are no numbers are refused; `source` is the file in messages. The crank angles of a log are the measured ones.
    """

    def choose(names: list[str]) -> Chosen:
        read = "reading" if any(name.lower().startswith("reading_0") for name in names) else "crank_angle"
        return {name: column_of(names, name.replace("crank_angle", read), unit, source) for name, unit in quantities}

    return np.stack(list(read_columns(path, source, choose, max_bytes, max_rows).values()), axis=-1)


def refuse_cells(
    source: str, quantities: Sequence[tuple[str, str]], values: np.ndarray, wrong: np.ndarray, allowed: str
) -> None:
    """Raises a `ConfigurationError` for the first `wrong` cell (n, k) of a table."""
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        place = f"{source}: row {row + 1}, {quantities[column][0]}"
        raise ConfigurationError(place, float(values[row, column]), allowed)


def refuse_back(source: str, time: np.ndarray) -> None:
    """Raises a `ConfigurationError` if times (n,) do not increase."""
    back = ~(np.diff(time, prepend=-math.inf) > 0.0)
    refuse_cells(source, (("time", "s"),), time[:, None], back[:, None], "a time after that of the row before")


def read_columns(
    path: str | Path, source: str, choose: Callable[[list[str]], Chosen], max_bytes: int, max_rows: int
) -> dict[str, np.ndarray]:
    """Columns (n,) of a table that `choose` selects by their names; otherwise like `read_numbers`."""
    import pyarrow as pa
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    check_file(path, source, max_bytes)
    try:
        if Path(path).suffix.lower() == ".parquet":
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                rows, chosen = file.metadata.num_rows, choose(_bounded(file.schema_arrow.names, source))
                # Before unpacking: a small file may have very many rows.
                table = None if rows > max_rows else file.read(columns=[name for name, _ in chosen.values()])
        else:
            with Path(path).open(encoding="utf-8-sig", newline="") as stream:
                names = [name.strip() for name in next(csv.reader(stream), [])]
            chosen = choose(_bounded(names, source))
            types = dict.fromkeys((name for name, _ in chosen.values()), pa.float64())
            table = pc.read_csv(
                path,
                # With several threads, messages do not name the row.
                pc.ReadOptions(use_threads=False, column_names=names, skip_rows=1, block_size=1 << 24),
                convert_options=pc.ConvertOptions(include_columns=list(types), column_types=types),
            )
            rows = table.num_rows
        if table is None or rows > max_rows:
            raise ConfigurationError(source, f"{rows} rows", f"at most {max_rows} rows")
        # Decimals and integers of a Parquet file become float64; text is refused.
        columns = {name: table.column(name).cast(pa.float64()).to_numpy() for name, _ in chosen.values()}
    except (OSError, ValueError, TypeError, KeyError, csv.Error, pa.ArrowException) as error:
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigurationError(source, text, "a table of numbers with a header") from None
    return {quantity: columns[name] * factor for quantity, (name, factor) in chosen.items()}


def _bounded(names: list[str], source: str) -> list[str]:
    if len(names) > MAX_COLUMNS:
        raise ConfigurationError(source, f"{len(names)} columns", f"at most {MAX_COLUMNS} columns")
    return names


def column_of(names: Sequence[str], quantity: str, unit: str, source: str) -> tuple[str, float]:
    """The only column of a quantity, and the factor from its unit to `unit`."""
    factors = {f"{quantity}_{ending}".removesuffix("_"): factor for ending, factor in ENDINGS[unit].items()}
    factors[quantity] = 1.0
    factors |= {name.removeprefix("pose_"): factor for name, factor in factors.items()}
    by_name = {name.lower(): factor for name, factor in factors.items()}
    columns = [name for name in names if name.lower() in by_name]
    if len(columns) != 1:
        found = ", ".join(columns) or f"none among {', '.join(names)[:300] or 'no columns'}"
        hint = f"; {hint}" if (hint := no_header(names)) else ""
        raise ConfigurationError(f"{source}: column of {quantity}", found, f"one of {', '.join(factors)}{hint}")
    return columns[0], by_name[columns[0].lower()]


def no_header(names: Sequence[str]) -> str:
    """A hint if all names of columns are numbers, otherwise empty."""
    try:
        return "the first line is numbers: is the header missing?" if [float(name) for name in names] else ""
    except ValueError:
        return ""


def to_csv(table: pa.Table) -> bytes:
    """A table as a CSV file, without its metadata."""
    from pyarrow import csv as pc

    stream = io.BytesIO()
    stream.write((",".join(table.column_names) + "\n").encode())
    pc.write_csv(table, stream, pc.WriteOptions(include_header=False))
    return stream.getvalue()


def numbers_to_csv(quantities: Sequence[tuple[str, str]], values: np.ndarray) -> str:
    """Values (n, k) of quantities with their units as a CSV table that `read_numbers` reads."""
    import pyarrow as pa

    names = [column_name(*quantity) for quantity in quantities]
    return to_csv(pa.table(list(np.asarray(values, dtype=float).T), names=names)).decode()


def with_about(table: pa.Table, key: str, about: Mapping[str, object]) -> pa.Table:
    """A table with sealed metadata `stewart_drake.KEY`: the plain values `about` and the names of its columns."""
    text = json.dumps(seal({**about, "columns": table.column_names}), allow_nan=False)
    return table.replace_schema_metadata({f"stewart_drake.{key}": text})


def to_parquet(table: pa.Table) -> bytes:
    """A table as a Parquet file with checksums of its pages."""
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd", write_page_checksum=True)
    return stream.getvalue()


def parquet_about(path: str | Path, source: str, key: str, max_bytes: int, made_by: str) -> Document:
    """The metadata of `with_about` in a Parquet file; raises a ConfigurationError if the file was changed."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_file(path, source, max_bytes, f"a file from {made_by}")
    try:
        schema = pq.read_schema(path)
        content = (schema.metadata or {})[f"stewart_drake.{key}".encode()]
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        text = "another Parquet file" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
        raise ConfigurationError(source, text, f"a Parquet file from {made_by}") from None
    about = unseal(content, source, made_by)
    if about.pop("columns", None) != schema.names:
        raise ConfigurationError(source, "other columns than were written", f"an unchanged file from {made_by}")
    return about
