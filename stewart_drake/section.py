"""Parts of a scenario, sweep or comparison: typed sections, and what is wrong with one, a line for each problem.

Constraints stand in the fields of a section: types, bounds, choices and lengths. They refuse values, feed the JSON
schema and make the words of a message. A rule between fields is in the section's `rules`.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import os
from collections.abc import Mapping
from functools import lru_cache, wraps
from typing import Annotated, Any, ClassVar, Self, dataclass_transform

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, Strict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic_core import ArgsKwargs, CoreSchema

from stewart_drake.errors import ConfigurationError
from stewart_drake.wording import TINY, as_problem, explain

MAX_SEED = 2**63 - 1

Real = Annotated[float, Strict()]
"""A finite number; an integer will do."""
Count = Annotated[int, Strict()]
Positive = Annotated[float, Strict(), Field(ge=TINY)]
NotNegative = Annotated[float, Strict(), Field(ge=0.0)]
Fraction = Annotated[float, Strict(), Field(gt=0.0, lt=1.0)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
LegNumber = Annotated[int, Strict(), Field(ge=0, le=5), "leg"]
"""The text in it is the noun that a message has."""
Natural = Annotated[int, Strict(), Field(ge=0)]
Seed = Annotated[int, Strict(), Field(ge=0, le=MAX_SEED)]
Window = Annotated[int, Strict(), Field(ge=1)]
"""[ticks]"""
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
NAME = r"^\w[\w .+-]*$"
NAME_WORDS = "letters, digits and _, and after the first of them space and . + - too"
"""Of a name that can be a folder's; a text beside a pattern says in words what it takes."""
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""
PositivePair = tuple[Positive, Positive]

SECTION: Any = {"extra": "forbid", "allow_inf_nan": False, "use_attribute_docstrings": True}
"""How pydantic reads a section; the docstrings of its fields become descriptions."""


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field, Field))
class Section:
    """Base of the sections: frozen, hashable, made by keywords.

    `SomeSection(...)` and `SomeSection.from_dict` obey the same rules. A subclass is a dataclass without a decorator;
    the texts under its fields reach `help()`. Lists and numbers of numpy are taken as tuples and numbers.

    Args of a subclass:
        key: Where it stands in a file, for messages of what is made in Python.

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
        checked_dataclass(frozen=True, kw_only=True, config=SECTION)(cls)
        for name, field in cls.__pydantic_fields__.items():
            if field.description is None:
                # Pydantic looks for the texts of the class itself alone.
                inherited = (getattr(base, "__pydantic_fields__", {}).get(name) for base in cls.__mro__[1:])
                field.description = next((each.description for each in inherited if each is not None), None)
        cls.__doc__ = cls._text + _key_texts(cls)
        checked = cls.__init__
        pydantic_init: Any = cls.__pydantic_validator__

        @wraps(checked)
        def init(self: Section, /, **keys: Any) -> None:
            keys = self.from_older({name: plain(value) for name, value in keys.items()})
            with np.errstate(all="ignore"):
                try:
                    pydantic_init.validate_python(ArgsKwargs((), keys), self_instance=self)
                except ValidationError as error:
                    raise explain(type(self), error, keys, type(self).section_key) from None

        if any(field.annotation == dict[str, Any] for field in cls.__pydantic_fields__.values()):
            cls.__hash__ = lambda self: hash(repr(self))  # type: ignore[method-assign]
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
        try:
            # Numbers near the largest overflow to infinity, which the checks refuse; numpy need not say so as well.
            with np.errstate(all="ignore"):
                return cls.__pydantic_validator__.validate_python(
                    cls.from_older(data) if isinstance(data, dict) else data
                )
        except ValidationError as error:
            raise explain(cls, error, data, cls.section_key if key is None else key) from None

    @classmethod
    def from_older(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Keys of an older file as this version has them."""
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
        try:
            self.rules()
        except ConfigurationError as error:
            error.key = error.key.removeprefix(f"{self.section_key}.")
            raise as_problem(error) from None

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        made = handler(schema)
        section = handler.resolve_ref_schema(made)
        section["description"] = cls._text
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
    """Checks a value that does not come in a section.

    Args:
        key: Its name.
        value: What was given.
        kind: Its type, such as `LegNumber`, `Vector6` or a `Literal`.

    Raises:
        ConfigurationError: It is not of that type.
    """
    try:
        _adapter(kind).validate_python(plain(value))
    except ValidationError as error:
        raise explain(kind, error, value, key) from None


@lru_cache(maxsize=64)
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config={"allow_inf_nan": False})


def _key_texts(section: Any) -> str:
    """The texts of the fields, for `help()`."""
    texts = {name: " ".join((field.description or "").split()) for name, field in section.__pydantic_fields__.items()}
    return "\n\nKeys:\n" + "\n".join(f"    {name}: {text}".rstrip(": ") for name, text in texts.items())
