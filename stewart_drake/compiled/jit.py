"""numba's decorator with a cache that is fresh where all of the sources are, and whole where its checksums are.

numba looks at a function's own file alone, not at those of what it calls: after a change (or an upgrade) of one file
the others would go on with what they have compiled of the old one. And it reads its files as they are: one that is cut
off is a traceback, one flipped bit in machine code another number. So there is a folder for each state of the sources,
and in it a checksum beside each file; a file without its own is thrown away and compiled anew.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import event

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import write_atomically

_F = TypeVar("_F", bound=Callable[..., Any])

_PREFIX, _CHECKSUM = "stewart_drake-", ".sha256"
_CONFIG: Any = numba.config
_REGISTER: Any = event.register
_LOCK, _COMPILE = "numba:compiler_lock", "numba:compile"


def digest(folder: Path = Path(__file__).parent) -> str:
    """Of all sources that code compiled in `folder` comes from."""
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in sorted(folder.glob("*.py")))).hexdigest()


def is_kept(function: Any) -> bool:
    """Whether machine code of a function of this package lies on the disk, fresh; if not, its first call compiles."""
    return {file.suffix for file in _files_of(function)} == {".nbi", ".nbc"}


def njit(**options: Any) -> Callable[[_F], _F]:
    """`numba.njit`, with `cache` safe; where there is no place for a cache, there is none."""

    def decorate(function: _F) -> _F:
        if _FOLDER is None:
            return numba.njit(**{**options, "cache": False})(function)
        before = _CONFIG.CACHE_DIR
        try:
            # Where files go is settled as the decorator runs; other people's functions keep their own place.
            _CONFIG.CACHE_DIR = str(_FOLDER)
            return numba.njit(**options)(function)
        except RuntimeError:  # the place is gone again
            return numba.njit(**{**options, "cache": False})(function)
        finally:
            _CONFIG.CACHE_DIR = before

    return decorate


class _Signer(event.Listener):
    """Gives what has been compiled its checksums as soon as numba has written it, which is when it lets its lock go."""

    def __init__(self) -> None:
        self._depth = 0
        self._new: list[Any] = []

    def on_start(self, event: event.Event) -> None:
        """See `event.Listener`."""
        if event.kind == _COMPILE:
            self._new.append(event.data["dispatcher"])
        else:
            self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """See `event.Listener`."""
        if event.kind == _COMPILE:
            return
        self._depth -= 1
        if self._depth == 0:
            while self._new:
                for file in _files_of(self._new.pop()):
                    # Gone again, or no room: then it is compiled anew next time.
                    with suppress(OSError, ConfigurationError):
                        write_atomically(Path(f"{file}{_CHECKSUM}"), _checksum(file))


def _files_of(function: Any) -> Iterator[Path]:
    """Files of numba's with machine code of a function of this package."""
    path = function.stats.cache_path
    if path is None or _FOLDER is None or not Path(path).is_relative_to(_FOLDER):
        return iter(())
    module = function.py_func.__module__.rpartition(".")[2]
    return Path(path).glob(f"{module}.{function.py_func.__qualname__}-*.nb[ci]")


def _checksum(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).hexdigest().encode()


def _folder(name: str) -> Path | None:
    """Where machine code of these sources is kept, without what is not whole; None where nothing can be."""
    own = Path(__file__).parent / "__pycache__"
    # Somebody's own choice comes first; an installation that is not ours to write to has its place at home.
    places = [Path(_CONFIG.CACHE_DIR)] if _CONFIG.CACHE_DIR else []
    places += [own, Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "stewart-drake"]
    for place in places:
        folder = place.absolute() / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
            for file in folder.rglob("*.nb[ci]"):
                if not _is_whole(file):
                    file.unlink(missing_ok=True)
        except (OSError, RuntimeError):  # RuntimeError: nobody's home
            continue
        if place == own:
            for other in own.glob(f"{_PREFIX}*"):
                if other.name != name:
                    shutil.rmtree(other, ignore_errors=True)
        return folder
    return None


def _is_whole(file: Path) -> bool:
    try:
        return _checksum(file) == Path(f"{file}{_CHECKSUM}").read_bytes()
    except OSError:
        return False


_FOLDER = _folder(_PREFIX + digest()[:16])
_SIGNER = _Signer()
for _kind in (_LOCK, _COMPILE):
    _REGISTER(_kind, _SIGNER)
