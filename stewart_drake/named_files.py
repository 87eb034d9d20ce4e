"""Files that a scenario, a sweep or a comparison names: where they are, and what is in them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_CLASS = re.compile(r"(?P<file>.+\.py)(?P<name>:[A-Za-z_]\w*)")
"""A class in a file, as `controller.system` has it."""
FILE_KEYS = ("weights_file", "motion_file")


def anchor_files(data: Any, folder: Path) -> None:
    """Makes relative paths of weights, motion and controller files absolute, from `folder`, however deep they are."""
    for section, key in _places(data):
        path, name = _split(section[key])
        # A path that is absolute stays as written.
        if not Path(path).is_absolute():
            section[key] = f"{(folder / path).absolute()}{name}"


def file_digests(data: Any) -> dict[str, str | None]:
    """Path of each file named in `data` -> sha256 of its content, None where it cannot be read.

    Args:
        data: Plain values: sections, lists, and under dotted keys such as `tuner.weights_file` what a sweep chooses
            from.
    """
    paths = {_split(section[key])[0] for section, key in _places(data)}
    return {path: _digest(Path(path)) for path in sorted(paths)}


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Sections or lists, and the key or index in them, at which a file is named."""
    waiting: list[tuple[str, Any]] = [("", data)]
    seen = set()
    while waiting:
        name, section = waiting.pop()
        # By way of an alias a YAML section can hold itself.
        if id(section) in seen:
            continue
        seen.add(id(section))
        if isinstance(section, (list, tuple)):
            waiting.extend((name, value) for value in section)
        if not isinstance(section, dict):
            continue
        for key, value in section.items():
            leaf = str(key).rpartition(".")[2]
            if _is_file(leaf, value):
                yield section, key
            # What a sweep chooses from lies in a list under `values`.
            elif leaf == "values" and name in (*FILE_KEYS, "system") and isinstance(value, list):
                yield from ((value, index) for index, path in enumerate(value) if _is_file(name, path))
            else:
                waiting.append((leaf, value))


def _is_file(key: str, value: Any) -> bool:
    """Whether a value names a file, given the last part of its key."""
    if not isinstance(value, str):
        return False
    return key in FILE_KEYS or (key == "system" and _CLASS.fullmatch(value) is not None)


def _split(value: str) -> tuple[str, str]:
    """Path, and for a controller's class the colon and its name."""
    match = _CLASS.fullmatch(value)
    return (match["file"], match["name"]) if match else (value, "")


def _digest(path: Path) -> str | None:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError):
        return None
