"""Compiled laws as C99: a translation of their source, function by function, that people can read.

The laws are written in a small subset of Python, see docs/export.md; their annotations give the types. Names,
docstrings and comments are kept. If an annotation leaves the size of an array open, the function is printed for every
size that it is called with. The C code computes as numba does: in the same order, with the same rules for powers, `min`
and NaN.
"""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.export import types as c
from stewart_drake.export.expressions import FIELDS
from stewart_drake.export.source import RESERVED, comment, field_comments, source_of
from stewart_drake.export.statements import WIDTH, Statements
from stewart_drake.export.types import Array, Struct, StructType, Untyped, Value, number

_TEMPLATES = Path(__file__).parent / "templates"
_HELPERS = {
    re.findall(r"^static \w+ (\w+)", text, re.MULTILINE)[0]: text
    for text in (_TEMPLATES / "helpers.c").read_text(encoding="utf-8").strip().split("\n\n")
}


def from_template(file: str, words: Mapping[str, str]) -> str:
    """The text of a template, with every `@NAME@` replaced by `words[NAME]`."""
    return re.sub(r"@(\w+)@", lambda match: words[match[1]], (_TEMPLATES / file).read_text(encoding="utf-8"))


class Program:
    """The laws that have been printed so far, and what they need."""

    def __init__(self) -> None:
        self._defined: dict[str, object] = {}  # Name of a constant -> value; printed as `#define`.
        self._types: dict[str, str] = {}  # Name of a struct -> its definition; inner ones first.
        self._structs: dict[StructType, str] = {}  # Type of a record -> name of its struct.
        self._tables: dict[str, str] = {}  # Name of a constant array or record -> its definition.
        self._helpers: set[str] = set()  # Names of the functions of helpers.c that are called.
        self._functions: dict[str, str] = {}  # Name of a function -> its definition; callees first.
        self._signatures: dict[object, c.Signature] = {}  # Python function and types of arguments -> signature in C.
        self._named: dict[str, object] = {}  # Name in C -> the Python function that took it first.

    def struct(self, of: StructType) -> str:
        """Name of a record's type in C: the class's name in snake case."""
        if of in self._structs:
            return self._structs[of]
        comments, text = field_comments(of.kind), ""
        for field in of.layout.names or ():
            inner, sizes = of.inner(field), "".join(f"[{size}]" for size in of.layout[field].shape)
            kind = f"struct {self.struct(inner)}" if inner else "double"
            text += f"    {kind} {field}{sizes}; {comment(comments.get(field, ''))}".rstrip() + "\n"
        name = re.sub(r"(?<!^)(?=[A-Z])", "_", of.kind.__name__.strip("_")).lower()
        if name in self._types:
            name = f"{of.kind.__module__.rsplit('.')[-1]}_{name}"
        self._structs[of] = name = _free(name, self._types)
        self._types[name] = f"{comment(of.kind.__doc__ or '')}struct {name} {{\n{text}}};"
        return name

    def result(self, kinds: Sequence[str]) -> str:
        """Return type of a function in C; a struct for several results."""
        if len(kinds) < 2:
            return kinds[0] if kinds else "void"
        name = f"result_{''.join(kind[0] for kind in kinds)}"
        fields = "".join(f"    {kind} {field};\n" for kind, field in zip(kinds, FIELDS, strict=False))
        self._types[name] = f"struct {name} {{\n{fields}}};"
        return f"struct {name}"

    def constant(self, names: Sequence[str], value: object, module: str) -> c.Scalar:
        """A constant with its name in the source, or the plain number if that name has another value already."""
        known, name = number(value), "_".join(names).strip("_").upper()
        if known.text in ("INFINITY", "-INFINITY", "NAN", "true", "false") or value is np.pi:
            return known
        for text in (name, f"{module.rsplit('.')[-1].upper()}_{name}"):
            if self._defined.setdefault(text, known.value) == known.value:
                return known._replace(text=text, binding=c.ATOM)
        return known

    def table(self, hint: str, values: np.ndarray) -> Array:
        """A constant array."""
        kind = "double" if values.dtype.kind == "f" else "int"
        sizes = "".join(f"[{size}]" for size in values.shape)
        return Array(kind, self._table_name(kind, hint, sizes, braced(values)), values.shape, root=None)

    def constant_record(self, hint: str, record: np.ndarray, of: StructType) -> Struct:
        """A constant record."""
        return Struct(of, f"&{self._table_name(f'struct {self.struct(of)}', hint, '', filled(record))}", None)

    def _table_name(self, kind: str, hint: str, sizes: str, value: str) -> str:
        """Name of a constant with this value; equal constants share one."""
        for name, text in self._tables.items():
            if text == f"static const {kind} {name}{sizes} = {value};":
                return name
        name = _free(hint, self._tables, self._functions)
        self._tables[name] = f"static const {kind} {name}{sizes} = {value};"
        return name

    def helper(self, name: str) -> str:
        """Marks a function of helpers.c as used, so that it is printed; returns its name."""
        self._helpers |= {name} & _HELPERS.keys()
        return name

    def function(self, function: Any, given: Sequence[Value]) -> c.Signature:
        """Signature in C of a function for arguments of these types; prints the function at the first call."""
        source, function = source_of(function), getattr(function, "py_func", function)
        arguments = source.tree.args.args
        if len(arguments) != len(given):
            raise Untyped(f"a call of `{function.__name__}` with {len(given)} arguments; give all of {len(arguments)}")
        parameters: tuple[Value, ...] = ()
        for argument, value in zip(arguments, given, strict=True):
            fitting = c.parameter(source.c_name(argument.arg), source.types.get(argument.arg), value)
            if fitting is None:
                hint = "" if argument.annotation else f"; write its type, such as `{argument.arg}: Vec6`"
                wanted = f"`{function.__name__}` takes `{ast.unparse(argument)}`{hint}"
                raise Untyped(f"`{c.described(value)}` where {wanted}")
            parameters += (fitting,)
        key = function, parameters
        if key not in self._signatures:
            name = function.__name__.strip("_")
            if self._named.setdefault(name, function) is not function or name in RESERVED:
                name = f"{function.__module__.rsplit('.')[-1]}_{name}"
            types = zip(parameters, (source.types[argument.arg] for argument in arguments), strict=True)
            free = dict.fromkeys(x.shape for x, kind in types if kind is np.ndarray and isinstance(x, Array))
            name += "".join(f"_{'x'.join(map(str, shape))}" for shape in free)
            name = _free(name, self._functions, self._tables)
            self._signatures[key], text = Statements(self, function, source).text(name, parameters)
            self._functions[name] = text
        return self._signatures[key]

    def text(self) -> str:
        """The whole program, definitions before their use."""
        names = "\n".join(f"#define {name} {number(value).text}" for name, value in self._defined.items())
        helpers = [text for name, text in _HELPERS.items() if name in self._helpers]
        blocks = [names, *self._types.values(), *self._tables.values(), *helpers, *self._functions.values()]
        return "\n\n".join(filter(None, blocks))


def _free(hint: str, *taken: Iterable[str]) -> str:
    """The name `hint`, with a number if it is taken already or used in a template."""
    used = {"initial", "signals", "signal_at", "run_parts", "end_parts", "has_room"}.union(*taken)
    return next(name for name in (hint, *(f"{hint}_{n}" for n in range(2, 100))) if name not in used)


def braced(values: Any) -> str:
    """A C initialiser of an array or number. Zeros at the end are left out: C fills an array with zeros."""
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
    """A C initialiser of a record. Fields that are zero are left out: C sets them to zero."""
    values = {name: record[name] for name in record.dtype.names or ()}
    texts = {name: filled(value) if value.dtype.names else braced(value[0]) for name, value in values.items()}
    some = [name for name, value in values.items() if np.any(value.view(np.float64))] or [next(iter(values))]
    return "{\n" + "\n".join(f"    .{name} = {texts[name]},".replace("\n", "\n    ") for name in some) + "\n}"
