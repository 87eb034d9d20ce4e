"""What an expression of a compiled law is, while it is printed as C: numbers, arrays, records and tuples.

All shapes are known, but for the first of a slice whose start is computed. An array is a view of a C array: some of its
indices are fixed, and each of the others runs over a part of it. So rows, columns and slices are pointers, not copies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

ATOM, UNARY, PRODUCT, SUM, RELATION, EQUALITY, CONJUNCTION, DISJUNCTION, CHOICE = range(9, 0, -1)
"""How strongly a C expression binds."""
C_TYPES = {"double": "double", "int": "int", "bool": "bool"}


class Unknown(Exception):
    """What the printer does not know; whoever walks the source adds file and line."""


class Scalar(NamedTuple):
    """A number: its kind, `double`, `int` or `bool`, its text in C, how strongly that binds, and its value if known."""

    kind: str
    text: str
    binding: int = ATOM
    value: Any = None

    def within(self, binding: int) -> str:
        """The text as an operand of an operator that binds so strongly."""
        return self.text if self.binding >= binding else f"({self.text})"


def number(value: Any) -> Scalar:
    """A constant."""
    if isinstance(value, (bool, np.bool_)):
        return Scalar("bool", "true" if value else "false", ATOM, bool(value))
    if isinstance(value, (int, np.integer)):
        return Scalar("int", str(int(value)), ATOM if value >= 0 else UNARY, int(value))
    value = float(value)
    text = repr(value) if math.isfinite(value) else "NAN" if math.isnan(value) else "INFINITY"
    if value == -math.inf:
        text = "-INFINITY"
    return Scalar("double", text, UNARY if text.startswith("-") else ATOM, value)


class Axis(NamedTuple):
    """An index of a C array: where it stands, or begins, and how far it runs; None where it does not."""

    start: str = "0"
    length: int | str | None = None


class Array(NamedTuple):
    """A view of a C array.

    Attributes:
        kind: Of its numbers.
        base: Text of the C array, or pointer.
        sizes: Of the dimensions of the base after the first, which C knows.
        axes: Index of each dimension of the base.
        root: Name of the argument that it is a part of; "" for a local one, None for a constant.
        hidden: Whether a first axis of one entry, that C does not have, is still to be indexed.
        flipped: Whether the two running axes are swapped.
    """

    kind: str
    base: str
    sizes: tuple[int, ...]
    axes: tuple[Axis, ...]
    root: str | None = ""
    hidden: bool = False
    flipped: bool = False

    @property
    def shape(self) -> tuple[int | str, ...]:
        """Lengths of the axes that run."""
        running = tuple(axis.length for axis in self.axes if axis.length is not None)
        return running[::-1] if self.flipped else running

    def at(self, indices: Sequence[str]) -> Scalar:
        """An entry."""
        given = iter(reversed(indices) if self.flipped else indices)
        places = [axis.start if axis.length is None else added(axis.start, next(given)) for axis in self.axes]
        return Scalar(self.kind, self.base + "".join(f"[{place}]" for place in places))

    def indexed(self, places: Sequence[Axis | None]) -> Array:
        """A part of it; None leaves an axis as it is."""
        given, axes = iter([*places, *[None] * (len(self.shape) - len(places))]), []
        for axis in self.axes:
            place = None if axis.length is None else next(given)
            axes.append(axis if place is None else Axis(added(axis.start, place.start), place.length))
        return self._replace(axes=tuple(axes))

    @property
    def layout(self) -> tuple[tuple[int, ...], tuple[bool, ...]]:
        """Sizes after the first of the C array as which it is passed, and which of its axes run."""
        running = [k for k, axis in enumerate(self.axes) if axis.length is not None]
        if self.flipped or self.hidden or not running:
            raise Unknown("an array that has to be copied before it is passed on")
        first, last = running[0], len(self.axes) - 1
        if len(running) == 1:
            row = math.prod(self.sizes[first:])
            return ((), (True,)) if first == last else ((row,), (True, False))
        if len(running) == 2 and running[1] == last:
            return (math.prod(self.sizes[first:]),), (True, True)
        if len(running) == len(self.axes) - first and all(axis.start == "0" for axis in self.axes[first + 1 :]):
            return self.sizes[first:], (True,) * len(running)
        raise Unknown("a part of an array that is no rows and columns")

    def pointer(self, constant: bool) -> str:
        """Text of a pointer to it, for a parameter of its `layout`."""
        sizes, _ = self.layout
        running = [k for k, axis in enumerate(self.axes) if axis.length is not None]
        inner = self.axes[running[0] + 1 :]
        whole = sizes == self.sizes[running[0] :] and all(axis.start == "0" for axis in inner) and len(running) > 1
        if whole or not sizes:
            places = [axis.start for axis in self.axes[: running[0] + 1]]
            text = self.base + "".join(f"[{place}]" for place in places[:-1])
            text = text if places[-1] == "0" else f"&{text}[{places[-1]}]"
            return f"{cast_of(self.kind, sizes)}{text}" if constant and sizes and self.root is not None else text
        entry = self.base + "".join(f"[{axis.start}]" for axis in self.axes)
        return f"{cast_of(self.kind, sizes, constant or self.root is None)}&{entry}"


def cast_of(kind: str, sizes: Sequence[int], constant: bool = True) -> str:
    """A cast to a pointer to an array."""
    return f"({'const ' if constant else ''}{C_TYPES[kind]} (*){''.join(f'[{size}]' for size in sizes)})"


def declared(kind: str, name: str, sizes: Sequence[int], constant: bool) -> str:
    """A pointer to an array as C declares it."""
    target = f"(*{name}){''.join(f'[{size}]' for size in sizes)}" if sizes else f"*{name}"
    return f"{'const ' if constant else ''}{C_TYPES[kind]} {target}"


class Entrywise(NamedTuple):
    """An array that is computed entry by entry: its entry at some indices. Nothing is stored yet."""

    kind: str
    shape: tuple[int | str, ...]
    at: Callable[[Sequence[str]], Scalar]


class Record(NamedTuple):
    """A record: its type and the text of a pointer to it; `root` as of `Array`."""

    kind: np.dtype
    pointer: str
    root: str | None = ""

    def field(self, name: str) -> str:
        """Text of a field."""
        return f"{self.pointer[1:]}.{name}" if self.pointer.startswith("&") else f"{self.pointer}->{name}"

    def attribute(self, name: str) -> Scalar | Array | Record:
        """A field: a number, an array of its own, or a record in this one."""
        shape = self.shape(name)
        if self.kind[name].names:
            return Record(self.kind[name], f"&{self.field(name)}", self.root)
        if not shape:
            return Scalar("double", self.field(name))
        return Array("double", self.field(name), shape[1:], tuple(Axis("0", size) for size in shape), self.root)

    def entry(self, name: str) -> Array:
        """A field of the array (1,) that the record stands in."""
        shape = self.shape(name)
        if not shape:
            return Array("double", f"(&{self.field(name)})", (), (Axis("0", 1),), self.root)
        return Array("double", self.field(name), shape[1:], tuple(Axis("0", n) for n in shape), self.root, hidden=True)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of a field, () of a single number."""
        if name not in (self.kind.names or ()):
            raise Unknown(f"no field {name}")
        return self.kind[name].shape


class Several(NamedTuple):
    """A tuple."""

    items: tuple[Any, ...]


class Constant(NamedTuple):
    """Anything of Python that the source names: a module, a function, a type of a record, a tuple of numbers."""

    value: Any


class Made(NamedTuple):
    """A new record of a kind."""

    kind: np.dtype


Value = Scalar | Array | Entrywise | Record | Several | Constant | Made


def added(start: str, index: str) -> str:
    """Text of the sum of two indices."""
    if start == "0":
        return index
    if index == "0":
        return start
    return str(int(start) + int(index)) if start.isdigit() and index.isdigit() else f"{start} + {index}"


class Signature(NamedTuple):
    """A printed function: its name, its result, which arguments it writes, and whether each array has a free length.

    The result is None, the kind of a number, a tuple of kinds, or the shape of an array, in a list.
    """

    name: str
    result: Any
    written: frozenset[int]


def kind_of(value: Value) -> Any:
    """What of an argument decides how a function is printed."""
    if isinstance(value, Scalar):
        return value.kind
    if isinstance(value, Array):
        shape = tuple(size if isinstance(size, int) else None for size in value.shape)
        return (value.kind, shape, *value.layout)
    if isinstance(value, Record):
        return value.kind
    raise Unknown("an argument that is neither a number nor an array nor a record")


class Call(Several):
    """Several results of a call."""

    text: str

    def __new__(cls, items: tuple[Any, ...], text: str = "") -> Call:
        """With the text of the call."""
        made = super().__new__(cls, items)
        made.text = text
        return made


def wider(one: str | None, other: str) -> str:
    """The kind of number that takes both."""
    order = ("bool", "int", "double")
    return other if one is None else order[max(order.index(one), order.index(other))]
