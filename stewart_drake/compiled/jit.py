"""numba's decorator with a cache that is fresh where all of the sources are."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

_F = TypeVar("_F", bound=Callable[..., Any])

_BESIDE = ("density.py", "estimator.py", "riccati.py")
"""Modules outside of this package whose constants its functions have compiled into them."""


def digest(folder: Path = Path(__file__).parent) -> str:
    """Of all sources that code compiled in `folder` comes from."""
    files = [*sorted(folder.glob("*.py")), *(folder.parent / name for name in _BESIDE)]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


_DIGEST = digest()


def is_kept(function: Any) -> bool:
    """Whether machine code of a function of this package lies on the disk, fresh; if not, its first call compiles."""
    try:
        return bool(function._cache._cache_file.load_index())
    except (AttributeError, OSError):
        return False


def njit(**options: Any) -> Callable[[_F], _F]:
    """`numba.njit`, with `cache` safe: numba looks at the function's own file alone, not at those of what it calls.

    After a change (or an upgrade) of one file the others would go on with what they have compiled of the old one. Where
    numba finds no place for a cache, or keeps it in another way than known here, there is none.
    """

    def decorate(function: _F) -> _F:
        try:
            compiled: Any = numba.njit(**options)(function)
            file = compiled._cache._cache_file
            file._source_stamp = file._source_stamp, _DIGEST
        except (AttributeError, RuntimeError):
            compiled = numba.njit(**{**options, "cache": False})(function)
        return compiled

    return decorate
