"""numba's decorator with a cache that is fresh where all of the sources are.

numba looks at a function's own file alone, not at those of what it calls: after a change (or an upgrade) of one file
the others would go on with what they have compiled of the old one. So there is a folder for each state of the sources.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

_F = TypeVar("_F", bound=Callable[..., Any])

_PREFIX = "stewart_drake-"
_CONFIG: Any = numba.config


def digest(folder: Path = Path(__file__).parent) -> str:
    """Of all sources that code compiled in `folder` comes from."""
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in sorted(folder.glob("*.py")))).hexdigest()


def is_kept(function: Any) -> bool:
    """Whether machine code of a function of this package lies on the disk, fresh; if not, its first call compiles."""
    path = function.stats.cache_path
    if path is None or _FOLDER is None or not Path(path).is_relative_to(_FOLDER):
        return False
    name = f"{function.py_func.__module__.rpartition('.')[2]}.{function.py_func.__qualname__}-*.nb[ci]"
    return {file.suffix for file in Path(path).glob(name)} == {".nbi", ".nbc"}


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


def _folder(name: str) -> Path | None:
    """Where machine code of these sources is kept; None where nothing can be."""
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
        except (OSError, RuntimeError):  # RuntimeError: nobody's home
            continue
        if place == own:
            for other in own.glob(f"{_PREFIX}*"):
                if other.name != name:
                    shutil.rmtree(other, ignore_errors=True)
        return folder
    return None


_FOLDER = _folder(_PREFIX + digest()[:16])
