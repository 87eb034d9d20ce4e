"""numba's decorator for laws, with one cache that is fresh for all sources.

A law is a compiled function of numbers, arrays and `records`. `NUMBA_DISABLE_JIT=1` runs the same source in Python, for
a debugger.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import caching

_F = TypeVar("_F", bound=Callable[..., Any])

_PREFIX = "compiled-"
_PACKAGE = Path(__file__).parents[1]
_OWN = _PACKAGE / "__pycache__"
_CONFIG: Any = numba.config
_FunctionCache: Any = caching.FunctionCache
_LAWS: list[Any] = []
_typeof: Any = numba.typeof
DISABLED = bool(_CONFIG.DISABLE_JIT)
"""Whether laws run in Python, by `NUMBA_DISABLE_JIT=1`."""


def njit(function: _F) -> _F:
    """Compiles a law: `numba.njit` with numpy's rules for a division by zero, without Python's lock, and with a cache.

    numba looks at a function's own file alone, not at those of what it calls. So machine code is kept in a folder for
    each state of all sources that compile anything; where there is no place for a cache, there is none.
    """
    # Nobody calls a law from C, so that entry is not compiled.
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    compiled: Any = numba.njit(**options)(function)
    _LAWS.append(compiled)
    if _FOLDER is None:
        return compiled
    before = _CONFIG.CACHE_DIR
    try:
        # Where files go is settled as a cache is made; other people's functions keep their own place.
        _CONFIG.CACHE_DIR = str(_FOLDER)
        with suppress(RuntimeError):  # the place is gone again
            compiled._cache = _Cache(function)
    finally:
        _CONFIG.CACHE_DIR = before
    return compiled


def specialised(function: Any, arguments: Sequence[Any]) -> Callable[..., Any]:
    """A law of this package for these types of arguments alone; any other function as it is.

    Which types they are is not looked up in a call, which takes as long as a small law does, and not checked.
    """
    if _CONFIG.DISABLE_JIT or not any(function is law for law in _LAWS):
        return cast("Callable[..., Any]", function)
    types = tuple(_typeof(each) for each in arguments)
    function.compile(types)
    return cast("Callable[..., Any]", function.overloads[types].entry_point)


class _Cache(_FunctionCache):
    """numba's cache of a function, whose files may be damaged, and their disk full, at any time."""

    told = False

    @contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        """Around all that loads and saves; numba's own, for Windows."""
        try:
            yield
        except Exception as error:  # of pickle any, of the disk OSError
            if not _Cache.told:
                _Cache.told = True
                why = f"{_FOLDER}: {error or type(error).__name__}"
                logging.getLogger("stewart_drake").warning(f"stewart-drake: cache of compiled code is bad, {why}")
            try:
                self.flush()
            except OSError:
                self.disable()


def source_digest() -> str:
    """sha256 of all sources of the package that compile anything, and of the versions that compile them."""
    content = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for file in sorted(_PACKAGE.rglob("*.py")):
        source = file.read_bytes()
        if b"stewart_drake.base.jit import" in source:
            content.update(source)
    return content.hexdigest()


def _folder(name: str) -> Path | None:
    """Where machine code of these sources is kept; None where nothing can be."""
    # Somebody's own choice comes first; an installation that is not ours to write to has its place at home.
    home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "stewart-drake"
    for place in [*([_CONFIG.CACHE_DIR] if _CONFIG.CACHE_DIR else []), _OWN, home]:
        try:
            folder = Path(place).expanduser().absolute() / name
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except (OSError, RuntimeError):  # RuntimeError: nobody's home
            continue
        for other in _OWN.glob(f"{_PREFIX}*") if place == _OWN else ():
            if other.name != name:
                shutil.rmtree(other, ignore_errors=True)
        return folder
    return None


_FOLDER = None if _CONFIG.DISABLE_JIT else _folder(_PREFIX + source_digest()[:16])
