"""Families of kinds, and how a user's class becomes a kind; the kinds themselves are in `registry`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping
from copy import copy
from functools import cached_property
from importlib import import_module
from operator import attrgetter
from typing import Any, ClassVar, TypeVar

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, PrivateAttr, ValidationInfo
from pydantic_core import CoreSchema, core_schema

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.code import CLASS_PATH, CodePath, path_of, source_of
from stewart_drake.base.config import Reading, Section, as_problem, check_plain, choices_text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import join_or

_Kind = TypeVar("_Kind")
_PACKAGE = __name__.partition(".")[0]
USER_CLASS = "module:Class"
"""A user's class, among the `choices` of a family."""
NO_FORMER: Mapping[str, str] = {}


class Table:
    """Objects by name; in `Annotated` it is the type of a key whose value is such a name.

    `lines`: name -> the object, or its `module:name` in this package, which is imported on first use.
    """

    def __init__(self, lines: dict[str, Any]) -> None:
        self._lines = lines

    @property
    def names(self) -> list[str]:
        """In the order of the lines."""
        return list(self._lines)

    def __getitem__(self, name: str) -> Any:
        """The object of a name."""
        if isinstance(self._lines[name], str):
            self._lines[name] = imported(self._lines[name])
        return self._lines[name]

    def add(self, name: str, thing: object) -> None:
        """Adds an object; raises a `ConfigurationError` if the name is taken."""
        self._check_new(name)
        self._lines[name] = thing

    def _check_new(self, name: str) -> None:
        if name in self._lines:
            raise ConfigurationError("kind", name, f"a new name; there are already {join_or(self.names)}")

    def added_code(self) -> dict[str, str]:
        """Kind -> source code of what was added from outside of the package, and of its module.

        It is part of the identity of stored results: a kind with other code is another kind.
        """
        sources: dict[str, str] = {}
        for kind, line in self._lines.items():
            for part in line if isinstance(line, tuple) else (line,):
                module = getattr(part, "__module__", _PACKAGE)
                if module.partition(".")[0] != _PACKAGE:
                    sources[kind] = f"{sources.get(kind, '')}{source_of(part)}{source_of(sys.modules.get(module))}"
        return sources

    def _validate(self, value: object, _: ValidationInfo) -> object:
        if isinstance(value, str) and value in self._lines:
            return value
        raise as_problem(ConfigurationError("", value, choices_text(value, self.names)))

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> Document:
        return {"enum": self.names, "type": "string"}


class Family(Table):
    """The kinds of one part of a scenario: a union of sections discriminated by the key `kind`.

    Use it in `Annotated` as the type of the part. Unlike in a union of pydantic's, kinds are imported on first use and
    can be added.

    Args:
        lines: Kind -> its section, see `Table`.
        default: The kind where the key `kind` is absent; None where it must be there.
        user_section: The section for a user's class, a `UserMade`; None where there can be none.
        methods: A user's object has one of these.
        former: Kind of an earlier version -> what to write now.
    """

    def __init__(
        self,
        lines: dict[str, object],
        default: str | None = None,
        user_section: str | None = None,
        methods: tuple[str, ...] = (),
        former: Mapping[str, str] = NO_FORMER,
    ) -> None:
        super().__init__(lines)
        self.default, self._user_line, self._methods, self._former = default, user_section, methods, former
        self._excluded: tuple[str, ...] = ()
        self._paths: dict[str, str] = {}

    def excluding(self, *kinds: str) -> Family:
        """The same kinds without some, and without a default."""
        family = copy(self)
        family.default, family._excluded = None, kinds
        return family

    @property
    def kinds(self) -> list[str]:
        """Names of the kinds."""
        return [kind for kind in self._lines if kind not in self._excluded]

    @property
    def choices(self) -> list[str]:
        """For messages."""
        return [*self.kinds, *self._paths, *([USER_CLASS] if self._user_line else [])]

    def __getitem__(self, name: str) -> Any:
        section = super().__getitem__(name)
        section.family = self
        return section

    def kinds_with(self, key: str) -> list[str]:
        """The kinds that have a key."""
        return [kind for kind in self.kinds if key in self[kind].__pydantic_fields__]

    def add(self, section: type[Section]) -> None:  # type: ignore[override]
        """Adds a section as a kind, named by the default of its field `kind`; the same class may be added again."""
        kind = section.__pydantic_fields__["kind"].default
        if kind in self._lines and path_of(self[kind]) == path_of(section):
            del self._lines[kind]
        super().add(kind, section)

    def register(self, name: str, path: str) -> None:
        """Makes a name a kind: short for the import path of a user's class, `module:Class`."""
        if self._user_line is None or ":" not in path:
            raise ConfigurationError(name, path, "module:Class, for a part that may be your own class")
        self._check_new(name)
        self._paths[name] = path

    def normalise(self, data: object) -> object:
        """What is given for a part as keys: a kind alone, or a user's class or object, becomes `{"kind": ...}`."""
        if isinstance(data, type) and issubclass(data, Section):
            return data()
        if self.is_user_code(data) or (isinstance(data, str) and data in self.kinds):
            data = {"kind": data}
        if not isinstance(data, Mapping):
            return data
        data, kind = {**data}, data.get("kind")
        if isinstance(kind, str) and kind in self._paths:
            data["kind"] = self._paths[kind]
        elif self.is_user_code(kind) and not isinstance(kind, str):
            data["kind"] = CodePath.of(kind)
        return data

    def resolve(self, data: object) -> Any:
        """Class of the section that is given for a part; None where it is none of these."""
        data = self.normalise(data)
        kind = data.get("kind", self.default) if isinstance(data, Mapping) else getattr(data, "kind", None)
        section = self._user_section if self.is_user_code(kind) else self[kind] if kind in self.kinds else None
        # An object of a subclass would lose what it overrides.
        return section if isinstance(data, Mapping) or type(data) is section else None

    @property
    def _user_section(self) -> Any:
        return None if self._user_line is None else imported(self._user_line)

    def is_user_code(self, kind: object) -> bool:
        """Whether a kind is a user's import path, class or object."""
        if self._user_line is None or kind is None or isinstance(kind, (Section, Mapping)):
            return False
        if isinstance(kind, str):
            return ":" in kind or kind in self._paths
        return isinstance(kind, (type, CodePath)) or any(hasattr(kind, method) for method in self._methods)

    def section(self, value: object, reading: Reading | None = None) -> Any:
        """The section of what is given for a part, checked."""
        value = self.normalise(value)
        section = self.resolve(value)
        if section is None:
            raise as_problem(self._refusal(value))
        return section.__pydantic_validator__.validate_python(value, context=reading)

    def _validate(self, value: object, info: ValidationInfo) -> object:
        return self.section(value, info.context)

    def _refusal(self, value: object) -> ConfigurationError:
        if not isinstance(value, (Mapping, Section)):
            allowed = f"a section with kind {join_or(self.choices)}, or such a kind alone"
            allowed = self._choices_text(value) if isinstance(value, str) else allowed
            return ConfigurationError("", value, allowed)
        kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
        if kind in self.kinds and isinstance(value, self[kind]):
            allowed = f"{self[kind].__name__}; a subclass of it must have another `kind`, and be added to the registry"
            return ConfigurationError("", type(value).__name__, allowed)
        required = "; this key is required" if isinstance(value, Mapping) and "kind" not in value else ""
        return ConfigurationError("kind", kind, f"{self._choices_text(kind)}{required}")

    def _choices_text(self, kind: object) -> str:
        return self._former.get(str(kind), choices_text(kind, self.choices))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> Document:
        sections = {kind: self[kind] for kind in self.kinds} | ({None: self._user_section} if self._user_line else {})
        ways: list[Document] = []
        alone = list(self._paths)
        for kind, section in sections.items():
            ways.append({**handler.resolve_ref_schema(handler(section.__pydantic_core_schema__))})
            section.describe(ways[-1])
            if kind not in (self.default, None):
                ways[-1]["required"] = ["kind"]
            if kind is not None and not any(field.is_required() for field in section.__pydantic_fields__.values()):
                alone.append(kind)
        if self._user_line is not None:
            ways.append({"type": "string", "pattern": CLASS_PATH})
        return {"anyOf": [*ways, {"enum": alone}]}


class UserMade(Section):
    """Base of the sections for a user's class.

    In a file `kind` is the import path of the class. In Python it may be the class or an object, and either may replace
    the whole section.
    """

    kind_keys = frozenset({"arguments"})
    asked: ClassVar[str]
    """The method that its objects need, and what that returns, such as `evaluate(t) returns ...`."""

    kind: CodePath
    """Import path of your class, from the folder of the file that names it: path/to/file.py:Class, or module:Class. Its
    code is run."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values."""
    _place: str = PrivateAttr("")
    """Key of the scenario that has it; empty outside of one."""

    def rules(self) -> None:
        """Arguments are plain values."""
        check_plain("arguments", self.arguments)

    @property
    def code(self) -> CodePath:
        """Where the class comes from."""
        return self.kind

    @property
    def code_key(self) -> str:
        """Key of the scenario that has it, for messages."""
        return f"{self._place or self.section_key}.kind"

    def __hash__(self) -> int:
        return hash(repr(self))

    def load(self) -> Any:
        """The class; raises a `ConfigurationError` if it cannot be loaded or is not a class."""
        loaded = self.code.load(self.code_key)
        if not isinstance(loaded, type) and self.code.given is None:
            raise ConfigurationError(self.code_key, self.code, f"a class, not a {type(loaded).__name__}")
        return loaded if isinstance(loaded, type) else type(loaded)

    def new_object(self, offered: Mapping[str, object]) -> Any:
        """A new object, from `arguments` and those of `offered` that the constructor names; or the object given."""
        kind, given = self.load(), self.code.given
        if given is not None and not isinstance(given, type):
            return given
        place = self.code_key.rpartition(".")[0]
        with self.code.blamed(self.code_key, f"a constructor that takes {place}.arguments and does not raise"):
            parameters = inspect.signature(kind).parameters
            return kind(**{name: value for name, value in offered.items() if name in parameters} | self.arguments)

    @cached_property
    def made(self) -> Any:
        """The object, made once; raises a `ConfigurationError` if it lacks the method."""
        made = self.new_object({})
        method = self.asked.partition("(")[0]
        if not callable(getattr(made, method, None)):
            raise self.refusal(f"one without {method}")
        return made

    def refusal(self, answer: str) -> ConfigurationError:
        """The error for a class that does something else than required."""
        return ConfigurationError(self.code_key, self.code, f"a class whose {self.asked}, not {answer}")

    def numbers(self, answer: object) -> np.ndarray:
        """What a method of the object returned, as an array; raises a `ConfigurationError` if it is not numbers."""
        try:
            return np.asarray(answer, dtype=float)
        except (TypeError, ValueError):
            raise self.refusal(f"a {type(answer).__name__} that is not an array of numbers") from None


def given_keys(value: object) -> Any:
    """The keys that were given, of the sections inside too; plain values except for code, which stays trusted."""
    if isinstance(value, Section):
        value = value.given()
    if isinstance(value, (list, tuple)):
        return [given_keys(item) for item in value]
    return {key: given_keys(item) for key, item in value.items()} if isinstance(value, Mapping) else value


def refuse_given(section: object) -> None:
    """Refuses classes and objects that were given in Python, where results are stored and identified by files."""
    for part in user_parts(section):
        if part.code.given is not None:
            raise ConfigurationError(part.code_key, part.code, "a class by its import path, to run it many times")


def user_parts(section: object) -> list[UserMade]:
    """All sections for a user's class in a section."""
    return [part for _, part in placed(section, UserMade)]


def place_users(section: object) -> None:
    """Gives the sections for users' classes their keys in a scenario, for messages."""
    for place, part in placed(section, UserMade):
        part._place = place


def placed(section: object, kind: type[_Kind], place: str = "") -> Iterator[tuple[str, _Kind]]:
    """All sections of a class in a section, itself included, with their keys."""
    if isinstance(section, kind):
        yield place, section
    fields = section.__pydantic_fields__ if isinstance(section, Section) else None
    named = () if fields is None else ((name, getattr(section, name)) for name in fields)
    for name, part in enumerate(section) if isinstance(section, tuple) else named:
        if isinstance(part, (Section, tuple)):
            yield from placed(part, kind, f"{place}.{name}" if place else str(name))


def imported(place: str) -> Any:
    """The object of a `module:name` in this package."""
    module, _, name = place.partition(":")
    return attrgetter(name)(import_module(f"{_PACKAGE}.{module}"))
