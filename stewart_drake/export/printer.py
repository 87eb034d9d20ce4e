"""Compiled laws as C99: a translation of their source, function by function, that people can read.

The laws are a small subset of Python: numbers, arrays of float64 of known shapes, records, and functions of these.
Names stay, docstrings and comments too. A function that is called with arrays of other shapes is printed again. Numbers
come out as numba computes them: in the same order, with its rules for powers, `min` and NaN. What is not known here is
refused with file and line.
"""

from __future__ import annotations

import ast
import inspect
import io
import math
import re
import textwrap
import tokenize
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base import jit
from stewart_drake.base.errors import ConfigurationError
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
    Constant,
    Entrywise,
    Made,
    Record,
    Scalar,
    Several,
    Unknown,
    Value,
    declared,
    number,
)

WIDTH = 110
_PACKAGE = Path(__file__).parents[1]
_RESERVED = frozenset([
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern",
    "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed",
    "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while", "bool",
    "true", "false", "main", "loop", "y0", "y1", "yn", "j0", "j1", "jn", "gamma", "exp", "log", "pow", "sqrt",
    "fabs",
])  # fmt: skip
_LETTERS = {"double": "d", "int": "i", "bool": "b"}
_FIELDS = ("first", "second", "third", "fourth")
_BINARY = {ast.Add: ("+", SUM), ast.Sub: ("-", SUM), ast.Mult: ("*", PRODUCT), ast.Div: ("/", PRODUCT)}
_COMPARED = {
    ast.Lt: ("<", RELATION), ast.LtE: ("<=", RELATION), ast.Gt: (">", RELATION), ast.GtE: (">=", RELATION),
    ast.Eq: ("==", EQUALITY), ast.NotEq: ("!=", EQUALITY),
}  # fmt: skip
_MATH: dict[Any, str] = {
    np.sin: "sin", np.cos: "cos", np.tanh: "tanh", np.exp: "exp", np.sqrt: "sqrt", np.abs: "fabs", np.rint: "rint",
    np.log10: "log10", np.arcsin: "asin", np.arccos: "acos", np.arctan2: "atan2", np.minimum: "minimum",
    np.maximum: "maximum", np.sign: "sign_of", np.isfinite: "isfinite", np.isnan: "isnan", abs: "fabs",
}  # fmt: skip
TEMPLATES = Path(__file__).parent / "templates"
_HELPERS = {
    re.findall(r"^static \w+ (\w+)", text, re.MULTILINE)[0]: text
    for text in (TEMPLATES / "helpers.c").read_text().strip().split("\n\n")
}
"""What C does not have: texts by name."""


class Signature(NamedTuple):
    """A printed function: its name, its result, which arguments it writes, and whether each array has a free length.

    The result is None, the kind of a number, a tuple of kinds, or the shape of an array, in a list.
    """

    name: str
    result: Any
    written: frozenset[int]


class Source(NamedTuple):
    """Where a function stands, its syntax, and its comments by their lines."""

    file: str
    tree: ast.FunctionDef
    comments: dict[int, str]


@lru_cache(maxsize=256)
def _parsed(path: str) -> tuple[ast.Module, dict[int, str]]:
    text = Path(path).read_text()
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokens
        if token.type == tokenize.COMMENT and token.line.lstrip().startswith("#")
    }
    return ast.parse(text), comments


def source_of(function: Any) -> Source:
    """The source of a law, compiled or not."""
    function = getattr(function, "py_func", function)
    if not inspect.isfunction(function):
        raise Unknown(f"{getattr(function, '__name__', function)}, which is no function of the package's laws")
    path, line = function.__code__.co_filename, function.__code__.co_firstlineno
    tree, comments = _parsed(path)
    for node in ast.walk(tree):
        first = node.decorator_list[:1] if isinstance(node, ast.FunctionDef) else []
        if isinstance(node, ast.FunctionDef) and line in (node.lineno, *(each.lineno for each in first)):
            return Source(_short(path), node, comments)
    raise Unknown(f"{function.__name__}, whose source is not there")


def refusal(place: str, given: str, reason: str) -> ConfigurationError:
    """What is not known here, with file and line."""
    return ConfigurationError(place, given, f"what can be printed as C, see docs/export.md; this is {reason}")


def _short(path: str) -> str:
    place = Path(path)
    return str(place.relative_to(_PACKAGE.parent)) if place.is_relative_to(_PACKAGE.parent) else path


class Program:
    """The laws that have been printed so far, and what they need.

    Attributes:
        functions: Their texts by name, callees first.
        records: Types of records by their names in C.
        tables: Names and texts of constant arrays and records.
    """

    def __init__(self) -> None:
        self.functions: dict[str, str] = {}
        self.records: dict[str, np.dtype] = {}
        self.tables: dict[str, str] = {}
        self._comments: dict[str, str] = {}
        self._signatures: dict[Any, Signature] = {}
        self._names = {"initial", "signals", "signal_at", "run_parts", "end_parts", "has_room"}
        self._owners: dict[str, Any] = {}
        self._constants: dict[str, Any] = {}
        self._helpers: set[str] = set()
        self._results: set[str] = set()

    # --- what the source names ---

    def record(self, kind: np.dtype, hint: str, function: Any = None) -> str:
        """Name in C of a type of a record: that of the constant beside the function, or a hint."""
        for name, known in self.records.items():
            if known == kind:
                return name
        name, own = hint, inspect.getmodule(getattr(function, "py_func", function))
        for module in [*([own] if own else []), *_modules()]:
            for given, value in vars(module).items():
                if isinstance(value, np.dtype) and (value is kind or (module is own and value == kind)):
                    owner: Any = next((m for m in _modules() if vars(m).get(given) is value), module)
                    plain = given.lower() not in ("state", "params") and not given.startswith("_")
                    name = given.strip("_").lower()
                    name = name if plain else f"{owner.__name__.rsplit('.')[-1]}_{name}"
                    self._comments[name] = _note(owner, given)
                    break
            if name != hint:
                break
        while name in self.records:
            name += "_"
        self.records[name] = kind
        return name

    def constant(self, names: Sequence[str], value: Any, module: Any) -> Scalar:
        """A constant of the source, under its own name."""
        known = number(value)
        if known.text in ("INFINITY", "-INFINITY", "NAN", "true", "false") or value is np.pi:
            return known
        name = "_".join(names).strip("_").upper()
        for each in (name, f"{module.__name__.rsplit('.')[-1].upper()}_{name}"):
            if self._constants.setdefault(each, known.value) == known.value:
                return known._replace(text=each, binding=ATOM)
        return known

    def table(self, hint: str, values: np.ndarray) -> Array:
        """A constant array."""
        kind = "double" if values.dtype.kind == "f" else "int"
        sizes = "".join(f"[{size}]" for size in values.shape)
        name = self._kept(C_TYPES[kind], hint, sizes, braced(values))
        return Array(kind, name, values.shape[1:], tuple(Axis("0", size) for size in values.shape), None)

    def constants_of(self, hint: str, record: np.ndarray, function: Any) -> Record:
        """A constant record."""
        kind = self.record(record.dtype, hint, function)
        return Record(record.dtype, f"&{self._kept(f'struct {kind}', hint, '', filled(record))}", None)

    def _kept(self, kind: str, hint: str, sizes: str, value: str) -> str:
        """Name of a constant with a value: of one that there is, or of a new one."""
        for name, text in self.tables.items():
            if text == f"static const {kind} {name}{sizes} = {value};":
                return name
        name, n = hint, 2
        while name in self.tables or name in self._names:
            name, n = f"{hint}_{n}", n + 1
        self.tables[name] = f"static const {kind} {name}{sizes} = {value};"
        return name

    def helper(self, name: str) -> str:
        """A function that C may not have, to be printed."""
        if name in _HELPERS:
            self._helpers.add(name)
        return name

    def result(self, kinds: Sequence[str]) -> str:
        """Type in C of several results."""
        letters = "".join(_LETTERS[kind] for kind in kinds)
        self._results.add(letters)
        return f"struct result_{letters}"

    def function(self, function: Any, arguments: Sequence[Any]) -> Signature:
        """A function for arguments like these, printed if it has not been."""
        function = getattr(function, "py_func", function)
        key = function, tuple(kind_of(each) for each in arguments)
        if key not in self._signatures:
            source = source_of(function)
            name = base = function.__name__.strip("_")
            if self._owners.setdefault(name, function) is not function or name in _RESERVED:
                name = base = f"{function.__module__.rsplit('.')[-1]}_{name}"
            n = 2
            while name in self._names:
                name, n = f"{base}_{n}", n + 1
            self._names.add(name)
            signature, text = _Translation(self, function, source, name, key[1]).text()
            self.functions[name] = text
            self._signatures[key] = signature
        return self._signatures[key]

    # --- text ---

    def text(self, calls: str) -> str:
        """All that some calls need, in an order that C takes."""
        functions: list[str] = []
        # While kinds of variables are found out, functions may be printed that nothing calls in the end.
        for name, text in reversed(self.functions.items()):
            if re.search(rf"\b{name}\(", calls):
                functions.insert(0, text)
                calls += text
        names = [f"#define {name} {number(value).text}" for name, value in self._constants.items()]
        letters = {letter: kind for kind, letter in _LETTERS.items()}
        results = [
            f"struct result_{kinds} {{\n"
            + "".join(f"    {letters[k]} {field};\n" for k, field in zip(kinds, _FIELDS, strict=False))
            + "};"
            for kinds in sorted(self._results)
        ]
        records = [self._struct(name, kind) for name, kind in self.records.items()]
        helpers = [text for name, text in _HELPERS.items() if name in self._helpers]
        blocks = ["\n".join(names), *results, *records, *self.tables.values(), *helpers, *functions]
        return "\n\n".join(filter(None, blocks)) + "\n"

    def _struct(self, name: str, kind: np.dtype) -> str:
        fields = "".join(f"    double {f}{''.join(f'[{n}]' for n in kind[f].shape)};\n" for f in kind.names or ())
        return f"{comment(self._comments.get(name, ''))}struct {name} {{\n{fields}}};"


def _modules() -> list[ModuleType]:
    import sys

    return [module for name, module in list(sys.modules.items()) if name.startswith("stewart_drake.")]


def _note(module: Any, name: str) -> str:
    """The docstring below a constant of a module."""
    body = _parsed(module.__file__)[0].body
    for node, following in pairwise(body):
        is_it = isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == name for t in node.targets)
        if is_it and isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
            return str(following.value.value)
    return ""


def comment(text: str, indent: str = "") -> str:
    """A comment of C, with its end of line; nothing of no text."""
    if not text:
        return ""
    lines = inspect.cleandoc(text.replace("*/", "* /")).splitlines()
    return f"{indent}/* " + f"\n{indent}   ".join(lines).replace("   \n", "\n") + " */\n"


def braced(values: Any) -> str:
    """Numbers as C initialises an array with them; zeros at the end are left out, as C adds them."""
    if np.ndim(values) == 0:
        return number(values).text
    rows = list(values)
    while len(rows) > 1 and not np.any(rows[-1]):
        rows.pop()
    if np.ndim(rows[0]):
        return "{\n" + "".join(f"    {braced(row)},\n".replace("\n    ", "\n        ") for row in rows) + "}"
    lines = textwrap.wrap(", ".join(number(value).text for value in rows), WIDTH - 8, break_on_hyphens=False)
    return "{" + "\n    ".join(lines) + "}"


def filled(record: np.ndarray) -> str:
    """A record as C initialises one; fields of zeros are left out, as C adds them."""
    values = [(name, record[name][0]) for name in record.dtype.names or ()]
    parts = [f"    .{name} = {braced(value)},".replace("\n", "\n    ") for name, value in values if np.any(value)]
    return "{\n" + "\n".join(parts or [f"    .{values[0][0]} = {braced(values[0][1])},"]) + "\n}"


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


class _Translation:
    """One function for arguments of some kinds; it is walked until kinds of variables and what is written are known."""

    def __init__(self, program: Program, function: Any, source: Source, name: str, kinds: Sequence[Any]) -> None:
        self.program, self.function, self.source, self.name, self.kinds = program, function, source, name, kinds
        self.known: dict[str, str] = {}  # Kinds of numbers by the names of variables.
        self.written: set[str] = set()
        self.result: Any = None
        self.homes = _homes(source.tree)
        self.loops = _loop_variables(source.tree)
        called = {_last_name(node.func) for node in ast.walk(source.tree) if isinstance(node, ast.Call)}
        used = {node.id for node in ast.walk(source.tree) if isinstance(node, ast.Name)}
        used |= {each.arg for each in source.tree.args.args}
        self.avoided = _RESERVED | {name.strip("_") for name in called if name} | {"abs", "min", "max"}
        self.used = {self.c_name(each) for each in used}

    # --- the whole ---

    def text(self) -> tuple[Signature, str]:
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

    def _struct(self, kind: np.dtype, hint: str) -> str:
        return self.program.record(kind, hint, self.function)

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

    def c_name(self, name: str) -> str:
        own = name.strip("_") or "unused"
        return f"{own}_" if own in self.avoided else own

    def fresh(self, hint: str) -> str:
        """A name that nothing else has."""
        name, n = hint, 1
        while name in self.taken or name in self.avoided:
            name, n = f"{hint}_{n}", n + 1
        self.taken.add(name)
        return name

    def emit(self, text: str) -> None:
        self.lines.append(f"{self.indent}{text}\n")

    def refused(self, node: ast.AST, reason: str) -> ConfigurationError:
        place = f"{self.source.file}:{getattr(node, 'lineno', self.line)}"
        return refusal(place, ast.unparse(node).splitlines()[0], reason)

    # --- statements ---

    def statement(self, node: ast.stmt) -> None:
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
        before, self.indent, taken = self.indent, self.indent + "    ", set(self.taken)
        for statement in body:
            self.statement(statement)
        self.indent, self.taken = before, taken

    def _expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return
        value = self.value(node.value)
        if isinstance(value, Scalar) or (isinstance(value, Several) and isinstance(value, _Call)):
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
            self.result = _wider(self.result, value.kind)
            self.emit(f"return {value.text};")
        elif isinstance(value, Several):
            kinds = tuple(self._as_scalar(each).kind for each in value.items)
            before = self.result or kinds
            self.result = tuple(_wider(a, b) for a, b in zip(before, kinds, strict=True))
            if isinstance(value, _Call) and kinds == self.result:
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

    def _several(self, value: Several, hint: str) -> Several:
        """Several values; those of a call are kept under a name."""
        if not isinstance(value, _Call):
            return value
        name = self.fresh(hint)
        kinds = [each.kind for each in value.items]
        self.emit(f"const {self.program.result(kinds)} {name} = {value.text};")
        return Several(tuple(Scalar(kind, f"{name}.{f}") for kind, f in zip(kinds, _FIELDS, strict=False)))

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
                self.emit(f"{_at(owner.pointer)} = {_at(value.pointer)};")
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
            kind = self.known[name] = _wider(self.known.get(name), value.kind)
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
            if isinstance(value, _Call):
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
        sign = _BINARY.get(type(node.op), ("",))[0]
        target, value = self.value(node.target), self.value(node.value)
        self._mark(target)
        if isinstance(node.target, (ast.Attribute, ast.Subscript)):
            self._mark(self.value(node.target.value))
        if isinstance(target, Scalar) and sign:
            if isinstance(node.target, ast.Name):
                self.known[node.target.id] = _wider(self.known.get(node.target.id), self._as_scalar(value).kind)
            self.emit(f"{target.text} {sign}= {self._as_scalar(value).text};")
        elif isinstance(target, Array) and sign:
            self._fill(target, value, f"{sign}=")
        else:
            raise Unknown("an operator of this kind")

    def _mark(self, value: Value) -> None:
        """Remembers that an argument is written."""
        root = getattr(value, "root", "")
        if root is None:
            raise Unknown("an assignment to a constant")
        if root:
            self.written.add(root)

    # --- arrays ---

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
        elif not (isinstance(value, Entrywise) and value.at is _nothing):
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
        return self._as_scalar(self.value(node))

    def _as_scalar(self, value: Value) -> Scalar:
        if isinstance(value, Scalar):
            return value
        if isinstance(value, Constant) and isinstance(value.value, (bool, int, float, np.generic)):
            return number(value.value)
        raise Unknown("no number where one is needed")

    def value(self, node: ast.expr) -> Value:
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
            return self._global([_last_name(node.value) or "", node.attr], value, inspect.getmodule(self.function))
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
        if type(node.op) not in _BINARY:
            raise Unknown("an operator of this kind")
        sign, binding = _BINARY[type(node.op)]

        def both(a: Scalar, b: Scalar) -> Scalar:
            kind = _wider(_wider("int", a.kind), b.kind)
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
            kind = _wider(a.kind, b.kind)
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

    # --- calls ---

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
            kind = _wider(kind, each.kind)
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
        return Entrywise(of, tuple(shape), (lambda _: number(0.0)) if zeros else _nothing)

    def _copied(self, value: Array) -> Entrywise:
        return Entrywise(value.kind, value.shape, value.at)

    def _method(self, owner: Value, name: str) -> Value:
        if name == "copy":
            if isinstance(owner, Record):
                kept = self.fresh("kept")
                self.emit(f"const struct {self._struct(owner.kind, kept)} {kept} = {_at(owner.pointer)};")
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
            return _Call(tuple(Scalar(kind, "") for kind in signature.result), text)
        return Scalar(signature.result or "void", text)


class _Call(Several):
    """Several results of a call."""

    text: str

    def __new__(cls, items: tuple[Any, ...], text: str = "") -> _Call:
        made = super().__new__(cls, items)
        made.text = text
        return made


def _nothing(_: Sequence[str]) -> Scalar:
    """An entry of an array that is not set yet."""
    return number(0.0)


def _at(pointer: str) -> str:
    return pointer[1:] if pointer.startswith("&") else f"*{pointer}"


def _wider(one: str | None, other: str) -> str:
    """The kind of number that takes both."""
    order = ("bool", "int", "double")
    return other if one is None else order[max(order.index(one), order.index(other))]


def _last_name(node: ast.expr) -> str | None:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None


def _has_body(node: ast.stmt) -> bool:
    return isinstance(node, (ast.For, ast.While, ast.If))


def _call(head: str, parameters: Sequence[str]) -> str:
    """A head of a function within the width."""
    text = f"{head}({', '.join(parameters)})"
    if len(text) <= WIDTH:
        return text
    wrapped = textwrap.wrap(", ".join(each.replace(" ", "~") for each in parameters), WIDTH - 4)
    return f"{head}(\n" + "\n".join(f"    {line}".replace("~", " ") for line in wrapped) + ")"


def _loop_variables(tree: ast.FunctionDef) -> set[str]:
    """Variables of loops that mean something in loops over them alone, as in C."""
    elsewhere: set[str] = set()

    def visit(node: ast.AST, inside: frozenset[str]) -> None:
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
            visit(node.iter, inside)
            for statement in node.body:
                visit(statement, inside | {node.target.id})
            return
        if isinstance(node, ast.Name) and (node.id not in inside or isinstance(node.ctx, ast.Store)):
            elsewhere.add(node.id)
        for child in ast.iter_child_nodes(node):
            visit(child, inside)

    visit(tree, frozenset())
    loops = {n.target.id for n in ast.walk(tree) if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}
    return loops - elsewhere


def _homes(tree: ast.FunctionDef) -> dict[str, int]:
    """Variables that can be declared where they are set first: their names, and the lines of that."""
    places: dict[str, list[tuple[tuple[int, ...], int | None]]] = {}

    def note(node: ast.AST, path: tuple[int, ...], line: int | None) -> None:
        for each in ast.walk(node):
            if isinstance(each, ast.Name):
                places.setdefault(each.id, []).append((path, line if isinstance(each.ctx, ast.Store) else None))

    def visit(body: Sequence[ast.stmt], path: tuple[int, ...]) -> None:
        for k, statement in enumerate(body):
            if isinstance(statement, (ast.For, ast.While, ast.If)):
                if isinstance(statement, ast.For):
                    note(statement.iter, path, None)
                else:
                    note(statement.test, path, None)
                visit(statement.body, (*path, 2 * k))
                visit(statement.orelse, (*path, 2 * k + 1))
            elif isinstance(statement, ast.Assign):
                note(statement.value, path, None)
                for target in statement.targets:
                    names = target.elts if isinstance(target, ast.Tuple) else [target]
                    for each in names:
                        note(each, path, statement.lineno if isinstance(each, ast.Name) else None)
            else:
                note(statement, path, None)

    visit(tree.body, ())
    homes = {}
    for name, found in places.items():
        path, line = found[0]
        if line is not None and all(each[: len(path)] == path for each, _ in found):
            homes[name] = line
    return homes
