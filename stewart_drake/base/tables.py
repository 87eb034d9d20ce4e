"""Tables of numbers in CSV and Parquet files, whose columns say their units: `time_s`, `pose_roll_rad`, `torque_0_Nm`.

One dialect for all: logs, recorded motions, recordings for identification, poses for calibration. A column is read in
any of its units, and without one in that of SI; `pose_` may be left out, and capitals make no difference.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from stewart_drake.base.atomic_files import check_file, seal, unseal
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
"""Unit -> endings of a column's name, the first that of what is written, and what one of each is in the unit."""

Coordinate = Literal["roll", "pitch", "yaw", "X", "Y", "Z"]
COORDINATES: tuple[Coordinate, ...] = get_args(Coordinate)
AXES = tuple(map(str.lower, COORDINATES))
"""Of a pose: for a reader, and in names of columns and metrics."""
POSE = tuple((f"pose_{axis}", unit) for axis, unit in zip(AXES, ("rad",) * 3 + ("m",) * 3, strict=True))
CRANK_ANGLES = tuple((f"crank_angle_{leg}", "rad") for leg in range(6))
"""Quantities of poses and of cranks with their units."""
MAX_COLUMNS = 5000
_FACTORS = {f"_{ending}": factor for each in ENDINGS.values() for ending, factor in each.items() if ending}

Chosen = Mapping[str, tuple[str, float]]
"""What a column holds -> its name in the file, and the factor to the unit that is kept."""


def column_name(quantity: str, unit: str) -> str:
    """What the column of a quantity is called, such as `pose_roll_rad`."""
    return f"{quantity}_{next(iter(ENDINGS[unit]))}".removesuffix("_")


def quantity_of(column: str) -> tuple[str, float]:
    """The quantity of a column, its name without the unit, and what one of the unit is in SI."""
    ending = max((each for each in _FACTORS if column.lower().endswith(each.lower())), key=len, default="")
    return column[: len(column) - len(ending)], _FACTORS.get(ending, 1.0)


def read_numbers(
    path: str | Path, source: str, quantities: Sequence[tuple[str, str]], most_bytes: int, most_rows: int
) -> np.ndarray:
    """Some quantities (n, k) of a .csv or .parquet file with a header, in the units that stand beside them.

    Columns may come in any order; further ones are left alone. A cell that is empty is NaN. A column that is missing or
    there twice, and a cell that is no number, are refused; `source` is what messages call the file. In a log the angles
    of cranks are those that were read.
    """

    def choose(names: list[str]) -> Chosen:
        read = "reading" if any(name.lower().startswith("reading_0") for name in names) else "crank_angle"
        return {each: column_of(names, each.replace("crank_angle", read), unit, source) for each, unit in quantities}

    return np.stack(list(read_columns(path, source, choose, most_bytes, most_rows).values()), axis=-1)


def refuse_cells(
    source: str, quantities: Sequence[tuple[str, str]], values: np.ndarray, wrong: np.ndarray, allowed: str
) -> None:
    """Raises a `ConfigurationError` for the first of the cells of a table (n, k) that are `wrong`."""
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        place = f"{source}: row {row + 1}, {quantities[column][0]}"
        raise ConfigurationError(place, float(values[row, column]), allowed)


def refuse_back(source: str, time: np.ndarray) -> None:
    """Raises a `ConfigurationError` where a time (n,) is not after that of the row before."""
    back = ~(np.diff(time, prepend=-math.inf) > 0.0)
    refuse_cells(source, (("time", "s"),), time[:, None], back[:, None], "a time after that of the row before")


def read_columns(
    path: str | Path, source: str, choose: Callable[[list[str]], Chosen], most_bytes: int, most_rows: int
) -> dict[str, np.ndarray]:
    """Columns (n,) of a table, as `choose` picks them from the names; else as `read_numbers`."""
    import pyarrow as pa
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    check_file(path, source, most_bytes)
    try:
        if Path(path).suffix.lower() == ".parquet":
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                rows, chosen = file.metadata.num_rows, choose(_bounded(file.schema_arrow.names, source))
                # Before they are unpacked: a small file may hold very many.
                table = None if rows > most_rows else file.read(columns=[name for name, _ in chosen.values()])
        else:
            with Path(path).open(encoding="utf-8-sig", newline="") as stream:
                names = [name.strip() for name in next(csv.reader(stream), [])]
            chosen = choose(_bounded(names, source))
            wanted = dict.fromkeys((name for name, _ in chosen.values()), pa.float64())
            table = pc.read_csv(
                path,
                # One thread: only then does a message name the row.
                pc.ReadOptions(use_threads=False, column_names=names, skip_rows=1, block_size=1 << 24),
                convert_options=pc.ConvertOptions(include_columns=list(wanted), column_types=wanted),
            )
            rows = table.num_rows
        if table is None or rows > most_rows:
            raise ConfigurationError(source, f"{rows} rows", f"at most {most_rows} rows")
        # Of text, no number is made; of a Parquet file's decimals and whole numbers, float64.
        kept = {name: table.column(name).cast(pa.float64()).to_numpy() for name, _ in chosen.values()}
    except (OSError, ValueError, TypeError, KeyError, csv.Error, pa.ArrowException) as error:
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigurationError(source, text, "a table of numbers with a header") from None
    return {quantity: kept[name] * factor for quantity, (name, factor) in chosen.items()}


def _bounded(names: list[str], source: str) -> list[str]:
    if len(names) > MAX_COLUMNS:
        raise ConfigurationError(source, f"{len(names)} columns", f"at most {MAX_COLUMNS} columns")
    return names


def column_of(names: Sequence[str], quantity: str, unit: str, source: str) -> tuple[str, float]:
    """The one column of a quantity, and what its unit is of the one that is kept."""
    ways = {f"{quantity}_{ending}".removesuffix("_"): factor for ending, factor in ENDINGS[unit].items()}
    ways[quantity] = 1.0
    ways |= {name.removeprefix("pose_"): factor for name, factor in ways.items()}
    folded = {name.lower(): factor for name, factor in ways.items()}
    columns = [name for name in names if name.lower() in folded]
    if len(columns) != 1:
        have = ", ".join(columns) or f"none among {', '.join(names)[:300] or 'no columns'}"
        hint = f"; {hint}" if (hint := no_header(names)) else ""
        raise ConfigurationError(f"{source}: column of {quantity}", have, f"one of {', '.join(ways)}{hint}")
    return columns[0], folded[columns[0].lower()]


def no_header(names: Sequence[str]) -> str:
    """What to ask where all names of columns are numbers; else nothing."""
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

    names = [column_name(*each) for each in quantities]
    return to_csv(pa.table(list(np.asarray(values, dtype=float).T), names=names)).decode()


def with_about(table: pa.Table, key: str, about: Mapping[str, Any]) -> pa.Table:
    """A table with plain values about it and the names of its columns, sealed, under `stewart_drake.KEY`."""
    text = json.dumps(seal({**about, "columns": table.column_names}), allow_nan=False)
    return table.replace_schema_metadata({f"stewart_drake.{key}": text})


def to_parquet(table: pa.Table) -> bytes:
    """A table as a Parquet file, whose pages have checksums."""
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd", write_page_checksum=True)
    return stream.getvalue()


def parquet_about(path: str | Path, source: str, key: str, most_bytes: int, made_by: str) -> dict[str, Any]:
    """What `with_about` said of a table in a Parquet file; ConfigurationError where that has changed since."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_file(path, source, most_bytes, f"a file from {made_by}")
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
