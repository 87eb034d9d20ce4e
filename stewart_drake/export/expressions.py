"""Expressions of a law as C, with calls of numpy's and Python's functions and of other laws."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.base import jit, records
from stewart_drake.export.source import Source, scope_of
from stewart_drake.export.types import (
    CHOICE,
    CONJUNCTION,
    DISJUNCTION,
    EQUALITY,
    NUMBERS,
    PRODUCT,
    RELATION,
    SUM,
    UNARY,
    Array,
    Constant,
    Local,
    Scalar,
    Struct,
    TupleType,
    Untyped,
    Value,
    described,
    number,
    wider,
)

if TYPE_CHECKING:
    from stewart_drake.export.program import Program

RESERVED = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false
    main loop y0 y1 yn j0 j1 jn gamma exp log pow sqrt fabs abs min max""".split()
)
FIELDS = ("first", "second", "third", "fourth")
"""Of the struct in which a function returns several numbers."""
BINARY: dict[type[ast.operator], tuple[str, int, Any]] = {
    ast.Add: ("+", SUM, operator.add),
    ast.Sub: ("-", SUM, operator.sub),
    ast.Mult: ("*", PRODUCT, operator.mul),
    ast.Div: ("/", PRODUCT, None),
}
_COMPARED: dict[type[ast.cmpop], tuple[str, int, Any]] = {
    ast.Lt: ("<", RELATION, operator.lt),
    ast.LtE: ("<=", RELATION, operator.le),
    ast.Gt: (">", RELATION, operator.gt),
    ast.GtE: (">=", RELATION, operator.ge),
    ast.Eq: ("==", EQUALITY, operator.eq),
    ast.NotEq: ("!=", EQUALITY, operator.ne),
}
_MATH: dict[Any, str] = {
    **{getattr(np, name): name for name in ("sin", "cos", "tanh", "exp", "sqrt", "rint", "log10", "hypot")},
    **{np.arcsin: "asin", np.arccos: "acos", np.arctan2: "atan2", np.abs: "fabs", abs: "fabs", np.sign: "sign_of"},
    **{getattr(np, name): name for name in ("minimum", "maximum", "isfinite", "isnan")},
}


class Expressions:
    """A function that is being printed: its variables, and the lines so far.

    Attributes:
        values: Variables by their names in Python.
        written: Arguments that are changed.
        lines: What has been printed. Text that depends on whether an argument is changed is marked, see `unless_written`.
    """

    def __init__(self, program: Program, function: Any, source: Source) -> None:
        self.program, self.function, self.source = program, function, source
        self.values: dict[str, Value] = {}
        self.written: set[str] = set()
        self.lines: list[str] = []
        self.indent, self.line = "    ", source.tree.lineno
        self.scope, self.leaking = scope_of(source.tree)
        nodes = list(ast.walk(source.tree))
        called = {last_name(node.func).strip("_") for node in nodes if isinstance(node, ast.Call)}
        self.avoided = RESERVED | called
        self.taken = {self.c_name(node.id) for node in nodes if isinstance(node, ast.Name)} | self.avoided

    # --- names and lines ---

    def c_name(self, name: str) -> str:
        """A variable's name in C."""
        name = name.strip("_") or "unused"
        return f"{name}_" if name in self.avoided else name

    def fresh(self, hint: str) -> str:
        """A name that nothing else has."""
        name, n = hint, 1
        while name in self.taken:
            name, n = f"{hint}_{n}", n + 1
        self.taken.add(name)
        return name

    def emit(self, text: str) -> None:
        """Adds a line."""
        self.lines.append(self.indent + text)

    def unless_written(self, root: str | None, text: str, otherwise: str = "") -> str:
        """Text for a part of an argument that is not changed, or of a constant."""
        if not root:
            return otherwise if root == "" else text
        return f"\0{root}\1{text}\1{otherwise}\0"

    def resolved(self, text: str) -> str:
        """Text without the marks of `unless_written`."""
        return re.sub("\0(.*?)\1(.*?)\1(.*?)\0", lambda m: m[3] if m[1] in self.written else m[2], text)

    def mark(self, value: Value) -> None:
        """Remembers that an argument is changed."""
        if isinstance(value, (Array, Struct)):
            if value.root is None:
                raise Untyped("an assignment to a constant")
            self.written.add(value.root)

    def named(self, value: TupleType, hint: str) -> TupleType:
        """Several numbers; those of a call are kept under a name."""
        if not value.call:
            return value
        name, kinds = self.fresh(hint), [item.kind for item in value.items]
        self.emit(f"const {self.program.result(kinds)} {name} = {value.call};")
        return TupleType(tuple(Scalar(kind, f"{name}.{f}") for kind, f in zip(kinds, FIELDS, strict=False)))

    def made(self, value: Local, name: str) -> Array | Struct:
        """A new array or record under a name."""
        if not isinstance(value.of, str):
            source = f" = {value.source.text}" if isinstance(value.source, Struct) else ""
            self.emit(f"struct {self.program.struct(value.of)} {name}{source};")
            return Struct(value.of, f"&{name}")
        sizes = "".join(f"[{size}]" for size in value.shape)
        self.emit(f"{value.of} {name}{sizes}{' = {0}' if value.zeros else ''};")
        array = Array(value.of, name, value.shape)
        if isinstance(value.source, Array):
            self._copy(array, value.source)
        return array

    def _copy(self, target: Array, source: Array) -> None:
        before, used = self.indent, re.findall(r"\w+", f"{target.base} {source.base} {source.start}")
        free = (name for name in ("k", "m", "n", "i", "j", "row", "column") if name not in used)
        while target.shape:
            index = next(free)
            self.emit(f"for (int {index} = 0; {index} < {target.shape[0]}; {index}++) {{")
            target, source, self.indent = target.at(index), source.at(index), self.indent + "    "
        self.emit(f"{target.base} = {source.base};")
        while self.indent != before:
            self.indent = self.indent[:-4]
            self.emit("}")

    # --- expressions ---

    def value(self, node: ast.expr) -> Value:
        """An expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}_value", None)
        if method is None:
            raise Untyped("this kind of expression")
        result: Value = method(node)
        return result

    def scalar(self, node: ast.expr) -> Scalar:
        """An expression that is a number."""
        return self._number(self.value(node))

    def _number(self, value: Value) -> Scalar:
        if isinstance(value, Constant) and isinstance(value.value, (bool, int, float, np.generic)):
            return number(value.value)
        if not isinstance(value, Scalar):
            raise Untyped(f"{described(value)} where a number is needed; write a loop over its numbers")
        return value

    def _constant_value(self, node: ast.Constant) -> Value:
        return number(node.value) if isinstance(node.value, (bool, int, float)) else Constant(node.value)

    def _name_value(self, node: ast.Name) -> Value:
        if node.id in self.values:
            return self.values[node.id]
        scope = self.function.__globals__
        if node.id in scope:
            return self._global([node.id], scope[node.id], self.function.__module__)
        builtins = scope["__builtins__"]
        found = builtins.get(node.id) if isinstance(builtins, dict) else getattr(builtins, node.id, None)
        if found is None:
            raise Untyped(f"the name {node.id}")
        return Constant(found)

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
            value, names = getattr(owner.value, node.attr), [last_name(node.value), node.attr]
            if isinstance(owner.value, ModuleType):
                return self._global(names[1:], value, owner.value.__name__)
            return self._global(names, value, self.function.__module__)
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
        if isinstance(owner, Struct) and isinstance(node.slice, ast.Constant) and node.slice.value == 0:
            return owner
        if isinstance(owner, TupleType):
            place = self.scalar(node.slice).value
            if not isinstance(place, int):
                raise Untyped("an index of a tuple that is computed; write an array")
            return self.named(owner, "result").items[place]
        if not isinstance(owner, Array) or len(indices) > len(owner.shape):
            raise Untyped(f"an index of `{described(owner)}`")
        part, column = owner, False
        for n, index in enumerate(indices):
            size = part.shape[0]
            if isinstance(index, ast.Slice):
                start, stop = (self._limit(x, y, size) for x, y in ((index.lower, 0), (index.upper, size)))
                column = n < len(indices) - 1 and (start, stop) == (0, size) and part.shape[1:] == (1,)
                if index.step or (n < len(indices) - 1 and not column):
                    raise Untyped("a part of an array that is not side by side in memory; copy it in a loop")
                part = part.at(str(start))._replace(shape=(size,)) if column else part.rows(str(start), stop - start)
            elif not column:
                place = self.scalar(index)
                if place.kind != "int":
                    raise Untyped("an index that is no integer; write `int(...)`")
                negative = place.value is not None and place.value < 0
                part = part.at(str(size + place.value) if negative else place.within(SUM))
        return part if part.shape else Scalar(part.kind, part.base)

    def _limit(self, node: ast.expr | None, default: int, size: int) -> int:
        value = default if node is None else self.scalar(node).value
        if not isinstance(value, int):
            raise Untyped("a slice whose ends are computed; write a loop, or pass its begin")
        return min(value + size if value < 0 else value, size)

    def _tuple_value(self, node: ast.Tuple) -> Value:
        return TupleType(tuple(self.scalar(item) for item in node.elts))

    def _unaryop_value(self, node: ast.UnaryOp) -> Value:
        of = self.scalar(node.operand)
        if isinstance(node.op, ast.Not):
            return number(not of.value) if of.value is not None else Scalar("bool", f"!{of.within(UNARY)}", UNARY)
        if not isinstance(node.op, ast.USub):
            raise Untyped("an operator of this kind")
        if of.value is not None and of.text[0].isdigit():
            return number(-of.value)
        text = f"({of.text})" if of.text.startswith("-") else of.within(UNARY)
        return Scalar(of.kind, f"-{text}", UNARY, None if of.value is None else -of.value)

    def _binop_value(self, node: ast.BinOp) -> Value:
        left, right = self.scalar(node.left), self.scalar(node.right)
        if isinstance(node.op, ast.Pow):
            return self._power(left, right)
        if isinstance(node.op, ast.Mod) and "double" in (left.kind, right.kind):
            return Scalar("double", f"{self.program.helper('modulo')}({left.text}, {right.text})")
        if isinstance(node.op, ast.FloorDiv) and left.kind == "int" and (right.value or 0) > 0:
            return Scalar("int", f"{left.within(PRODUCT)} / {right.within(UNARY)}", PRODUCT)
        if type(node.op) not in BINARY:
            raise Untyped("an operator of this kind; products of matrices, remainders of integers are loops and sums")
        sign, binding, law = BINARY[type(node.op)]
        kind, first, value = wider("int", left.kind, right.kind), left.within(binding), None
        if sign == "/" and kind == "int":
            first, kind = f"(double){left.within(UNARY)}", "double"
        elif kind == "int" and left.value is not None and right.value is not None:
            value = law(left.value, right.value)
            if left.text.isdigit() and right.text.isdigit():
                return number(value)
        return Scalar(kind, f"{first} {sign} {right.within(binding + 1)}", binding, value)

    def _power(self, base: Scalar, exponent: Scalar) -> Scalar:
        if exponent.kind == "int" and exponent.value is not None and exponent.value >= 0 and base.kind == "double":
            if exponent.value == 2 and re.fullmatch(r"[\w.]+(->\w+)?(\[\w+\])*", base.text):
                return Scalar("double", f"{base.text} * {base.text}", PRODUCT)
            return Scalar("double", f"{self.program.helper('power')}({base.text}, {exponent.value})")
        return Scalar("double", f"pow({base.text}, {exponent.text})")

    def _boolop_value(self, node: ast.BoolOp) -> Value:
        is_and = isinstance(node.op, ast.And)
        sign, binding = ("&&", CONJUNCTION) if is_and else ("||", DISJUNCTION)
        parts = [self.scalar(part) for part in node.values]
        parts = [part for part in parts if part.value is None or bool(part.value) != is_and]
        if not parts or parts[0].value is not None:
            return number(is_and if not parts else not is_and)
        texts = [part.within(EQUALITY if part.binding != binding else binding) for part in parts]
        return parts[0] if len(parts) == 1 else Scalar("bool", f" {sign} ".join(texts), binding)

    def _compare_value(self, node: ast.Compare) -> Value:
        values, results = [self.scalar(part) for part in (node.left, *node.comparators)], []
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in _COMPARED:
                raise Untyped("a comparison of this kind")
            sign, binding, law = _COMPARED[type(op)]
            known = a.kind == b.kind == "int" and a.value is not None and b.value is not None
            text = f"{a.within(SUM)} {sign} {b.within(SUM)}"
            results.append(number(law(a.value, b.value)) if known else Scalar("bool", text, binding))
        if len(results) == 1:
            return results[0]
        return Scalar("bool", " && ".join(result.text for result in results), CONJUNCTION)

    def _ifexp_value(self, node: ast.IfExp) -> Value:
        test = self.scalar(node.test)
        if test.value is not None:
            return self.value(node.body if test.value else node.orelse)
        yes, no = self.value(node.body), self.value(node.orelse)
        if isinstance(yes, Array) and isinstance(no, Array) and yes.shape == no.shape:
            text = f"({test.within(CHOICE + 1)} ? {yes.pointer} : {no.pointer})"
            return Array(yes.kind, text, yes.shape, root=yes.root or no.root)
        yes, no = self._number(yes), self._number(no)
        text = f"{test.within(CHOICE + 1)} ? {yes.within(CHOICE)} : {no.within(CHOICE)}"
        return Scalar(wider(yes.kind, no.kind), text, CHOICE)

    # --- calls ---

    def _call_value(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute) and not isinstance(owner := self.value(node.func.value), Constant):
            if node.func.attr != "copy" or not isinstance(owner, (Array, Struct)):
                raise Untyped(f"the method {node.func.attr}; write a loop")
            return Local(owner.kind, owner.shape, owner) if isinstance(owner, Array) else Local(owner.of, (), owner)
        function = self.value(node.func)
        if not isinstance(function, Constant) or node.keywords:
            raise Untyped("an argument by its name" if node.keywords else "a call of what is no function")
        called = function.value
        if called is jit.record or called is records.record:
            return self.value(node.args[0])
        if called in (np.empty, np.zeros):
            return self._new(node.args, called is np.zeros)
        if called is len:
            of = self.value(node.args[0])
            return number(of.shape[0]) if isinstance(of, Array) else number(len(getattr(of, "items", ())))
        if called in NUMBERS:
            of, kind = self.scalar(node.args[0]), NUMBERS[called]
            return of if of.kind == kind else Scalar(kind, f"({kind}){of.within(UNARY)}", UNARY)
        if called not in (min, max, *_MATH):
            return self._law(called, [self.value(argument) for argument in node.args])
        of = [self.scalar(argument) for argument in node.args]
        if called not in (min, max):
            if _MATH[called] == "fabs" and of[0].kind == "int":
                raise Untyped("the size of an integer; write `float(...)`")
            kind = "bool" if called in (np.isfinite, np.isnan) else "double"
            return Scalar(kind, f"{self.program.helper(_MATH[called])}({', '.join(x.text for x in of)})")
        kind, result = wider("int", *(x.kind for x in of)), of[0]
        helper = ("lesser" if called is min else "greater") + ("_int" if kind == "int" else "")
        for x in of[1:]:
            result = Scalar(kind, f"{self.program.helper(helper)}({result.text}, {x.text})")
        return result

    def _new(self, arguments: Sequence[ast.expr], zeros: bool) -> Local:
        kind = self.value(arguments[1]) if len(arguments) > 1 else Constant(float)
        if isinstance(kind, Constant) and isinstance(kind.value, np.dtype):
            return Local(self.program.struct_of(kind.value))
        sizes = arguments[0].elts if isinstance(arguments[0], ast.Tuple) else [arguments[0]]
        shape = tuple(self.scalar(size).value for size in sizes)
        if not all(isinstance(size, int) for size in shape):
            raise Untyped("an array whose size is computed; write a constant")
        of = {float: "double", np.bool_: "bool"}.get(getattr(kind, "value", None))
        if of is None:
            raise Untyped("an array of such numbers; write float64")
        return Local(of, shape, zeros=zeros)

    def _law(self, called: Any, values: Sequence[Value]) -> Value:
        given = [self.made(x, self.fresh(f"local_{called.__name__}")) if isinstance(x, Local) else x for x in values]
        signature, parameters = self.program.function(called, given)
        texts = []
        for k, (value, parameter) in enumerate(zip(given, parameters, strict=True)):
            if k in signature.written:
                self.mark(value)
            text = value.text if isinstance(value, Scalar) else value.pointer
            if isinstance(value, Array) and len(value.shape) > 1 and k not in signature.written:
                # C does not make a pointer to constant rows of a pointer to rows.
                text = self.unless_written(value.root, "", f"(const {value.declared('')})") + text
            texts.append(text)
        text, kinds = f"{signature.name}({', '.join(texts)})", signature.result
        if len(kinds) > 1:
            return TupleType(tuple(Scalar(kind, "") for kind in kinds), text)
        return Scalar(kinds[0] if kinds else "void", text)


def last_name(node: ast.expr) -> str:
    """A name without what is before its last dot."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
