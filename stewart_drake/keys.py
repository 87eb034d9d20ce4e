"""Keys of a scenario as texts, such as `robot.rod_length`: taken apart, read, set."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from stewart_drake.config import meant, shown
from stewart_drake.errors import ConfigurationError

_KEY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*|\[(?:0|[1-9]\d{0,5})\])*")


def split_key(key: str) -> tuple[str | int, ...]:
    """Names and indices in a key such as `robot.rod_length` or `initial_offset[0]`; else a `ConfigurationError`."""
    if _KEY.fullmatch(key) is None:
        raise ConfigurationError(shown(key), key, "a key such as robot.rod_length or initial_offset[0]")
    return tuple(int(index) if index else name for name, index in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", key))


def value_at(data: Mapping[str, Any], key: str) -> Any:
    """Value of a key in a scenario, given in plain values; a `ConfigurationError` where it has no such key."""
    here: Any = data
    where: list[str] = []
    for part in split_key(key):
        inside = ".".join(where) or "the scenario"
        if isinstance(part, int):
            if not isinstance(here, list):
                raise ConfigurationError(key, here, f"a key without [{part}]; {inside} is not a list")
            if part >= len(here):
                raise ConfigurationError(key, part, f"a component from 0 to {len(here) - 1}")
        elif not isinstance(here, dict):
            hint = "; `mismatch: true` fills it" if inside == "model_robot" and here is None else ""
            raise ConfigurationError(key, here, f"a key in a section; {inside} is not a section{hint}")
        elif part not in here:
            guess = meant(part, here)
            has = f"{' ' if guess else '; '}{inside} has {', '.join(here)}"
            raise ConfigurationError(shown(key), part, f"no such key{guess}{has}")
        here = here[part]
        where.append(str(part))
    return here


def set_component(data: Any, full: Any, key: str, value: Any) -> None:
    """Sets what a key with indices names in plain values; what is null in `data` is filled from `full` as needed.

    Raises:
        ConfigurationError: The scenario has no such key.
    """
    value_at(full, key)
    *parents, last = split_key(key)
    for part in parents:
        full = full[part]
        if (data.get(part) if isinstance(data, dict) else data[part]) is None:
            data[part] = [{} if isinstance(each, dict) else each for each in full] if isinstance(full, list) else {}
        data = data[part]
    data[last] = value
