"""Files that a scenario, a sweep or a comparison names: where they are, and what is in them."""

from __future__ import annotations

import copy
import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.user_code import split_path
from stewart_drake.files.whole import open_checked, read_checked

MAX_BYTES = 100_000_000
"""Of any file that is named."""
CLASS_LISTS = ("disturbances", "metrics", "monitors", "parts")
"""Keys of lists in which a class may stand by its path alone."""
CLASS_KEYS = ("system", "kind", "controller", "reference", "motion", *CLASS_LISTS)
"""Of a class in a file."""
FILE_KEYS = ("weights_file", "motion_file")
ROBOT_KEYS = ("robot", "model_robot")
"""At these a text is a file where it has a folder or an ending, else the name of a robot."""


def anchor_files(data: Any, folder: Path) -> None:
    """Makes relative paths of files of weights, motions, robots and controllers absolute, from `folder`, at any depth.

    Args:
        data: Plain values of a YAML file or a command line; they have not been through here before.
        folder: Where that file lies; for a command line the current folder.

    Raises:
        ConfigurationError: The file of a controller, whose code would be run, lies elsewhere than in `folder` or below.
    """
    for section, key, place in _places(data):
        path, name = _split(section[key])
        if name:
            # As written, without `..`, and not where links lead: this very path is what is opened.
            top = os.path.abspath(folder)  # noqa: PTH100 - Path.absolute leaves `..` in
            found = os.path.normpath(os.path.join(top, path))  # noqa: PTH118
            if not Path(found).is_relative_to(top):
                raise ConfigurationError(place, section[key], f"a file in {top} or below")
            section[key] = f"{found}{name}"
        elif not Path(path).is_absolute():
            section[key] = str((folder / path).absolute())


def take_code_along(scenario: Mapping[str, Any], folder: str = "") -> tuple[dict[str, Any], dict[str, bytes]]:
    """A scenario that can be run from another folder, although it may run only what lies beside it.

    Args:
        scenario: From `Scenario.to_dict`.
        folder: Relative; where the files will lie.

    Returns:
        A copy with the files of the user's classes relative to it, and those files, name -> content.

    Raises:
        ConfigurationError: A file cannot be read.
    """
    data: dict[str, Any] = copy.deepcopy(dict(scenario))
    names: dict[Path, str] = {}
    files: dict[str, bytes] = {}
    for section, key, _ in list(_places(data)):
        text, kind = _split(section[key])
        if not kind:
            continue
        path = Path(text)
        if path not in names:
            # Of two files of one name the second gets a number.
            tries = (path.name, *(f"{path.stem}_{count}.py" for count in range(2, len(names) + 2)))
            names[path] = str(Path(folder) / next(name for name in tries if str(Path(folder) / name) not in files))
            files[names[path]] = read_checked(path, f"code file {path}", MAX_BYTES)
        section[key] = f"{names[path]}{kind}"
    return data, files


def file_digests(data: Any) -> dict[str, str | None]:
    """Path of each file named in `data` -> sha256 of its content, None where it cannot be read.

    Args:
        data: Plain values: sections, lists, and under dotted keys such as `tuner.weights_file` what a sweep chooses
            from.
    """
    paths = {_split(section[key])[0] for section, key, _ in _places(data)}
    return {path: digest(path) for path in sorted(paths)}


def digest(path: str | Path) -> str | None:
    """sha256 of a file's content; None where it cannot be read, is no regular file or larger than `MAX_BYTES`."""
    try:
        with open_checked(path, str(path), MAX_BYTES) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (ConfigurationError, OSError):
        return None


def _places(data: Any) -> Iterator[tuple[Any, Any, str]]:
    """Sections or lists, the key or index in them at which a file is named, and the whole key for messages."""
    waiting: list[tuple[str, str, Any]] = [("", "", data)]
    seen: set[tuple[str, int]] = set()
    while waiting:
        name, place, section = waiting.pop()
        # Sections made in Python can hold themselves; of one that two keys share, both count.
        if (name, id(section)) in seen:
            continue
        seen.add((name, id(section)))
        if isinstance(section, (list, tuple)):
            waiting.extend((name, f"{place}{index}.", value) for index, value in enumerate(section))
            found = (index for index, value in enumerate(section) if name in CLASS_LISTS and _is_file(name, value))
            yield from ((section, index, f"{place}{index}") for index in found)
        if not isinstance(section, dict):
            continue
        for key, value in section.items():
            leaf = str(key).rpartition(".")[2]
            if _is_file(leaf, value):
                yield section, key, f"{place}{key}"
                continue
            waiting.append((leaf, f"{place}{key}.", value))
            # What a sweep chooses from lies in a list under `values`.
            if leaf == "values" and name in (*FILE_KEYS, *ROBOT_KEYS, *CLASS_KEYS) and isinstance(value, list):
                found = (index for index, path in enumerate(value) if _is_file(name, path))
                yield from ((value, index, f"{place}{key}.{index}") for index in found)


def _is_file(key: str, value: Any) -> bool:
    """Whether a value names a file, given the last part of its key."""
    if not isinstance(value, str):
        return False
    if key in ROBOT_KEYS:
        return Path(value).name != value or Path(value).suffix != ""
    return key in FILE_KEYS or (key in CLASS_KEYS and split_path(value) is not None)


def _split(value: str) -> tuple[str, str]:
    """Path, and for a controller's class the colon and its name."""
    found = split_path(value)
    return (found[0], f":{found[1]}") if found else (value, "")
