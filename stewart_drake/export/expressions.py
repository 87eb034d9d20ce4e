"""Expressions of a law as C, with calls of numpy's and Python's functions and of other laws."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.base.records import record
from stewart_drake.export import types as c
from stewart_drake.export.source import Source, last_name
from stewart_drake.export.types import Array, Constant, Local, Scalar, Struct, TupleType, Untyped, Value, number, wider

if TYPE_CHECKING:
    from stewart_drake.export.program import Program

FIELDS = ("first", "second", "third", "fourth")  # Fields of the struct in which a function returns several numbers.
BINARY = {ast.Add: ("+", c.SUM), ast.Sub: ("-", c.SUM), ast.Mult: ("*", c.PRODUCT), ast.Div: ("/", c.PRODUCT)}
_COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_MATH: dict[object, str] = {np.arcsin: "asin", np.arccos: "acos", np.arctan2: "atan2", np.abs: "fabs", abs: "fabs"}
_MATH |= {
    getattr(np, name): name for name in ("sin", "cos", "tanh", "exp", "sqrt", "rint", "log10", "hypot", "floor", "ceil")
}
_MATH |= {getattr(np, name): name for name in ("minimum", "maximum", "isfinite", "isnan")} | {np.sign: "sign_of"}


class Expressions:
    """A function that is being printed."""

    def __init__(self, program: Program, function: Any, source: Source) -> None:
        self.program, self.function, self.source = program, function, source
        self.values: dict[str, Value] = {}  # Variables by their names in Python.
        self.written: set[str] = set()  # Arguments that are changed.
        self.lines: list[str] = []  # What has been printed, with the marks of `unless_written`.
        self.indent, self.line = "    ", source.tree.lineno
        self.c_name, nodes = source.c_name, ast.walk(source.tree)
        self.taken = {self.c_name(node.id) for node in nodes if isinstance(node, ast.Name)} | source.avoided

    # --- names and lines ---

    def fresh(self, hint: str) -> str:
        """A new name in this function."""
        name = next(x for x in (hint, *(f"{hint}_{n}" for n in range(1, 100))) if x not in self.taken)
        self.taken.add(name)
        return name

    def emit(self, text: str) -> None:
        """Adds a line."""
        self.lines.append(self.indent + text)

    def unless_written(self, root: str | None, text: str, otherwise: str = "") -> str:
        """`text` if the argument `root` is never written, else `otherwise`; a placeholder until that is known."""
        return f"\0{root}\1{text}\1{otherwise}\0" if root else otherwise if root == "" else text

    def mark(self, value: Value) -> None:
        """Notes that an argument is written."""
        if isinstance(value, (Array, Struct)):
            if value.root is None:
                raise Untyped("an assignment to a constant")
            self.written.add(value.root)

    def named(self, value: TupleType, hint: str) -> tuple[Any, ...]:
        """The values of a tuple; those of a call are kept under a name."""
        if not value.call:
            return value.items
        name, kinds = self.fresh(hint), [item.kind for item in value.items]
        self.emit(f"const {self.program.result(kinds)} {name} = {value.call};")
        return tuple(Scalar(kind, f"{name}.{field}") for kind, field in zip(kinds, FIELDS, strict=False))

    def made(self, value: Local, name: str) -> Array | Struct:
        """A new array or record under a name."""
        of, source = value.of, value.source
        if isinstance(of, c.StructType):
            text = f" = {source.text}" if isinstance(source, Struct) else ""
            self.emit(f"struct {self.program.struct(of)} {name}{text};")
            return Struct(of, f"&{name}")
        self.emit(f"double {name}{''.join(f'[{size}]' for size in of)}{' = {0}' if value.zeros else ''};")
        if isinstance(source, Array):
            stars = "*" * (len(of) - 1)
            pointer = f"({source.pointer})" if stars and source.start != "0" else source.pointer
            copied = f"{stars}{name}, {stars}{pointer}, {int(np.prod(of))}"
            self.emit(f"{self.program.helper('copy_numbers')}({copied});")
        return Array("double", name, of)

    # --- expressions ---

    def value(self, node: ast.expr) -> Value:
        """An expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}_value", None)
        if method is None:
            raise Untyped("this kind of expression")
        result: Value = method(node)
        return result

    def scalar(self, of: ast.expr | Value) -> Scalar:
        """An expression, or its value, that is a number."""
        value = self.value(of) if isinstance(of, ast.expr) else of
        if isinstance(value, Constant) and isinstance(value.value, (bool, int, float, np.generic)):
            return number(value.value)
        if not isinstance(value, Scalar):
            raise Untyped(f"{c.described(value)} where a number is needed; write a loop over its numbers")
        return value

    def _constant_value(self, node: ast.Constant) -> Value:
        return number(node.value) if isinstance(node.value, (bool, int, float)) else Constant(node.value)

    def _name_value(self, node: ast.Name) -> Value:
        scope = self.function.__globals__
        if node.id in self.values:
            return self.values[node.id]
        if node.id in scope:
            return self._global([node.id], scope[node.id], self.function.__module__)
        if not hasattr(builtins, node.id):
            raise Untyped(f"the name {node.id}")
        return Constant(getattr(builtins, node.id))

    def _global(self, names: Sequence[str], value: Any, module: str) -> Value:
        if isinstance(value, (bool, int, float)):
            return self.program.constant(names, value, module)
        if type(value) is tuple and value and all(isinstance(x, (int, float)) for x in value):
            value = np.array(value)
        if isinstance(value, np.ndarray) and value.dtype.kind in "fi":
            return self.program.table("_".join(names).strip("_").upper(), value)
        return Constant(value)

    def _attribute_value(self, node: ast.Attribute) -> Value:
        owner = self.value(node.value)
        if isinstance(owner, Constant):
            value = getattr(owner.value, node.attr)
            if isinstance(owner.value, ModuleType):
                return self._global([node.attr], value, owner.value.__name__)
            return self._global([last_name(node.value), node.attr], value, self.function.__module__)
        if isinstance(owner, Struct):
            return owner.field(node.attr)
        if isinstance(owner, Array) and node.attr == "shape":
            return TupleType(tuple(map(number, owner.shape)))
        if isinstance(owner, Array) and node.attr == "size":
            return number(int(np.prod(owner.shape)))
        raise Untyped(f"the attribute {node.attr}; write a loop")

    def _subscript_value(self, node: ast.Subscript) -> Value:
        if ast.unparse(node.slice) == "0" and isinstance(node.value, ast.Subscript):
            field, of = getattr(node.value.slice, "value", None), self.value(node.value.value)
            if isinstance(of, Struct) and isinstance(field, str):  # `state["field"][0]` of an array of one record
                return of.field(field)
        owner = self.value(node.value)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(owner, Struct) and ast.unparse(node.slice) == "0":
            return owner
        if isinstance(owner, TupleType):
            return self.named(owner, "result")[self._index(node.slice, 0)]
        if not isinstance(owner, Array) or len(indices) > len(owner.shape):
            raise Untyped(f"an index of `{c.described(owner)}`")
        part = owner
        for n, index in enumerate(indices):
            if not isinstance(index, ast.Slice):
                place = self.scalar(index)
                if place.kind != "int" or (place.value or 0) < 0:
                    raise Untyped("an index that is no integer, or negative; write `int(...)`, or count from 0")
                part = part.row(place.within(c.SUM))
                continue
            start, stop = self._index(index.lower, 0), self._index(index.upper, part.shape[0])
            if n < len(indices) - 1 and (start, part.shape[1:], ast.unparse(indices[-1])) == (0, (1,), "0"):
                return part.row("0")._replace(shape=(stop,))  # The one column of a matrix.
            if index.step or n < len(indices) - 1:
                raise Untyped("a part of an array that is not side by side in memory; copy it in a loop")
            part = part.rows(start, min(stop, part.shape[0]))
        return part if part.shape else Scalar(part.kind, part.base)

    def _index(self, node: ast.expr | None, default: int) -> int:
        value = default if node is None else self.scalar(node).value
        if not isinstance(value, int) or value < 0:
            raise Untyped("a slice with ends that are computed, or negative; write a loop, or pass its first index")
        return value

    def _tuple_value(self, node: ast.Tuple) -> Value:
        return TupleType(tuple(self.value(item) for item in node.elts))

    def _unaryop_value(self, node: ast.UnaryOp) -> Value:
        of = self.scalar(node.operand)
        if isinstance(node.op, ast.Not):
            return Scalar("bool", f"!{of.within(c.UNARY)}", c.UNARY)
        if not isinstance(node.op, ast.USub):
            raise Untyped("an operator of this kind")
        if of.value is not None and of.text[0].isdigit():
            return number(-of.value)
        text = f"({of.text})" if of.text.startswith("-") else of.within(c.UNARY)
        return Scalar(of.kind, f"-{text}", c.UNARY, None if of.value is None else -of.value)

    def _binop_value(self, node: ast.BinOp) -> Value:
        left, right = self.scalar(node.left), self.scalar(node.right)
        if isinstance(node.op, ast.Pow):
            return self._power(left, right)
        if isinstance(node.op, ast.Mod) and "double" in (left.kind, right.kind):
            return Scalar("double", f"{self.program.helper('modulo')}({left.text}, {right.text})")
        if type(node.op) not in BINARY:
            raise Untyped("an operator of this kind; products of matrices are loops")
        sign, binding = BINARY[type(node.op)]
        kind, first, value = wider("int", left.kind, right.kind), left.within(binding), None
        if sign == "/" and kind == "int":
            first, kind = f"(double){left.within(c.UNARY)}", "double"
        elif kind == "int" and left.value is not None and right.value is not None:
            value = {"+": left.value + right.value, "-": left.value - right.value}.get(sign, left.value * right.value)
            if left.text.isdigit() and right.text.isdigit():
                return number(value)
        return Scalar(kind, f"{first} {sign} {right.within(binding + 1)}", binding, value)

    def _power(self, base: Scalar, exponent: Scalar) -> Scalar:
        if exponent.kind == "int" and exponent.value is not None and exponent.value >= 0 and base.kind == "double":
            if exponent.value == 2 and re.fullmatch(r"[\w.]+(->\w+)?(\[\w+\])*", base.text):
                return Scalar("double", f"{base.text} * {base.text}", c.PRODUCT)
            return Scalar("double", f"{self.program.helper('power')}({base.text}, {exponent.value})")
        return Scalar("double", f"pow({base.text}, {exponent.text})")

    def _boolop_value(self, node: ast.BoolOp) -> Value:
        sign, binding = ("&&", c.CONJUNCTION) if isinstance(node.op, ast.And) else ("||", c.DISJUNCTION)
        parts = [self.scalar(part) for part in node.values]
        texts = [part.within(c.EQUALITY if part.binding != binding else binding) for part in parts]
        return Scalar("bool", f" {sign} ".join(texts), binding)

    def _compare_value(self, node: ast.Compare) -> Value:
        values = [self.scalar(part) for part in (node.left, *node.comparators)]
        signs = [_COMPARED.get(type(op)) for op in node.ops]
        if None in signs:
            raise Untyped("a comparison of this kind")
        if signs == ["=="] and all(x.kind == "int" and x.value is not None for x in values):
            return number(values[0].value == values[1].value)
        pairs = zip(signs, values, values[1:], strict=False)
        texts = [f"{a.within(c.SUM)} {sign} {b.within(c.SUM)}" for sign, a, b in pairs]
        binding = c.EQUALITY if signs[0] in ("==", "!=") else c.RELATION
        return Scalar("bool", " && ".join(texts), binding if len(texts) == 1 else c.CONJUNCTION)

    def _ifexp_value(self, node: ast.IfExp) -> Value:
        test = self.scalar(node.test)
        if test.value is not None:
            return self.value(node.body if test.value else node.orelse)
        yes, no = self.value(node.body), self.value(node.orelse)
        if isinstance(yes, Array) and isinstance(no, Array) and yes.shape == no.shape:
            text = f"({test.within(c.CHOICE + 1)} ? {yes.pointer} : {no.pointer})"
            return Array(yes.kind, text, yes.shape, root=None if None in (yes.root, no.root) else yes.root or no.root)
        yes, no = self.scalar(yes), self.scalar(no)
        text = f"{test.within(c.CHOICE + 1)} ? {yes.within(c.CHOICE)} : {no.within(c.CHOICE)}"
        return Scalar(wider(yes.kind, no.kind), text, c.CHOICE)

    # --- calls ---

    def _call_value(self, node: ast.Call) -> Value:
        if node.keywords:
            raise Untyped("an argument by its name")
        if isinstance(node.func, ast.Attribute) and not isinstance(owner := self.value(node.func.value), Constant):
            if node.func.attr != "copy" or not isinstance(owner, (Array, Struct)):
                raise Untyped(f"the method {node.func.attr}; write a loop")
            return Local(owner.shape if isinstance(owner, Array) else owner.of, owner)
        called = getattr(self.value(node.func), "value", None)
        if called in (np.empty, np.zeros):
            return self._new(node.args, called is np.zeros)
        given = [self.value(argument) for argument in node.args]
        if called is record:
            return given[0]
        if called is len and isinstance(given[0], Array):
            return number(given[0].shape[0])
        if called not in (min, max, *_MATH, *c.NUMBERS):
            return self._law(called, given)
        of_numbers = [self.scalar(value) for value in given]
        first = of_numbers[0]
        if called in c.NUMBERS:
            kind = c.NUMBERS[called]
            return first if first.kind == kind else Scalar(kind, f"({kind}){first.within(c.UNARY)}", c.UNARY)
        if called in _MATH:
            if _MATH[called] == "fabs" and first.kind == "int":
                raise Untyped("the size of an integer; write `float(...)`")
            kind = "bool" if called in (np.isfinite, np.isnan) else "double"
            return Scalar(kind, f"{self.program.helper(_MATH[called])}({', '.join(x.text for x in of_numbers)})")
        kind = wider("int", *(x.kind for x in of_numbers))
        helper = self.program.helper(("lesser" if called is min else "greater") + ("_int" if kind == "int" else ""))
        for x in of_numbers[1:]:
            first = Scalar(kind, f"{helper}({first.text}, {x.text})")
        return first

    def _new(self, arguments: Sequence[ast.expr], zeros: bool) -> Local:
        if len(arguments) > 1:
            kind = getattr(self.value(arguments[1]), "value", None)
            if not isinstance(kind, np.dtype):
                raise Untyped("an array of such numbers; write float64 alone")
            return Local(c.struct_type(kind))
        sizes = arguments[0].elts if isinstance(arguments[0], ast.Tuple) else [arguments[0]]
        shape = tuple(self.scalar(size).value for size in sizes)
        if not all(isinstance(size, int) for size in shape):
            raise Untyped("an array with a computed size; write a constant")
        return Local(shape, zeros=zeros)

    def _law(self, called: object, values: Sequence[Value]) -> Value:
        given = [self.made(x, self.fresh("local")) if isinstance(x, Local) else x for x in values]
        (name, kinds, written), texts = self.program.function(called, given), list[str]()
        for k, value in enumerate(given):
            if k in written:
                self.mark(value)
            text = value.text if isinstance(value, Scalar) else value.pointer  # type: ignore[union-attr]
            if isinstance(value, Array) and len(value.shape) > 1 and k not in written:
                # C does not make a pointer to constant rows of a pointer to rows.
                text = self.unless_written(value.root, "", f"(const {value.declared('')})") + text
            texts.append(text)
        text = f"{name}({', '.join(texts)})"
        if len(kinds) > 1:
            return TupleType(tuple(Scalar(kind, "") for kind in kinds), text)
        return Scalar(kinds[0] if kinds else "void", text)
