"""Tables in files: as CSV, and as Parquet with a checksum of every byte that is verified before anything is read."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import open_checked

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_SEAL = "stewart_drake.sha256"
_MARK, _DIGITS = b"sha256 of all other bytes: ", 64
_BLOCK = 2**20


def to_csv(table: pa.Table) -> bytes:
    """A table as a CSV file, without its metadata."""
    from pyarrow import csv

    stream = io.BytesIO()
    csv.write_csv(table, stream)
    return stream.getvalue()


class SealedWriter:
    """Writes a table in row groups, and at the end a checksum of the whole file.

    A context manager; where the block raises, the file has no checksum and will not be read.

    Args:
        stream: An empty file, open for writing and reading.
        schema: Its columns.
        key: Of the schema's metadata, under which `about` stands.
        about: What else there is to say, in plain values with finite numbers.

    Raises:
        OSError: The disk is full, or the like; from every method.
    """

    def __init__(self, stream: BinaryIO, schema: pa.Schema, key: bytes, about: Mapping[str, Any]) -> None:
        import pyarrow.parquet as pq

        metadata = {key: json.dumps(about, allow_nan=False)}
        self._stream, self._schema = stream, schema.with_metadata(metadata)
        self._writer = pq.ParquetWriter(stream, self._schema, compression="zstd")

    def __enter__(self) -> Self:
        return self

    def write(self, table: pa.Table) -> None:
        """Adds a row group; the table's own metadata is not kept."""
        self._writer.write_table(table.cast(self._schema))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._writer.add_key_value_metadata({_SEAL: _MARK.decode() + "0" * _DIGITS})
        self._writer.close()
        if error is None:
            place = _place_of_digits(self._stream)
            assert place is not None
            found = _digest(self._stream, place)
            self._stream.seek(place)
            self._stream.write(found)
            self._stream.flush()


def read_sealed(
    path: str | Path,
    what: str,
    key: bytes,
    largest: int,
    most_rows: int,
    made_by: str,
    stride: Callable[[int], int] = lambda _: 1,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Reads what a `SealedWriter` wrote.

    Args:
        path: The file.
        what: What it is, with its path, for messages.
        key: As in `SealedWriter`.
        largest: [byte] of the file.
        most_rows: That it may have: a few kilobytes can hold billions of equal ones.
        made_by: What writes such files, for messages.
        stride: From the number of rows to which of them are kept: every so many, from the first.

    Returns:
        `about`, and the columns by name, (rows kept,) each.

    Raises:
        ConfigurationError: Missing, no regular file, too large, another file, or not what was written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with open_checked(path, what, largest, f"a file from {made_by}") as stream:
        try:
            file = pq.ParquetFile(stream)
            metadata = file.metadata.metadata or {}
            if key not in metadata:
                raise ConfigurationError(what, "another Parquet file", f"one written by {made_by}")
            place = _place_of_digits(stream)
            if place is None or not _is_whole(stream, place):
                raise ConfigurationError(what, "a checksum that is not that of its content", f"a file from {made_by}")
            refuse_bomb(file, what, file.schema_arrow.names, most_rows)
            about = json.loads(metadata[key])
            names, every, first = file.schema_arrow.names, stride(file.metadata.num_rows), 0
            parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
            for index in range(file.num_row_groups):
                group = file.read_row_group(index)
                for name in names:
                    # A copy: a view would keep the whole row group.
                    parts[name].append(group.column(name).to_numpy()[first::every].copy())
                first = (first - group.num_rows) % every
        except (OSError, ValueError, TypeError, KeyError, RecursionError, MemoryError, pa.ArrowException) as error:
            text = " ".join(str(error).split()) or type(error).__name__
            raise ConfigurationError(what, text, "a Parquet file that is whole") from None
    return about, {name: np.concatenate(part) if part else np.empty(0) for name, part in parts.items()}


def refuse_bomb(file: pq.ParquetFile, what: str, names: Iterable[str], most_rows: int) -> None:
    """Refuses, before it is unpacked, what would take more memory than its rows of numbers: by its metadata alone.

    Args:
        file: Open.
        what: What it is, with its path, for messages.
        names: Of the columns that will be read; each has one number of at most 32 bytes a row.
        most_rows: That it may have: a few kilobytes can hold billions of equal ones.

    Raises:
        ConfigurationError: Too many rows, or a column of anything but numbers.
    """
    import pyarrow as pa

    rows, schema = file.metadata.num_rows, file.schema_arrow
    if rows > most_rows:
        raise ConfigurationError(what, f"{rows} rows", f"at most {most_rows} rows")
    for name in names:
        kind = schema.field(name).type
        if not any(is_kind(kind) for is_kind in (pa.types.is_primitive, pa.types.is_decimal, pa.types.is_null)):
            raise ConfigurationError(what, f"column {name} of {kind}", "a table of numbers")
        index = schema.get_field_index(name)
        groups = (file.metadata.row_group(number) for number in range(file.num_row_groups))
        size = sum(group.column(index).total_uncompressed_size for group in groups)
        if size > 64 * (rows + _BLOCK):
            raise ConfigurationError(what, f"column {name} of {size} bytes for {rows} rows", "a table of numbers")


def _place_of_digits(stream: BinaryIO) -> int | None:
    """Where in a Parquet file its checksum stands; None where it has none."""
    end = stream.seek(0, 2)
    stream.seek(max(0, end - 8))
    tail = int.from_bytes(stream.read(4), "little") + 8
    start = stream.seek(max(0, end - tail))
    index = stream.read(tail).rfind(_MARK)
    return None if index < 0 else start + index + len(_MARK)


def _digest(stream: BinaryIO, place: int) -> bytes:
    """Of all bytes but the digits at `place`, as digits."""
    digest = hashlib.sha256()
    stream.seek(0)
    left = place
    while left > 0 and (block := stream.read(min(left, _BLOCK))):
        digest.update(block)
        left -= len(block)
    stream.seek(place + _DIGITS)
    while block := stream.read(_BLOCK):
        digest.update(block)
    return digest.hexdigest().encode()


def _is_whole(stream: BinaryIO, place: int) -> bool:
    stream.seek(place)
    return stream.read(_DIGITS) == _digest(stream, place)
