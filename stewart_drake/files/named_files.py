"""Files that a scenario, a sweep or a comparison names: where they are, and what is in them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from stewart_drake.files.code_path import CodePath, code_in, file_of
from stewart_drake.files.whole import digest

FILE_KEYS = ("weights_file", "motion_file")
ROBOT_KEYS = ("robot", "model_robot")
"""At these a text is a file where it has a folder or an ending, else the name of a robot."""


def anchored(data: Any, folder: Path) -> Any:
    """A copy in which relative paths of weights, motions, robots and code are absolute, from `folder`, at any depth.

    Args:
        data: Plain values of a YAML file or a command line.
        folder: Where that file lies; for a command line the current folder.
    """

    def from_folder(key: str, text: str) -> str:
        code = file_of(text)
        if code is not None:
            # Without `..`, and not where links lead: this very path is what is opened.
            return f"{os.path.abspath(folder / code[0])}:{code[1]}"  # noqa: PTH100
        return str((folder / text).absolute()) if _is_file(key, text) else text

    return with_texts(data, from_folder)


def file_digests(data: Any) -> dict[str, str | None]:
    """Path of each file of data that is named in `data` -> sha256 of its content, None where it cannot be read.

    Args:
        data: Plain values: sections, lists, and under dotted keys such as `tuner.weights_file` what a sweep chooses
            from.
    """
    paths: set[str] = set()
    _each_text(data, lambda key, text: paths.add(text) if _is_file(key, text) else None)
    return {path: digest(path) for path in sorted(paths)}


def code_named(data: Any) -> list[CodePath]:
    """The user's code that is named in plain values, trusted or not."""
    texts: set[str] = set()
    _each_text(data, lambda _, text: texts.add(text))
    return code_in(texts)


def with_texts(data: Any, change: Callable[[str, str], str], key: str = "") -> Any:
    """A copy of plain values with each text changed.

    Args:
        data: Plain values.
        change: Called with the last part of the key at which a text stands, alone or in a list, and the text. Under
            `values`, as of a distribution, it is the key above.
        key: At which `data` stands.
    """
    if isinstance(data, str):
        return change(key, data)
    if isinstance(data, Mapping):
        leaves = {name: str(name).rpartition(".")[2] for name in data}
        return {
            name: with_texts(value, change, key if leaves[name] == "values" else leaves[name])
            for name, value in data.items()
        }
    return [with_texts(each, change, key) for each in data] if isinstance(data, (list, tuple)) else data


def _each_text(data: Any, look: Callable[[str, str], None]) -> None:
    def unchanged(key: str, text: str) -> str:
        look(key, text)
        return text

    with_texts(data, unchanged)


def _is_file(key: str, value: str) -> bool:
    """Whether a text names a file of data, given the last part of its key."""
    if key in ROBOT_KEYS:
        return Path(value).name != value or Path(value).suffix != ""
    return key in FILE_KEYS
