"""Whose code may run: what the user has said to trust, known again by the digest of the code.

It is kept in a file of the user's own, which whoever writes a scenario has no say in.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Literal

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import PACKAGE, read_checked
from stewart_drake.files.yaml_files import shipped_folder

_LARGEST = 10_000_000
"""[byte] of the user's file; a line takes some hundred."""

_Rule = Literal["ask", "trust", "name"] | frozenset[str]
_RULE: ContextVar[_Rule] = ContextVar("rule", default="ask")
_TRUSTED: set[str] = set()
"""Keys of code that was trusted in this process."""


def trusting_code(trust: bool = True) -> AbstractContextManager[None]:
    """Within it the code that files name is trusted, and whenever it is the same from then on.

    Args:
        trust: False changes nothing.
    """
    return _ruled("trust" if trust else _RULE.get())


def naming_code() -> AbstractContextManager[None]:
    """Within it files may name code that is not trusted; that code is not run."""
    return _ruled("name")


def only_code(keys: frozenset[str]) -> AbstractContextManager[None]:
    """Within it this code is trusted, and no other: a study runs one version of it, wherever its workers are."""
    return _ruled(keys)


@contextmanager
def _ruled(rule: _Rule) -> Iterator[None]:
    before = _RULE.set(rule)
    try:
        yield
    finally:
        _RULE.reset(before)


def is_trusted(key: str, files: Sequence[Path]) -> bool:
    """Whether code may run.

    Args:
        key: Digest and name.
        files: That it is in.
    """
    rule = _RULE.get()
    if isinstance(rule, frozenset):
        return key in rule
    if key in _TRUSTED or is_shipped(files) or key in _kept():
        return True
    if rule == "trust":
        _keep(key)
    return rule == "trust"


def may_be_named() -> bool:
    """Whether a file may name code that is not trusted."""
    return _RULE.get() == "name"


def how_to_trust(source: str) -> str:
    """What to do about code that is not trusted, given where it is."""
    if isinstance(_RULE.get(), frozenset):
        return "the code that the study began with; it has changed since, and --restart begins anew"
    return f"code that you trust; it is new or has changed: read {source}, then say --trust-code (trust_code=True)"


def is_shipped(files: Sequence[Path]) -> bool:
    """Whether all files belong to the package; in a checkout `diagrams` does."""
    own = (PACKAGE, shipped_folder("scenarios").parent)
    return all(any(Path(os.path.realpath(file)).is_relative_to(each) for each in own) for file in files)


def store() -> Path:
    """The file with the keys, a line each; who deletes a line is asked again."""
    return Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "stewart-drake" / "trusted_code"


def _kept() -> set[str]:
    # There may be nobody's home.
    with suppress(ConfigurationError, RuntimeError):
        return set(read_checked(store(), "trusted code", _LARGEST).decode(errors="replace").splitlines())
    return set()


def _keep(key: str) -> None:
    _TRUSTED.add(key)
    # Where nothing can be written, it is trusted in this process and its workers.
    with suppress(OSError, RuntimeError):
        store().parent.mkdir(parents=True, exist_ok=True)
        with store().open("a", encoding="utf-8") as stream:
            stream.write(f"{key}\n")
