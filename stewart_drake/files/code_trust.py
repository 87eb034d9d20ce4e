"""Whose code may run: what the user has said to trust, known again by its digest.

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

Rule = Literal["ask", "trust", "name"] | frozenset[str]
"""ask: code that is not trusted is refused. trust: it is trusted from now on. name: it may be named, and is not run.
Keys: this code runs and no other, as a study has one version of it."""
_RULE: ContextVar[Rule] = ContextVar("rule", default="ask")
_TRUSTED: set[str] = set()
"""Keys of code that was trusted in this process."""
_LARGEST = 10_000_000
"""[byte] of the user's file; a line takes some hundred."""


@contextmanager
def code_rule(rule: Rule) -> Iterator[None]:
    """Within it this rule holds for code that files name."""
    before = _RULE.set(rule)
    try:
        yield
    finally:
        _RULE.reset(before)


def trusting_code(trust: bool = True) -> AbstractContextManager[None]:
    """Within it code that files name is trusted, now and whenever it is the same; `trust` off changes nothing."""
    return code_rule("trust" if trust else _RULE.get())


def may_be_named() -> bool:
    """Whether code that is not trusted may be named."""
    return _RULE.get() == "name"


def is_trusted(key: str, files: Sequence[Path]) -> bool:
    """Whether code may run, given its key, see `CodePath.key`, and the files that it is in."""
    rule = _RULE.get()
    if isinstance(rule, frozenset):
        return key in rule
    known = key in _TRUSTED or is_shipped(files) or key in _kept()
    if rule == "trust" and not known:
        _keep(key)
    return known or rule == "trust"


def is_shipped(files: Sequence[Path]) -> bool:
    """Whether all files belong to the package; in a checkout `diagrams` does."""
    own = (PACKAGE, shipped_folder("scenarios").parent)
    return all(any(Path(os.path.realpath(file)).is_relative_to(each) for each in own) for file in files)


def store() -> Path:
    """The file with the keys, a line each; of one that is deleted the user is asked again."""
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    # A relative one would be in the folder of whoever wrote the scenario.
    state = state if state.is_absolute() else Path("~/.local/state").expanduser()
    return state / "stewart-drake" / "trusted_code"


def _kept() -> set[str]:
    with suppress(ConfigurationError, RuntimeError):  # RuntimeError: nobody's home
        return set(read_checked(store(), "trusted code", _LARGEST).decode(errors="replace").splitlines())
    return set()


def _keep(key: str) -> None:
    _TRUSTED.add(key)
    # Where nothing can be written, it is trusted in this process and its workers.
    with suppress(OSError, RuntimeError):
        store().parent.mkdir(parents=True, exist_ok=True)
        with store().open("a", encoding="utf-8") as stream:
            stream.write(f"{key}\n")
