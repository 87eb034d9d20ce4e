"""Compiled laws as C99: a translation of their source, function by function, that people can read.

The laws are a small subset of Python: numbers, arrays of float64 of known shapes, records, and functions of these.
Names stay, docstrings and comments too. A function that is called with arrays of other shapes is printed again. Numbers
come out as numba computes them: in the same order, with its rules for powers, `min` and NaN. What is not known here is
refused with file and line.
"""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from stewart_drake.export.expressions import FIELDS
from stewart_drake.export.source import comment, note, source_of
from stewart_drake.export.translation import RESERVED, WIDTH, Translation
from stewart_drake.export.values import ATOM, C_TYPES, Array, Axis, Record, Scalar, Signature, kind_of, number

_LETTERS = {"double": "d", "int": "i", "bool": "b"}
TEMPLATES = Path(__file__).parent / "templates"
_HELPERS = {
    re.findall(r"^static \w+ (\w+)", text, re.MULTILINE)[0]: text
    for text in (TEMPLATES / "helpers.c").read_text(encoding="utf-8").strip().split("\n\n")
}


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
                    self._comments[name] = note(owner, given)
                    break
            if name != hint:
                break
        for inner in kind.names or ():
            if kind[inner].names:
                self.record(kind[inner], inner)
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
            if self._owners.setdefault(name, function) is not function or name in RESERVED:
                name = base = f"{function.__module__.rsplit('.')[-1]}_{name}"
            n = 2
            while name in self._names:
                name, n = f"{base}_{n}", n + 1
            self._names.add(name)
            signature, text = Translation(self, function, source, name, key[1]).text()
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
            + "".join(f"    {letters[k]} {field};\n" for k, field in zip(kinds, FIELDS, strict=False))
            + "};"
            for kinds in sorted(self._results)
        ]
        records = [self._struct(name, kind) for name, kind in self.records.items()]
        helpers = [text for name, text in _HELPERS.items() if name in self._helpers]
        blocks = ["\n".join(names), *results, *records, *self.tables.values(), *helpers, *functions]
        return "\n\n".join(filter(None, blocks)) + "\n"

    def _struct(self, name: str, kind: np.dtype) -> str:
        fields = "".join(
            f"    {f'struct {self.record(kind[f], f)}' if kind[f].names else 'double'} {f}"
            f"{''.join(f'[{n}]' for n in kind[f].shape)};\n"
            for f in kind.names or ()
        )
        return f"{comment(self._comments.get(name, ''))}struct {name} {{\n{fields}}};"


def _modules() -> list[ModuleType]:
    return [module for name, module in list(sys.modules.items()) if name.startswith("stewart_drake.")]


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
    values = {name: record[name] for name in record.dtype.names or ()}
    texts = {name: filled(each) if each.dtype.names else braced(each[0]) for name, each in values.items()}
    some = [name for name, each in values.items() if np.any(each.view(np.float64))] or [next(iter(values))]
    return "{\n" + "\n".join(f"    .{name} = {texts[name]},".replace("\n", "\n    ") for name in some) + "\n}"
