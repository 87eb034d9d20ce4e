"""Sections of scenarios, sweeps and comparisons, as pydantic models; and what is wrong with one, a line a problem.

Constraints are in the types of the fields and make the JSON schema. A rule between fields is in the section's `rules`.
A text under a field begins with its unit in brackets, which messages repeat.
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
from functools import lru_cache
from typing import Annotated, Any, ClassVar, NamedTuple, Self, cast

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    PrivateAttr,
    Strict,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WrapValidator,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import TINY, Key, all_keys, allowed_text, join_or, keys_of, part_at, unit_and_text
from stewart_drake.base.units import in_unit, or_text, smaller_unit, wrong_unit

MAX_SEED = 2**63 - 1


def with_message(text: str) -> WrapValidator:
    """The message for a value that a type does not take; must come last in `Annotated`."""

    def checked(value: object, handler: Callable[[object], object]) -> object:
        try:
            return handler(value)
        except ValidationError:
            raise as_problem(ConfigurationError("", value, text)) from None

    return WrapValidator(checked)


Real = Annotated[float, Strict()]
"""A finite number; integers are accepted."""
Phase = Annotated[float, Strict(), Field(ge=-math.tau, le=math.tau)]
"""[rad] within a turn; a larger number was probably meant in degrees."""
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
"""Pattern of a name that can be used for a folder."""
NAME_WORDS = "letters, digits and _, and after the first of them space and . + - too"
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""
PositivePair = tuple[Positive, Positive]


def one_for_six(number: object) -> BeforeValidator:
    """In `Annotated` of six numbers of one type: a single number is accepted for all six."""

    def repeated(value: object) -> object:
        return (value,) * 6 if isinstance(value, (int, float)) else value

    return BeforeValidator(repeated, json_schema_input_type=number | tuple[(number,) * 6])  # type: ignore[misc]


SixNumbers = Annotated[Vector6, one_for_six(Real)]
"""Six numbers of one unit, or one number for all."""


class Reading(NamedTuple):
    """How values are read: the `context` of pydantic's validators, for a section and all sections in it."""

    trust_code: bool = False
    """Whether code that is named in the values may run."""
    defaults: Callable[[type[Section], Document], Document | None] | None = None
    """Adds to the keys of a section those whose defaults follow the robot; None for a section that has no such keys."""


class InOtherKinds:
    """The value of a key for kinds that do not have it: `rod_joint = InOtherKinds("universal")` in their base class."""

    def __init__(self, value: object) -> None:
        self._value = value

    def __get__(self, section: object, _: object = None) -> Any:
        if section is None:
            raise AttributeError  # Else pydantic warns where a kind has the key.
        return self._value


class Section(BaseModel):
    """Base of the sections of a file: frozen, hashable; `SomeSection(...)` and `from_dict` obey the same rules.

    Lists and numbers of numpy are taken as tuples and numbers. `key` is its place in a file, for messages.

    Raises:
        ConfigurationError: All that is wrong: unknown keys, values that a field does not take, and broken rules.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True, ignored_types=(InOtherKinds,)
    )
    section_key: ClassVar[str] = ""
    kind_keys: ClassVar[frozenset[str]] = frozenset()
    """Of sections with a `kind`: keys that mean something else in another kind, which a change of kind drops."""
    moved_keys: ClassVar[Mapping[str, str]] = {}
    """Former key -> where it is now, for messages."""
    knobs: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Keys of positive numbers that a slider of the live page sets, and their labels."""
    family: ClassVar[Any] = None
    """The kinds of which it is one."""
    _text: ClassVar[str]
    _units: ClassVar[Mapping[str, str]]
    _default_sections: ClassVar[Sequence[str]]
    _nulls: frozenset[str] = PrivateAttr(frozenset())
    """Keys that were given as null, in place of which a default was filled in."""

    def __init__(self, /, **keys: object) -> None:
        self._read(keys, Reading(), self_instance=self)

    # Without this mark pydantic would make the sections in a section by calling the constructor.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def __init_subclass__(cls, key: str | None = None, **config: Any) -> None:
        super().__init_subclass__(**config)
        if key is not None:
            cls.section_key = key

    @classmethod
    def __pydantic_init_subclass__(cls, **_: object) -> None:
        """Takes over the texts of inherited fields, and adds the keys to the docstring."""
        cls._text = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
        texts, units, sections = [f"{cls._text}\n\nKeys:"], {}, []
        for name, field in cls.__pydantic_fields__.items():
            inherited = (getattr(base, "__pydantic_fields__", {}).get(name) for base in cls.__mro__)
            field.description = next((other.description for other in inherited if other and other.description), None)
            texts.append(f"    {name}: {' '.join((field.description or '').split())}".rstrip(": "))
            units[name] = unit_and_text(field.description or "")[0].removesuffix("-")
            if isinstance(factory := field.default_factory, type) and issubclass(factory, Section):
                sections.append(name)
        cls._default_sections = sections
        cls.__doc__, cls._units = "\n".join(texts), units

    @classmethod
    def from_dict(cls, data: object, key: str | None = None) -> Self:
        """A section from plain values, as YAML gives them; `key` is its place in messages, by default the class's."""
        return cls._read(data, Reading(), key)

    @classmethod
    def _read(cls, data: object, reading: Reading, key: str | None = None, **details: Any) -> Self:
        # Numbers near the largest overflow to infinity, which the checks refuse; numpy need not warn as well.
        with np.errstate(all="ignore"):
            try:
                return cast(Self, cls.__pydantic_validator__.validate_python(data, context=reading, **details))
            except ValidationError as error:
                raise _as_one(error, cls.section_key if key is None else key) from None

    @model_validator(mode="wrap")
    @classmethod
    def _completed(cls, data: object, handler: Callable[[object], Self], info: ValidationInfo) -> Self:
        """Takes texts with units as numbers, fills in defaults that follow the robot, and checks the rules."""
        defaults = info.context.defaults if isinstance(info.context, Reading) else None
        given, private = data, None
        if isinstance(data, cls):
            if defaults is None or defaults(cls, {}) is None:
                return data
            given, private = data.given(), data.__pydantic_private__
        values = given
        try:
            if not isinstance(given, Mapping):
                return handler(given)
            values = {name: in_unit(plain(value), cls._units.get(name, "")) for name, value in given.items()}
            if defaults is not None and (filled := defaults(cls, values)) is not None:
                values = {name: {} for name in cls._default_sections} | filled
            result = handler(values)
            result.rules()
        except ValidationError as error:
            raise explain(error, cls, values) from None
        except ConfigurationError as error:
            error.key = error.key.removeprefix(f"{cls.section_key}.")
            raise as_problem(error) from None
        except RecursionError:
            raise as_problem(ConfigurationError("", data, "values that do not contain themselves")) from None
        result.model_fields_set.intersection_update(given)
        if private is not None:
            result.__pydantic_private__ = dict(private)
        elif nulls := [name for name in given if given[name] is None and getattr(result, name) is not None]:
            result._nulls = frozenset(nulls)
        return result

    @classmethod
    def unit_of(cls, name: str) -> str:
        """The unit in brackets before the text of a field, such as `rad, m`; empty without."""
        return cls._units.get(name, "")

    @classmethod
    def keys(cls, *, inside: bool = False) -> list[Key]:
        """Its keys: unit, text, what is allowed, default; with `inside` those of the sections in it too."""
        schema = cls.model_json_schema()
        return list(all_keys(schema, schema)) if inside else keys_of(schema, schema)

    def given(self) -> Document:
        """The kind, and the keys that were given, with their values; a null that was given stays null."""
        names = [name for name in self.__pydantic_fields__ if name in self.model_fields_set or name == "kind"]
        return {name: None if name in self._nulls else getattr(self, name) for name in names}

    def replace(self, **changes: Any) -> Self:
        """The same section with some keys changed, checked again."""
        return type(self)(**{name: getattr(self, name) for name in self.__pydantic_fields__} | changes)

    def to_dict(self) -> Document:
        """Every key with its value, in plain types."""
        return {name: to_plain(getattr(self, name)) for name in self.__pydantic_fields__}

    def rules(self) -> None:
        """Raises a `ConfigurationError` for a broken rule between fields; its key is relative to this section."""

    def __eq__(self, other: object) -> bool:
        # Pydantic would compare cached arrays as well.
        names = self.__pydantic_fields__
        return type(self) is type(other) and all(getattr(self, name) == getattr(other, name) for name in names)

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_"):
            allowed = f"no assignment, as sections do not change: replace({name}=...) makes a changed copy"
            raise ConfigurationError(f"{self.section_key}.{name}".lstrip("."), value, allowed)
        super().__setattr__(name, value)

    def __str__(self) -> str:
        return repr(self)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> Document:
        result = handler(schema)
        cls.describe(handler.resolve_ref_schema(result))
        return result

    @classmethod
    def describe(cls, schema: Document) -> None:
        """Adds the texts of the section and its keys to its JSON schema, and that a number may have a unit."""
        properties = schema["properties"]
        schema["description"] = cls._text
        for name, field in cls.__pydantic_fields__.items():
            if cls._units[name]:
                properties[name] = or_text(properties[name])
            if field.description:
                properties[name].setdefault("description", field.description)


def plain(value: object) -> Any:
    """NumPy's scalars as Python's, lists and one-dimensional arrays as tuples; anything else unchanged."""
    if isinstance(value, (np.floating, np.integer, np.bool_)):
        return value.item()
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim == 1):
        return tuple(plain(x) for x in value)
    return value


def to_plain(value: object) -> Any:
    """A value of a section, or of NumPy, in types that JSON and YAML have."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, (str, os.PathLike)):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    if isinstance(value, Section):
        return value.to_dict()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return {key: to_plain(item) for key, item in value.items()} if isinstance(value, Mapping) else value


def check_plain(key: str, value: object) -> None:
    """Raises a `ConfigurationError` for values that a file cannot hold."""
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigurationError(key, value, f"plain values, all numbers finite ({error})") from None


def check_value(key: str, value: object, kind: object, unit: str = "") -> None:
    """Raises a `ConfigurationError` for a value that is not of a type, such as `LegNumber` or `Vector6`."""
    try:
        _adapter(kind).validate_python(plain(value))
    except ValidationError as error:
        raise _as_one(explain(error, kind, value, unit), key) from None


def number_in(key: str, text: str, unit: str) -> float:
    """The number [unit] of a text such as `0.01` or `10 mm`."""
    value = in_unit(text, unit)
    with contextlib.suppress(ValueError):
        value = float(value)
    check_value(key, value, Real, unit)
    return float(value)


@lru_cache(maxsize=256)
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=None if isinstance(kind, type) else {"allow_inf_nan": False})


@lru_cache(maxsize=256)
def _schema_of(kind: Any) -> Document:
    return TypeAdapter(kind).json_schema()


# --- what is wrong, in words ---


def shorten(key: str) -> str:
    """A key as one short printable line."""
    key = key if key and key.isprintable() else repr(key)
    return key if len(key) <= 60 else f"{key[:57]}..."


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """`; did you mean X?` if a known name is close to the given one, else an empty text."""
    if not isinstance(given, str) or not given:
        return ""
    known = list(known)
    close = difflib.get_close_matches(given, known, n=1) or [name for name in known if name.startswith(given)]
    return f"; did you mean {close[0]}?" if close else ""


def choices_text(given: object, choices: Sequence[str]) -> str:
    """Choices in words, and the closest one."""
    return join_or(choices) + did_you_mean(given, choices)


def unknown_key(key: object, keys: Sequence[str], kinds: Sequence[str] = ()) -> str:
    """The message for an unknown key; `kinds` are other kinds of the section that have it."""
    guess = f"; kind {join_or(kinds)} has it." if kinds else did_you_mean(key, keys)
    return f"no such key{guess}{' The' if guess else '; the'} keys here are {', '.join(keys)}"


def as_problem(error: ConfigurationError) -> PydanticCustomError:
    """A `ConfigurationError`, with a key relative to its section, as an error that pydantic collects."""
    # Not the value: pydantic would format it, and fails for an integer of thousands of digits.
    return PydanticCustomError("rule", "expected {allowed}", {"error": error, "allowed": error.allowed})


def explain(error: ValidationError, kind: object, data: object, unit: str = "") -> ValidationError:
    """What pydantic found wrong with the data of a section, or of another type with a unit, in our words."""
    lines = []
    for report in error.errors(include_url=False):
        location, problem = _problem(report, kind, data, unit)
        lines.append(InitErrorDetails(type=as_problem(problem), loc=location, input=report["input"]))
    return ValidationError.from_exception_data("section", lines)


def _problem(report: Any, kind: object, data: Any, unit: str) -> tuple[tuple[int | str, ...], ConfigurationError]:
    """Where a report of pydantic is, and what is wrong there."""
    error, location, value, context = report["type"], report["loc"], report["input"], report.get("ctx", {})
    path = location
    if isinstance(kind, type) and issubclass(kind, Section) and location:
        name, path = location[0], location[1:]
        if error == "extra_forbidden":
            return location, ConfigurationError("", value, _unknown_here(kind, str(name)))
        if error == "missing" and not path:
            unit = kind.unit_of(name) and f" [{kind.unit_of(name)}]"
            return location, ConfigurationError("", None, f"a value{unit}; this key is required")
        data, unit, kind = data.get(name), kind.unit_of(name), _type_of(kind.__pydantic_fields__.get(name))
    if error == "missing":  # An item of a list that is too short: what is wrong is the list.
        location, path = location[:-1], ()
    if path and isinstance(data, (int, float)):  # One number for all six.
        location, path, value = location[: -len(path)], (), data
    if error == "rule" and not (isinstance(value, str) and unit):
        return location, context["error"]
    if error == "model_type":
        return location, ConfigurationError("", value, "a section")
    if error == "invalid_key" or "[key]" in location:
        return location, ConfigurationError("", value, "keys that are texts")
    root = _schema_of(kind)
    part, unit = part_at(root, root, path, unit)
    if allowed := wrong_unit(value, unit.split(", ")[0]):
        return location[: len(location) - len(path)], ConfigurationError("", value, allowed)
    if error == "rule":
        return location, context["error"]
    allowed = allowed_text(part, root, unit)
    if error == "finite_number":
        allowed = allowed.replace("number", "finite number", 1)
    allowed += did_you_mean(value, re.findall("'([^']*)'", context.get("expected", "")))
    if (most := context.get("le", context.get("lt"))) is not None:
        allowed += smaller_unit(value, unit, lambda number: number <= most)
    return location, ConfigurationError("", value, allowed)


def _as_one(error: ValidationError, key: str) -> ConfigurationError:
    """Problems in our words as one error, unknown keys first."""
    lines: dict[str, ConfigurationError] = {}
    for report in error.errors(include_url=False):
        problem: ConfigurationError = report["ctx"]["error"]
        keys = [key, *(shorten(str(part)) for part in report["loc"] if part != "[key]"), problem.key]
        line = ConfigurationError(".".join(filter(None, keys)) or "scenario", problem.value, problem.allowed)
        lines[str(line)] = line
    first, *others = sorted(lines.values(), key=lambda line: not line.allowed.startswith("no such"))
    first.others = tuple(others)
    return first


def _type_of(field: FieldInfo | None) -> object:
    if field is None:
        return None
    return Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation


def _unknown_here(section: type[Section], key: str) -> str:
    if key in section.moved_keys:
        return f"no such key; it is now {section.moved_keys[key]}"
    kinds = section.family.kinds_with(key) if section.family else ()
    return unknown_key(key, list(section.__pydantic_fields__), kinds)
