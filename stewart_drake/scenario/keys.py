"""Keys of a scenario such as `robot.legs[2].rod_length`: the value at one, and options with some values changed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from stewart_drake.base.code import ROBOT_KEY
from stewart_drake.base.config import Section, shorten, unknown_key
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import Family
from stewart_drake.robot.robot_files import robot_section

if TYPE_CHECKING:
    from stewart_drake.scenario.control_options import ControlOptions

_Options = TypeVar("_Options", bound="ControlOptions")
_KEY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*|\[(?:0|[1-9]\d{0,5})\])*")


def split_key(key: str) -> tuple[str | int, ...]:
    """Names and indices in a key such as `robot.rod_length` or `initial_offset[0]`; else a `ConfigurationError`."""
    if _KEY.fullmatch(key) is None:
        raise ConfigurationError(shorten(key), key, "a key such as robot.rod_length or initial_offset[0]")
    return tuple(int(index) if index else name for name, index in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", key))


def value_at(data: Mapping[str, Any], key: str) -> Any:
    """Value of a key in a scenario, given in plain values; a `ConfigurationError` where it has no such key."""
    here: Any = data
    inside = "the scenario"
    for part in split_key(key):
        if isinstance(part, str) and isinstance(here, dict) and part not in here:
            raise ConfigurationError(shorten(key), part, unknown_key(part, list(here)))
        _refuse_part(key, here, part, inside)
        here, inside = here[part], str(part)
    return here


def unit_at(section: Any, key: str) -> str:
    """Unit of a key of a section, such as `rad` of `initial_offset[0]`; empty where it has none."""
    units, here = "", section
    for part in split_key(key):
        if isinstance(part, str):
            units, here = here.unit_of(part) if isinstance(here, Section) else "", getattr(here, part, None)
        else:
            several = units.split(", ")
            units, here = several[part * len(several) // len(here)], here[part]
    return units


def _refuse_part(key: str, here: Any, part: str | int, inside: str) -> None:
    """Raises a `ConfigurationError` where what a key goes into is no section, or no list that is long enough."""
    if isinstance(part, str) and not isinstance(here, dict):
        hint = "; `mismatch: true` fills it" if key.startswith("model.robot.") and here is None else ""
        raise ConfigurationError(key, here, f"a section with this key, which {inside} is not{hint}")
    if isinstance(part, int) and not (isinstance(here, list) and part < len(here)):
        has = f"components from 0 to {len(here) - 1}" if isinstance(here, list) else "no components"
        raise ConfigurationError(key, here, f"an existing key: {inside} has {has}")


def with_keys(kind: type[_Options], data: dict[str, Any], changes: Mapping[str, Any]) -> _Options:
    """A section of given keys and values with some of them changed."""
    families = {
        name: family
        for name, field in kind.__pydantic_fields__.items()
        for family in field.metadata
        if isinstance(family, Family)
    }
    components = {key: value for key, value in changes.items() if "[" in key}
    for key, value in changes.items():
        if key not in components:
            _assign(data, key, value, {}, families)
    section = kind.from_dict(data)
    if not components:
        return section
    # Components are those of lists in full, defaults included.
    data, full = section.given(), section.in_full()
    for key, value in components.items():
        _assign(data, key, value, full, families)
    return kind.from_dict(data)


def _assign(data: dict[str, Any], key: str, value: Any, full: Any, families: Mapping[str, Family]) -> None:
    """Sets a key; what is changed inside is a copy, and a list that was not given is filled from `full`."""
    *parents, last = path = split_key(key)
    here: Any = data
    for depth, part in enumerate(parents):
        at = isinstance(full, list) and isinstance(part, int)
        full = full.get(part) if isinstance(full, dict) else full[part] if at else None
        inside = _opened(part, families if depth == 0 else {}, here.get(part) if isinstance(here, dict) else here[part])
        if inside is None:
            inside = [{} if isinstance(each, dict) else each for each in full] if isinstance(full, list) else {}
        _refuse_part(key, inside, path[depth + 1], str(part))
        here[part] = inside
        here = inside
    if last == "kind" and len(parents) == 1 and parents[0] in families:
        family = families[str(parents[0])]
        old, new = family.resolve(here), family.resolve({"kind": value})
        if old is not None and new is not None:
            for name in set(old.__pydantic_fields__) - (set(new.__pydantic_fields__) - new.own_keys):
                if old.drops_keys or here.get(name) == old.__pydantic_fields__[name].default:
                    here.pop(name, None)
    here[last] = value


def _opened(name: str | int, families: Mapping[str, Family], value: Any) -> Any:
    """A copy of what stands at a key, to change something in it; `families` are those of keys here."""
    if name == ROBOT_KEY and isinstance(value, str):
        value = robot_section(value)
    elif name in families:
        value = families[str(name)].normalise(value)
    if isinstance(value, Section):
        return value.given()
    return list(value) if isinstance(value, (list, tuple)) else dict(value) if isinstance(value, Mapping) else value
