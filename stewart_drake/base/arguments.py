"""Arguments of another class than a function asks for, refused in one line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache, wraps
from types import NoneType, UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import join_or

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _classes(hint: Any) -> tuple[type, ...]:
    """Of a class, a generic, or a union of them; none where there are numbers or arrays among them."""
    kinds = [get_origin(each) or each for each in (get_args(hint) if isinstance(hint, UnionType) else (hint,))]
    return tuple(kinds) if all(isinstance(kind, type) and kind not in (int, float, bool, Any) for kind in kinds) else ()


def checked(function: _Function) -> _Function:
    """Refuses what is no instance of an annotated class, which may have a hint for the message, `where_from`."""
    names = tuple(inspect.signature(function).parameters)

    @cache
    def classes() -> dict[str, tuple[type, ...]]:
        return {name: _classes(hint) for name, hint in get_type_hints(function).items()}

    @wraps(function)
    def checking(*arguments: Any, **named: Any) -> Any:
        for name, value in (*zip(names, arguments, strict=False), *named.items()):
            # A text is a sequence too, of letters.
            if (kinds := classes().get(name)) and (not isinstance(value, kinds) or type(value) is str not in kinds):
                wanted = [kind for kind in kinds if kind is not NoneType]
                hint = getattr(wanted[0], "where_from", "")
                either = join_or([kind.__name__ for kind in wanted])
                raise ConfigurationError(name, value, f"a {either}{'; ' if hint else ''}{hint}")
        return function(*arguments, **named)

    return cast(_Function, checking)
