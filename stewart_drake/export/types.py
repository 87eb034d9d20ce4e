"""What an expression of a compiled law is while it is printed as C: a number, an array, a record or a tuple.

Arguments and results have the types of their annotations. An array is some rows of a C array, side by side in memory,
so that a row, or a range of rows, is a pointer and no copy.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import numpy as np

from stewart_drake.base.records import Record

ATOM, UNARY, PRODUCT, SUM, RELATION, EQUALITY, CONJUNCTION, DISJUNCTION, CHOICE = range(9, 0, -1)
"""How strongly a C expression binds."""
NUMBERS = {bool: "bool", int: "int", float: "double"}
"""Types of numbers in C, the narrower ones first."""


class Untyped(Exception):
    """What cannot be printed, and what to write instead; file and line are added by who walks the source."""


class Scalar(NamedTuple):
    """A number: its type in C, its text, how strongly that binds, and its value where it is known."""

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


class Array(NamedTuple):
    """Rows of a C array.

    Attributes:
        kind: Type of its numbers.
        base: Text of the C array, or of a pointer.
        shape: Its sizes.
        start: Text of the index of its first row.
        root: Name of the argument that it is a part of; "" for a local one, None for a constant.
    """

    kind: str
    base: str
    shape: tuple[int, ...]
    start: str = "0"
    root: str | None = ""

    def at(self, index: str) -> Array:
        """A row of it."""
        return self._replace(base=f"{self.base}[{added(self.start, index)}]", shape=self.shape[1:], start="0")

    def rows(self, start: str, count: int) -> Array:
        """A range of rows."""
        return self._replace(start=added(self.start, start), shape=(count, *self.shape[1:]))

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


class Struct(NamedTuple):
    """A record: the text of a pointer to it; `root` as of `Array`."""

    of: StructType
    pointer: str
    root: str | None = ""

    @property
    def text(self) -> str:
        """The struct itself."""
        return self.pointer[1:] if self.pointer.startswith("&") else f"*{self.pointer}"

    def field(self, name: str) -> Scalar | Array | Struct:
        """A number, an array or a record in it."""
        if name not in (self.of.layout.names or ()):
            raise Untyped(f"no field `{name}` of `{self.of.kind.__name__}`")
        kind = self.of.layout[name]
        text = f"{self.pointer[1:]}.{name}" if self.pointer.startswith("&") else f"{self.pointer}->{name}"
        if kind.names:
            return Struct(StructType(self.of.kind.fields[name], kind), f"&{text}", self.root)
        return Array("double", text, kind.shape, root=self.root) if kind.shape else Scalar("double", text)


class TupleType(NamedTuple):
    """Several numbers; `call` is the text of the call that they are the result of, if any."""

    items: tuple[Scalar, ...]
    call: str = ""


class Constant(NamedTuple):
    """Anything of Python that the source names: a module, a function, the dtype of a record."""

    value: Any


class Local(NamedTuple):
    """A new array or record that has no name yet; `source` is what it is filled with: 0, a copy, or nothing."""

    of: StructType | str
    shape: tuple[int, ...] = ()
    source: Array | Struct | None = None
    zeros: bool = False


Value = Scalar | Array | Struct | TupleType | Constant | Local


def added(start: str, index: str) -> str:
    """Text of the sum of two indices."""
    if "0" in (start, index):
        return index if start == "0" else start
    return str(int(start) + int(index)) if start.isdigit() and index.isdigit() else f"{start} + {index}"


def wider(*kinds: str) -> str:
    """The type of number that takes all of these."""
    order = [*NUMBERS.values()]
    return order[max(map(order.index, kinds))]


def struct_type(annotation: Any, layout: np.dtype) -> StructType:
    """The type of a record with this dtype: the annotated class, or one that extends it."""
    kinds = [annotation] if isinstance(annotation, type) and issubclass(annotation, Record) else []
    for kind in kinds:
        if tuple(kind.fields) == layout.names:
            return StructType(kind, layout)
        kinds += kind.__subclasses__()
    raise Untyped(f"a record of {', '.join(layout.names or ())}; annotate it with its class")


def parameter(name: str, annotation: Any, given: Value) -> Value | None:
    """A parameter as its function has it: of the annotation's type, with the argument's sizes where that has none.

    None where the argument does not fit.
    """
    shape = get_args(annotation)[1] if get_origin(annotation) is Annotated else ()
    if isinstance(given, Scalar) and annotation in NUMBERS:
        if wider(NUMBERS[annotation], given.kind) == NUMBERS[annotation]:
            return Scalar(NUMBERS[annotation], name)
    elif isinstance(given, Struct) and isinstance(annotation, type) and issubclass(given.of.kind, annotation):
        return Struct(given.of, name, name)
    elif isinstance(given, Array):
        sizes = given.shape if annotation is np.ndarray else shape
        if tuple(m if isinstance(n, str) else n for n, m in zip(sizes, given.shape, strict=False)) == given.shape:
            return Array(given.kind, name, given.shape, root=name)
    return None


def described(value: Value) -> str:
    """A value's type as an annotation has it."""
    if isinstance(value, Scalar):
        return next(kind.__name__ for kind, text in NUMBERS.items() if text == value.kind)
    if isinstance(value, Array):
        return f"array {value.shape}"
    return value.of.kind.__name__ if isinstance(value, Struct) else type(value).__name__


def result_kinds(annotation: Any) -> tuple[str, ...]:
    """Types in C of the numbers that a function returns, by its annotation."""
    kinds = get_args(annotation) if get_origin(annotation) is tuple else (annotation,)
    if kinds in ((None,), (type(None),)):
        return ()
    if not all(kind in NUMBERS for kind in kinds):
        raise Untyped("a result that is no number; let the function fill its last argument")
    return tuple(NUMBERS[kind] for kind in kinds)


class Signature(NamedTuple):
    """A printed function: its name, types of its results, and which arguments it writes."""

    name: str
    result: tuple[str, ...]
    written: frozenset[int]
