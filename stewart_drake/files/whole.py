"""Files: read only once they are known to be files, written whole or not at all, with checksums of what they say."""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stewart_drake.errors import ConfigurationError

if TYPE_CHECKING:
    from filelock import FileLock

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of this package; in a checkout, beside `sdf` and `diagrams`."""
LARGEST = 100_000_000
"""[byte] of any file that a scenario names."""
CHECKSUM, NOT_FINITE = "checksum", "not_finite"
"""Keys that `seal` and `plain_json` add."""

_UNFINISHED, _LOCK = ".part", ".lock"
"""Ending of a file that is being written; file in a folder that is in use."""
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}


def open_checked(path: str | Path, what: str, largest: int, allowed: str = "a readable file") -> BufferedReader:
    """Opens a file for reading, if it is a regular file of at most `largest` bytes.

    Args:
        path: The file.
        what: What it is, with its path, for messages.
        largest: [byte].
        allowed: What a readable file is called in messages.

    Raises:
        ConfigurationError: Missing or unreadable; a folder, pipe or device; too large.
    """
    try:
        # Without O_NONBLOCK a pipe that nobody writes to would wait for ever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except (OSError, ValueError) as error:
        raise ConfigurationError(what, getattr(error, "strerror", None) or str(error), allowed) from None
    stream = None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            kind = _KINDS.get(stat.S_IFMT(status.st_mode), "a device")
            raise ConfigurationError(what, kind, "a regular file")
        if status.st_size > largest:
            raise ConfigurationError(what, f"{status.st_size} bytes", f"at most {largest} bytes")
        stream = os.fdopen(descriptor, "rb")
    finally:
        if stream is None:
            os.close(descriptor)
    return stream


def read_checked(path: str | Path, what: str, largest: int, allowed: str = "a readable file") -> bytes:
    """Content of a regular file of at most `largest` bytes; see `open_checked`.

    Raises:
        ConfigurationError: See `open_checked`; it grew beyond `largest` since.
    """
    with open_checked(path, what, largest, allowed) as stream:
        try:
            # Files below /proc say that they are empty.
            content = stream.read(largest + 1)
        except OSError as error:
            raise ConfigurationError(what, error.strerror or str(error), allowed) from None
    if len(content) > largest:
        raise ConfigurationError(what, f"more than {largest} bytes", f"at most {largest} bytes")
    return content


def digest(path: str | Path) -> str | None:
    """sha256 of a file's content; None where it cannot be read, is no regular file or larger than `LARGEST`."""
    try:
        with open_checked(path, str(path), LARGEST) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (ConfigurationError, OSError):
        return None


def write_atomically(path: Path, content: bytes) -> None:
    """Writes `content` to `path` by way of a temporary file in the same folder; on the disk once this returns.

    Raises:
        ConfigurationError: The folder is missing or not writable; nothing is left behind.
    """
    try:
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=_UNFINISHED)
        try:
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            # mkstemp makes files private; give them what the umask gives any other file.
            umask = os.umask(0)
            os.umask(umask)
            Path(name).chmod(0o666 & ~umask)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        sync_folder(path.parent)
    except OSError as error:
        raise ConfigurationError(str(path), error.strerror or str(error), "a file in a writable folder") from error


def sync_folder(folder: Path) -> None:
    """Brings the names in a folder to the disk, where the system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def take_lock(path: Path, refusal: ConfigurationError) -> FileLock:
    """Takes the lock that a file stands for, without waiting; it is made. `release` lifts it, or the process's end.

    A file that is deleted, by whoever has its lock, is no lock any more.

    Raises:
        ConfigurationError: `refusal`, where another process has it; or its disk has no locks.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(path, blocking=False)
    try:
        lock.acquire()
    except (Timeout, FileNotFoundError):
        raise refusal from None
    except OSError as error:
        allowed = f"a folder that can be locked ({error.strerror})"
        raise ConfigurationError(refusal.key, refusal.value, allowed) from None
    return lock


@contextmanager
def locked_folder(folder: Path, key: str = "--out") -> Iterator[None]:
    """Keeps other processes that ask for it out of a folder; the system lifts the lock when this process ends.

    What a process that was killed has left half written in it is cleared away: nobody is writing it any more.

    Args:
        folder: It exists.
        key: For messages.

    Raises:
        ConfigurationError: Another process has it, or its disk has no locks.
    """
    allowed = "a folder that no other process is using"
    lock = take_lock(folder / _LOCK, ConfigurationError(key, str(folder), allowed))
    try:
        for name in folder.glob(f".*{_UNFINISHED}"):
            with suppress(OSError):
                name.unlink()
        yield
    finally:
        with suppress(OSError):
            (folder / _LOCK).unlink()
        lock.release()


def plain_json(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document that strict JSON can hold: null for each number that is not finite, and why.

    Args:
        document: Plain values.

    Returns:
        A copy; where there are such numbers with one more key, `not_finite`: dotted key -> nan, inf or -inf.
    """
    found: dict[str, str] = {}

    def plain(value: Any, name: str) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            found[name] = repr(float(value))
            return None
        if isinstance(value, Mapping):
            return {key: plain(each, f"{name}.{key}" if name else str(key)) for key, each in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(each, f"{name}.{index}") for index, each in enumerate(value)]
        return value

    copy: dict[str, Any] = plain(document, "")
    return {**copy, NOT_FINITE: found} if found else copy


def checksum(document: Any) -> str:
    """Of a document of plain values, whatever the order of its keys.

    Raises:
        ValueError, TypeError: A number is not finite, or a value has no place in JSON.
    """
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def seal(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with the checksum of the rest of it as its last key.

    Raises:
        ValueError, TypeError: See `checksum`.
    """
    return {**document, CHECKSUM: checksum(document)}


def unseal(document: Any) -> dict[str, Any]:
    """The inverse of `seal`.

    Raises:
        ValueError: No mapping, no checksum, or not that of the content.
    """
    if not isinstance(document, dict):
        raise ValueError("no mapping of keys to values")
    rest = {key: value for key, value in document.items() if key != CHECKSUM}
    if document.get(CHECKSUM) != checksum(rest):
        raise ValueError("its checksum is not that of its content")
    return rest
