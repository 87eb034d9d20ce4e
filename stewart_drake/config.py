"""Typed sections of scenarios, sweeps and comparisons, on pydantic; and what is wrong with one, a line a problem.

Constraints stand in the fields and make the JSON schema, and the words of a message come from that schema. A rule
between fields is in the section's `rules`. A text under a field begins with its unit in brackets.
"""

from __future__ import annotations

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
from typing import Annotated, Any, ClassVar, Self, dataclass_transform

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    Strict,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from stewart_drake.errors import ConfigurationError

TINY = float(np.finfo(float).tiny)
"""Smallest number whose reciprocal is finite: what counts as above 0."""
MAX_SEED = 2**63 - 1


def words(text: str) -> Any:
    """In `Annotated`: what a type is called in messages, where its bounds do not say it."""
    return Field(json_schema_extra={"$comment": text})


Real = Annotated[float, Strict()]
"""A finite number; an integer will do."""
Count = Annotated[int, Strict()]
Positive = Annotated[float, Strict(), Field(ge=TINY)]
NotNegative = Annotated[float, Strict(), Field(ge=0.0)]
Fraction = Annotated[float, Strict(), Field(gt=0.0, lt=1.0)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
LegNumber = Annotated[int, Strict(), Field(ge=0, le=5), words("a leg from 0 to 5")]
Natural = Annotated[int, Strict(), Field(ge=0)]
Seed = Annotated[int, Strict(), Field(ge=0, le=MAX_SEED)]
Window = Annotated[int, Strict(), Field(ge=1)]
"""[ticks]"""
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
NAME = r"^\w[\w .+-]*$"
NAME_WORDS = words("letters, digits and _, and after the first of them space and . + - too")
"""Of a name that can be a folder's."""
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""
PositivePair = tuple[Positive, Positive]


def one_for_six(number: Any) -> BeforeValidator:
    """In `Annotated` of six numbers of a type, which have one unit: a single number stands for all six."""

    def spread(given: Any) -> Any:
        if not isinstance(given, (int, float)):
            return given
        try:
            check_value("", given, number)
        except ConfigurationError as error:
            raise as_problem(ConfigurationError("", given, f"{error.allowed}, or six of them")) from None
        return (given,) * 6

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
            given = {name: plain(value) for name, value in keys.items()}
            type(self)._validated(given, type(self).section_key, self_instance=self)

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
        if fill is not None and isinstance(data, cls) and cls.adapts:
            data = data.given()
        given = {name: value is None for name, value in data.items()} if isinstance(data, dict) else None
        try:
            result = handler(data if fill is None or given is None else fill(cls, data))
        except ConfigurationError as error:
            error.key = error.key.removeprefix(f"{cls.section_key}.")
            raise as_problem(error) from None
        except ValidationError as error:
            raise _in_words(error, schema_of(cls), cls.kinds_with) from None  # type: ignore[arg-type]
        if given is not None:
            vars(result)["_given"] = given
        return result

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
        section = handler.resolve_ref_schema(result)
        section["description"] = cls._text
        section["properties"] = {name: section["properties"][name] for name in cls.__pydantic_fields__}
        for name, field in cls.__pydantic_fields__.items():
            if field.description:
                section["properties"][name].setdefault("description", field.description)
        return result


def plain(value: Any) -> Any:
    """Numpy's numbers and truth values as Python's, lists and arrays of one axis as tuples; all else as it is."""
    if isinstance(value, (np.floating, np.integer, np.bool_)):
        return value.item()
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim == 1):
        return tuple(plain(x) for x in value)
    return value


def to_plain(value: Any) -> Any:
    """A value of a section in what JSON and YAML have."""
    if isinstance(value, (str, os.PathLike)):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [to_plain(each) for each in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return {key: to_plain(each) for key, each in value.items()} if isinstance(value, Mapping) else value


def is_finite(value: Any) -> bool:
    """Whether a value is a finite number; a truth value, or a text that looks like one, is not."""
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def check_plain(key: str, value: Any) -> None:
    """Raises a `ConfigurationError` for what is not plain values, such as a file can hold."""
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigurationError(key, value, f"plain values, all numbers finite ({error})") from None


def check_value(key: str, value: Any, kind: Any) -> None:
    """Raises a `ConfigurationError` for a value that is not of a type, such as `LegNumber` or `Vector6`."""
    try:
        _adapter(kind).validate_python(plain(value))
    except ValidationError as error:
        raise _as_one(_in_words(error, schema_of(kind)), key) from None


@lru_cache(maxsize=256)
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=None if isinstance(kind, type) else {"allow_inf_nan": False})


class _AnySchema(GenerateJsonSchema):
    """A user's own section may have what JSON has not."""

    def handle_invalid_for_json_schema(self, schema: Any, error_info: str) -> dict[str, Any]:  # noqa: ARG002
        return {}


@lru_cache(maxsize=256)
def schema_of(kind: Any) -> dict[str, Any]:
    """JSON schema of a type."""
    return _adapter(kind).json_schema(schema_generator=_AnySchema)


# --- what is wrong, in words ---

_NOUNS = {
    "boolean": "true or false",
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "object": "a section",
}
_BOUNDS = {
    "exclusiveMinimum": "above {:g}",
    "minimum": "at least {:g}",
    "exclusiveMaximum": "below {:g}",
    "maximum": "at most {:g}",
    "minLength": "at least {} characters",
    "maxLength": "at most {} characters",
}


def shown(key: str) -> str:
    """A key as one short line, whatever is in it."""
    key = key if key and key.isprintable() else repr(key)
    return key if len(key) <= 60 else f"{key[:57]}..."


def either(words: Sequence[str]) -> str:
    """Words as a list in English."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def meant(given: Any, known: Iterable[str]) -> str:
    """`; did you mean X?` where one of the known names is close to what was given, else nothing."""
    if not isinstance(given, str) or not given:
        return ""
    known = list(known)
    close = difflib.get_close_matches(given, known, n=1) or [each for each in known if each.startswith(given)]
    return f"; did you mean {close[0]}?" if close else ""


def chosen(given: Any, choices: Sequence[str]) -> str:
    """Choices in words, and the one that was perhaps meant."""
    return either(choices) + meant(given, choices)


def unknown(key: Any, keys: Sequence[str], kinds: Sequence[str] = ()) -> str:
    """What is said of a key that is none of those that are there; `kinds` are others of the section that have it."""
    guess = f"; kind {either(kinds)} has it." if kinds else meant(key, keys)
    return f"no such key{guess}{' The' if guess else '; the'} keys here are {', '.join(keys)}"


def as_problem(error: ConfigurationError) -> PydanticCustomError:
    """An error with a key of its own section as pydantic passes it on to the sections around it."""
    context = {"key": error.key, "got": error.value, "allowed": error.allowed}
    return PydanticCustomError("rule", "expected {allowed}", context)


def _as_one(error: ValidationError, section: str) -> ConfigurationError:
    """Problems that are in our words already as one error, unknown keys first."""
    problems: dict[str, ConfigurationError] = {}
    for report in error.errors(include_url=False):
        context = report["ctx"]
        keys = [section, *(shown(str(part)) for part in report["loc"] if part != "[key]"), context["key"]]
        problem = ConfigurationError(".".join(filter(None, keys)) or "scenario", context["got"], context["allowed"])
        problems[str(problem)] = problem
    first, *others = sorted(problems.values(), key=lambda each: not each.allowed.startswith("no such"))
    first.others = tuple(others)
    return first


def _in_words(
    error: ValidationError, schema: Mapping[str, Any], kinds_with: Callable[[str], list[str]] = lambda _: []
) -> ValidationError:
    """Pydantic's report on a section, or on one value, with what its JSON schema says."""
    lines: list[InitErrorDetails] = []
    for report in error.errors(include_url=False):
        kind, location, value = report["type"], report["loc"], report["input"]
        if kind == "rule":
            problem = PydanticCustomError("rule", "expected {allowed}", report["ctx"])
        elif kind in ("unexpected_keyword_argument", "invalid_key"):
            key = location[-1]
            allowed = unknown(key, list(schema.get("properties", {})), kinds_with(str(key)))
            problem = as_problem(ConfigurationError("", value, allowed))
        else:
            required = kind.startswith("missing") and isinstance(location[-1], str)
            if kind.startswith("missing") and not required:  # of a list that is too short
                location = location[:-1]
            value = None if required else value
            part, unit = _at(schema, location)
            allowed = in_words(part, unit, schema) + "; this key is required" * required
            if kind == "finite_number":
                allowed = allowed.replace("number", "finite number", 1)
            allowed += meant(value, [str(each) for option in _options(schema, part) for each in _choices(option)])
            problem = as_problem(ConfigurationError("", value, allowed))
        lines.append(InitErrorDetails(type=problem, loc=location, input=value))
    return ValidationError.from_exception_data("section", lines)


def _at(schema: Mapping[str, Any], location: Sequence[int | str]) -> tuple[Mapping[str, Any], str]:
    """The part of a JSON schema at a place, and its unit."""
    here, unit = schema, ""
    for part in location:
        inside: Any = None
        for option in _options(schema, here):
            if isinstance(part, int):
                fixed = option.get("prefixItems", ())
                inside = inside or (fixed[part] if part < len(fixed) else option.get("items"))
                units = unit[1:-1].split(", ")
                if len(units) > 1 and part < len(fixed):
                    unit = f"[{units[part * len(units) // len(fixed)]}]"
            else:
                inside = inside or option.get("properties", {}).get(part) or option.get("additionalProperties")
        here = inside if isinstance(inside, Mapping) else {}
        text = here.get("description", "")
        unit = text[: text.index("]") + 1] if text.startswith("[") else unit if isinstance(part, int) else ""
    return here, unit.replace("[-]", "")


def _options(root: Mapping[str, Any], schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What a part of a schema may be, references followed."""
    if "$ref" in schema:
        return _options(root, root["$defs"][schema["$ref"].rpartition("/")[2]])
    if "anyOf" in schema and "$comment" not in schema:
        return [option for each in schema["anyOf"] for option in _options(root, each)]
    return [schema]


def _choices(schema: Mapping[str, Any]) -> list[Any]:
    return list(schema.get("enum", [schema["const"]] if "const" in schema else []))


def in_words(schema: Mapping[str, Any], unit: str, root: Mapping[str, Any]) -> str:
    """A part of a JSON schema in words: a positive number [s]; red or blue; a list of 6 numbers, or null."""
    ways = []
    options = _options(root, schema)
    for option in (each for each in options if each.get("type") != "null"):
        kind = option.get("type")
        words = _noun(option, root)
        if "$comment" not in option or kind == "string":
            limits = [text.format(option[key]) for key, text in _BOUNDS.items() if option.get(key, TINY) != TINY]
            words += f" {unit}" if unit and kind in ("number", "integer", "array") else ""
            words += f", {' and '.join(limits)}" if limits else ""
        ways.append(words)
    return " or ".join(ways) + ", or null" * (len(ways) < len(options))


def _noun(schema: Mapping[str, Any], root: Mapping[str, Any]) -> str:
    """What a value is called, without unit and bounds."""
    if "$comment" in schema or _choices(schema):
        return str(schema.get("$comment") or either([str(each) for each in _choices(schema)]))
    kind = schema.get("type")
    if kind == "array":
        fixed = schema.get("prefixItems", ())
        inside = _options(root, fixed[0] if fixed else schema.get("items", {}))
        inner = " or ".join(_noun(each, root).partition(",")[0].removeprefix("a ") for each in inside)
        inner = re.sub(r"^((positive |whole )*(number|text|list|section|value))", r"\1s", inner)
        count = f"{len(fixed)} " if fixed else f"at least {schema['minItems']} " if "minItems" in schema else ""
        return f"a list of {count}{inner}"
    return "a positive number" if schema.get("minimum") == TINY else _NOUNS.get(str(kind), "another value")
