"""Typed sections of scenarios, sweeps and comparisons, on pydantic; and what is wrong with one, a line a problem.

Constraints stand in the fields and make the JSON schema. A rule between fields is in the section's `rules`. A text
under a field begins with its unit in brackets, which messages repeat.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import inspect
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from functools import lru_cache, wraps
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Self, dataclass_transform

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    Strict,
    TypeAdapter,
    ValidationError,
    WrapValidator,
    model_validator,
)
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import TINY, Key, all_keys, allowed_text, join_or, keys_of, part_at, unit_and_text
from stewart_drake.base.units import in_unit, or_text, smaller_unit

MAX_SEED = 2**63 - 1


def with_message(text: str) -> WrapValidator:
    """In `Annotated`, last: what is said of a value that the type does not take."""

    def checked(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise as_problem(ConfigurationError("", value, text)) from None

    return WrapValidator(checked)


Real = Annotated[float, Strict()]
"""A finite number; an integer will do."""
Phase = Annotated[float, Strict(), Field(ge=-math.tau, le=math.tau)]
"""[rad] within a turn: more was meant in degrees."""
Count = Annotated[int, Strict()]
Positive = Annotated[float, Strict(), Field(ge=TINY)]
NotNegative = Annotated[float, Strict(), Field(ge=0.0)]
Period = Annotated[float, Strict(), Field(ge=TINY, le=1.0)]
"""[s] of a controller."""
Fraction = Annotated[float, Strict(), Field(gt=0.0, lt=1.0)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
LegNumber = Annotated[int, Strict(), Field(ge=0, le=5), with_message("a leg from 0 to 5")]
Natural = Annotated[int, Strict(), Field(ge=0)]
Seed = Annotated[int, Strict(), Field(ge=0, le=MAX_SEED)]
Window = Annotated[int, Strict(), Field(ge=1)]
"""[ticks]"""
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
NAME = r"^\w[\w .+-]*$"
NAME_WORDS = "letters, digits and _, and after the first of them space and . + - too"
"""Of a name that can be a folder's."""
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""
PositivePair = tuple[Positive, Positive]


def one_for_six(number: Any, unit: str = "") -> BeforeValidator:
    """In `Annotated` of six numbers of a type, which have one unit: a single number stands for all six."""

    def spread(given: Any) -> Any:
        if isinstance(given, (int, float)):
            try:
                check_value("", given, number, unit)
            except ConfigurationError as error:
                # What is no such number stays, and the message on it names both forms; a hint at its unit goes first.
                if "; did you mean" in error.allowed:
                    raise as_problem(ConfigurationError("", given, error.allowed)) from None
                return given
            return (given,) * 6
        return given

    return BeforeValidator(spread, json_schema_input_type=number | tuple[(number,) * 6])  # type: ignore[misc]


SixNumbers = Annotated[Vector6, one_for_six(Real)]
"""Of one unit, in the same order; one number stands for all."""


FILL: ContextVar[Callable[[type[Section], dict[str, Any]], dict[str, Any]] | None] = ContextVar("fill", default=None)
"""Adds defaults that depend on the scenario around a section, such as its robot, to the keys that were given."""


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field, Field))
class Section:
    """Base of the sections: frozen, hashable, made by keywords; `SomeSection(...)` and `from_dict` obey the same rules.

    A subclass is a pydantic dataclass without a decorator; the texts under its fields reach `help()`. Lists and numbers
    of numpy are taken as tuples and numbers. `key` is where it stands in a file, for messages of what Python makes.

    Raises:
        ConfigurationError: A value outside what its field says.
    """

    section_key: ClassVar[str] = ""
    own_keys: ClassVar[frozenset[str]] = frozenset()
    """Of sections with a `kind`: keys that mean something else in each kind, which a change of kind drops."""
    adapts: ClassVar[bool] = True
    """Whether it, or a section in it, may have defaults that depend on the scenario, see `FILL`."""
    moved_keys: ClassVar[Mapping[str, str]] = {}
    """Keys that were here -> where they are now, for messages."""
    knobs: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Keys of positive numbers that a slider of the live page sets, and what the page calls them."""
    kinds_with: ClassVar[Callable[[str], list[str]]] = lambda _: []
    """The other kinds that have a key."""
    __pydantic_validator__: ClassVar[Any]
    __pydantic_fields__: ClassVar[Mapping[str, Any]]
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]
    _text: ClassVar[str]

    def __init_subclass__(cls, key: str | None = None) -> None:
        super().__init_subclass__()
        if key is not None:
            cls.section_key = key
        # Not what it inherits: a dataclass without a text of its own gets its signature as one.
        cls._text = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
        config: Any = {"extra": "forbid", "allow_inf_nan": False, "use_attribute_docstrings": True}
        checked_dataclass(frozen=True, kw_only=True, config=config)(cls)
        texts = [f"{cls._text}\n\nKeys:"]
        for name, field in cls.__pydantic_fields__.items():
            # Pydantic looks for the texts of the class itself alone.
            inherited = (getattr(base, "__pydantic_fields__", {}).get(name) for base in cls.__mro__)
            field.description = next((each.description for each in inherited if each and each.description), None)
            texts.append(f"    {name}: {' '.join((field.description or '').split())}".rstrip(": "))
        cls.__doc__ = "\n".join(texts)
        if any(field.annotation == dict[str, Any] for field in cls.__pydantic_fields__.values()):
            cls.__hash__ = lambda self: hash(repr(self))  # type: ignore[method-assign]

        @wraps(cls.__init__)
        def init(self: Section, /, **keys: Any) -> None:
            type(self)._validated(keys, type(self).section_key, self_instance=self)

        cls.__init__ = init  # type: ignore[method-assign, assignment]

    @classmethod
    def from_dict(cls, data: Any, key: str | None = None) -> Self:
        """A section from plain values, as YAML gives them.

        Args:
            data: Keys and values.
            key: Goes before the key in messages; None takes that of the class.

        Raises:
            ConfigurationError: As for the class.
        """
        result: Self = cls._validated(data, cls.section_key if key is None else key)
        return result

    @classmethod
    def _validated(cls, data: Any, key: str, **details: Any) -> Any:
        # Numbers near the largest overflow to infinity, which the checks refuse; numpy need not say so as well.
        with np.errstate(all="ignore"):
            try:
                return cls.__pydantic_validator__.validate_python(data, **details)
            except ValidationError as error:
                raise _as_one(error, key) from None

    @model_validator(mode="wrap")
    @classmethod
    def _checked(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        """Remembers which keys were given; says what pydantic finds wrong in our words, wherever the section stands."""
        fill = FILL.get()
        if fill is not None and isinstance(data, cls) and data.adapts:
            data = data.given()
        given = {name: value is None for name, value in data.items()} if isinstance(data, dict) else None
        wrong: dict[str, InitErrorDetails] = {}
        try:
            if isinstance(data, dict):
                data = _without_units(cls, data, wrong)
            if given is not None:
                data = cls.with_defaults(data)
                data = data if fill is None else fill(cls, data)
            result = handler(data)
        except ConfigurationError as error:
            error.key = error.key.removeprefix(f"{cls.section_key}.")
            raise (_problems(wrong.values()) if wrong else as_problem(error)) from None
        except ValidationError as error:
            raise _in_words(error, cls, wrong=wrong) from None
        except RecursionError:
            raise as_problem(ConfigurationError("", data, "values that do not hold themselves")) from None
        if wrong:
            raise _problems(wrong.values())
        if given is not None:
            vars(result)["_given"] = given
        return result

    @classmethod
    def with_defaults(cls, given: dict[str, Any]) -> dict[str, Any]:
        """The keys that were given, and those whose default depends on them."""
        return given

    @classmethod
    def unit_of(cls, name: str) -> str:
        """What stands in brackets before the text of a field, such as `rad, m`; empty without."""
        description = getattr(cls.__pydantic_fields__.get(name), "description", None)
        return unit_and_text(description or "")[0].removesuffix("-")

    @classmethod
    def keys(cls, *, inside: bool = False) -> list[Key]:
        """Its keys: unit, text, what is allowed, default; with `inside` those of the sections in it too."""
        schema = TypeAdapter(cls).json_schema()
        return list(all_keys(schema, schema)) if inside else keys_of(schema, schema)

    def given(self) -> dict[str, Any]:
        """The keys that were given, and the kind, with their values: what is only a default is left out.

        A null that was given is null here too, whatever the scenario has put in its place.
        """
        nulls: Mapping[str, bool] = vars(self)["_given"]
        kind = {"kind": getattr(self, "kind")} if "kind" in self.__pydantic_fields__ else {}  # noqa: B009
        return kind | {name: None if null else getattr(self, name) for name, null in nulls.items()}

    def to_dict(self) -> dict[str, Any]:
        """Every key with its value, in plain types."""
        return {name: to_plain(getattr(self, name)) for name in self.__pydantic_fields__}

    def rules(self) -> None:
        """Rules between fields.

        Raises:
            ConfigurationError: Names the key in this section, its value and what is allowed.
        """

    def __post_init__(self) -> None:
        self.rules()

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        result = handler(schema)
        cls.describe(handler.resolve_ref_schema(result))
        return result

    @classmethod
    def describe(cls, schema: dict[str, Any]) -> None:
        """Adds to its JSON schema what the section and its keys are, and that a number may have a unit."""
        properties = {name: schema["properties"][name] for name in cls.__pydantic_fields__}
        schema |= {"description": cls._text, "properties": properties}
        for name, field in cls.__pydantic_fields__.items():
            if cls.unit_of(name):
                properties[name] = or_text(properties[name])
            if field.description:
                properties[name].setdefault("description", field.description)


def plain(value: Any) -> Any:
    """Numpy's numbers and truth values as Python's, lists and arrays of one axis as tuples; all else as it is."""
    if isinstance(value, (np.floating, np.integer, np.bool_)):
        return value.item()
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim == 1):
        return tuple(plain(x) for x in value)
    return value


def to_plain(value: Any) -> Any:
    """A value of a section, or numpy's, in what JSON and YAML have."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, (str, os.PathLike)):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [to_plain(each) for each in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return {key: to_plain(each) for key, each in value.items()} if isinstance(value, Mapping) else value


def check_plain(key: str, value: Any) -> None:
    """Raises a `ConfigurationError` for what is not plain values, such as a file can hold."""
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigurationError(key, value, f"plain values, all numbers finite ({error})") from None


def check_value(key: str, value: Any, kind: Any, unit: str = "") -> None:
    """Raises a `ConfigurationError` for a value that is not of a type, such as `LegNumber` or `Vector6`."""
    try:
        _adapter(kind).validate_python(plain(value))
    except ValidationError as error:
        raise _as_one(_in_words(error, kind, kind, unit), key) from None


def number_in(key: str, text: str, unit: str) -> float:
    """The number [unit] of a text such as `0.01` or `10 mm`."""
    value = in_unit(text, key, unit)
    with contextlib.suppress(ValueError):
        value = float(value)
    check_value(key, value, float, unit)
    return float(value)


@lru_cache(maxsize=256)
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=None if isinstance(kind, type) else {"allow_inf_nan": False})


# --- what is wrong, in words ---

_NOT_IN_SCHEMA = {"dataclass_type": "a section", "invalid_key": "keys that are texts"}
"""Kind of pydantic's error -> what it expected, where the type of the value does not say it."""


def shorten(key: str) -> str:
    """A key as one short line, whatever is in it."""
    key = key if key and key.isprintable() else repr(key)
    return key if len(key) <= 60 else f"{key[:57]}..."


def did_you_mean(given: Any, known: Iterable[str]) -> str:
    """`; did you mean X?` where one of the known names is close to what was given, else nothing."""
    if not isinstance(given, str) or not given:
        return ""
    known = list(known)
    close = difflib.get_close_matches(given, known, n=1) or [each for each in known if each.startswith(given)]
    return f"; did you mean {close[0]}?" if close else ""


def choices_text(given: Any, choices: Sequence[str]) -> str:
    """Choices in words, and the one that was perhaps meant."""
    return join_or(choices) + did_you_mean(given, choices)


def unknown_key(key: Any, keys: Sequence[str], kinds: Sequence[str] = ()) -> str:
    """What is said of a key that is none of those that are there; `kinds` are others of the section that have it."""
    guess = f"; kind {join_or(kinds)} has it." if kinds else did_you_mean(key, keys)
    return f"no such key{guess}{' The' if guess else '; the'} keys here are {', '.join(keys)}"


def _unknown_here(section: Any, key: str) -> str:
    if key in section.moved_keys:
        return f"no such key; it is now {section.moved_keys[key]}"
    return unknown_key(key, list(section.__pydantic_fields__), section.kinds_with(key))


def as_problem(error: ConfigurationError) -> PydanticCustomError:
    """An error with a key of its own section as pydantic passes it on to the sections around it."""
    # Pydantic writes out all of it, but not an integer of thousands of digits.
    return PydanticCustomError("rule", "expected {allowed}", {"error": error, "allowed": error.allowed})


def _as_one(error: ValidationError, section: str) -> ConfigurationError:
    """Problems that are in our words already as one error, unknown keys first."""
    problems: dict[str, ConfigurationError] = {}
    for report in error.errors(include_url=False):
        own: ConfigurationError = report["ctx"]["error"]
        keys = [section, *(shorten(str(part)) for part in report["loc"] if part != "[key]"), own.key]
        problem = ConfigurationError(".".join(filter(None, keys)) or "scenario", own.value, own.allowed)
        problems[str(problem)] = problem
    first, *others = sorted(problems.values(), key=lambda each: not each.allowed.startswith("no such"))
    first.others = tuple(others)
    return first


def _without_units(section: Any, data: dict[str, Any], wrong: dict[str, InitErrorDetails]) -> dict[str, Any]:
    """Keys with numbers in place of texts such as `5 mm`; those with another unit go to `wrong`."""
    numbers = {}
    for name, value in data.items():
        try:
            numbers[name] = in_unit(plain(value), name, section.unit_of(name))
        except ConfigurationError as error:
            problem = as_problem(ConfigurationError("", error.value, error.allowed))
            wrong[name] = InitErrorDetails(type=problem, loc=(name,), input=value)
    return numbers


def _problems(lines: Iterable[InitErrorDetails]) -> ValidationError:
    return ValidationError.from_exception_data("section", list(lines))


def _in_words(
    error: ValidationError,
    section: Any,
    kind: Any = None,
    unit: str = "",
    wrong: Mapping[str, InitErrorDetails] = MappingProxyType({}),
) -> ValidationError:
    """Pydantic's report on a section, or on a value of a type and unit, in our words; `wrong` keys were left out."""
    fields: Mapping[str, Any] = getattr(section, "__pydantic_fields__", {})
    lines: list[InitErrorDetails] = [*wrong.values()]
    for report in error.errors(include_url=False):
        location, value, context = report["loc"], report["input"], report.get("ctx", {})
        if location and location[0] in wrong:
            continue
        if report["type"] == "unexpected_keyword_argument":
            key = str(location[-1])
            problem = as_problem(ConfigurationError("", value, _unknown_here(section, key)))
        elif report["type"] == "rule":
            problem = PydanticCustomError("rule", "expected {allowed}", context)
        else:
            last = location[-1] if location else ""
            field = fields.get(str(location[0])) if location else None
            if field is not None:
                kind, unit = field.annotation, section.unit_of(str(location[0]))
                kind = Annotated[(kind, *field.metadata)] if field.metadata else kind
            if report["type"].startswith("missing") and isinstance(last, str):
                value, allowed = None, f"a value{unit and f' [{unit}]'}; this key is required"
            else:
                # Of a list that is too short, the list.
                path = [part for part in location[field is not None :] if report["type"] != "missing"]
                allowed = _NOT_IN_SCHEMA.get(report["type"]) or _allowed(kind, path, unit)
                if report["type"] == "finite_number":
                    allowed = allowed.replace("number", "finite number", 1)
                allowed += did_you_mean(value, re.findall("'([^']*)'", context.get("expected", "")))
                allowed += _fitting_unit(value, context, unit)
            if report["type"] == "missing" and isinstance(last, int):  # of a list that is too short
                location = location[:-1]
            problem = as_problem(ConfigurationError("", value, allowed))
        lines.append(InitErrorDetails(type=problem, loc=location, input=value))
    return _problems(lines)


def _allowed(kind: Any, path: Sequence[int | str], unit: str) -> str:
    """What a type takes at a path inside of it, such as an index, in words."""
    root = _adapter(kind).json_schema()
    part, unit = part_at(root, root, path, unit)
    return allowed_text(part, root, unit)


def _fitting_unit(value: Any, context: Mapping[str, Any], unit: str) -> str:
    if "le" not in context and "lt" not in context:
        return ""
    return smaller_unit(value, unit, lambda each: each <= context.get("le", context.get("lt")))


def unit_hints(section: Any, largest: Mapping[str, float], key: str = "") -> list[str]:
    """A sentence for each number of a section that is larger than its unit allows, but not in a smaller one."""
    hints = []
    for name in section.__pydantic_fields__:
        value, units = getattr(section, name), section.unit_of(name).split(", ")
        place = f"{key or section.section_key}.{name}"
        if isinstance(value, tuple) and value and isinstance(value[0], Section):
            hints += [hint for k, each in enumerate(value) for hint in unit_hints(each, largest, f"{place}[{k}]")]
        if isinstance(value, Section):
            hints += unit_hints(value, largest, place)
        flat = list(np.ravel(np.array(value, dtype=object))) if isinstance(value, (int, float, tuple)) else []
        length = 6 if len(flat) % 6 == 0 else max(1, len(flat))
        for index, number in enumerate(flat):
            unit = units[index % length * len(units) // length]
            most = largest.get(unit, float("inf"))
            if isinstance(number, (int, float)) and abs(number) > most:
                other = smaller_unit(float(number), unit, lambda each, most=most: abs(each) <= most)  # type: ignore[misc]
                hints.append(f"{place} has {number:g} {unit}{other}")
    return hints
