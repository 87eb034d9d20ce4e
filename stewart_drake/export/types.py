"""What an expression of a compiled law is while it is printed as C: a number, an array, a record or a tuple.

Arguments and results have the types of their annotations. An array is some rows of a C array, side by side in memory,
so that a row, or a range of rows, is a pointer and no copy.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import numpy as np

from stewart_drake.base.records import Record

# How strongly a C expression binds.
ATOM, UNARY, PRODUCT, SUM, RELATION, EQUALITY, CONJUNCTION, DISJUNCTION, CHOICE = range(9, 0, -1)
NUMBERS: dict[object, str] = {bool: "bool", int: "int", float: "double"}  # Types in C, the narrower ones first.


class Untyped(Exception):
    """A construct that cannot be printed, and what to write instead; the caller adds file and line."""


class Scalar(NamedTuple):
    """A number: its type in C, its text, the precedence of its outer operator, and its value if it is a constant."""

    kind: str
    text: str
    binding: int = ATOM
    value: Any = None

    def within(self, binding: int) -> str:
        """The text as an operand of an operator of this precedence, in parentheses if needed."""
        return self.text if self.binding >= binding else f"({self.text})"


class Array(NamedTuple):
    """Rows of a C array."""

    kind: str  # Type of its numbers.
    base: str  # Text of the C array, or of a pointer.
    shape: tuple[int, ...]
    start: str = "0"  # Text of the index of its first row.
    root: str | None = ""  # Argument that it is a part of; "" for a local one, None for a constant.

    def row(self, index: str) -> Array:
        """A row of it."""
        return self._replace(base=f"{self.base}[{added(self.start, index)}]", shape=self.shape[1:], start="0")

    def rows(self, start: int, stop: int) -> Array:
        """A range of rows."""
        return self._replace(start=added(self.start, str(start)), shape=(stop - start, *self.shape[1:]))

    @property
    def pointer(self) -> str:
        """Text of a pointer to its first row."""
        return self.base if self.start == "0" else f"&{self.base}[{self.start}]"

    def declared(self, name: str) -> str:
        """A pointer to such rows as C declares it."""
        sizes = "".join(f"[{size}]" for size in self.shape[1:])
        return f"{self.kind} (*{name}){sizes}" if sizes else f"{self.kind} *{name}"


class StructType(NamedTuple):
    """A record's class, and its dtype, which has the sizes that the class leaves free."""

    kind: type[Record]
    layout: np.dtype

    def inner(self, name: str) -> StructType | None:
        """The type of a field that is a record."""
        return StructType(self.kind.fields[name], self.layout[name]) if self.layout[name].names else None


class Struct(NamedTuple):
    """A record."""

    of: StructType
    pointer: str  # Text of a pointer to it.
    root: str | None = ""  # See `Array.root`.

    @property
    def text(self) -> str:
        """The struct itself."""
        return self.pointer[1:] if self.pointer.startswith("&") else f"*{self.pointer}"

    def field(self, name: str) -> Scalar | Array | Struct:
        """A number, an array or a record in it."""
        if name not in (self.of.layout.names or ()):
            raise Untyped(f"no field `{name}` of `{self.of.kind.__name__}`")
        text = f"{self.pointer[1:]}.{name}" if self.pointer.startswith("&") else f"{self.pointer}->{name}"
        inner, shape = self.of.inner(name), self.of.layout[name].shape
        if inner:
            return Struct(inner, f"&{text}", self.root)
        return Array("double", text, shape, root=self.root) if shape else Scalar("double", text)


class TupleType(NamedTuple):
    """Several values; `call` is the text of the call that they are the result of, if any."""

    items: tuple[Any, ...]
    call: str = ""


class Constant(NamedTuple):
    """Anything of Python that the source names: a module, a function, the dtype of a record."""

    value: Any


class Local(NamedTuple):
    """A new array or record that has no name yet, and what it is a copy of."""

    of: tuple[int, ...] | StructType
    source: Array | Struct | None = None
    zeros: bool = False


Value = Scalar | Array | Struct | TupleType | Constant | Local
Signature = tuple[str, tuple[str, ...], set[int]]  # Name of a function, types of its results, arguments that it writes.


def number(value: Any) -> Scalar:
    """A constant."""
    if isinstance(value, (bool, np.bool_)):
        return Scalar("bool", "true" if value else "false", ATOM, bool(value))
    if isinstance(value, (int, np.integer)):
        return Scalar("int", str(int(value)), ATOM if value >= 0 else UNARY, int(value))
    value = float(value)
    special = {math.inf: "INFINITY", -math.inf: "-INFINITY"}
    text = "NAN" if math.isnan(value) else special.get(value, repr(value))
    return Scalar("double", text, UNARY if text.startswith("-") else ATOM, value)


def added(start: str, index: str) -> str:
    """Text of the sum of two indices."""
    if "0" in (start, index):
        return index if start == "0" else start
    return str(int(start) + int(index)) if start.isdigit() and index.isdigit() else f"{start} + {index}"


def wider(*kinds: str) -> str:
    """The type of number that takes all of these."""
    return max(kinds, key=list(NUMBERS.values()).index)


def described(value: Value) -> str:
    """A value's type, for messages."""
    if isinstance(value, Scalar):
        return "float" if value.kind == "double" else value.kind
    if isinstance(value, Array):
        return f"array {value.shape}"
    return value.of.kind.__name__ if isinstance(value, Struct) else type(value).__name__


def struct_type(layout: np.dtype, base: type[Record] = Record) -> StructType:
    """The type of a record by its dtype: that of a class, or one with its fields, which extends `base`."""
    kinds = [base] if isinstance(base, type) and issubclass(base, Record) else []
    for kind in kinds:
        kinds += kind.__subclasses__()
    same = [kind for kind in kinds if tuple(getattr(kind, "fields", ())) == layout.names]
    if not same:
        raise Untyped(f"a record of {', '.join((layout.names or ())[:3])}, ...; annotate it with its class")
    return StructType(next((kind for kind in same if getattr(kind, "layout", None) is layout), same[0]), layout)


def parameter(name: str, annotation: object, given: Value) -> Value | None:
    """A parameter of the annotated type, with the argument's sizes where that has none; None if it does not fit."""
    if isinstance(given, Scalar) and annotation in NUMBERS:
        kind = NUMBERS[annotation]
        return Scalar(kind, name) if wider(kind, given.kind) == kind else None
    if isinstance(given, Struct) and isinstance(annotation, type) and issubclass(given.of.kind, annotation):
        return Struct(given.of, name, name)
    if isinstance(given, Array):
        sizes = get_args(annotation)[1] if get_origin(annotation) is Annotated else ()
        sizes = tuple(m if isinstance(n, str) else n for n, m in zip(sizes, given.shape, strict=False))
        fits = annotation is np.ndarray or sizes == given.shape
        return Array(given.kind, name, given.shape, root=name) if fits else None
    return None


def result_kinds(annotation: object) -> tuple[str, ...]:
    """Types in C of the numbers that a function returns, by its annotation."""
    kinds = get_args(annotation) if get_origin(annotation) is tuple else (annotation,)
    if annotation is not type(None) and not all(kind in NUMBERS for kind in kinds):
        raise Untyped("a result that is no number; let the function fill its last argument")
    return tuple(NUMBERS[kind] for kind in kinds if kind in NUMBERS)
