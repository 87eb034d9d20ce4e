"""Rows on disk as they come, so that an interrupted sweep goes on where it was; what is not whole is rejected."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from stewart_drake.campaigns.tables import Row
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import (
    check_file,
    checksum,
    locked_folder,
    read_checked,
    seal,
    unseal,
    write_atomically,
)
from stewart_drake.runs.outputs import prepare_folder

ROWS, HEADER = "rows.jsonl", "sweep.json"
CAMPAIGN = "campaign"
"""Key of a kept row: checksum of the identity that it belongs to."""

_LONGEST = 2**24
"""[byte] of a line; a row takes a few thousand."""
_LARGEST = 2**40
_LARGEST_HEADER = 2**30


class RowStore:
    """The folder of one sweep: `sweep.json` says which, `rows.jsonl` gets a line a run.

    Both carry checksums. A row that is torn, changed or another sweep's is run again; a header that is not whole is
    written again where no row is another sweep's. A context manager: within it, the folder is this process's alone.

    Args:
        folder: Where.
        identity: What the rows depend on, in plain values; rows of another identity are never mixed in.
        restart: Throw away what is there.
        products: Names of what is made from the rows; it never stands beside rows of another identity.

    Raises:
        ConfigurationError: The folder holds another sweep, is in use, or cannot be written to.
    """

    def __init__(
        self, folder: Path, identity: Mapping[str, Any], restart: bool = False, products: Sequence[str] = ()
    ) -> None:
        self.folder, self._identity, self._restart = folder, json.loads(json.dumps(identity)), restart
        self._campaign, self._products = checksum(self._identity), products
        self._open = ExitStack()
        self._stream: BinaryIO

    def __enter__(self) -> Self:
        prepare_folder(self.folder)
        path = self.folder / ROWS
        with ExitStack() as opened:
            opened.enter_context(locked_folder(self.folder))
            try:
                path.touch()
                check_file(path, str(path), _LARGEST)
                self._stream = opened.enter_context(path.open("a+b", buffering=0))
            except OSError as error:
                raise ConfigurationError(str(path), error.strerror, "a file that can be written to") from None
            self._take()
            self._open = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def rows(self) -> dict[int, Row]:
        """Rows that are there and whole, by index."""
        found: dict[int, Row] = {}
        for line in self._lines():
            try:
                row = unseal(line)
            except (ValueError, TypeError):
                continue  # run again
            if row.pop(CAMPAIGN, None) == self._campaign:
                found[row["index"]] = row
        return found

    def add(self, row: Row) -> None:
        """Keeps a row, in plain values with finite numbers.

        Raises:
            ConfigurationError: The disk is full, or the like.
        """
        line = json.dumps(seal({**row, CAMPAIGN: self._campaign}), allow_nan=False).encode() + b"\n"
        try:
            written = self._stream.write(line)
        except OSError as error:
            raise ConfigurationError(str(self.folder / ROWS), error.strerror, "a disk with room for it") from None
        if written != len(line):
            raise ConfigurationError(str(self.folder / ROWS), f"{written} bytes", "a disk with room for a row")

    def _take(self) -> None:
        header = self.folder / HEADER
        if self._restart:
            # The header last: until it is gone, the folder is that of the rows.
            for name in self._products:
                (self.folder / name).unlink(missing_ok=True)
            self._stream.truncate(0)
            header.unlink(missing_ok=True)
        different = self._difference(_read(header))
        if different:
            allowed = "a new folder, the same work by the same version, or --restart to throw away what is there"
            raise ConfigurationError("--out", str(self.folder), f"{allowed}; {different}")
        # What an earlier process left half written would spoil the next row too.
        size = self._stream.seek(0, os.SEEK_END)
        if size:
            self._stream.seek(size - 1)
            if self._stream.read(1) != b"\n":
                self._stream.write(b"\n")
        write_atomically(header, (json.dumps(seal(self._identity), indent=1) + "\n").encode())

    def _difference(self, kept: dict[str, Any] | None) -> str:
        """In words, what tells the folder from one of this identity; empty where nothing does."""
        if kept is not None:
            names = _unequal(kept, self._identity)
            versions = [name for name in names if name == "columns" or name.startswith("versions.")]
            if versions:
                return f"it was made by another version ({', '.join(versions)})"
            return f"it differs in {', '.join(names[:5])}{' and more' if len(names) > 5 else ''}" if names else ""
        campaigns = {str(line.get(CAMPAIGN)) for line in self._lines()}
        there = [name for name in self._products if os.path.lexists(self.folder / name)]
        if campaigns - {self._campaign}:
            return f"{ROWS} holds other rows, and there is no {HEADER} that can be read"
        return f"{there[0]} is there without a {HEADER} that can be read" if there and not campaigns else ""

    def _lines(self) -> Iterator[dict[str, Any]]:
        """Lines that could be rows."""
        with (self.folder / ROWS).open("rb") as stream:
            # Piece by piece: a damaged file may be one endless line.
            while line := stream.readline(_LONGEST):
                try:
                    row = json.loads(line)
                    if type(row["index"]) is int and row["index"] >= 0:
                        yield row
                except (ValueError, KeyError, TypeError, RecursionError):
                    continue


def _read(path: Path) -> dict[str, Any] | None:
    """The header; None where there is none that is whole."""
    try:
        return unseal(json.loads(read_checked(path, str(path), _LARGEST_HEADER)))
    except (ConfigurationError, ValueError, TypeError, RecursionError):
        return None


def _unequal(one: Any, other: Any, name: str = "") -> list[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        keys = dict.fromkeys([*one, *other])
        return [n for k in keys for n in _unequal(one.get(k), other.get(k), f"{name}.{k}" if name else k)]
    return [] if one == other and type(one) is type(other) else [name]
