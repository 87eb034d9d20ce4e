"""Calls in laws as C: numpy's and Python's own, methods of arrays, and other laws."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from typing import Any

import numpy as np

from stewart_drake.base import jit
from stewart_drake.export.expressions import Expressions, at_pointer, nothing
from stewart_drake.export.values import (
    C_TYPES,
    EQUALITY,
    UNARY,
    Array,
    Call,
    Constant,
    Entrywise,
    Made,
    Record,
    Scalar,
    Several,
    Unknown,
    Value,
    kind_of,
    number,
    wider,
)

_MATH: dict[Any, str] = {
    np.sin: "sin", np.cos: "cos", np.tanh: "tanh", np.exp: "exp", np.sqrt: "sqrt", np.abs: "fabs", np.rint: "rint",
    np.log10: "log10", np.arcsin: "asin", np.arccos: "acos", np.arctan2: "atan2", np.minimum: "minimum",
    np.maximum: "maximum", np.sign: "sign_of", np.isfinite: "isfinite", np.isnan: "isnan", abs: "fabs",
}  # fmt: skip


class Calls(Expressions):
    """A function whose statements are being printed, with what it calls."""

    def _call_value(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute):
            owner = self.value(node.func.value)
            if not isinstance(owner, Constant):
                return self._method(owner, node.func.attr)
        function = self.value(node.func)
        if not isinstance(function, Constant):
            raise Unknown("a call of what is no function")
        called = function.value
        if called is jit.record or called is np.ascontiguousarray:
            value = self.value(node.args[0])
            return self._copied(value) if isinstance(value, Array) else value
        if called in (np.empty, np.zeros):
            return self._new(node, called is np.zeros)
        if called is len:
            size = getattr(self.value(node.args[0]), "shape", (None,))[0]
            return number(size) if isinstance(size, int) else Scalar("int", str(size))
        values = [self.value(each) for each in node.args]
        if node.keywords:
            raise Unknown("an argument by its name")
        if called in (int, float, bool):
            of, kind = self._as_scalar(values[0]), {int: "int", float: "double", bool: "bool"}[called]
            if of.kind == kind:
                return of
            return Scalar(kind, f"({C_TYPES[kind]}){of.within(UNARY)}", UNARY)
        if called in (min, max):
            return self._extreme(called is min, [self._as_scalar(each) for each in values])
        if called is np.where:
            test, yes, no = values
            return self._mapped(lambda t, a, b: self._as_scalar(self._chosen(t, a, b)), test, yes, no)
        if called in _MATH:
            return self._mapped(lambda *of: self._math(called, of), *values)
        return self._user_call(called, values)

    def _math(self, called: Any, of: Sequence[Scalar]) -> Scalar:
        if _MATH[called] == "fabs" and of[0].kind == "int":
            raise Unknown("the size of an integer")
        kind = "bool" if called in (np.isfinite, np.isnan) else "double"
        return Scalar(kind, f"{self.program.helper(_MATH[called])}({', '.join(each.text for each in of)})")

    def _extreme(self, least: bool, values: list[Scalar]) -> Scalar:
        kind, result = "int", values[0]
        for each in values:
            kind = wider(kind, each.kind)
        helper = self.program.helper(("lesser" if least else "greater") + ("_int" if kind == "int" else ""))
        for each in values[1:]:
            result = Scalar(kind, f"{helper}({result.text}, {each.text})")
        return result

    def _new(self, node: ast.Call, zeros: bool) -> Value:
        shape_node = node.args[0]
        parts = shape_node.elts if isinstance(shape_node, ast.Tuple) else [shape_node]
        kind: Any = self.value(node.args[1]) if len(node.args) > 1 else None
        if isinstance(kind, Constant) and isinstance(kind.value, np.dtype):
            return Made(kind.value)
        shape = []
        for part in parts:
            size = self.scalar(part).value
            if not isinstance(size, int):
                raise Unknown("an array whose size is computed")
            shape.append(size)
        of = "bool" if isinstance(kind, Constant) and kind.value is np.bool_ else "double"
        return Entrywise(of, tuple(shape), (lambda _: number(0.0)) if zeros else nothing)

    def _copied(self, value: Array) -> Entrywise:
        return Entrywise(value.kind, value.shape, value.at)

    def _method(self, owner: Value, name: str) -> Value:
        if name == "copy":
            if isinstance(owner, Record):
                kept = self.fresh("kept")
                self.emit(f"const struct {self._struct(owner.kind, kept)} {kept} = {at_pointer(owner.pointer)};")
                return Record(owner.kind, f"&{kept}", None)
            if isinstance(owner, Array):
                return self._copied(owner)
        if not isinstance(owner, (Array, Entrywise)):
            raise Unknown(f"the method {name}")
        result = self.fresh({"any": "is_any", "all": "are_all"}.get(name, name))
        if name in ("any", "all", "sum"):
            kind = "bool" if name != "sum" else "int" if owner.kind == "bool" else "double"
            start = {"any": "false", "all": "true"}.get(name, "0" if kind == "int" else "0.0")
        elif name in ("min", "max", "argmax") and len(owner.shape) == 1:
            owner = self.stored(owner, "kept")
            kind, start = ("int", "0") if name == "argmax" else ("double", owner.at(["0"]).text)
        else:
            raise Unknown(f"the method {name}")
        self.emit(f"{C_TYPES[kind]} {result} = {start};")
        with self._loops(owner.shape) as indices:
            entry = owner.at(indices)
            if name == "sum":
                self.emit(f"{result} += {entry.text};")
            elif name in ("any", "all"):
                sign = "||" if name == "any" else "&&"
                self.emit(f"{result} = {result} {sign} {entry.within(EQUALITY)};")
            else:
                # The first NaN stays, as with numpy.
                best = owner.at([result]).text if name == "argmax" else result
                self.emit(f"if (!isnan({best}) && !({entry.text} {'>=' if name == 'min' else '<='} {best})) {{")
                self.emit(f"    {result} = {indices[0] if name == 'argmax' else entry.text};")
                self.emit("}")
        return Scalar(kind, result)

    def _user_call(self, called: Any, values: Sequence[Value]) -> Value:
        ready: list[Any] = []
        for value in values:
            if isinstance(value, Made):
                name = self.fresh("made")
                self.emit(f"struct {self._struct(value.kind, name)} {name};")
                value = Record(value.kind, f"&{name}")
            elif isinstance(value, (Entrywise, Several)) or (
                isinstance(value, Array) and (value.hidden or value.flipped)
            ):
                value = self.stored(value, "given")
            elif isinstance(value, Constant):
                value = self._as_scalar(value)
            try:
                kind_of(value)
            except Unknown:
                value = self.stored(self._copied(value), "given") if isinstance(value, Array) else value
            ready.append(value)
        signature = self.program.function(called, ready)
        texts: list[str] = []
        for k, value in enumerate(ready):
            if isinstance(value, Scalar):
                texts.append(value.text)
                continue
            if k in signature.written:
                self._mark(value)
            if isinstance(value, Record):
                texts.append(value.pointer)
                continue
            constant = k not in signature.written
            texts.append(value.pointer(constant))
            if not isinstance(value.shape[0], int):
                texts.append(value.shape[0])
        if isinstance(signature.result, list):
            result = self._local("double", self.fresh(f"{called.__name__.strip('_')}_result"), signature.result)
            self.emit(f"{signature.name}({', '.join([*texts, result.base])});")
            self.temporaries.add(result.base)
            return result
        text = f"{signature.name}({', '.join(texts)})"
        if isinstance(signature.result, tuple):
            return Call(tuple(Scalar(kind, "") for kind in signature.result), text)
        return Scalar(signature.result or "void", text)
