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
from functools import lru_cache, wraps
from typing import Annotated, Any, ClassVar, Self, dataclass_transform

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, Strict, TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic.errors import PydanticInvalidForJsonSchema
from pydantic_core import ArgsKwargs, CoreSchema, InitErrorDetails, PydanticCustomError

from stewart_drake.errors import UNTRUSTED_CODE, ConfigurationError

TINY = float(np.finfo(float).tiny)
"""Smallest number whose reciprocal is finite: what counts as above 0."""
MAX_SEED = 2**63 - 1


class Words:
    """In `Annotated`: what a type is called in messages, where its bounds do not say it."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), "$comment": self.text}


Real = Annotated[float, Strict()]
"""A finite number; an integer will do."""
Count = Annotated[int, Strict()]
Positive = Annotated[float, Strict(), Field(ge=TINY)]
NotNegative = Annotated[float, Strict(), Field(ge=0.0)]
Fraction = Annotated[float, Strict(), Field(gt=0.0, lt=1.0)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
LegNumber = Annotated[int, Strict(), Field(ge=0, le=5), Words("a leg from 0 to 5")]
Natural = Annotated[int, Strict(), Field(ge=0)]
Seed = Annotated[int, Strict(), Field(ge=0, le=MAX_SEED)]
Window = Annotated[int, Strict(), Field(ge=1)]
"""[ticks]"""
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
NAME = r"^\w[\w .+-]*$"
NAME_WORDS = Words("letters, digits and _, and after the first of them space and . + - too")
"""Of a name that can be a folder's."""
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""
PositivePair = tuple[Positive, Positive]


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
        texts = []
        for name, field in cls.__pydantic_fields__.items():
            # Pydantic looks for the texts of the class itself alone.
            inherited = (getattr(base, "__pydantic_fields__", {}).get(name) for base in cls.__mro__)
            field.description = next((each.description for each in inherited if each and each.description), None)
            texts.append(f"    {name}: {' '.join((field.description or '').split())}".rstrip(": "))
        cls.__doc__ = "\n".join([f"{cls._text}\n\nKeys:", *texts])
        if any(field.annotation == dict[str, Any] for field in cls.__pydantic_fields__.values()):
            cls.__hash__ = lambda self: hash(repr(self))  # type: ignore[method-assign]

        @wraps(cls.__init__)
        def init(self: Section, /, **keys: Any) -> None:
            given = ArgsKwargs((), {name: plain(value) for name, value in keys.items()})
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
        made: Self = cls._validated(data, cls.section_key if key is None else key)
        return made

    @classmethod
    def _validated(cls, given: Any, key: str, **details: Any) -> Any:
        # Numbers near the largest overflow to infinity, which the checks refuse; numpy need not say so as well.
        with np.errstate(all="ignore"):
            try:
                return cls.__pydantic_validator__.validate_python(given, **details)
            except ValidationError as error:
                raise _told(error, key) from None

    @model_validator(mode="wrap")
    @classmethod
    def _checked(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        """What pydantic finds in this section in our words, wherever it stands."""
        try:
            if isinstance(data, ArgsKwargs):
                data = ArgsKwargs((), cls.prepared(data.kwargs or {}))
            return handler(cls.prepared(data) if isinstance(data, dict) else data)
        except ConfigurationError as error:
            error.key = error.key.removeprefix(f"{cls.section_key}.")
            raise as_problem(error) from None
        except ValidationError as error:
            raise _in_words(error, schema_of(cls)) from None  # type: ignore[arg-type]

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Keys and values as given, made ready for the checks."""
        return data

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
        made = handler(schema)
        section = handler.resolve_ref_schema(made)
        section["description"] = cls._text
        section["properties"] = {name: section["properties"][name] for name in cls.__pydantic_fields__}
        for name, field in cls.__pydantic_fields__.items():
            if field.description:
                section["properties"][name].setdefault("description", field.description)
        return made


def by_default(section: Section) -> Any:
    """A field whose default is this very section: it is frozen, so that all may share it."""
    return Field(default_factory=lambda: section)


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
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, (list, tuple)):
        return [to_plain(each) for each in value]
    if isinstance(value, Mapping):
        return {key: to_plain(each) for key, each in value.items()}
    return value


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
        raise _told(_in_words(error, schema_of(kind)), key) from None


def keys_of(section: Any) -> list[str]:
    """Keys of a section, given its class."""
    return list(getattr(section, "__pydantic_fields__", None) or getattr(section, "__dataclass_fields__", {}))


# --- what is wrong, in words ------------------------------------------------------------------------------------------

_SHOWN_KEY = 60
_TYPES = {"boolean": "true or false", "string": "a text", "number": "a number", "integer": "a whole number"}


def shown(key: str) -> str:
    """A key as one short line, whatever is in it."""
    key = key if key and key.isprintable() else repr(key)
    return key if len(key) <= _SHOWN_KEY else f"{key[: _SHOWN_KEY - 3]}..."


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


def as_problem(error: ConfigurationError) -> PydanticCustomError:
    """An error with a key of its own section as pydantic passes it on to the sections around it."""
    context = {"key": error.key, "got": error.value, "allowed": error.allowed, "reason": error.reason}
    return PydanticCustomError("rule", "expected {allowed}", context)


def _told(error: ValidationError, section: str) -> ConfigurationError:
    """Problems that are in our words already as one error: code that is not trusted first, then unknown keys."""
    found: dict[str, ConfigurationError] = {}
    for report in error.errors(include_url=False):
        context = report["ctx"]
        keys = [section, *(shown(str(part)) for part in report["loc"] if part != "[key]"), context["key"]]
        problem = ConfigurationError(".".join(filter(None, keys)) or "scenario", context["got"], context["allowed"])
        problem.reason = context["reason"]
        found[str(problem)] = problem
    first, *others = sorted(
        found.values(), key=lambda each: (each.reason != UNTRUSTED_CODE, not each.allowed.startswith("no such"))
    )
    return first.with_others(others)


def _in_words(error: ValidationError, schema: Mapping[str, Any]) -> ValidationError:
    """Pydantic's report on a section, or on one value, with what its JSON schema says."""
    reports = error.errors(include_url=False)
    places = [report["loc"] for report in reports]
    lines: list[InitErrorDetails] = []
    guessed = {""}
    order = {key: place for place, key in enumerate(_options(schema, schema)[0].get("properties", {}))}
    # By field, unknown keys before them: a mistyped key that is required shows up twice.
    for report in sorted(reports, key=lambda each: order.get(str((*each["loc"], "")[0]), -1)):
        kind, location, value = report["type"], report["loc"], report["input"]
        # Of a list with bad entries pydantic says too that there are too few.
        if any(len(at) > len(location) and at[: len(location)] == location for at in places):
            continue
        if kind == "rule":
            problem = PydanticCustomError("rule", "expected {allowed}", report["ctx"])
        else:
            if kind.startswith("missing") and isinstance(location[-1], int):
                kind, location = "too_short", location[:-1]
            required = kind.startswith("missing")
            if required and location[-1] in guessed:
                continue
            value = None if required else value
            allowed = _allowed(kind, location, value, schema) + "; this key is required" * required
            guessed.add(allowed.partition("did you mean ")[2].partition("?")[0])
            problem = as_problem(ConfigurationError("", value, allowed))
        lines.append(InitErrorDetails(type=problem, loc=location, input=value))
    return ValidationError.from_exception_data("section", lines)


def _allowed(kind: str, location: tuple[int | str, ...], value: Any, schema: Mapping[str, Any]) -> str:
    """What would have been accepted at a place, for a kind of pydantic's errors."""
    if kind == "invalid_key" or "[key]" in location:
        return "keys that are texts"
    if kind == "unexpected_keyword_argument":
        section, _ = _at(schema, location[:-1])
        keys = list(_options(schema, section)[0].get("properties", {}))
        guess = meant(location[-1], keys)
        return f"no such key{guess}{' The' if guess else '; the'} keys here are {', '.join(keys)}"
    part, unit = _at(schema, location)
    words = in_words(part, unit, schema)
    if kind == "finite_number":
        return words.replace("number", "finite number", 1)
    choices = [str(each) for option in _options(schema, part) for each in _choices(option)]
    if isinstance(value, str) and "number" in words and re.fullmatch(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*", value):
        return f"{words}; write it without quotes"
    return words + meant(value, choices)


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
                if fixed and len(units) > 1:
                    unit = f"[{units[part * len(units) // len(fixed)]}]" if part < len(fixed) else ""
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


def describe(kind: Any, unit: str = "") -> str:
    """A type in words, with its bounds, and whether null will do."""
    schema = schema_of(kind)
    return in_words(schema, unit, schema)


def in_words(schema: Mapping[str, Any], unit: str = "", root: Mapping[str, Any] | None = None) -> str:
    """A part of a JSON schema in words: a positive number [s]; red or blue; a list of 6 numbers, or null."""
    options = _options(root or schema, schema)
    found = [_one_in_words(each, unit, root or schema) for each in options if each.get("type") != "null"]
    null = ", or null" if len(found) < len(options) else ""
    return " or ".join(found) + null


def _one_in_words(schema: Mapping[str, Any], unit: str, root: Mapping[str, Any]) -> str:
    kind, unit = schema.get("type"), f" {unit}" if unit else ""
    if _choices(schema):
        return either([str(each) for each in _choices(schema)])
    words = schema.get("$comment", _TYPES.get(str(kind), "another value"))
    if kind == "string":
        return words + _size(schema, "Length", ", {} characters")
    if "$comment" in schema or kind == "boolean":
        return str(words)
    if kind == "object":
        keys = list(schema.get("properties", {}))
        return f"a section, with keys such as {', '.join(keys[:3])}" if keys else "a section"
    if kind == "array":
        fixed = schema.get("prefixItems")
        size = f"{len(fixed)} " if fixed else _size(schema, "Items", "{} ")
        inner = in_words(fixed[0] if fixed else schema.get("items", {}), "", root)
        inner = inner.removeprefix("a ").partition(", with")[0]
        return (
            f"a list of {size}"
            + re.sub(r"^((positive |whole )*(number|text|list|section|value))", r"\1s", inner)
            + unit
        )
    return f"{_with_bounds(schema, words)}{unit}" if kind in ("number", "integer") else str(words)


def _size(schema: Mapping[str, Any], what: str, form: str) -> str:
    sizes = [
        f"at {word} {size}" for word, key in (("least", "min"), ("most", "max")) if (size := schema.get(key + what))
    ]
    return form.format(" and ".join(sizes)) if sizes else ""


def _with_bounds(schema: Mapping[str, Any], noun: str) -> str:
    """Such as: a positive number; a whole number from 1 to 10."""
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    low, high = schema.get("minimum"), schema.get("maximum")
    if low == TINY:
        above, low = 0.0, None
    ends = [f"{end:d}" if isinstance(end, int) else f"{end:g}" for end in (low, high) if end is not None]
    if above == 0.0 and high is None and below is None:
        return noun.replace("a ", "a positive ", 1)
    if low == 0.0 and high is None and below is None:
        return f"{noun}, zero or positive"
    if len(ends) == 2:
        return f"{noun} from {ends[0]} to {ends[1]}"
    if above is not None and below is not None:
        return f"{noun} between {above:g} and {below:g}"
    limits = {"above": above, "at least": low, "below": below, "at most": high}
    words = [f"{word} {limit:g}" for word, limit in limits.items() if limit is not None]
    return " ".join([noun, ", ".join(words)]).rstrip()


# --- JSON schema ------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def _adapter(kind: Any) -> TypeAdapter[Any]:
    config: Any = None if isinstance(kind, type) and issubclass(kind, Section) else {"allow_inf_nan": False}
    return TypeAdapter(kind, config=config)


@lru_cache(maxsize=256)
def schema_of(kind: Any) -> dict[str, Any]:
    """JSON schema of a type, in which a family of kinds is but its words and `family`, the `families.Family` itself."""
    try:
        return _adapter(kind).json_schema()
    except PydanticInvalidForJsonSchema:  # a user's own section may have what JSON has not
        return {}
