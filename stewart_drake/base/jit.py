"""numba's decorator for laws, with a cache that depends on all sources.

A law is a compiled function of numbers, arrays and `records`. With `NUMBA_DISABLE_JIT=1` laws run in Python, for a
debugger.
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
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import caching

_F = TypeVar("_F", bound=Callable[..., object])

_PREFIX = "compiled-"
_PACKAGE = Path(__file__).parents[1]
_PYCACHE = _PACKAGE / "__pycache__"
_CONFIG: Any = numba.config
_FunctionCache: Any = caching.FunctionCache
_LAWS: list[object] = []
_typeof: Any = numba.typeof
DISABLED = bool(_CONFIG.DISABLE_JIT)  # Whether laws run in Python, by `NUMBA_DISABLE_JIT=1`.


def njit(function: _F) -> _F:
    """Compiles a law: `numba.njit` with numpy's rules for division by zero, without Python's lock, and with a cache.

    numba's cache checks only the file of a function, not those of the functions that it calls. So the name of the
    folder of compiled code has a digest of all sources of laws. Without a writable folder there is no cache.
    """
    # The entry for calls from C is not needed.
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    compiled: Any = numba.njit(**options)(function)
    _LAWS.append(compiled)
    if _FOLDER is None:
        return compiled
    before = _CONFIG.CACHE_DIR
    try:
        # A cache keeps the folder that is set when it is made; other packages' functions use the folder from before.
        _CONFIG.CACHE_DIR = str(_FOLDER)
        with suppress(RuntimeError):  # The folder no longer exists.
            compiled._cache = _Cache(function)
    finally:
        _CONFIG.CACHE_DIR = before
    return compiled


def specialised(function: Any, arguments: Sequence[object]) -> Callable[..., Any]:
    """The compiled version of a law for exactly these types; a function that is no law is returned unchanged.

    Skips numba's type dispatch, which is as slow as a small law; the types are not checked.
    """
    if _CONFIG.DISABLE_JIT or not any(function is law for law in _LAWS):
        return function
    types = tuple(map(_typeof, arguments))
    function.compile(types)
    return function.overloads[types].entry_point


class _Cache(_FunctionCache):
    """numba's cache of a function, which tolerates damaged files and a full disk."""

    warned = False

    @contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        """Replaces a method of numba that is called around loading and saving."""
        try:
            yield
        except Exception as error:  # pickle may raise any error, the disk OSError.
            if not _Cache.warned:
                _Cache.warned = True
                text = f"{_FOLDER}: {error or type(error).__name__}"
                logging.getLogger("stewart_drake").warning(f"stewart-drake: cache of compiled code is bad, {text}")
            try:
                self.flush()
            except OSError:
                self.disable()


def source_digest() -> str:
    """sha256 of all sources of laws, and of the versions of numba and numpy."""
    content = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for file in sorted(_PACKAGE.rglob("*.py")):
        source = file.read_bytes()
        if b"stewart_drake.base.jit import" in source:
            content.update(source)
    return content.hexdigest()


def _folder(name: str) -> Path | None:
    """Folder of compiled code; None if none is writable."""
    # First the user's choice, then the package, then the home folder if the package is read-only.
    home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "stewart-drake"
    for place in [*([_CONFIG.CACHE_DIR] if _CONFIG.CACHE_DIR else []), _PYCACHE, home]:
        try:
            folder = Path(place).expanduser().absolute() / name
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except (OSError, RuntimeError):  # RuntimeError: no home folder.
            continue
        for other in _PYCACHE.glob(f"{_PREFIX}*") if place == _PYCACHE else ():
            if other.name != name:
                shutil.rmtree(other, ignore_errors=True)
        return folder
    return None


_FOLDER = None if _CONFIG.DISABLE_JIT else _folder(_PREFIX + source_digest()[:16])
