"""Statements of a law as C, until kinds of variables, and which arguments are written, are known."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.calls import Calls
from stewart_drake.export.expressions import BINARY, at_pointer, last_name
from stewart_drake.export.source import Source, comment, homes_of, loop_variables, refusal
from stewart_drake.export.values import (
    C_TYPES,
    Array,
    Axis,
    Call,
    Constant,
    Entrywise,
    Made,
    Record,
    Scalar,
    Several,
    Signature,
    Unknown,
    Value,
    declared,
    number,
    wider,
)

if TYPE_CHECKING:
    from stewart_drake.export.printer import Program

WIDTH = 110
RESERVED = frozenset([
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern",
    "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed",
    "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while", "bool",
    "true", "false", "main", "loop", "y0", "y1", "yn", "j0", "j1", "jn", "gamma", "exp", "log", "pow", "sqrt",
    "fabs",
])  # fmt: skip


class Translation(Calls):
    """One function for arguments of some kinds; it is walked until kinds of variables and what is written are known."""

    def __init__(self, program: Program, function: Any, source: Source, name: str, kinds: Sequence[Any]) -> None:
        self.program, self.function, self.source, self.name, self.kinds = program, function, source, name, kinds
        self.known: dict[str, str] = {}  # Kinds of numbers by the names of variables.
        self.written: set[str] = set()
        self.result: Any = None
        self.homes = homes_of(source.tree)
        self.loops = loop_variables(source.tree)
        called = {last_name(node.func) for node in ast.walk(source.tree) if isinstance(node, ast.Call)}
        used = {node.id for node in ast.walk(source.tree) if isinstance(node, ast.Name)}
        used |= {each.arg for each in source.tree.args.args}
        self.avoided = RESERVED | {name.strip("_") for name in called if name} | {"abs", "min", "max"}
        self.used = {self.c_name(each) for each in used}

    def text(self) -> tuple[Signature, str]:
        """The function, printed."""
        for _ in range(6):
            before = dict(self.known), set(self.written), self.result
            body = self._walk()
            if before == (self.known, self.written, self.result):
                break
        parameters, arguments = [], self.source.tree.args.args
        for argument, kind in zip(arguments, self.kinds, strict=True):
            parameters += self._parameter(argument.arg, kind)
        result = self.result
        if isinstance(result, list):
            parameters.append(declared("double", "result", result[1:], False))
        of = self.program.result(result) if isinstance(result, tuple) else "void"
        of = C_TYPES[result] if isinstance(result, str) else of
        head = _call(f"static {of} {self.name}", parameters or ["void"])
        said = ast.get_docstring(self.source.tree)
        place = f"{self.source.file}, {self.source.tree.name}"
        written = frozenset(k for k, each in enumerate(arguments) if each.arg in self.written)
        note = comment(f"{said}\n\n{place}" if said and "\n" in said else f"{said}\n{place}" if said else place)
        return Signature(self.name, result, written), f"{note}{head}\n{{\n{''.join(body)}}}"

    def _parameter(self, name: str, kind: Any) -> list[str]:
        own, constant = self.c_name(name), name not in self.written
        if isinstance(kind, str):
            return [f"{C_TYPES[kind]} {own}"]
        if isinstance(kind, np.dtype):
            return [f"{'const ' if constant else ''}struct {self._struct(kind, name)} *{own}"]
        of, shape, sizes, _ = kind
        length = [f"int {own}_rows"] if shape[0] is None else []
        return [declared(of, own, sizes, constant), *length]

    def _walk(self) -> list[str]:
        self.lines: list[str] = []
        self.taken = set(self.used)
        self.indent, self.line = "    ", self.source.tree.lineno
        self.top: list[str] = []
        self.declared: set[str] = set()
        self.temporaries: set[str] = set()
        self.values: dict[str, Value] = {}
        for argument, kind in zip(self.source.tree.args.args, self.kinds, strict=True):
            self.values[argument.arg] = self._argument(argument.arg, kind)
        for statement in self.source.tree.body:
            self.statement(statement)
        unused = [self.c_name(a.arg) for a in self.source.tree.args.args if self._is_unused(a.arg)]
        return [*self.top, *(f"    (void){name};\n" for name in unused), *self.lines]

    def _is_unused(self, name: str) -> bool:
        pattern = re.compile(rf"\b{re.escape(self.c_name(name))}\b")
        return not any(pattern.search(line.split("/*")[0]) for line in self.lines)

    def _argument(self, name: str, kind: Any) -> Value:
        own = self.c_name(name)
        if isinstance(kind, str):
            return Scalar(kind, own)
        if isinstance(kind, np.dtype):
            return Record(kind, own, name)
        of, shape, sizes, pattern = kind
        lengths = iter(f"{own}_rows" if size is None else size for size in shape)
        return Array(of, own, sizes, tuple(Axis("0", next(lengths) if runs else None) for runs in pattern), name)

    def refused(self, node: ast.AST, reason: str) -> ConfigurationError:
        """The error of a node that is not known."""
        place = f"{self.source.file}:{getattr(node, 'lineno', self.line)}"
        return refusal(place, ast.unparse(node).splitlines()[0], reason)

    def statement(self, node: ast.stmt) -> None:
        """A statement, with the comments before it."""
        for line in range(self.line + 1, node.lineno):
            if line in self.source.comments:
                for each in comment(self.source.comments[line], self.indent).splitlines():
                    self.lines.append(each + "\n")
        self.line = node.lineno
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        try:
            if method is None:
                raise Unknown("this kind of statement")
            method(node)
        except Unknown as error:
            raise self.refused(node, str(error)) from None
        self.line = max(self.line, node.end_lineno or node.lineno) if not _has_body(node) else self.line

    def block(self, body: Sequence[ast.stmt]) -> None:
        """Statements within braces."""
        before, self.indent, taken = self.indent, self.indent + "    ", set(self.taken)
        for statement in body:
            self.statement(statement)
        self.indent, self.taken = before, taken

    def _expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return
        value = self.value(node.value)
        if isinstance(value, Scalar) or (isinstance(value, Several) and isinstance(value, Call)):
            self.emit(f"{value.text};")

    def _if(self, node: ast.If) -> None:
        test = self.scalar(node.test)
        if test.value is not None:
            for statement in node.body if test.value else node.orelse:
                self.statement(statement)
            return
        self.emit(f"if ({test.text}) {{")
        self.block(node.body)
        if node.orelse:
            # What an `elif` needs first stands before it, so it is nested.
            self.emit("} else {")
            self.block(node.orelse)
            self._flatten()
        self.emit("}")

    def _flatten(self) -> None:
        """Makes of `else { if ... }` an `else if`, where nothing else is in it."""
        start = max(k for k, line in enumerate(self.lines) if line == f"{self.indent}}} else {{\n")
        inner, deeper = self.lines[start + 1 :], self.indent + "    "
        opens = inner[0].startswith(f"{deeper}if (") if inner else False
        whole = [line for line in inner if line.startswith(deeper) and not line.startswith(deeper + " ")]
        alone = all(re.match(r"\s*(if \(|\} else (if \(.*\) )?\{|\})", line) for line in whole)
        if opens and alone and sum(line.startswith(f"{deeper}if (") for line in whole) == 1:
            moved = [line[4:] for line in inner[:-1]]
            self.lines[start:] = [f"{self.indent}}} else {moved[0].lstrip()}", *moved[1:]]

    def _while(self, node: ast.While) -> None:
        if not (isinstance(node.test, ast.Constant) and node.test.value is True) or node.orelse:
            raise Unknown("a loop with a condition")
        self.emit("while (true) {")
        self.block(node.body)
        self.emit("}")

    def _for(self, node: ast.For) -> None:
        if not isinstance(node.target, ast.Name) or node.orelse:
            raise Unknown("a loop of more than one variable")
        if node.target.id not in self.loops:
            raise Unknown("a loop whose variable is used or set outside of loops")
        name = self.c_name(node.target.id)
        if isinstance(node.iter, ast.Call) and getattr(node.iter.func, "id", "") == "range":
            limits = [self.scalar(each) for each in node.iter.args]
            start, stop, step = (
                (number(0), limits[0], number(1)) if len(limits) == 1 else (*limits, number(1))[:3]
            )  # fmt: skip
            if step.value not in (1, -1):
                raise Unknown("a loop with another step than 1 or -1")
            if re.search(r"[-(]>|\(", stop.text):
                end = self.fresh("end")
                self.emit(f"const int {end} = {stop.text};")
                stop = Scalar("int", end)
            until = f"{name} >= 0" if stop.value == -1 else f"{name} {'<' if step.value == 1 else '>'} {stop.text}"
            self.emit(f"for (int {name} = {start.text}; {until}; {name}{'++' if step.value == 1 else '--'}) {{")
            self.values[node.target.id] = Scalar("int", name)
            self.block(node.body)
            self.emit("}")
            return
        over = self.value(node.iter)
        if isinstance(over, Several) and not all(isinstance(each, Scalar) for each in over.items):
            for each in over.items:
                self.emit("{")
                self.values[node.target.id] = each
                self.block(node.body)
                self.emit("}")
            return
        over = self.stored(over, f"{name}_of")
        index = self.fresh("n")
        self.emit(f"for (int {index} = 0; {index} < {over.shape[0]}; {index}++) {{")
        entry = self._part(over, [Axis(index)])
        self.indent += "    "
        assert isinstance(entry, Scalar)
        self.emit(f"const {C_TYPES[entry.kind]} {name} = {entry.text};")
        self.indent = self.indent[:-4]
        self.values[node.target.id] = Scalar(entry.kind, name)
        self.block(node.body)
        self.emit("}")

    def _continue(self, _: ast.Continue) -> None:
        self.emit("continue;")

    def _break(self, _: ast.Break) -> None:
        self.emit("break;")

    def _return(self, node: ast.Return) -> None:
        if node.value is None:
            self.emit("return;")
            return
        value = self.value(node.value)
        if isinstance(value, Scalar):
            self.result = wider(self.result, value.kind)
            self.emit(f"return {value.text};")
        elif isinstance(value, Several):
            kinds = tuple(self._as_scalar(each).kind for each in value.items)
            before = self.result or kinds
            self.result = tuple(wider(a, b) for a, b in zip(before, kinds, strict=True))
            if isinstance(value, Call) and kinds == self.result:
                self.emit(f"return {value.text};")
                return
            items = ", ".join(each.text for each in self._several(value, "result").items)
            self.emit(f"return ({self.program.result(self.result)}){{{items}}};")
        elif isinstance(value, (Array, Entrywise)):
            self.result = list(value.shape)
            sizes = tuple(size for size in value.shape if isinstance(size, int))
            self._fill(Array("double", "result", sizes[1:], tuple(Axis("0", size) for size in sizes)), value)
            self.emit("return;")
        else:
            raise Unknown("a result of this kind")

    def _assign(self, node: ast.Assign) -> None:
        for target in node.targets[::-1]:
            if isinstance(target, ast.Tuple):
                self._unpack(target, node.value)
            else:
                self._store(target, self.value(node.value), node)

    def _annassign(self, node: ast.AnnAssign) -> None:
        assert node.value is not None
        self._store(node.target, self.value(node.value), node)

    def _unpack(self, targets: ast.Tuple, given: ast.expr) -> None:
        value = self.value(given)
        if isinstance(value, Constant) and isinstance(value.value, tuple):
            value = Several(tuple(number(each) for each in value.value))
        if not isinstance(value, Several):
            raise Unknown("an assignment to several names of what is not several")
        value = self._several(value, "result")
        names = {self.c_name(each.id) for each in targets.elts if isinstance(each, ast.Name)}
        items = list(value.items)
        places = any(not isinstance(each, ast.Name) for each in targets.elts)
        # All of the right side comes first: what of it may change on the way is kept.
        for k, item in enumerate(items):
            if k == 0 or not isinstance(given, ast.Tuple) or not isinstance(item, Scalar):
                continue
            if names.intersection(re.findall(r"\w+", item.text)) or (places and re.search(r"[\[>]", item.text)):
                kept = self.fresh("kept")
                self.emit(f"const {C_TYPES[item.kind]} {kept} = {item.text};")
                items[k] = Scalar(item.kind, kept)
        for target, item in zip(targets.elts, items, strict=True):
            self._store(target, item, target)

    def _store(self, target: ast.expr, value: Value, node: ast.AST) -> None:
        if isinstance(target, ast.Name):
            self._name(target.id, value, node)
            return
        if isinstance(target, ast.Attribute):
            owner = self.value(target.value)
            if not isinstance(owner, Record):
                raise Unknown("an assignment to an attribute of what is no record")
            self._mark(owner)
            place: Value = owner.attribute(target.attr)
        elif isinstance(target, ast.Subscript):
            owner = self.value(target.value)
            self._mark(owner)
            if isinstance(owner, Record):
                if not isinstance(value, Record) or value.kind != owner.kind:
                    raise Unknown("an assignment to a record of what is none of its kind")
                self.emit(f"{at_pointer(owner.pointer)} = {at_pointer(value.pointer)};")
                return
            place = self._part(owner, self._indices(target.slice, owner))
        else:
            raise Unknown("an assignment of this kind")
        if isinstance(place, Scalar):
            self.emit(f"{place.text} = {self._as_scalar(value).text};")
        elif isinstance(place, Array):
            self._fill(place, value)
        else:
            raise Unknown("an assignment of this kind")

    def _name(self, name: str, value: Value, node: ast.AST) -> None:
        if name == "_":
            return
        own, home = self.c_name(name), self.homes.get(name)
        here = home is not None and home == getattr(node, "lineno", None) and name not in self.declared
        if isinstance(value, Scalar):
            kind = self.known[name] = wider(self.known.get(name), value.kind)
            if here:
                self.declared.add(name)
                self.emit(f"{C_TYPES[kind]} {own} = {value.text};")
            else:
                if name not in self.declared and not isinstance(self.values.get(name), Scalar):
                    self.declared.add(name)
                    self.top.append(f"    {C_TYPES[kind]} {own} = {'false' if kind == 'bool' else '0'};\n")
                self.emit(f"{own} = {value.text};")
            self.values[name] = Scalar(kind, own)
        elif isinstance(value, Record) or (isinstance(value, Array) and value.flipped):
            self.values[name] = value
        elif isinstance(value, Several):
            kinds = {each.kind for each in value.items if isinstance(each, Scalar)}
            if isinstance(value, Call):
                self.values[name] = self._several(value, own)
            elif kinds == {"double"}:
                self.values[name] = self.stored(value, own)
            else:
                self.values[name] = value
        elif isinstance(value, Array):
            if value.base == own or value.base in self.temporaries:
                self.values[name] = value
                return
            sizes, pattern = value.layout
            constant = value.root is None or (value.root != "" and value.root not in self.written)
            lengths = iter(value.shape)
            view = tuple(Axis("0", next(lengths) if runs else None) for runs in pattern)
            self.emit(f"{declared(value.kind, own, sizes, constant)} = {value.pointer(constant)};")
            self.values[name] = Array(value.kind, own, sizes, view, value.root)
        elif isinstance(value, Entrywise):
            before = self.values.get(name)
            if not (isinstance(before, Array) and before.shape == value.shape and before.root == ""):
                before = self.values[name] = self._local(value.kind, own, value.shape)
            self._fill(before, value)
        elif isinstance(value, Made):
            self.emit(f"struct {self._struct(value.kind, name)} {own};")
            self.values[name] = Record(value.kind, f"&{own}")
        else:
            self.values[name] = value

    def _augassign(self, node: ast.AugAssign) -> None:
        sign = BINARY.get(type(node.op), ("",))[0]
        target, value = self.value(node.target), self.value(node.value)
        self._mark(target)
        if isinstance(node.target, (ast.Attribute, ast.Subscript)):
            self._mark(self.value(node.target.value))
        if isinstance(target, Scalar) and sign:
            if isinstance(node.target, ast.Name):
                self.known[node.target.id] = wider(self.known.get(node.target.id), self._as_scalar(value).kind)
            self.emit(f"{target.text} {sign}= {self._as_scalar(value).text};")
        elif isinstance(target, Array) and sign:
            self._fill(target, value, f"{sign}=")
        else:
            raise Unknown("an operator of this kind")


def _has_body(node: ast.stmt) -> bool:
    return isinstance(node, (ast.For, ast.While, ast.If))


def _call(head: str, parameters: Sequence[str]) -> str:
    """A head of a function within the width."""
    text = f"{head}({', '.join(parameters)})"
    if len(text) <= WIDTH:
        return text
    wrapped = textwrap.wrap(", ".join(each.replace(" ", "~") for each in parameters), WIDTH - 4)
    return f"{head}(\n" + "\n".join(f"    {line}".replace("~", " ") for line in wrapped) + ")"
