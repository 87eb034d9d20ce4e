"""Keys of a scenario such as `robot.legs[2].rod_length`: the value at one, and options with some values changed."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.code import ROBOT_KEY
from stewart_drake.base.config import Section, shorten, to_plain, unknown_key
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


def value_at(data: Mapping[str, object], key: str) -> Any:
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


def _refuse_part(key: str, here: object, part: str | int, inside: str) -> None:
    """Raises a `ConfigurationError` where a key goes into no section, or no list that is long enough."""
    if isinstance(part, str) and not isinstance(here, dict):
        hint = "; `mismatch: true` fills it" if key.startswith("model.robot.") and here is None else ""
        raise ConfigurationError(key, here, f"a section with this key, which {inside} is not{hint}")
    if isinstance(part, int) and not (isinstance(here, list) and part < len(here)):
        has = f"components from 0 to {len(here) - 1}" if isinstance(here, list) else "no components"
        raise ConfigurationError(key, here, f"an existing key: {inside} has {has}")


def with_keys(
    kind: type[_Options], data: Document, changes: Mapping[str, object], trust_code: bool = False
) -> _Options:
    """A section of given keys and values with some of them changed."""
    components = {key: value for key, value in changes.items() if "[" in key}
    for key, value in changes.items():
        if key not in components:
            _assign(kind, data, key, value, {})
    section = kind.from_dict(data, trust_code=trust_code)
    if not components:
        return section
    # Components are those of lists in full, defaults included.
    data, full = section.given(), section.in_full()
    for key, value in components.items():
        _assign(kind, data, key, value, full)
    return kind.from_dict(data, trust_code=trust_code)


def _assign(section: type[Section], data: Document, key: str, value: object, full: Any) -> None:
    """Sets a key; what is changed inside is a copy, and a list that was not given is filled from `full`."""
    *parents, last = path = split_key(key)
    here: Any = data
    inner: Any = section
    found, filled = None, full
    for depth, part in enumerate(parents):
        at = isinstance(full, list) and isinstance(part, int)
        full = full.get(part) if isinstance(full, dict) else full[part] if at else None
        found = _type_at(inner, part) if isinstance(part, str) else found
        inside = _opened(part, found, here.get(part) if isinstance(here, dict) else here[part])
        if inside is None:
            inside = [{} if isinstance(part, dict) else part for part in full] if isinstance(full, list) else {}
        _refuse_part(key, inside, path[depth + 1], str(part))
        here[part] = inside
        here, inner = inside, found.resolve(inside) if isinstance(found, Family) else found
    if last == "kind" and isinstance(found, Family):
        _change_kind(key, here, value, found)
        return
    found = _type_at(inner, last) if isinstance(last, str) else found
    if isinstance(found, Family) and not isinstance(value, (Mapping, Section)):
        # A kind alone, where there is a section, is another kind of it.
        alone, present = found.normalise(value), here.get(last) if isinstance(here, dict) else here[last]
        if isinstance(alone, Mapping) and isinstance(found.normalise(present), (Mapping, Section)):
            _assign(section, data, f"{key}.kind", alone["kind"], filled)
            return
    here[last] = value


def _change_kind(key: str, here: Document, kind: object, family: Family) -> None:
    """Sets the kind of a section; keys that the new one has stay, and a line names those that are dropped."""
    old, new = family.resolve(here), family.resolve({"kind": kind})
    if old is not None and new is not None and here.get("kind", family.default) != kind:
        fields = old.__pydantic_fields__
        lost = set(here) & set(fields) - (set(new.__pydantic_fields__) - new.kind_keys)
        if dropped := sorted(name for name in lost if to_plain(here.pop(name)) != to_plain(fields[name].default)):
            name = getattr(kind, "__name__", kind)
            _log_once(f"{key}: dropped {', '.join(dropped)}, which {name} lacks or takes for something else")
    here["kind"] = kind


@lru_cache(maxsize=256)
def _log_once(line: str) -> None:
    logging.getLogger("stewart_drake").warning(f"stewart-drake: {line}")


def _type_at(section: object, name: str) -> object:
    """The family of kinds at a key of a section, or in a list there; else the class of the section there; else None."""
    field = getattr(section, "__pydantic_fields__", {}).get(name)
    types: list[object] = [] if field is None else [field.annotation, *field.metadata]
    while types:
        kind = types.pop()
        if isinstance(kind, Family) or (isinstance(kind, type) and issubclass(kind, Section)):
            return kind
        types += get_args(kind)
    return None


def _opened(name: str | int, family: object, value: object) -> object:
    """A copy of the value at a key, to change it; `family` is that of its kinds, if it has some."""
    if name == ROBOT_KEY and isinstance(value, str):
        value = robot_section(value)
    elif isinstance(family, Family):
        value = family.normalise(value)
    if isinstance(value, Section):
        return value.given()
    return list(value) if isinstance(value, (list, tuple)) else dict(value) if isinstance(value, Mapping) else value
