"""Files: read only if they are regular and not too large, written whole or not at all, with checksums of content."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import signal
import stat
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from filelock import FileLock, Timeout

from stewart_drake.base.errors import ConfigurationError, DiskError

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of this package; in a checkout, beside `sdf` and `diagrams`."""
MAX_FILE_BYTES = 100_000_000
"""[byte] of any file that a scenario names."""
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
CHECKSUM, NOT_FINITE = "checksum", "not_finite"
"""Keys that `seal` and `plain_json` add."""


def check_file(path: str | Path, what: str, largest: int, allowed: str = "a readable file") -> Path:
    """The path of a regular file of at most `largest` [byte]; `what` it is, with its path, for messages."""
    try:
        status = Path(path).stat()
    except (OSError, ValueError) as error:
        raise ConfigurationError(what, getattr(error, "strerror", None) or str(error), allowed) from None
    if not stat.S_ISREG(status.st_mode):
        raise ConfigurationError(what, "a folder, a pipe or a device", "a regular file")
    if status.st_size > largest:
        raise ConfigurationError(what, f"{status.st_size} bytes", f"at most {largest} bytes")
    return Path(path)


def read_checked(path: str | Path, what: str, largest: int) -> bytes:
    """Content of a file that passes `check_file`."""
    try:
        return check_file(path, what, largest).read_bytes()
    except OSError as error:
        raise ConfigurationError(what, error.strerror or str(error), "a readable file") from None


def digest(path: str | Path) -> str | None:
    """sha256 of a file's content; None where it cannot be read, is no regular file or larger than `MAX_FILE_BYTES`."""
    with suppress(ConfigurationError):
        return hashlib.sha256(read_checked(path, str(path), MAX_FILE_BYTES)).hexdigest()
    return None


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file beside its place and renames it: a reader sees the old content or the new one."""
    write_together({path: content})


def write_together(files: Mapping[Path, bytes], instead_of: Iterable[Path] = ()) -> None:
    """Writes files beside their places; once all are on the disk, renames them and removes those of `instead_of`."""
    # Of this thread alone: another may be writing to the same place.
    parts = {path: path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part") for path in files}
    try:
        for path, content in files.items():
            with _disk_errors(str(path)), parts[path].open("wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
        for path in instead_of:
            path.unlink(missing_ok=True)
        for path, part in parts.items():
            with _disk_errors(str(path)):
                part.replace(path)
    finally:
        for part in parts.values():
            with suppress(OSError):
                part.unlink()


def append(stream: IO[bytes], document: Mapping[str, Any]) -> None:
    """Adds a sealed document as a line to a file without a buffer."""
    line = json.dumps(seal(document), allow_nan=False).encode() + b"\n"
    with _disk_errors(str(stream.name)):
        while line:
            line = line[stream.write(line) :]


@contextmanager
def _disk_errors(what: str) -> Iterator[None]:
    """Turns an OSError while something is written into a `DiskError`, or a `ConfigurationError` about its place."""
    try:
        yield
    except OSError as error:
        why = error.strerror or str(error)
        if error.errno in DISK_FULL:
            raise DiskError(f"{what}: {why}") from error
        raise ConfigurationError(what, why, "a file in a writable folder") from error


@contextmanager
def signals_held() -> Iterator[list[int]]:
    """Holds back what Ctrl-C, SIGTERM and SIGHUP would raise until the end; what has come, which may be cleared."""
    held: list[int] = []
    # Python's handlers run in the main thread alone.
    mine = threading.current_thread() is threading.main_thread()
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if mine else ()
    handlers = {each: handler for each in signals if callable(handler := signal.getsignal(each))}
    try:
        for each in handlers:
            signal.signal(each, lambda number, _: held.append(number))
        yield held
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
        for number in held:
            signal.raise_signal(number)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Keeps other processes that ask for it out of a folder; the system lifts the lock when this process ends.

    Files that a killed process has left half written in it are removed.
    """
    lock = FileLock(folder / ".lock", blocking=False)
    try:
        lock.acquire()
    except (OSError, Timeout) as error:
        problem = "that no other process is using" if isinstance(error, Timeout) else f"that can be locked ({error})"
        raise ConfigurationError("--out", str(folder), f"a folder {problem}") from None
    try:
        for part in folder.glob(".*.part"):
            part.unlink(missing_ok=True)
        yield
    finally:
        (folder / ".lock").unlink(missing_ok=True)
        lock.release()


def plain_json(document: Mapping[str, Any]) -> dict[str, Any]:
    """A copy that strict JSON can hold: null for each number that is not finite.

    Where there are such numbers it has one more key, `not_finite`: dotted key -> nan, inf or -inf.
    """
    not_finite: dict[str, str] = {}

    def plain(value: Any, name: str) -> Any:
        value = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(value, float) and not math.isfinite(value):
            not_finite[name.removeprefix(".")] = repr(float(value))
            return None
        if isinstance(value, Mapping):
            return {key: plain(each, f"{name}.{key}") for key, each in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(each, f"{name}.{index}") for index, each in enumerate(value)]
        return value

    copy: dict[str, Any] = plain(document, "")
    return {**copy, NOT_FINITE: not_finite} if not_finite else copy


def checksum(document: Any) -> str:
    """Of a document of plain values, whatever the order of its keys; ValueError or TypeError where JSON has no such."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def seal(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with the checksum of the rest of it as its last key."""
    return {**document, CHECKSUM: checksum(document)}


def unseal(content: str | bytes, what: str, made_by: str) -> dict[str, Any]:
    """The inverse of `seal`, from JSON; ConfigurationError where that is not as `made_by` has written it."""
    try:
        document = json.loads(content)
        rest = {key: value for key, value in document.items() if key != CHECKSUM} if isinstance(document, dict) else {}
        if not rest or document.get(CHECKSUM) != checksum(rest):
            changed = "its checksum is not that of its content"
            raise ValueError(changed if rest and CHECKSUM in document else "no checksum, as in older versions")
        return rest
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(what, str(error), f"an unchanged file from {made_by}") from None
