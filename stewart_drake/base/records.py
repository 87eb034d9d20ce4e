"""Records: named float64 numbers side by side in memory, which compiled laws, Python, a Context and C share.

A record is declared as a class of annotated fields; it is stored as a structured array (1,) of the class's `layout`:

    class LqiState(Record):
        torque: Vec6  # [N m]
        gain: Mat6x18  # K of (31)
        bridged: float  # Ticks in a row that were bridged.

    state = LqiState.new(torque=1.0)

A compiled law has `state: LqiState` among its arguments, and reads `record(state).torque[0]`. numba ignores the
annotation; the type checker, the printer of C and the reader use it.

In compiled code a record does not keep its array alive. So a law that makes a record passes the array on, and an inner
law calls `record`: never `record(np.empty(1, KIND))`.
"""

from __future__ import annotations

import inspect
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar, get_args

import numba
import numpy as np

from stewart_drake.base.jit import DISABLED

_R = TypeVar("_R", bound="Record")
Vector = np.ndarray
"""(n,)"""
Matrix = np.ndarray
"""(n, m)"""
Vec1 = Annotated[np.ndarray, (1,)]
Vec2 = Annotated[np.ndarray, (2,)]
Vec3 = Annotated[np.ndarray, (3,)]
Vec4 = Annotated[np.ndarray, (4,)]
Vec5 = Annotated[np.ndarray, (5,)]
Vec6 = Annotated[np.ndarray, (6,)]
Vec9 = Annotated[np.ndarray, (9,)]
Vec12 = Annotated[np.ndarray, (12,)]
Vec18 = Annotated[np.ndarray, (18,)]
Mat3 = Annotated[np.ndarray, (3, 3)]
Mat4 = Annotated[np.ndarray, (4, 4)]
Mat5 = Annotated[np.ndarray, (5, 5)]
Mat6 = Annotated[np.ndarray, (6, 6)]
Mat6x1 = Annotated[np.ndarray, (6, 1)]
Mat6x3 = Annotated[np.ndarray, (6, 3)]
Mat6x7 = Annotated[np.ndarray, (6, 7)]
Mat7x5 = Annotated[np.ndarray, (7, 5)]
Mat6x18 = Annotated[np.ndarray, (6, 18)]
TickResult = tuple[int, int, float]
"""How a law ended: status, 0 where all is well; leg or -1; margin."""

if TYPE_CHECKING:
    _Base = np.ndarray
else:
    _Base = object


class Record(_Base):
    """Base of records. A field is a `float`, an array such as `Vec6`, or another record.

    A size may be a name, `Annotated[np.ndarray, ("n",)]`; `sized(n=4)` is then the record of that size. A record may
    extend others; their fields come first, in the order of the bases.

    Attributes:
        layout: dtype of the structured array.
        fields: Name -> annotation.
    """

    layout: ClassVar[np.dtype]
    fields: ClassVar[dict[str, Any]]
    _sizes: ClassVar[dict[str, int]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.fields = {}
        for base in cls.__bases__:
            cls.fields |= getattr(base, "fields", {})
        cls.fields |= inspect.get_annotations(cls, eval_str=True)
        shapes = {name: _shape(f"{cls.__name__}.{name}", kind, cls._sizes) for name, kind in cls.fields.items()}
        # Without fields if a size is missing, see `sized`.
        items = shapes.items() if None not in shapes.values() else ()
        cls.layout = np.dtype([(n, of) if isinstance(of, np.dtype) else (n, np.float64, of) for n, of in items])

    @classmethod
    def sized(cls, **sizes: int) -> type[Self]:
        """The record with these sizes in the place of their names."""
        return _sized(cls, tuple(sorted(sizes.items())))  # type: ignore[arg-type]

    @classmethod
    def new(cls, options: object = None, **values: object) -> Self:
        """A structured array (1,) with named values; what is not given is that attribute of the options.

        An attribute that is None, a limit that is off, is infinite. Without options, what is not given is zero.
        """
        if cls.layout.names != tuple(cls.fields):
            raise TypeError(f"{cls.__name__} has sizes without a number, see `Record.sized`")
        result: Any = np.zeros(1, cls.layout)
        for name in cls.fields if options is not None else ():
            if name not in values:
                value = getattr(options, name)
                result[name][:] = np.inf if value is None else value
        for name, value in values.items():
            result[name][:] = value
        return result

    @classmethod
    def empty(cls) -> Self:
        """A structured array (1,) for a law to fill."""
        result: Any = np.empty(1, cls.layout)
        return result

    @classmethod
    def of(cls, numbers: np.ndarray) -> Self:
        """The record in a row (n,) of a signal, or those in rows (m, n), for Python: fields are attributes."""
        result: Any = np.ascontiguousarray(numbers, dtype=float).view(cls.layout).view(np.recarray)[..., 0][()]
        return result


if TYPE_CHECKING:

    def record(array: _R) -> _R:
        """The record of a structured array (1,), with its fields as attributes; a view."""
elif DISABLED:

    def record(array):
        """The record of a structured array (1,), with its fields as attributes; a view."""
        return array.view(np.recarray)[0]
else:

    @numba.njit(inline="always")
    def record(array):
        """The record of a structured array (1,), with its fields as attributes; a view."""
        return array[0]


@lru_cache(maxsize=256)
def _sized(kind: type[_R], sizes: tuple[tuple[str, int], ...]) -> type[_R]:
    return type(kind.__name__, (kind,), {"_sizes": dict(sizes), "__module__": kind.__module__, "__annotations__": {}})


def _shape(name: str, kind: object, sizes: dict[str, int]) -> object:
    """Shape of a field, dtype of a record in it, None where a size is a name that is not known."""
    if kind is float:
        return ()
    if isinstance(kind, type) and issubclass(kind, Record):
        kind = kind if kind.layout.names else kind.sized(**sizes) if sizes else kind
        return kind.layout if kind.layout.names else None
    if len(get_args(kind)) != 2:
        raise TypeError(f"{name}: expected float, an array such as Vec6, or a Record, got {kind}")
    shape = tuple(sizes.get(n, n) if isinstance(n, str) else n for n in get_args(kind)[1])
    return None if any(isinstance(n, str) for n in shape) else shape
