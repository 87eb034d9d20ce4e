"""Files: reads regular files of limited size, writes completely or not at all, and checksums."""

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
MAX_FILE_BYTES = 100_000_000  # [byte] of any file that a scenario names.
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
Document = dict[str, Any]  # JSON or YAML of any form.
CHECKSUM = "checksum"  # Key that `seal` adds.
NOT_FINITE = "not_finite"  # Key that `plain_json` adds.


def check_file(path: str | Path, key: str, max_bytes: int, allowed: str = "a readable file") -> Path:
    """The path of a regular file of at most `max_bytes` [byte]; `key` is the file in messages."""
    try:
        status = Path(path).stat()
    except (OSError, ValueError) as error:
        raise ConfigurationError(key, getattr(error, "strerror", None) or str(error), allowed) from None
    if not stat.S_ISREG(status.st_mode):
        raise ConfigurationError(key, "a folder, a pipe or a device", "a regular file")
    if status.st_size > max_bytes:
        raise ConfigurationError(key, f"{status.st_size} bytes", f"at most {max_bytes} bytes")
    return Path(path)


def read_checked(path: str | Path, key: str, max_bytes: int) -> bytes:
    """Content of a file that passes `check_file`."""
    try:
        return check_file(path, key, max_bytes).read_bytes()
    except OSError as error:
        raise ConfigurationError(key, error.strerror or str(error), "a readable file") from None


def digest(path: str | Path) -> str | None:
    """sha256 of a file's content; None if it is not readable, not regular or larger than `MAX_FILE_BYTES`."""
    with suppress(ConfigurationError):
        return hashlib.sha256(read_checked(path, str(path), MAX_FILE_BYTES)).hexdigest()
    return None


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a temporary file and renames it: a reader sees the old content or the new one."""
    write_together({path: content})


def write_together(files: Mapping[Path, bytes], instead_of: Iterable[Path] = ()) -> None:
    """Writes temporary files; once all are on the disk, removes those of `instead_of` and renames them."""
    # Names of this thread: another may be writing to the same place.
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


def append(stream: IO[bytes], document: Mapping[str, object]) -> None:
    """Adds a sealed document as a line to an unbuffered file."""
    line = json.dumps(seal(document), allow_nan=False).encode() + b"\n"
    with _disk_errors(str(stream.name)):
        while line:
            line = line[stream.write(line) :]


@contextmanager
def _disk_errors(key: str) -> Iterator[None]:
    """Turns an OSError while writing into a `DiskError` of a full disk, or else a `ConfigurationError`."""
    try:
        yield
    except OSError as error:
        text = error.strerror or str(error)
        if error.errno in DISK_FULL:
            raise DiskError(f"{key}: {text}") from error
        raise ConfigurationError(key, text, "a file in a writable folder") from error


@contextmanager
def signals_held() -> Iterator[list[int]]:
    """Delays Ctrl-C, SIGTERM and SIGHUP until the end; yields the received signals, which may be cleared."""
    held: list[int] = []
    # Python's handlers run only in the main thread.
    is_main = threading.current_thread() is threading.main_thread()
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if is_main else ()
    handlers = {number: handler for number in signals if callable(handler := signal.getsignal(number))}
    try:
        for number in handlers:
            signal.signal(number, lambda got, _: held.append(got))
        yield held
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for received in held:
            signal.raise_signal(received)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Locks a folder against other processes of this package; the lock ends with this process at the latest.

    Removes incomplete files of killed processes.
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


def plain_json(document: Mapping[str, object]) -> Document:
    """A copy in values of strict JSON: null for numbers that are not finite.

    If there are such numbers it has another key, `not_finite`: dotted key -> nan, inf or -inf.
    """
    not_finite: dict[str, str] = {}

    def plain(value: object, name: str) -> Any:
        value = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(value, float) and not math.isfinite(value):
            not_finite[name.removeprefix(".")] = repr(float(value))
            return None
        if isinstance(value, Mapping):
            return {key: plain(item, f"{name}.{key}") for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(item, f"{name}.{index}") for index, item in enumerate(value)]
        return value

    copy: Document = plain(document, "")
    return {**copy, NOT_FINITE: not_finite} if not_finite else copy


def checksum(document: object) -> str:
    """Checksum of plain values, for any order of keys; raises ValueError or TypeError for values not in JSON."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def seal(document: Mapping[str, object]) -> dict[str, object]:
    """A document with its checksum as the last key."""
    return {**document, CHECKSUM: checksum(document)}


def unseal(content: str | bytes, key: str, made_by: str) -> Document:
    """The inverse of `seal`, from JSON; raises a ConfigurationError if the content was changed."""
    try:
        document = json.loads(content)
        rest = {k: value for k, value in document.items() if k != CHECKSUM} if isinstance(document, dict) else {}
        if not rest or document.get(CHECKSUM) != checksum(rest):
            changed = "its checksum is not that of its content"
            raise ValueError(changed if rest and CHECKSUM in document else "no checksum, as in older versions")
        return rest
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(key, str(error), f"an unchanged file from {made_by}") from None
