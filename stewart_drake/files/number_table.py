"""Tables of numbers in CSV files, whose columns say their units."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import read_checked


def read_numbers(
    path: str | Path, source: str, columns: Sequence[tuple[str, Mapping[str, float]]], most_bytes: int, most_rows: int
) -> np.ndarray:
    """Chosen columns of a CSV file with a header, in any order; further columns are left alone.

    Args:
        path: The file.
        source: What it is, with its path, for messages.
        columns: k of them: what is in it, and each name that it may have -> what one of its unit is of that kept.
        most_bytes: Of the file.
        most_rows: Likewise.

    Returns:
        (n, k); no number need be finite.

    Raises:
        ConfigurationError: Not readable or too large, a column missing or there twice, a cell that is no number.
    """
    try:
        text = read_checked(path, source, most_bytes).decode("utf-8-sig")
        table = csv.reader(io.StringIO(text))
        names = [name.strip() for name in next(table, [])]
        chosen = [_column(names, name, ways, source) for name, ways in columns]
        rows = list(_rows(table, names, [column for column, _ in chosen], source, most_rows))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigurationError(source, str(error), "a CSV table in UTF-8 with a header") from None
    return np.array(rows).reshape(-1, len(chosen)) * np.array([factor for _, factor in chosen])


def _column(names: list[str], name: str, ways: Mapping[str, float], source: str) -> tuple[int, float]:
    """Place of a quantity's column, and what its unit is of the one that is kept."""
    found = [place for place, each in enumerate(names) if each in ways]
    if len(found) != 1:
        have = ", ".join(names[place] for place in found) or f"none among {', '.join(names) or 'no columns'}"
        raise ConfigurationError(f"{source}: column of {name}", have, f"one of {' and '.join(ways)}")
    return found[0], ways[names[found[0]]]


def _rows(
    table: Iterable[list[str]], names: list[str], columns: list[int], source: str, most_rows: int
) -> Iterator[list[float]]:
    """Numbers of the columns, a list for each row that is not empty."""
    row = 0
    for cells in table:
        if not any(cell.strip() for cell in cells):
            continue
        row += 1
        if row > most_rows:
            raise ConfigurationError(source, f"more than {most_rows} rows", f"at most {most_rows} rows")
        if len(cells) != len(names):
            raise ConfigurationError(f"{source}: row {row}", f"{len(cells)} cells", f"{len(names)}, as the header has")
        numbers = []
        for column in columns:
            try:
                numbers.append(float(cells[column]))
            except ValueError:
                key = f"{source}: row {row}, {names[column]}"
                raise ConfigurationError(key, cells[column], "a finite number") from None
        yield numbers
