"""Statements of a law as C, and the function that they are."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Sequence

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.expressions import BINARY, Expressions, last_name
from stewart_drake.export.source import comment
from stewart_drake.export.types import (
    Array,
    Constant,
    Local,
    Scalar,
    Signature,
    Struct,
    TupleType,
    Untyped,
    Value,
    described,
    number,
    result_kinds,
    wider,
)

WIDTH = 110


class Statements(Expressions):
    """A function that is being printed, statement by statement."""

    def text(self, name: str, parameters: Sequence[Value]) -> tuple[Signature, str]:
        """The function, printed."""
        tree, self.top = self.source.tree, list[str]()
        self.result = result_kinds(self.source.types.get("return", object))
        arguments = [argument.arg for argument in tree.args.args]
        self.values = dict(zip(arguments, parameters, strict=True))
        self.statements(tree.body)
        body = "\n".join(self.lines)
        code, heads = re.sub(r"/\*.*?\*/", "", body, flags=re.DOTALL), []
        for argument, value in zip(arguments, parameters, strict=True):
            given = self.c_name(argument)
            if isinstance(value, Scalar):
                heads.append(f"{value.kind} {given}")
            elif isinstance(value, (Array, Struct)):
                struct = isinstance(value, Struct) and f"struct {self.program.struct(value.of)} *{given}"
                constant = "" if given in self.written else "const "
                heads.append(constant + (struct or value.declared(given)))
            if not re.search(rf"\b{given}\b", code):
                self.top.append(f"    (void){given};")
        kind = self.program.result(self.result)
        head = wrapped(f"static {kind} {name}({', '.join(heads) or 'void'})")
        docstring, place = ast.get_docstring(tree), f"{self.source.file}, {tree.name}"
        note = f"{docstring or ''}\n{place}" if "\n" not in (docstring or "") else f"{docstring}\n\n{place}"
        lines = [wrapped(self.resolved(line)) for line in [*self.top, *self.lines]]
        written = frozenset(k for k, argument in enumerate(arguments) if self.c_name(argument) in self.written)
        return Signature(name, self.result, written), f"{comment(note.lstrip())}{head}\n{{\n" + "\n".join(lines) + "\n}"

    def statements(self, body: Sequence[ast.stmt]) -> None:
        """Statements, with the comments before them."""
        for node in body:
            for line in range(self.line + 1, node.lineno):
                if line in self.source.comments:
                    self.lines += comment(self.source.comments[line], self.indent).splitlines()
            self.line = node.lineno
            method = getattr(self, f"_{type(node).__name__.lower()}", None)
            try:
                if method is None:
                    raise Untyped("this kind of statement")
                method(node)
            except Untyped as error:
                raise self._refusal(node, str(error)) from None
            if not isinstance(node, (ast.For, ast.While, ast.If)):
                self.line = max(self.line, node.end_lineno or 0)

    def _refusal(self, node: ast.stmt, reason: str) -> ConfigurationError:
        return self.source.refusal(node.lineno, ast.unparse(node).splitlines()[0], reason)

    def _block(self, body: Sequence[ast.stmt]) -> None:
        before, taken = self.indent, set(self.taken)
        self.indent += "    "
        self.statements(body)
        self.indent, self.taken = before, taken

    def _expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            value = self.value(node.value)
            self.emit(f"{value.call if isinstance(value, TupleType) else self._number(value).text};")

    def _if(self, node: ast.If) -> None:
        test = self.scalar(node.test)
        if test.value is not None:
            self.statements(node.body if test.value else node.orelse)
            return
        self.emit(f"if ({test.text}) {{")
        self._block(node.body)
        while len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
            node, count = node.orelse[0], len(self.lines)
            test = self.scalar(node.test)
            if len(self.lines) > count or test.value is not None:
                raise Untyped("an `elif` that needs a statement of its own; compute its condition before")
            self.emit(f"}} else if ({test.text}) {{")
            self._block(node.body)
        if node.orelse:
            self.emit("} else {")
            self._block(node.orelse)
        self.emit("}")

    def _while(self, node: ast.While) -> None:
        if not (isinstance(node.test, ast.Constant) and node.test.value is True) or node.orelse:
            raise Untyped("a loop with a condition; write `while True` and `break`")
        self.emit("while (true) {")
        self._block(node.body)
        self.emit("}")

    def _for(self, node: ast.For) -> None:
        call = node.iter
        if not isinstance(node.target, ast.Name) or not isinstance(call, ast.Call) or last_name(call.func) != "range":
            raise Untyped("a loop that is not over a `range`")
        if node.target.id in self.leaking:
            raise Untyped("a loop with a variable that is used outside of it; give that another name")
        limits = [self.scalar(limit) for limit in call.args]
        start, stop, step = (number(0), limits[0], number(1)) if len(limits) == 1 else (*limits, number(1))[:3]
        if step.value not in (1, -1):
            raise Untyped("a loop with another step than 1 or -1")
        name = self.c_name(node.target.id)
        if re.search(r"[-(]>|\(", stop.text):
            end = self.fresh("end")
            self.emit(f"const int {end} = {stop.text};")
            stop = Scalar("int", end)
        until = f"{name} >= 0" if stop.value == -1 else f"{name} {'<' if step.value == 1 else '>'} {stop.text}"
        self.emit(f"for (int {name} = {start.text}; {until}; {name}{'++' if step.value == 1 else '--'}) {{")
        self.values[node.target.id] = Scalar("int", name)
        self._block(node.body)
        self.emit("}")

    def _continue(self, _: ast.Continue) -> None:
        self.emit("continue;")

    def _break(self, _: ast.Break) -> None:
        self.emit("break;")

    def _pass(self, _: ast.Pass) -> None:
        pass

    def _return(self, node: ast.Return) -> None:
        value = TupleType(()) if node.value is None else self.value(node.value)
        items = value.items if isinstance(value, TupleType) else (self._number(value),)
        if len(items) != len(self.result) or any(
            wider(k, x.kind) != k for k, x in zip(self.result, items, strict=True)
        ):
            raise Untyped(f"a result of other types than `{ast.unparse(self.source.tree.returns or node)}`")
        text = f" {value.call}" if isinstance(value, TupleType) and value.call else ""
        if len(items) == 1:
            text = f" {items[0].text}"
        elif items and (not text or tuple(item.kind for item in items) != self.result):
            items = self.named(value, "result").items
            text = f" ({self.program.result(self.result)}){{{', '.join(item.text for item in items)}}}"
        self.emit(f"return{text};")

    def _assign(self, node: ast.Assign) -> None:
        for target in reversed(node.targets):
            if isinstance(target, ast.Tuple):
                self._unpack(target, node.value)
            else:
                self._store(target, self.value(node.value))

    def _annassign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self._store(node.target, self.value(node.value))

    def _unpack(self, targets: ast.Tuple, given: ast.expr) -> None:
        if isinstance(given, ast.Tuple):
            items = [self.value(item) for item in given.elts]
        else:
            value = self.value(given)
            if not isinstance(value, TupleType):
                raise Untyped("an assignment to several names of what is no tuple")
            items = list(self.named(value, "result").items)
        # All of the right side comes first: what an assignment before may change is kept.
        names, places = set[str](), False
        for k, (target, item) in enumerate(zip(targets.elts, items, strict=True)):
            text = item.text if isinstance(item, Scalar) and isinstance(given, ast.Tuple) else ""
            if names.intersection(re.findall(r"\w+", text)) or (places and re.search(r"[\[>]", text)):
                kept = self.fresh("kept")
                self.emit(f"const {item.kind} {kept} = {item.text};")
                items[k] = Scalar(item.kind, kept)
            names |= {self.c_name(target.id)} if isinstance(target, ast.Name) else set()
            places = places or not isinstance(target, ast.Name)
        for target, item in zip(targets.elts, items, strict=True):
            self._store(target, item)

    def _store(self, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Name):
            self._name(target.id, value)
            return
        if not isinstance(target, (ast.Attribute, ast.Subscript)):
            raise Untyped("an assignment of this kind")
        place = self.value(target)
        self.mark(self.value(target.value))
        if isinstance(place, Struct) and isinstance(value, Struct) and place.of == value.of:
            self.emit(f"{place.text} = {value.text};")
        elif isinstance(place, Scalar):
            self.emit(f"{place.text} = {self._number(value).text};")
        else:
            raise Untyped("an assignment to a whole array; write a loop, `copy_to` or `set_to`")

    def _name(self, name: str, value: Value) -> None:
        if name == "_":
            return
        text, before = self.c_name(name), self.values.get(name)
        here = self.scope.get(name) == self.line
        if isinstance(value, (Scalar, Constant)):
            value = self._number(value)
            if before is None and not here:
                self.top.append(f"    {value.kind} {text} = {'false' if value.kind == 'bool' else '0'};")
            elif isinstance(before, Scalar) and before.kind != value.kind:
                kinds, better = f"{described(before)} before, {described(value)} here", wider(before.kind, value.kind)
                raise Untyped(
                    f"`{name}`, {kinds}; {'write `0.0` or `float(...)`' if better == 'double' else 'use two names'}"
                )
            self.emit(f"{f'{value.kind} ' if before is None and here else ''}{text} = {value.text};")
            self.values[name] = Scalar(value.kind, text)
        elif isinstance(value, (Array, Struct)) and value.pointer in (text, getattr(before, "pointer", "")):
            self.values[name] = value
        elif before is not None or not (here or isinstance(value, Struct)):
            raise Untyped(f"another array or record under the name `{name}`, or one that is used after its block")
        elif isinstance(value, Array):
            self.emit(f"{self.unless_written(value.root, 'const ')}{value.declared(text)} = {value.pointer};")
            self.values[name] = value._replace(base=text, start="0")
        elif isinstance(value, Local):
            self.values[name] = self.made(value, text)
        elif isinstance(value, TupleType) and {item.kind for item in value.items} == {"double"} and not value.call:
            self.emit(f"const double {text}[] = {{{', '.join(item.text for item in value.items)}}};")
            self.values[name] = Array("double", text, (len(value.items),), root=None)
        else:
            self.values[name] = value

    def _augassign(self, node: ast.AugAssign) -> None:
        target, value = self.value(node.target), self.scalar(node.value)
        if not isinstance(target, Scalar) or type(node.op) not in BINARY:
            raise Untyped("an operator of this kind; write a loop over the numbers")
        if isinstance(node.target, (ast.Attribute, ast.Subscript)):
            self.mark(self.value(node.target.value))
        if wider(target.kind, value.kind) != target.kind or (isinstance(node.op, ast.Div) and target.kind != "double"):
            raise Untyped(f"`{ast.unparse(node.target)}`, an integer that becomes a float; begin with `0.0`")
        self.emit(f"{target.text} {BINARY[type(node.op)][0]}= {value.text};")


def wrapped(text: str) -> str:
    """A line of C within the width, broken between arguments and around operators."""
    if len(text) <= WIDTH or "/*" in text:
        return text
    indent = " " * (len(text) - len(text.lstrip()))
    whole = re.sub(r"(?<=[\w*]) (?=[\w*(])", "\0", text.lstrip())
    lines = textwrap.wrap(whole, WIDTH, initial_indent=indent, subsequent_indent=indent + "    ", break_long_words=False,
                          break_on_hyphens=False)  # fmt: skip
    return "\n".join(lines).replace("\0", " ")
