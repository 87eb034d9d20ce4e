"""Where laws stand: their syntax, their comments, and what of their variables C has to know before."""

from __future__ import annotations

import ast
import inspect
import io
import tokenize
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.values import Unknown

_PACKAGE = Path(__file__).parents[1]


class Source(NamedTuple):
    """Where a function stands, its syntax, and its comments by their lines."""

    file: str
    tree: ast.FunctionDef
    comments: dict[int, str]


@lru_cache(maxsize=256)
def _parsed(path: str) -> tuple[ast.Module, dict[int, str]]:
    text = Path(path).read_text(encoding="utf-8")
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


def note(module: Any, name: str) -> str:
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


def loop_variables(tree: ast.FunctionDef) -> set[str]:
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


def homes_of(tree: ast.FunctionDef) -> dict[str, int]:
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
