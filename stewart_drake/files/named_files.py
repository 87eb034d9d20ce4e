"""Files that a scenario, a sweep or a comparison names: where they are, and what is in them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from stewart_drake.files.code_path import CLASS_PATH, CodePath
from stewart_drake.files.code_trust import code_rule
from stewart_drake.files.whole import digest

FILE_KEYS = ("weights_file", "motion_file")
ROBOT_KEYS = ("robot", "model_robot")
"""At these a text is a file where it has a folder or an ending, else the name of a robot."""


def anchored(data: Any, folder: Path) -> Any:
    """A copy of plain values in which paths of weights, motions, robots and code are absolute, from `folder`.

    That is where the file lies that they come from; for a command line the current folder.
    """

    def absolute(key: str, text: str) -> str:
        named = _is_file(key, text) or (_is_code(text) and ".py:" in text)
        return text if not named or Path(text).is_absolute() else str((folder / text).absolute())

    return with_texts(data, absolute)


def file_digests(data: Any, code: Iterable[CodePath] | None = None) -> dict[str, str | None]:
    """Path of each file that is named in plain values -> sha256 of its content, None where it cannot be read.

    `code` is what is named in them, as it was; None for as it is.
    """
    own = {str(each.files[-1]): each.digest for each in (code_named(data) if code is None else code)}
    return own | {path: digest(path) for path in sorted({text for key, text in _texts(data) if _is_file(key, text)})}


def code_named(data: Any) -> list[CodePath]:
    """The user's code that is named in plain values, trusted or not."""
    with code_rule("name"):
        found = [CodePath.named(text) for text in sorted({text for _, text in _texts(data)}) if _is_code(text)]
    return [code for code in found if code.files]


def with_texts(data: Any, change: Callable[[str, str], str | None], key: str = "") -> Any:
    """A copy of plain values with each text changed, given the last part of its key, and the text.

    Of a list it is the key of the list; of `values`, from which a sweep chooses, the key above.
    """
    if isinstance(data, str):
        return change(key, data)
    if isinstance(data, Mapping):
        lasts = {name: str(name).rpartition(".")[2] for name in data}
        return {name: with_texts(data[name], change, key if last == "values" else last) for name, last in lasts.items()}
    return [with_texts(each, change, key) for each in data] if isinstance(data, (list, tuple)) else data


def _texts(data: Any) -> set[tuple[str, str]]:
    """Each text with the last part of its key."""
    found: set[tuple[str, str]] = set()
    with_texts(data, lambda *each: found.add(each))
    return found


def _is_code(text: str) -> bool:
    return re.fullmatch(CLASS_PATH, text) is not None


def _is_file(key: str, value: str) -> bool:
    """Whether a text names a file of data, given the last part of its key."""
    if key in ROBOT_KEYS:
        return Path(value).name != value or Path(value).suffix != ""
    return key in FILE_KEYS
