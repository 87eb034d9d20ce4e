"""Families of kinds, and how a user's own class becomes one of them; the kinds themselves are in `registry`."""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Mapping
from functools import cached_property
from importlib import import_module
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from stewart_drake.errors import ConfigurationError, OlderFileWarning
from stewart_drake.files.code_path import CodePath, UserCodePath, path_of, source_of
from stewart_drake.section import Section, check_plain, to_plain
from stewart_drake.wording import OWN, as_problem, chosen, either

_PACKAGE = __name__.partition(".")[0]


class Family:
    """The kinds of one part of a scenario, told apart by the key `kind`; in `Annotated`, the type of such a part.

    Args:
        lines: Kind -> its section: `module:name` in this package, or the class itself.
        default: Kind where the key is absent; None where it is required.
        own: Section for a user's own class, a `UserMade`, as `module:name`; None where there is none.
        methods: What an object of the user's own has one of; none for classes alone.
        without: Kinds that are not taken here.
        older: Names that kinds had in older files -> their names.
    """

    def __init__(
        self,
        lines: dict[str, Any],
        default: str | None = None,
        own: str | None = None,
        methods: tuple[str, ...] = (),
        without: tuple[str, ...] = (),
        older: Mapping[str, str] | None = None,
    ) -> None:
        self.default = default
        self._lines, self._own, self._methods, self._without = lines, own, methods, without
        self._older = older or {}

    def but(self, *kinds: str) -> Family:
        """The same kinds, without some."""
        return Family(self._lines, self.default, self._own, self._methods, (*self._without, *kinds), self._older)

    @property
    def kinds(self) -> list[str]:
        """Names of the kinds."""
        return [kind for kind in self._lines if kind not in self._without]

    @property
    def words(self) -> list[str]:
        """The kinds, and how a user's own is written."""
        return self.kinds if self._own is None else [*self.kinds, OWN]

    def add(self, section: type[Section]) -> None:
        """Adds a kind: its section, whose `kind` has its name as the default.

        A section that was added before may be added again, as a cell of a notebook does.

        Raises:
            ConfigurationError: The section has no such default, or a kind of that name is there already; it lacks a
                method that its base asks for, such as `parts`.
        """
        field = getattr(section, "__pydantic_fields__", {}).get("kind")
        kind = None if field is None else field.default
        if not isinstance(kind, str):
            raise ConfigurationError(
                f"{section.__name__}.kind", None, 'a name as its default, such as kind: str = "own"'
            )
        before = self.section(kind) if kind in self._lines else section
        if path_of(before) != path_of(section):
            raise ConfigurationError(
                f"{section.__name__}.kind", kind, f"a name that no kind has, unlike {either(self.kinds)}"
            )
        missing = sorted(getattr(section, "__abstractmethods__", ()))
        if missing:
            raise ConfigurationError(section.__name__, None, f"a section with {', '.join(missing)}")
        self._lines[kind] = section

    def added_code(self) -> dict[str, str]:
        """See `added_code`."""
        return added_code(self._lines)

    def section(self, kind: Any) -> Any:
        """Class of a kind's section; None for no such kind."""
        known = isinstance(kind, str) and kind in self._lines and kind not in self._without
        return _loaded(self._lines, kind) if known else None

    def spelled(self, data: Any) -> Any:
        """A section as written, in full: a text that is a kind stands for a section of it; anything else as it is."""
        kind = data.get("kind") if isinstance(data, Mapping) else data
        if isinstance(kind, str) and kind in self._older:
            warnings.warn(f"the kind `{kind}` is named `{self._older[kind]}` now", OlderFileWarning, stacklevel=3)
        return self._spelled(data)

    def _spelled(self, data: Any) -> Any:
        if isinstance(data, str) and (self._is_own(data) or data in self.kinds or data in self._older):
            data = {"kind": data}
        kind = data.get("kind") if isinstance(data, Mapping) else None
        return {**data, "kind": self._older[kind]} if isinstance(kind, str) and kind in self._older else data

    def section_of(self, data: Any) -> Any:
        """Class of a section that is written, or made; None where it is not one of these."""
        data = self._spelled(data)
        kind = data.get("kind", self.default) if isinstance(data, Mapping) else getattr(data, "kind", None)
        found = self._own_section if self._is_own(kind) else self.section(kind)
        return found if isinstance(data, Mapping) or (found is not None and isinstance(data, found)) else None

    @property
    def _own_section(self) -> Any:
        return None if self._own is None else _import(self._own)

    def _is_own(self, kind: Any) -> bool:
        """Whether a kind is a user's import path, class or object."""
        if self._own is None or kind is None or isinstance(kind, Section):
            return False
        if isinstance(kind, str):
            return ":" in kind
        return isinstance(kind, (type, CodePath)) or any(hasattr(kind, method) for method in self._methods)

    def _validate(self, value: Any) -> Any:
        if isinstance(value, type) and issubclass(value, Section) and value is not Section:
            value = value()
        elif not isinstance(value, (Mapping, Section, str)) and self._is_own(value):
            value = {"kind": value}
        value = self.spelled(value)
        section = self.section_of(value)
        if isinstance(value, Mapping):
            if section is not None and self._is_own(value.get("kind")):
                rest = {key: each for key, each in value.items() if key != "kind"}
                value = {section.path_key: CodePath.of(value["kind"]), **rest}
            if section is not None:
                return section.__pydantic_validator__.validate_python(value)
            missing = "kind" not in value
            allowed = f"{either(self.words)}; this key is required" if missing else chosen(value["kind"], self.words)
            raise as_problem(ConfigurationError("kind", value.get("kind"), allowed))
        if section is not None:
            return value
        if isinstance(value, Section):
            raise as_problem(ConfigurationError("kind", getattr(value, "kind", None), either(self.words)))
        if isinstance(value, str):
            raise as_problem(ConfigurationError("", value, chosen(value, self.words)))
        raise PydanticCustomError("section", "a section")

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        # What `json_schema` makes references of: pydantic knows only those that it made itself.
        kinds = {kind: self.section(kind) for kind in self.kinds}
        return {"kinds": kinds, "default kind": self.default, "own": self._own_section}


class Table:
    """Objects by name, in `Annotated` the type of a key that holds such a name.

    Args:
        lines: Name -> `module:name` in this package, or the object itself.
    """

    def __init__(self, lines: dict[str, Any]) -> None:
        self._lines = lines

    @property
    def names(self) -> list[str]:
        """In the order of the lines."""
        return list(self._lines)

    words = names

    def __getitem__(self, name: str) -> Any:
        """The object of a name."""
        return _loaded(self._lines, name)

    def add(self, name: str, made: Any) -> None:
        """Adds an object.

        Raises:
            ConfigurationError: The name means something already.
        """
        if name in self._lines:
            raise ConfigurationError("kind", name, f"a name that no kind has, unlike {either(self.names)}")
        self._lines[name] = made

    def added_code(self) -> dict[str, str]:
        """See `added_code`."""
        return added_code(self._lines)

    def _validate(self, value: Any) -> Any:
        if isinstance(value, str) and value in self._lines:
            return value
        raise as_problem(ConfigurationError("", value, chosen(value, self.names)))

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"enum": self.names, "type": "string"}


def added_code(lines: Mapping[str, Any]) -> dict[str, str]:
    """Kind -> source of what was added from outside of the package, and of the modules that it stands in.

    Results are kept under it: a kind with other code is another kind.
    """
    found: dict[str, str] = {}
    for kind, line in lines.items():
        for part in line if isinstance(line, tuple) else (line,):
            module = getattr(part, "__module__", None)
            if module is not None and module.partition(".")[0] != _PACKAGE:
                found[kind] = f"{found.get(kind, '')}{source_of(part)}{source_of(sys.modules.get(module))}"
    return found


class UserMade(Section):
    """Base of sections for what a class of the user's own makes.

    In a file `kind` is the import path of the class; in Python the class itself, or an object, may stand there, or in
    place of the whole section.
    """

    path_key: ClassVar[str] = "kind"
    """Key under which the path of the class is kept."""
    asked: ClassVar[str]
    """What an object of the class does, such as `evaluate(t) returns ...`; begins with its method."""

    kind: UserCodePath
    """path/to/file.py:Class, from the folder of the file that names it, or module:Class. Its code is run."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of the constructor, plain values."""

    def rules(self) -> None:
        """See `Section.rules`."""
        check_plain("arguments", self.arguments)

    @property
    def code(self) -> CodePath:
        """Where the class comes from."""
        found: CodePath = getattr(self, self.path_key)
        return found

    @property
    def code_key(self) -> str:
        """Key of the scenario that has it, for messages."""
        return f"{vars(self).get('place', self.section_key)}.{self.path_key}"

    def load(self) -> Any:
        """The class; it is not called.

        Raises:
            ConfigurationError: See `CodePath.load`; it is not a class.
        """
        found = self.code.load(self.code_key)
        if not isinstance(found, type) and self.code.given is None:
            raise ConfigurationError(self.code_key, self.code, f"a class, not a {type(found).__name__}")
        return found if isinstance(found, type) else type(found)

    def construct(self, offered: Mapping[str, Any]) -> Any:
        """The object: made with `arguments` and with those of `offered` that the constructor names, or as it was given.

        Raises:
            ConfigurationError: See `load`; the constructor raises.
        """
        kind, given = self.load(), self.code.given
        if given is not None and not isinstance(given, type):
            return given
        keywords = dict(self.arguments)
        place = self.code_key.rpartition(".")[0]
        with self.code.blamed(self.code_key, f"a constructor that takes {place}.arguments and does not raise"):
            for name, parameter in inspect.signature(kind).parameters.items():
                if name in offered and parameter.kind is not inspect.Parameter.VAR_KEYWORD:
                    keywords.setdefault(name, offered[name])
            return kind(**keywords)

    @cached_property
    def made(self) -> Any:
        """The object.

        Raises:
            ConfigurationError: See `construct`; it does not have the method.
        """
        made = self.construct({})
        method = self.asked.partition("(")[0]
        if not callable(getattr(made, method, None)):
            raise self.refusal(f"one without {method}")
        return made

    def refusal(self, found: str) -> ConfigurationError:
        """The error that says what is asked of the class, and what was found instead."""
        return ConfigurationError(self.code_key, self.code, f"a class whose {self.asked}, not {found}")

    def numbers(self, answer: Any) -> np.ndarray:
        """An answer of the object as an array.

        Raises:
            ConfigurationError: It is not one.
        """
        try:
            return np.asarray(answer, dtype=float)
        except (TypeError, ValueError):
            raise self.refusal(f"a {type(answer).__name__} that is not an array of numbers") from None


def given_again(section: Any) -> Any:
    """A section in plain values, except for its code, which need not be trusted anew."""
    if isinstance(section, (list, tuple)):
        return [given_again(each) for each in section]
    if isinstance(section, Section):
        return {name: given_again(getattr(section, name)) for name in section.__pydantic_fields__}
    return section if isinstance(section, CodePath) else to_plain(section)


def refuse_given(section: Any) -> None:
    """Refuses what was given in Python as a class or an object, where results are kept and known again by content.

    Raises:
        ConfigurationError: There is such a part.
    """
    for part in user_parts(section):
        if part.code.given is not None:
            raise ConfigurationError(part.code_key, part.code, "a class by its import path, to run it many times")


def user_parts(section: Any) -> list[UserMade]:
    """Every part of the user's own in a section, and in those inside."""
    found = [section] if isinstance(section, UserMade) else []
    inside = vars(section).values() if isinstance(section, Section) else section if isinstance(section, tuple) else ()
    return found + [each for part in inside for each in user_parts(part)]


def place_users(section: Any, place: str = "") -> None:
    """Tells the sections of a user's classes where they stand, for messages."""
    if isinstance(section, UserMade):
        vars(section)["place"] = place
    if isinstance(section, (Section, tuple)):
        named = vars(section).items() if isinstance(section, Section) else enumerate(section)
        for name, part in list(named):
            place_users(part, f"{place}.{name}" if place else str(name))


def _loaded(lines: dict[str, Any], name: str) -> Any:
    """What stands in a line, imported where that is `module:name`."""
    if isinstance(lines[name], str):
        lines[name] = _import(lines[name])
    return lines[name]


def _import(place: str) -> Any:
    module, _, name = place.partition(":")
    return attrgetter(name)(import_module(f"{_PACKAGE}.{module}"))
