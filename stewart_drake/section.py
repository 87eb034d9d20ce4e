"""Parts of a scenario: types of their values, checks that refuse a value, and what is wrong in one line."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, Field, Strict, ValidationError

from stewart_drake.errors import ConfigurationError

Real = Annotated[float, Strict()]
"""A real number; an integer will do."""
Count = Annotated[int, Strict()]

# The same with bounds for editors, by way of the JSON schema; what refuses a value is the section's own check.
Positive = Annotated[float, Strict(), Field(json_schema_extra={"exclusiveMinimum": 0.0})]
NotNegative = Annotated[float, Strict(), Field(json_schema_extra={"minimum": 0.0})]
Fraction = Annotated[float, Strict(), Field(json_schema_extra={"exclusiveMinimum": 0.0, "exclusiveMaximum": 1.0})]
Share = Annotated[float, Strict(), Field(json_schema_extra={"minimum": 0.0, "maximum": 1.0})]
Leg = Annotated[int, Strict(), Field(json_schema_extra={"minimum": 0, "maximum": 5})]
Natural = Annotated[int, Strict(), Field(json_schema_extra={"minimum": 0})]
Flag = Annotated[bool, Strict()]
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""

SECTION: Any = {"extra": "forbid", "allow_inf_nan": False, "use_attribute_docstrings": True}
"""How pydantic reads a plain dataclass as a section of a scenario; its docstrings become the schema's descriptions."""


def plain(value: Any) -> Any:
    """Numpy's numbers as Python's, and lists and arrays of one axis as tuples; anything else as it is."""
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim == 1):
        return tuple(plain(x) for x in value)
    return value


def is_finite(value: Any) -> bool:
    """Whether a value is a finite number; a truth value or a text that looks like one is none."""
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


MAX_SEED = 2**63 - 1


def check_real(
    key: str,
    value: Any,
    low: float = 0.0,
    allowed: str = "a finite number, zero or positive",
    high: float = math.inf,
) -> None:
    """Raises a `ConfigurationError` for what is not a finite number from `low` to `high`."""
    if not (is_finite(value) and low <= value <= high):
        raise ConfigurationError(key, value, allowed)


def check_positive(key: str, *values: Any, allowed: str = "a positive number") -> None:
    """Raises a `ConfigurationError` for what is not a finite number above 0."""
    for value in values:
        check_real(key, value, float(np.finfo(float).tiny), allowed)


def check_fraction(key: str, value: Any) -> None:
    """Raises a `ConfigurationError` for what is not a number strictly between 0 and 1."""
    if not (is_finite(value) and 0.0 < value < 1.0):
        raise ConfigurationError(key, value, "a number between 0 and 1")


def check_whole(key: str, value: Any, low: int, high: int, allowed: str | None = None) -> None:
    """Raises a `ConfigurationError` for what is not a whole number from `low` to `high`."""
    if type(value) is not int or not low <= value <= high:
        raise ConfigurationError(key, value, allowed or f"a whole number from {low} to {high}")


def check_seed(key: str, seed: Any) -> None:
    """Raises a `ConfigurationError` for what is no seed."""
    check_whole(key, seed, 0, MAX_SEED)


def check_leg(key: str, leg: Any) -> None:
    """Raises a `ConfigurationError` for what is no leg."""
    check_whole(key, leg, 0, 5, "a leg, 0 to 5")


def check_other_leg(key: str, kind: str, leg: Any, other: Any) -> None:
    """Raises a `ConfigurationError` unless two swapped legs are two, and only they have an `other`."""
    if kind != "swapped":
        if other is not None:
            raise ConfigurationError(key, other, "null, but for kind swapped")
        return
    check_leg(key, other)
    if other == leg:
        raise ConfigurationError(key, other, f"another leg than {leg}")


def check_choice(key: str, value: Any, *choices: str) -> None:
    """Raises a `ConfigurationError` for what is none of at least two choices."""
    if not isinstance(value, str) or value not in choices:
        raise ConfigurationError(key, value, f"{', '.join(choices[:-1])} or {choices[-1]}")


def check_numbers(key: str, values: Any, size: int, allowed: str | None = None) -> None:
    """Raises a `ConfigurationError` for what is not so many finite numbers."""
    if not are_numbers(values, size):
        raise ConfigurationError(key, values, allowed or f"{size} finite numbers")


def check_positive_pair(key: str, pair: Any, allowed: str) -> None:
    """Raises a `ConfigurationError` for what is not two finite numbers above 0."""
    if not (are_numbers(pair, 2) and all(x > 0.0 for x in pair)):
        raise ConfigurationError(key, pair, allowed)


def are_numbers(values: Any, size: int) -> bool:
    """Whether `values` are so many finite numbers."""
    values = plain(values)
    return isinstance(values, tuple) and len(values) == size and all(is_finite(x) for x in values)


_UNKNOWN_KEY = {"extra_forbidden", "unexpected_keyword_argument"}
_BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
_WORDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
_NOUNS: dict[Any, str] = {float: "number", int: "whole number", str: "text"}
_SHOWN_KEY = 60


def explain(root: type, error: ValidationError, data: Any, section: str = "") -> ConfigurationError:
    """The first problem of pydantic's report, in one line, under the key as the user wrote it.

    Args:
        root: Class of the scenario, or of one section of it.
        error: The report.
        data: What was validated.
        section: Key of that section.
    """
    problems = error.errors(include_url=False)
    # A mistyped key that is required shows up twice; as an unknown key the message can name the right one.
    first = next((problem for problem in problems if problem["type"] in _UNKNOWN_KEY), problems[0])
    kind, location, value = first["type"], list(first["loc"]), first["input"]
    context: dict[str, Any] = first.get("ctx", {})
    keys = _keys_written(location, data)
    expected = _type_at(root, location)

    if kind in _UNKNOWN_KEY:
        allowed = _known_keys(_members(_type_at(root, location[:-1]))[0], str(location[-1]))
    elif kind == "missing" and isinstance(location[-1], int):
        keys, allowed = keys[:-1], _describe(_type_at(root, location[:-1]))
    elif kind == "missing":
        value, allowed = None, f"{_describe(expected)}; this key is required"
    elif kind == "union_tag_invalid":
        keys.append("kind")
        value, allowed = value["kind"], _kinds(expected)
    elif kind == "union_tag_not_found":
        keys.append("kind")
        value, allowed = None, f"{_kinds(expected)}; this key is required"
    elif kind in _BOUNDS:
        allowed = _describe(expected, _bounds(root, location))
    elif kind == "finite_number":
        allowed = _describe(expected, _bounds(root, location), finite="finite ")
    elif kind == "string_pattern_mismatch":
        allowed = "letters, digits and _, and after the first of them space and . + - too"
    elif kind in ("string_too_short", "string_too_long"):
        (size,) = context.values()
        allowed = f"a text of at {'least' if kind == 'string_too_short' else 'most'} {size} characters"
    elif kind == "invalid_key":
        allowed = "keys that are texts"
    else:
        allowed = _describe(expected, _bounds(root, location))
        if isinstance(value, str) and _is_number(value) and "number" in allowed:
            allowed += " (without quotes)"
    if len(problems) > 1:
        allowed += f" (and {len(problems) - 1} more problem{'s' if len(problems) > 2 else ''})"
    keys = [section, *keys] if section else keys
    return ConfigurationError(".".join(map(shown, keys)) or "scenario", value, allowed)


def keys_of(section: Any) -> list[str]:
    """Keys of a section of the scenario, given its class."""
    if isinstance(section, type) and issubclass(section, BaseModel):
        return list(section.model_fields)
    return [field.name for field in dataclasses.fields(section)] if dataclasses.is_dataclass(section) else []


def kind_class(root: type, key: str, kind: Any) -> type | None:
    """The class that a section with a `kind` has for that kind; None where there is no such kind."""
    return next((member for member in _members(get_type_hints(root)[key]) if _kind(member) == kind), None)


def shown(key: str) -> str:
    """A key as one short line, whatever is in it."""
    key = key if key and key.isprintable() else repr(key)
    return key if len(key) <= _SHOWN_KEY else f"{key[: _SHOWN_KEY - 3]}..."


def _keys_written(location: Iterable[int | str], data: Any) -> list[str]:
    """The parts of pydantic's location that the user wrote: the tag of a union is none of them."""
    location = list(location)
    keys: list[str] = []
    here: Any = data
    for depth, part in enumerate(location):
        here = vars(here) if dataclasses.is_dataclass(here) else here
        inside = (isinstance(here, Mapping) and part in here) or (
            isinstance(here, (list, tuple)) and isinstance(part, int) and part < len(here)
        )
        if inside:
            here = here[part]
            keys.append(str(part))
        elif depth == len(location) - 1 and part != "[key]":
            keys.append(str(part))
    return keys


def _type_at(root: Any, location: Iterable[int | str]) -> Any:
    """The annotation at a location of pydantic's report."""
    here = root
    for part in location:
        members = _members(here)
        tagged = [member for member in members if part == _kind(member)]
        if tagged and part not in keys_of(tagged[0]):
            here = tagged[0]
            continue
        here = members[0] if len(members) == 1 else here
        if part in keys_of(here):
            here = get_type_hints(here)[part]
        elif get_origin(here) is tuple and isinstance(part, int):
            here = get_args(here)[0 if Ellipsis in get_args(here) else part]
        else:
            return None
    return here


def _bounds(root: Any, location: Sequence[int | str]) -> str:
    """All bounds of a key in words, such as " above 0, at most 10"; empty for none."""
    if not location:
        return ""
    *parents, last = location
    (owner, *_) = _members(_type_at(root, parents)) if parents else [root]
    if not (isinstance(owner, type) and issubclass(owner, BaseModel)) or last not in owner.model_fields:
        return ""
    metadata = list(owner.model_fields[str(last)].metadata)
    for member in get_args(owner.model_fields[str(last)].annotation):
        for part in get_args(member):
            metadata += getattr(part, "metadata", [])
    found = [
        f"{word} {getattr(each, name):g}" for each in metadata for name, word in _WORDS.items() if hasattr(each, name)
    ]
    return f" {', '.join(found)}" if found else ""


def _members(annotation: Any) -> list[Any]:
    """The types of a union without None; a list of itself for any other type."""
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, types.UnionType):
        return [member for member in get_args(annotation) if member is not type(None)]
    return [annotation]


def _kind(section: Any) -> Any:
    """Value of `kind` in a section's class; None where it has none, or several to choose from."""
    if "kind" not in keys_of(section):
        return None
    kinds = get_args(get_type_hints(section)["kind"])
    return kinds[0] if len(kinds) == 1 else None


def _kinds(annotation: Any) -> str:
    return _either([str(_kind(member)) for member in _members(annotation)])


def _describe(annotation: Any, bound: str = "", finite: str = "") -> str:
    """A type in words, with its bound."""
    members = _members(annotation)
    suffix = ", or null" if type(None) in get_args(annotation) else ""
    if len(members) > 1:
        return f"a section, with kind: {_kinds(annotation)}{suffix}"
    (one,) = members
    if get_origin(one) is Literal:
        return _either([str(option) for option in get_args(one)]) + suffix
    if one is bool:
        return f"true or false{suffix}"
    if keys_of(one):
        return f"a section, with keys such as {', '.join(keys_of(one)[:3])}{suffix}"
    return f"a {finite}{_noun(one)}{bound}{suffix}"


def _noun(annotation: Any) -> str:
    if get_origin(annotation) is tuple:
        first, *rest = get_args(annotation)
        count = "" if Ellipsis in rest else f"{len(rest) + 1} "
        plural = _noun(first).replace("list of", "lists of") if get_origin(first) is tuple else f"{_noun(first)}s"
        return f"list of {count}{plural}"
    return "section" if keys_of(_members(annotation)[0]) else _NOUNS.get(annotation, "value of another type")


def _known_keys(section: Any, given: str) -> str:
    known = keys_of(section)
    close = difflib.get_close_matches(given, known, n=1) or [key for key in known if given and key.startswith(given)]
    guess = f", did you mean {close[0]}? The" if close else "; the"
    return f"no such key{guess} keys here are {', '.join(known)}"


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
