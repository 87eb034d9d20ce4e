"""What is wrong with a section, in words: pydantic's report as lines that name key, value and what is allowed."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import types
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, Protocol, Union, get_args, get_origin

import numpy as np
from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from stewart_drake.errors import UNTRUSTED_CODE, ConfigurationError

TINY = float(np.finfo(float).tiny)
"""Smallest number whose reciprocal is finite: what counts as above 0."""

_UNKNOWN_KEY = {"extra_forbidden", "unexpected_keyword_argument"}
_MISSING = {"missing", "missing_keyword_only_argument"}
_NOUNS: dict[Any, str] = {float: "number", int: "whole number", str: "text", bool: "truth value"}
_SHOWN_KEY = 60
OWN = "module:Class"
"""How a kind of a user's own is written, among the `words` of a family."""


class _Family(Protocol):
    """See `families.Family`."""

    words: Sequence[str]

    def section_of(self, data: Any) -> Any:
        """Class of a section that is written, or made."""


def as_problem(error: ConfigurationError) -> PydanticCustomError:
    """An error with a key of its own section as pydantic passes it on to the sections around it."""
    context = {"key": error.key, "got": error.value, "allowed": error.allowed, "reason": error.reason}
    return PydanticCustomError("rule", "a rule", context)


def explain(root: Any, error: ValidationError, data: Any, section: str = "") -> ConfigurationError:
    """Pydantic's report in our words, under the keys as the user wrote them.

    Args:
        root: Class of the section, or a type.
        error: The report.
        data: What was validated.
        section: Key of that section.

    Returns:
        The first problem with the `others`: code that is not trusted before unknown keys, and these before the rest.
    """
    order = {key: place for place, key in enumerate(data)} if isinstance(data, dict) else {}
    reports = sorted(
        error.errors(include_url=False),
        key=lambda report: (
            report.get("ctx", {}).get("reason") != UNTRUSTED_CODE,
            report["type"] not in _UNKNOWN_KEY,
            order.get((*report["loc"], None)[0], len(order)),
        ),
    )
    # Of a list with bad entries pydantic says too that there are too few.
    places = [report["loc"] for report in reports]
    reports = [
        r for r in reports if not any(len(at) > len(r["loc"]) and at[: len(r["loc"])] == r["loc"] for at in places)
    ]
    found, guessed = [], set()
    for report in reports:
        problem, guess = _problem(root, report, data, section)
        guessed.add((problem.key.rpartition(".")[0], guess))
        # A mistyped key that is required shows up twice.
        if report["type"] not in _MISSING or problem.key.rpartition(".")[::2] not in guessed:
            found.append(problem)
    # Of a list that is too short pydantic reports each entry that is missing.
    first, *others = {str(problem): problem for problem in found}.values()
    return first.with_others(others)


def keys_of(section: Any) -> list[str]:
    """Keys of a section, given its class."""
    found = getattr(section, "__pydantic_fields__", None) or getattr(section, "__dataclass_fields__", {})
    return list(found)


def shown(key: str) -> str:
    """A key as one short line, whatever is in it."""
    key = key if key and key.isprintable() else repr(key)
    return key if len(key) <= _SHOWN_KEY else f"{key[: _SHOWN_KEY - 3]}..."


def known_keys(section: Any, given: str) -> tuple[str, str | None]:
    """What to say of a key that a section does not have, and the one that was perhaps meant."""
    known = keys_of(section)
    guess = _close(given, known)
    close = f", did you mean {guess}? The" if guess else "; the"
    return f"no such key{close} keys here are {', '.join(known)}", guess


def _problem(root: Any, report: Any, data: Any, section: str) -> tuple[ConfigurationError, str | None]:
    """One problem, and the key that an unknown one was perhaps meant to be."""
    kind, location, value = report["type"], list(report["loc"]), report["input"]
    context: dict[str, Any] = report.get("ctx", {})
    expected, unit = _type_at(root, location, data)
    keys = [str(part) for part in location if part != "[key]"]
    guess = None
    if kind == "rule":
        keys += [context["key"]] if context["key"] else []
        value, allowed = context["got"], context["allowed"]
    elif kind in _UNKNOWN_KEY:
        allowed, guess = known_keys(_section_at(root, location[:-1], data), str(location[-1]))
    elif kind in _MISSING and isinstance(location[-1], int):
        keys, allowed = keys[:-1], describe(*_type_at(root, location[:-1], data))
    elif kind in _MISSING:
        value, allowed = None, f"{describe(expected, unit)}; this key is required"
    elif kind == "string_pattern_mismatch":
        allowed = next((each for each in _metadata(expected) if isinstance(each, str)), "another text")
    elif kind == "invalid_key" or "[key]" in location:
        allowed = "keys that are texts"
    elif kind == "literal_error":
        allowed = chosen(value, [str(choice) for choice in get_args(_one(expected))]) + _or_null(expected)
    else:
        allowed = describe(expected, unit)
        if kind == "finite_number":
            allowed = allowed.replace("number", "finite number", 1)
        if isinstance(value, str) and _is_number(value) and "number" in allowed:
            allowed += " (without quotes)"
    keys = [section, *keys] if section else keys
    problem = ConfigurationError(".".join(map(shown, keys)) or "scenario", value, allowed)
    problem.reason = context.get("reason", problem.reason)
    return problem, guess


def _section_at(root: Any, location: Sequence[int | str], data: Any) -> Any:
    """Class of the section at a location."""
    here, _ = _type_at(root, location, data)
    family = _family(here)
    for part in location:
        data = _entry(data, part)
    return family.section_of(data) if family else _one(here)


def _type_at(root: Any, location: Sequence[int | str], data: Any) -> tuple[Any, str]:
    """The annotation at a location of pydantic's report, and the unit of the field."""
    here, unit = root, ""
    for part in location:
        family = _family(here)
        here = family.section_of(data) if family else _one(here)
        fields = getattr(here, "__pydantic_fields__", {})
        if part in fields:
            field = fields[part]
            here = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
            text = field.description or ""
            unit = text[: text.index("]") + 1] if text.startswith("[") and not text.startswith("[-]") else ""
        elif dataclasses.is_dataclass(here) and part in keys_of(here):
            here = inspect.get_annotations(here, eval_str=True)[str(part)]  # type: ignore[arg-type]
        elif get_origin(here) is tuple and isinstance(part, int):
            inner = get_args(here)
            size = len(inner)
            here = inner[0] if Ellipsis in inner else inner[part] if part < size else None
            units = unit[1:-1].split(", ")
            if len(units) > 1:
                unit = "" if Ellipsis in inner or part >= size else f"[{units[part * len(units) // size]}]"
        elif get_origin(here) is dict:
            here = get_args(here)[1]
        else:
            return None, ""
        data = _entry(data, part)
    return here, unit


def _entry(data: Any, part: Any) -> Any:
    if dataclasses.is_dataclass(data):
        return getattr(data, str(part), None)
    try:
        return data[part]
    except (KeyError, IndexError, TypeError):
        return None


def _family(annotation: Any) -> _Family | None:
    return next((each for each in _metadata(annotation) if hasattr(each, "section_of")), None)


def _metadata(annotation: Any) -> Iterator[Any]:
    """What stands beside a type in `Annotated`, also where it is one of a type and None."""
    if get_origin(annotation) is Annotated:
        for each in get_args(annotation)[1:]:
            yield each
            yield from getattr(each, "metadata", ())
        yield from _metadata(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, types.UnionType):
        for member in get_args(annotation):
            yield from _metadata(member)


def _one(annotation: Any) -> Any:
    """The type itself, without None and without what stands beside it."""
    while get_origin(annotation) in (Annotated, Union, types.UnionType):
        members = get_args(annotation)[:1] if get_origin(annotation) is Annotated else get_args(annotation)
        annotation = next(member for member in members if member is not type(None))
    return annotation


def _or_null(annotation: Any) -> str:
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return ", or null" if type(None) in get_args(annotation) and get_origin(annotation) is not tuple else ""


def describe(annotation: Any, unit: str = "") -> str:
    """A type in words, with its bounds, the unit of its field, and whether null will do."""
    one, suffix, family = _one(annotation), _or_null(annotation), _family(annotation)
    if family is not None:
        return f"a section, with kind: {either(family.words)}, or a kind by itself{suffix}"
    if get_origin(one) is Literal:
        return either([str(option) for option in get_args(one)]) + suffix
    if one is bool:
        return f"true or false{suffix}"
    if keys_of(one):
        return f"a section, with keys such as {', '.join(keys_of(one)[:3])}{suffix}"
    unit = f" {unit}" if unit else ""
    return f"{_with_bounds(annotation, _noun(annotation))}{unit}{suffix}"


def _with_bounds(annotation: Any, noun: str) -> str:
    """Such as: a positive number; a whole number from 1 to 10; a text of at most 80 characters."""
    found: dict[str, Any] = {}
    for each in _metadata(annotation):
        for name in ("gt", "ge", "lt", "le", "min_length", "max_length"):
            if getattr(each, name, None) is not None:
                found[name] = getattr(each, name)
    low, high = found.get("ge", found.get("gt")), found.get("le", found.get("lt"))
    least, most = found.get("min_length"), found.get("max_length")
    if least is not None or most is not None:
        sizes = [f"at {word} {size}" for word, size in (("least", least), ("most", most)) if size is not None]
        size = " and ".join(sizes)
        return f"a {noun} of {size} characters" if noun == "text" else f"a {noun.replace('of', f'of {size}', 1)}"
    above = "gt" in found or low == TINY
    if high is None:
        if low is None:
            return f"a {noun}"
        if low in (0, TINY):
            return f"a positive {noun}" if above else f"a {noun}, zero or positive"
        return f"a {noun} {'above' if above else 'of at least'} {low:g}"
    if low is None:
        return f"a {noun} {'below' if 'lt' in found else 'of at most'} {high:g}"
    if above and "lt" in found:
        return f"a {noun} between {0 if low == TINY else low:g} and {high:g}"
    if above:
        return f"a {noun} above {0 if low == TINY else low:g}, at most {high:g}"
    ends = [f"{end:d}" if isinstance(end, int) else f"{end:g}" for end in (low, high)]
    return f"a {noun} from {ends[0]} to {ends[1]}" + (" (excluded)" if "lt" in found else "")


def _noun(annotation: Any) -> str:
    """Of a type, without an article."""
    one = _one(annotation)
    if get_origin(one) in (tuple, list):
        first, *rest = get_args(one)
        count = "" if Ellipsis in rest or get_origin(one) is list else f"{len(rest) + 1} "
        inner = "section" if _family(first) or keys_of(_one(first)) else _noun(first)
        sign = "positive " if all(low == TINY for low in _lows(first)) and list(_lows(first)) else ""
        return f"list of {count}{sign}" + (inner.replace("list of", "lists of") if "list of" in inner else f"{inner}s")
    if get_origin(one) is Literal:
        return either([str(option) for option in get_args(one)])
    named = next((each for each in _metadata(annotation) if isinstance(each, str)), None)
    if one is dict or get_origin(one) is dict:
        return "section"
    return named if named and one is not str else _NOUNS.get(one, "value of another type")


def _lows(annotation: Any) -> Iterator[float]:
    return (each.ge for each in _metadata(annotation) if getattr(each, "ge", None) is not None)


def chosen(given: Any, choices: Sequence[str]) -> str:
    """Choices in words, and the one that was perhaps meant."""
    guess = _close(given, choices)
    return either(choices) + (f"; did you mean {guess}?" if guess else "")


def _close(given: Any, known: Sequence[str]) -> str | None:
    if not isinstance(given, str) or not given:
        return None
    close = difflib.get_close_matches(given, known, n=1) or [each for each in known if each.startswith(given)]
    return close[0] if close else None


def either(words: Sequence[str]) -> str:
    """Words as a list in English."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
