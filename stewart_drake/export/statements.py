"""Statements of a law as C, and the function that they are."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Sequence

from stewart_drake.export import types as c
from stewart_drake.export.expressions import BINARY, Expressions
from stewart_drake.export.source import comment, last_name
from stewart_drake.export.types import Array, Constant, Local, Scalar, Struct, TupleType, Untyped, Value, number, wider

WIDTH = 110


class Statements(Expressions):
    """A function that is being printed, statement by statement."""

    def text(self, name: str, parameters: Sequence[Value]) -> tuple[c.Signature, str]:
        """The function's name, the types of its results, which arguments it writes; and its text."""
        tree, self.top = self.source.tree, list[str]()
        self.result = c.result_kinds(self.source.types.get("return", object))
        arguments = [argument.arg for argument in tree.args.args]
        self.values = dict(zip(arguments, parameters, strict=True))
        self.statements(tree.body)
        code, heads, written = re.sub(r"/\*.*?\*/", "", "\n".join(self.lines), flags=re.DOTALL), [], set()
        for k, (argument, value) in enumerate(zip(map(self.c_name, arguments), parameters, strict=True)):
            constant = "" if argument in self.written else "const "
            if isinstance(value, Struct):
                heads.append(f"{constant}struct {self.program.struct(value.of)} *{argument}")
            elif isinstance(value, Array):
                heads.append(constant + value.declared(argument))
            elif isinstance(value, Scalar):
                heads.append(f"{value.kind} {argument}")
            written |= {k} if argument in self.written else set()
            if not re.search(rf"\b{argument}\b", code):
                self.top.append(f"    (void){argument};")
        head = f"static {self.program.result(self.result)} {name}({', '.join(heads) or 'void'})"
        docstring, place = ast.get_docstring(tree) or "", f"{self.source.file}, {tree.name}"
        note = comment(f"{docstring}\n\n{place}" if "\n" in docstring else f"{docstring}\n{place}".strip())
        marks = re.compile("\0(.*?)\1(.*?)\1(.*?)\0")
        lines = (marks.sub(lambda m: m[3] if m[1] in self.written else m[2], x) for x in (*self.top, *self.lines))
        body = "\n".join(map(wrapped, lines))
        return (name, self.result, written), f"{note}{wrapped(head)}\n{{\n{body}\n}}"

    def statements(self, body: Sequence[ast.stmt]) -> None:
        """Statements, with the comments before them."""
        for node in body:
            notes = [self.source.comments.get(line, "") for line in range(self.line + 1, node.lineno)]
            self.lines += comment("\n".join(filter(None, notes)), self.indent).splitlines()
            self.line = node.lineno
            method = getattr(self, f"_{type(node).__name__.lower()}", None)
            try:
                if method is None:
                    raise Untyped("this kind of statement")
                method(node)
            except Untyped as error:
                raise self.source.refusal(node.lineno, ast.unparse(node).splitlines()[0], str(error)) from None
            if not isinstance(node, (ast.For, ast.If)):
                self.line = max(self.line, node.end_lineno or 0)

    def _block(self, head: str, body: Sequence[ast.stmt]) -> None:
        before, taken = self.indent, set(self.taken)
        self.emit(f"{head} {{")
        self.indent += "    "
        self.statements(body)
        self.indent, self.taken = before, taken

    def _expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            value = self.value(node.value)
            self.emit(f"{value.call if isinstance(value, TupleType) else self.scalar(value).text};")

    def _if(self, node: ast.If) -> None:
        test = self.scalar(node.test)
        if test.value is not None:
            self.statements(node.body if test.value else node.orelse)
            return
        self._block(f"if ({test.text})", node.body)
        while len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
            node, count = node.orelse[0], len(self.lines)
            test = self.scalar(node.test)
            if len(self.lines) > count:
                raise Untyped("an `elif` with a condition that needs another statement; compute it before")
            self._block(f"}} else if ({test.text})", node.body)
        if node.orelse:
            self._block("} else", node.orelse)
        self.emit("}")

    def _for(self, node: ast.For) -> None:
        call = node.iter
        if not isinstance(node.target, ast.Name) or not isinstance(call, ast.Call) or last_name(call.func) != "range":
            raise Untyped("a loop that is not over a `range`")
        if node.target.id in self.source.leaking:
            raise Untyped("a loop with a variable that is used outside of it; give that another name")
        limits = [self.scalar(limit) for limit in call.args]
        start, stop, step = (number(0), limits[0], number(1)) if len(limits) == 1 else (*limits, number(1))[:3]
        if step.value not in (1, -1):
            raise Untyped("a loop with another step than 1 or -1")
        name, sign = self.c_name(node.target.id), "<" if step.value == 1 else ">"
        if re.search(r"[-(]>|\(", stop.text):
            end = self.fresh("end")
            self.emit(f"const int {end} = {stop.text};")
            stop = Scalar("int", end)
        until = f"{name} >= 0" if stop.value == -1 else f"{name} {sign} {stop.text}"
        self.values[node.target.id] = Scalar("int", name)
        self._block(f"for (int {name} = {start.text}; {until}; {name}{'++' if step.value == 1 else '--'})", node.body)
        self.emit("}")

    def _jump(self, node: ast.Break | ast.Continue) -> None:
        self.emit(f"{ast.unparse(node)};")

    _break = _continue = _jump

    def _return(self, node: ast.Return) -> None:
        value = TupleType(()) if node.value is None else self.value(node.value)
        if not isinstance(value, TupleType):
            value = TupleType((self.scalar(value),))
        kinds = tuple(self.scalar(item).kind for item in value.items)
        if len(kinds) != len(self.result) or tuple(map(wider, kinds, self.result)) != self.result:
            raise Untyped(f"a result of other types than `{ast.unparse(self.source.tree.returns or node)}`")
        if len(kinds) < 2 or (value.call and kinds == self.result):
            text = value.call or "".join(item.text for item in value.items)
        else:
            items = ", ".join(item.text for item in self.named(value, "result"))
            text = f"({self.program.result(self.result)}){{{items}}}"
        self.emit(f"return {text}".rstrip() + ";")

    def _assign(self, node: ast.Assign) -> None:
        for target in reversed(node.targets):
            if isinstance(target, ast.Tuple):
                self._unpack(target, node.value)
            else:
                self._store(target, self.value(node.value))

    def _annassign(self, node: ast.AnnAssign) -> None:
        self._store(node.target, self.value(node.value or node.target))

    def _unpack(self, targets: ast.Tuple, given: ast.expr) -> None:
        value = self.value(given)
        if not isinstance(value, TupleType):
            raise Untyped("an assignment to several names of what is no tuple")
        items = list(self.named(value, "result"))
        # All of the right side comes first: what an assignment before may change is kept.
        names, places = set[str](), False
        for k, (target, item) in enumerate(zip(targets.elts, items, strict=True)):
            text = item.text if isinstance(item, Scalar) and isinstance(given, ast.Tuple) else ""
            if names.intersection(re.findall(r"\w+", text)) or (places and re.search(r"[\[>]", text)):
                kept = self.fresh("kept")
                self.emit(f"const {item.kind} {kept} = {text};")
                items[k] = Scalar(item.kind, kept)
            names |= {self.c_name(last_name(target))}
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
        if isinstance(place, Scalar):
            self.emit(f"{place.text} = {self.scalar(value).text};")
        elif isinstance(place, Struct) and isinstance(value, Struct) and place.of == value.of:
            self.emit(f"{place.text} = {value.text};")
        else:
            raise Untyped("an assignment to a whole array; write a loop, `copy_to` or `set_to`")

    def _name(self, name: str, value: Value) -> None:
        if name == "_":
            return
        text, before, here = self.c_name(name), self.values.get(name), self.source.scope.get(name) == self.line
        if isinstance(value, (Scalar, Constant)):
            value = self.scalar(value)
            if before is None and not here:
                self.top.append(f"    {value.kind} {text} = {'false' if value.kind == 'bool' else '0'};")
            elif before is not None and getattr(before, "kind", "") != value.kind:
                kinds = f"{c.described(before)} before and {c.described(value)} here"
                raise Untyped(f"`{name}`, {kinds}; write `0.0` or `float(...)`, or take two names")
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
        elif isinstance(value, TupleType):
            self.taken.discard(text)
            self.values[name] = TupleType(self.named(value, text))
        else:  # A record in another one.
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
    whole = re.sub(r"(?<=[\w*]) (?=[\w*(])", "\0", text.lstrip())
    lines = textwrap.wrap(whole, WIDTH - 4, break_long_words=False, break_on_hyphens=False)
    indent = " " * (len(text) - len(text.lstrip()))
    return indent + f"\n{indent}    ".join(lines).replace("\0", " ")
