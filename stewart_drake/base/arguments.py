"""Checks the classes of a function's arguments, with errors of one line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache, wraps
from types import NoneType, UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import join_or

_Function = TypeVar("_Function", bound=Callable[..., object])


def _classes(hint: object) -> tuple[type, ...]:
    """Classes of a type hint; none for hints with numbers, which accept other types too, or with special forms."""
    kinds = [get_origin(part) or part for part in (get_args(hint) if isinstance(hint, UnionType) else (hint,))]
    return tuple(kinds) if all(isinstance(kind, type) and kind not in (int, float, bool, Any) for kind in kinds) else ()


def checked(function: _Function) -> _Function:
    """Refuses arguments that are no instances of the annotated classes; `where_from` of a class is a hint."""
    names = tuple(inspect.signature(function).parameters)

    @cache
    def classes() -> dict[str, tuple[type, ...]]:
        return {name: _classes(hint) for name, hint in get_type_hints(function).items()}

    @wraps(function)
    def checking(*arguments: object, **named: object) -> object:
        for name, value in (*zip(names, arguments, strict=False), *named.items()):
            # A text is also a Sequence, but never meant as one.
            if (kinds := classes().get(name)) and (not isinstance(value, kinds) or type(value) is str not in kinds):
                expected = [kind for kind in kinds if kind is not NoneType]
                hint = getattr(expected[0], "where_from", "")
                names_of = join_or([kind.__name__ for kind in expected])
                raise ConfigurationError(name, value, f"a {names_of}{'; ' if hint else ''}{hint}")
        return function(*arguments, **named)

    return cast(_Function, checking)
