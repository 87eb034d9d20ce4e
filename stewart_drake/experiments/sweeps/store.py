"""Rows on disk as they come, so that an interrupted sweep goes on where it was."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from stewart_drake.errors import ConfigurationError
from stewart_drake.experiments.sweeps.one_run import Row
from stewart_drake.files import write_atomically
from stewart_drake.outputs import prepare_folder

ROWS, HEADER, TABLE = "rows.jsonl", "sweep.json", "sweep.parquet"


class RowStore:
    """The folder of one sweep: `sweep.json` says which, `rows.jsonl` gets a line a run.

    A context manager: within it, the folder is this process's alone.

    Args:
        folder: Where.
        identity: What the rows depend on, in plain values; rows of another identity are never mixed in.
        restart: Throw away what is there.

    Raises:
        ConfigurationError: The folder holds another sweep, is in use, or cannot be written to.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any], restart: bool = False) -> None:
        self.folder, self._identity, self._restart = folder, json.loads(json.dumps(identity)), restart
        self._stream: BinaryIO | None = None

    def __enter__(self) -> Self:
        prepare_folder(self.folder)
        try:
            self._stream = (self.folder / ROWS).open("a+b", buffering=0)
        except OSError as error:
            raise ConfigurationError(str(self.folder / ROWS), error.strerror, "a file that can be written to") from None
        try:
            self._take()
        except BaseException:
            self._stream.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._stream is not None
        self._stream.close()

    def rows(self) -> dict[int, Row]:
        """Rows that are there, by index."""
        assert self._stream is not None
        self._stream.seek(0)
        found: dict[int, Row] = {}
        for line in self._stream.read().splitlines():
            try:
                row = json.loads(line)
                found[int(row["index"])] = row
            except (ValueError, KeyError, TypeError):
                continue  # not whole: run again
        return found

    def add(self, row: Row) -> None:
        """Keeps a row.

        Raises:
            ConfigurationError: The disk is full, or the like.
        """
        assert self._stream is not None
        line = json.dumps(row).encode() + b"\n"
        try:
            written = self._stream.write(line)
        except OSError as error:
            raise ConfigurationError(str(self.folder / ROWS), error.strerror, "a disk with room for it") from None
        if written != len(line):
            raise ConfigurationError(str(self.folder / ROWS), f"{written} bytes", "a disk with room for a row")

    def _take(self) -> None:
        assert self._stream is not None
        header = self.folder / HEADER
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigurationError("--out", str(self.folder), "a folder that nobody else is using") from None
        if self._restart:
            self._stream.truncate(0)
            header.unlink(missing_ok=True)
            (self.folder / TABLE).unlink(missing_ok=True)
        if header.exists() or self._stream.seek(0, 2):
            different = _difference(_read(header), self._identity)
            if different:
                allowed = "a new folder, the same work by the same version, or --restart to throw away what is there"
                raise ConfigurationError("--out", str(self.folder), f"{allowed}; {different}")
        # What an earlier process left half written would spoil the next row too.
        self._stream.seek(0)
        content = self._stream.read()
        self._stream.truncate(content.rfind(b"\n") + 1)
        write_atomically(header, (json.dumps(self._identity, indent=1) + "\n").encode())


def _read(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def _difference(kept: dict[str, Any], wanted: dict[str, Any]) -> str:
    """In words, what tells two identities apart; empty for the same."""
    if not kept:
        return f"{ROWS} is there without a {HEADER} that can be read"
    names = _unequal(kept, wanted)
    return f"it differs in {', '.join(names[:5])}{' and more' if len(names) > 5 else ''}" if names else ""


def _unequal(one: Any, other: Any, name: str = "") -> list[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        keys = dict.fromkeys([*one, *other])
        return [n for k in keys for n in _unequal(one.get(k), other.get(k), f"{name}.{k}" if name else k)]
    return [] if one == other and type(one) is type(other) else [name]
