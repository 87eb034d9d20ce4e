"""Expressions of laws as C: what they are, see `values`, and what has to stand before the statement they are in."""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.export.values import (
    ATOM,
    C_TYPES,
    CHOICE,
    CONJUNCTION,
    DISJUNCTION,
    EQUALITY,
    PRODUCT,
    RELATION,
    SUM,
    UNARY,
    Array,
    Axis,
    Call,
    Constant,
    Entrywise,
    Record,
    Scalar,
    Several,
    Unknown,
    Value,
    number,
    wider,
)

if TYPE_CHECKING:
    from stewart_drake.export.printer import Program

FIELDS = ("first", "second", "third", "fourth")
BINARY = {ast.Add: ("+", SUM), ast.Sub: ("-", SUM), ast.Mult: ("*", PRODUCT), ast.Div: ("/", PRODUCT)}
_COMPARED = {
    ast.Lt: ("<", RELATION), ast.LtE: ("<=", RELATION), ast.Gt: (">", RELATION), ast.GtE: (">=", RELATION),
    ast.Eq: ("==", EQUALITY), ast.NotEq: ("!=", EQUALITY),
}  # fmt: skip


class Expressions:
    """A function whose statements are being printed: its variables, and the lines so far."""

    program: Program
    function: Any
    values: dict[str, Value]
    known: dict[str, str]  # Kinds of numbers by the names of variables.
    written: set[str]  # Arguments that are changed.
    lines: list[str]
    indent: str
    used: set[str]
    taken: set[str]
    avoided: frozenset[str]
    temporaries: set[str]

    # --- names and lines ---

    def c_name(self, name: str) -> str:
        """A variable's name in C."""
        own = name.strip("_") or "unused"
        return f"{own}_" if own in self.avoided else own

    def _struct(self, kind: np.dtype, hint: str) -> str:
        return self.program.record(kind, hint, self.function)

    def fresh(self, hint: str) -> str:
        """A name that nothing else has."""
        name, n = hint, 1
        while name in self.taken or name in self.avoided:
            name, n = f"{hint}_{n}", n + 1
        self.taken.add(name)
        return name

    def emit(self, text: str) -> None:
        """Adds a line."""
        self.lines.append(f"{self.indent}{text}\n")

    def _several(self, value: Several, hint: str) -> Several:
        """Several values; those of a call are kept under a name."""
        if not isinstance(value, Call):
            return value
        name = self.fresh(hint)
        kinds = [each.kind for each in value.items]
        self.emit(f"const {self.program.result(kinds)} {name} = {value.text};")
        return Several(tuple(Scalar(kind, f"{name}.{f}") for kind, f in zip(kinds, FIELDS, strict=False)))

    def _mark(self, value: Value) -> None:
        """Remembers that an argument is written."""
        root = getattr(value, "root", "")
        if root is None:
            raise Unknown("an assignment to a constant")
        if root:
            self.written.add(root)

    @contextmanager
    def _loops(self, sizes: Sequence[int | str]) -> Iterator[list[str]]:
        """Nested loops over indices of an array; what is emitted within stands in the innermost."""
        before, taken, indices = self.indent, set(self.taken), list[str]()
        for size in sizes:
            indices.append(self.fresh("kmnp"[len(indices)]))
            self.emit(f"for (int {indices[-1]} = 0; {indices[-1]} < {size}; {indices[-1]}++) {{")
            self.indent += "    "
        yield indices
        while self.indent != before:
            self.indent = self.indent[:-4]
            self.emit("}")
        self.taken = taken

    def _local(self, kind: str, name: str, shape: Sequence[int | str]) -> Array:
        """A new array."""
        if not all(isinstance(size, int) for size in shape):
            raise Unknown("an array whose size is computed")
        sizes = tuple(int(size) for size in shape)
        self.emit(f"{C_TYPES[kind]} {name}{''.join(f'[{size}]' for size in sizes)};")
        return Array(kind, name, sizes[1:], tuple(Axis("0", size) for size in sizes))

    def _fill(self, place: Array, value: Value, sign: str = "=") -> None:
        self._mark(place)
        if isinstance(value, Several):
            for k, each in enumerate(value.items):
                self.emit(f"{place.at([str(k)]).text} {sign} {self._as_scalar(each).text};")
        elif not (isinstance(value, Entrywise) and value.at is nothing):
            with self._loops(place.shape) as indices:
                self.emit(f"{place.at(indices).text} {sign} {self._entry(value, indices, place.shape).text};")

    def _entry(self, value: Value, indices: Sequence[str], shape: Sequence[int | str]) -> Scalar:
        if isinstance(value, Scalar):
            return value
        if not isinstance(value, (Array, Entrywise)) or tuple(value.shape) != tuple(shape):
            raise Unknown(f"an array of another shape than {tuple(shape)}")
        return value.at(indices)

    def stored(self, value: Value, hint: str) -> Array:
        """An array as it can be passed on: as it is, or kept under a name."""
        if isinstance(value, Array) and not value.flipped and not value.hidden:
            return value
        if isinstance(value, Several):
            items = [self._as_scalar(each) for each in value.items]
            name = hint if hint not in self.taken or hint in self.used else self.fresh(hint)
            text = ", ".join(each.text for each in items)
            self.emit(f"const double {name}[{len(items)}] = {{{text}}};")
            return Array("double", name, (), (Axis("0", len(items)),), None)
        if not isinstance(value, (Array, Entrywise)):
            raise Unknown("no array")
        result = self._local(value.kind, self.fresh(hint), value.shape)
        self._fill(result, value)
        self.temporaries.add(result.base)
        return result

    def _indices(self, node: ast.expr, owner: Value) -> list[Axis | None]:
        parts = node.elts if isinstance(node, ast.Tuple) else [node]
        shape = [1, *owner.shape] if isinstance(owner, Array) and owner.hidden else list(getattr(owner, "shape", [1]))
        places: list[Axis | None] = []
        for part, size in zip(parts, shape, strict=False):
            if not isinstance(part, ast.Slice):
                place = self.scalar(part)
                if place.kind != "int":
                    raise Unknown("an index that is no integer")
                if place.value is not None and place.value < 0:
                    place = number(size + place.value)
                places.append(Axis(place.within(SUM)))
                continue
            if part.step is not None:
                raise Unknown("a slice with a step")
            if part.lower is None and part.upper is None:
                places.append(None)
                continue
            start = number(0) if part.lower is None else self.scalar(part.lower)
            stop = number(size) if part.upper is None else self.scalar(part.upper)
            ends = [
                each if each.value is None or each.value >= 0 else number(size + each.value) for each in (start, stop)
            ]
            if all(each.value is not None for each in ends):
                length: int | str = min(ends[1].value, size) - ends[0].value
            elif ends[1].value == size and not places:
                name = self.fresh("start")
                self.emit(f"const int {name} = {ends[0].text};")
                ends[0], length = Scalar("int", name), f"{size} - {name}"
            else:
                raise Unknown("a slice whose end is computed")
            places.append(Axis(ends[0].within(SUM), length))
        return places

    def _part(self, owner: Value, places: list[Axis | None]) -> Value:
        if isinstance(owner, Constant) and isinstance(owner.value, tuple):
            place = places[0]
            if place is not None and place.start.isdigit():
                return number(owner.value[int(place.start)])
            raise Unknown("an index of this kind")
        if isinstance(owner, Several):
            place = places[0]
            if place is None or not place.start.isdigit():
                raise Unknown("an index of several values that is not known")
            return self._several(owner, "result").items[int(place.start)]
        if isinstance(owner, Entrywise):
            owner = self.stored(owner, "kept")
        if not isinstance(owner, Array):
            raise Unknown("an index of what is no array")
        if owner.hidden:
            owner, places = owner._replace(hidden=False), places[1:]
        part = owner.indexed(places[::-1] if owner.flipped else places)
        return part if part.shape else part.at([])

    # --- expressions ---

    def scalar(self, node: ast.expr) -> Scalar:
        """An expression that is a number."""
        return self._as_scalar(self.value(node))

    def _as_scalar(self, value: Value) -> Scalar:
        if isinstance(value, Scalar):
            return value
        if isinstance(value, Constant) and isinstance(value.value, (bool, int, float, np.generic)):
            return number(value.value)
        raise Unknown("no number where one is needed")

    def value(self, node: ast.expr) -> Value:
        """An expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}_value", None)
        if method is None:
            raise Unknown("this kind of expression")
        result: Value = method(node)
        return result

    def _constant_value(self, node: ast.Constant) -> Value:
        return number(node.value) if isinstance(node.value, (bool, int, float)) else Constant(node.value)

    def _name_value(self, node: ast.Name) -> Value:
        if node.id in self.values:
            return self.values[node.id]
        scope = self.function.__globals__
        if node.id in scope:
            return self._global([node.id], scope[node.id], inspect.getmodule(self.function))
        builtins = scope["__builtins__"]
        found = builtins.get(node.id) if isinstance(builtins, dict) else getattr(builtins, node.id, None)
        if found is None:
            raise Unknown(f"the name {node.id}")
        return Constant(found)

    def _global(self, names: list[str], value: Any, module: Any) -> Value:
        if isinstance(value, (bool, int, float)):
            return self.program.constant(names, value, module)
        if isinstance(value, np.ndarray) and value.dtype.kind in "fib":
            return self.program.table("_".join(names).strip("_").upper(), value)
        if type(value) is tuple and value and all(type(each) is float for each in value):
            return self.program.table("_".join(names).strip("_").upper(), np.array(value))
        return Constant(value)

    def _attribute_value(self, node: ast.Attribute) -> Value:
        owner = self.value(node.value)
        if isinstance(owner, Constant):
            value = getattr(owner.value, node.attr)
            if isinstance(owner.value, ModuleType):
                return self._global([node.attr], value, owner.value)
            return self._global([last_name(node.value) or "", node.attr], value, inspect.getmodule(self.function))
        if isinstance(owner, Record):
            return owner.attribute(node.attr)
        if isinstance(owner, (Array, Entrywise)):
            if node.attr == "shape":
                return Several(tuple(number(n) if isinstance(n, int) else Scalar("int", n) for n in owner.shape))
            if node.attr == "size" and all(isinstance(n, int) for n in owner.shape):
                return number(math.prod(int(n) for n in owner.shape))
            if node.attr == "T" and isinstance(owner, Array) and len(owner.shape) == 2:
                return owner._replace(flipped=not owner.flipped)
        raise Unknown(f"the attribute {node.attr}")

    def _subscript_value(self, node: ast.Subscript) -> Value:
        owner = self.value(node.value)
        if isinstance(owner, Record):
            if isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, str):
                return owner.entry(node.slice.value)
            return owner
        return self._part(owner, self._indices(node.slice, owner))

    def _tuple_value(self, node: ast.Tuple) -> Value:
        return Several(tuple(self.value(each) for each in node.elts))

    def _unaryop_value(self, node: ast.UnaryOp) -> Value:
        value = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            of = self._as_scalar(value)
            if of.value is not None:
                return number(not of.value)
            return Scalar("bool", f"!{of.within(UNARY)}", UNARY)
        if not isinstance(node.op, ast.USub):
            raise Unknown("an operator of this kind")

        def negative(of: Scalar) -> Scalar:
            if of.value is not None and of.text[0].isdigit():
                return number(-of.value)
            text = of.within(ATOM) if of.text.startswith("-") else of.within(UNARY)
            return Scalar(of.kind, f"-{text}", UNARY, None if of.value is None else -of.value)

        return self._mapped(negative, value)

    def _binop_value(self, node: ast.BinOp) -> Value:
        left, right = self.value(node.left), self.value(node.right)
        if isinstance(node.op, ast.MatMult):
            return self._product(left, right)
        if isinstance(node.op, ast.Pow):
            return self._mapped(lambda base: self._power(base, self._as_scalar(right)), left)
        if isinstance(node.op, (ast.Mod, ast.FloorDiv)):
            a, b = self._as_scalar(left), self._as_scalar(right)
            if isinstance(node.op, ast.Mod):
                return Scalar("double", f"{self.program.helper('modulo')}({a.text}, {b.text})")
            if a.kind != "int" or not (b.value or 0) > 0:
                raise Unknown("a whole quotient of what may be negative")
            return Scalar("int", f"{a.within(PRODUCT)} / {b.within(PRODUCT + 1)}", PRODUCT)
        if type(node.op) not in BINARY:
            raise Unknown("an operator of this kind")
        sign, binding = BINARY[type(node.op)]

        def both(a: Scalar, b: Scalar) -> Scalar:
            kind = wider(wider("int", a.kind), b.kind)
            if kind == "int" and a.value is not None and b.value is not None and sign != "/":
                value = {"+": a.value + b.value, "-": a.value - b.value, "*": a.value * b.value}[sign]
                if a.text.isdigit() and b.text.isdigit():
                    return number(value)
            first = a.within(binding)
            if sign == "/" and kind == "int":
                first, kind = f"(double){a.within(UNARY)}", "double"
            return Scalar(kind, f"{first} {sign} {b.within(binding + 1)}", binding)

        return self._mapped(both, left, right)

    def _power(self, base: Scalar, exponent: Scalar) -> Scalar:
        if exponent.kind == "int" and exponent.value is not None and exponent.value >= 0 and base.kind == "double":
            if exponent.value == 2 and re.fullmatch(r"[\w.]+(->\w+)?(\[\w+\])*", base.text):
                return Scalar("double", f"{base.text} * {base.text}", PRODUCT)
            return Scalar("double", f"{self.program.helper('power')}({base.text}, {exponent.value})")
        return Scalar("double", f"pow({base.text}, {exponent.text})")

    def _product(self, left: Value, right: Value) -> Value:
        """A product of matrices, or of one with a vector, kept."""
        if not isinstance(right, Array):
            right = self.stored(right, "right")
        if not isinstance(left, Array) or len(left.shape) != 2 or left.shape[1] != right.shape[0]:
            raise Unknown("a product of this kind")
        shape = (left.shape[0], *right.shape[1:])
        result = self._local("double", self.fresh("product"), shape)
        inner = self.fresh("n")
        with self._loops(shape) as rows:
            entry = result.at(rows).text
            self.emit(f"{entry} = 0.0;")
            self.emit(f"for (int {inner} = 0; {inner} < {left.shape[1]}; {inner}++) {{")
            self.emit(f"    {entry} += {left.at([rows[0], inner]).text} * {right.at([inner, *rows[1:]]).text};")
            self.emit("}")
        self.temporaries.add(result.base)
        return result

    def _boolop_value(self, node: ast.BoolOp) -> Value:
        is_and = isinstance(node.op, ast.And)
        sign, binding = ("&&", CONJUNCTION) if is_and else ("||", DISJUNCTION)
        parts = [self.scalar(each) for each in node.values]
        if any(each.value is not None and bool(each.value) != is_and for each in parts[:1]):
            return number(not is_and)
        left = [each for each in parts if each.value is None]
        if not left or any(each.value is not None and bool(each.value) != is_and for each in parts):
            return number(is_and if not left else not is_and)
        if len(left) == 1:
            return left[0]
        texts = [each.within(EQUALITY if each.binding != binding else binding) for each in left]
        return Scalar("bool", f" {sign} ".join(texts), binding)

    def _compare_value(self, node: ast.Compare) -> Value:
        values = [self.value(each) for each in (node.left, *node.comparators)]
        results = []
        for operator, left, right in zip(node.ops, values, values[1:], strict=False):
            if type(operator) not in _COMPARED:
                raise Unknown("a comparison of this kind")
            sign, binding = _COMPARED[type(operator)]

            def compared(a: Scalar, b: Scalar, sign: str = sign, binding: int = binding) -> Scalar:
                if a.kind == b.kind == "int" and a.value is not None and b.value is not None and sign in ("==", "!="):
                    return number((a.value == b.value) == (sign == "=="))
                return Scalar("bool", f"{a.within(SUM)} {sign} {b.within(SUM)}", binding)

            results.append(self._mapped(compared, left, right))
        if len(results) == 1:
            return results[0]
        return Scalar("bool", " && ".join(self._as_scalar(each).text for each in results), CONJUNCTION)

    def _ifexp_value(self, node: ast.IfExp) -> Value:
        test = self.scalar(node.test)
        if test.value is not None:
            return self.value(node.body if test.value else node.orelse)
        return self._chosen(test, self.value(node.body), self.value(node.orelse))

    def _chosen(self, test: Scalar, yes: Value, no: Value) -> Value:
        if isinstance(yes, Several) and isinstance(no, Several):
            return Several(tuple(self._chosen(test, a, b) for a, b in zip(yes.items, no.items, strict=True)))
        if isinstance(yes, Array) and isinstance(no, Array) and yes.layout == no.layout and yes.shape == no.shape:
            sizes, pattern = yes.layout
            lengths = iter(yes.shape)
            view = tuple(Axis("0", next(lengths) if runs else None) for runs in pattern)
            text = f"({test.within(CHOICE + 1)} ? {yes.pointer(False)} : {no.pointer(False)})"
            return Array(yes.kind, text, sizes, view, yes.root if yes.root else no.root)

        def choice(a: Scalar, b: Scalar) -> Scalar:
            kind = wider(a.kind, b.kind)
            text = f"{test.within(CHOICE + 1)} ? {a.within(CHOICE)} : {b.within(CHOICE)}"
            return Scalar(kind, text, CHOICE)

        return self._mapped(choice, yes, no)

    def _mapped(self, law: Callable[..., Scalar], *values: Value) -> Value:
        """A law of numbers, entry by entry where one of its arguments is an array."""
        arrays = [each for each in values if isinstance(each, (Array, Entrywise))]
        if not arrays:
            return law(*(self._as_scalar(each) for each in values))
        shape = arrays[0].shape

        def at(indices: Sequence[str]) -> Scalar:
            return law(*(self._entry(each, indices, shape) for each in values))

        return Entrywise(at(["0"] * len(shape)).kind, shape, at)


def nothing(_: Sequence[str]) -> Scalar:
    """An entry of an array that is not set yet."""
    return number(0.0)


def at_pointer(pointer: str) -> str:
    """What a pointer points to."""
    return pointer[1:] if pointer.startswith("&") else f"*{pointer}"


def last_name(node: ast.expr) -> str | None:
    """A name without what stands before its last dot."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None
