"""Sources of laws: their syntax, their comments, and where C can declare their variables."""

from __future__ import annotations

import ast
import inspect
import io
import tokenize
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.records import Record
from stewart_drake.export.types import Untyped

ALLOWED = "what can be printed as C, see docs/export.md"
_ROOT = Path(__file__).parents[2]


class Source(NamedTuple):
    """A function."""

    file: str
    tree: ast.FunctionDef
    comments: dict[int, str]  # Those on lines of their own.
    types: dict[str, Any]  # Of arguments and result.

    def refusal(self, line: int, given: str, reason: str) -> ConfigurationError:
        """The error of a line that cannot be printed."""
        return ConfigurationError(f"{self.file}:{line}", given, f"{ALLOWED}; this is {reason}")


@lru_cache(maxsize=256)
def _parsed(path: str) -> tuple[ast.Module, dict[int, str], dict[int, str]]:
    """Syntax of a file, and its comments by line: those on lines of their own, and those after something."""
    text = Path(path).read_text(encoding="utf-8")
    own: dict[int, str] = {}
    beside: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments = own if token.line.lstrip().startswith("#") else beside
            comments[token.start[0]] = token.string.lstrip("# ")
    return ast.parse(text), own, beside


@lru_cache(maxsize=512)
def source_of(function: Any) -> Source:
    """The source of a law, compiled or not."""
    function = getattr(function, "py_func", function)
    if not inspect.isfunction(function):
        raise Untyped(f"{getattr(function, '__name__', function)}, which is no function of the package's laws")
    path, line = function.__code__.co_filename, function.__code__.co_firstlineno
    tree, comments, _ = _parsed(path)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and line in (node.lineno, *(x.lineno for x in node.decorator_list[:1])):
            inside = Path(path).is_relative_to(_ROOT)
            file = str(Path(path).relative_to(_ROOT)) if inside else path
            return Source(file, node, comments, get_type_hints(function, include_extras=True))
    raise Untyped(f"{function.__name__}, which has no source")


def field_comments(kind: type[Record]) -> dict[str, str]:
    """The comments beside the fields of a record."""
    comments: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        tree, _, beside = _parsed(inspect.getfile(base))
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and node.name == base.__name__:
                fields = [field for field in node.body if isinstance(field, ast.AnnAssign)]
                comments |= {ast.unparse(field.target): beside.get(field.lineno, "") for field in fields}
    return comments


def comment(text: str, indent: str = "") -> str:
    """A comment of C, with its end of line; nothing of no text."""
    if not text:
        return ""
    lines = inspect.cleandoc(text.replace("*/", "* /")).splitlines()
    return f"{indent}/* " + f"\n{indent}   ".join(lines).replace("   \n", "\n") + " */\n"


def scope_of(tree: ast.FunctionDef) -> tuple[dict[str, int], set[str]]:
    """Where C can declare variables, and variables of loops that are used outside of them.

    A variable can be declared on the line that sets it first where all else that concerns it is in the same block.
    """
    places: dict[str, list[tuple[tuple[int, ...], int | None]]] = {}
    loops: set[str] = set()

    def visit(body: Sequence[ast.stmt], path: tuple[int, ...], inside: frozenset[str]) -> None:
        for k, node in enumerate(body):
            for name in ast.walk(getattr(node, "iter", getattr(node, "test", node))):
                if isinstance(name, ast.Name) and (name.id not in inside or isinstance(name.ctx, ast.Store)):
                    line = node.lineno if isinstance(name.ctx, ast.Store) else None
                    places.setdefault(name.id, []).append((path, line))
            if isinstance(node, (ast.For, ast.If)):
                own = {ast.unparse(node.target)} if isinstance(node, ast.For) else set()
                loops.update(own)
                visit(node.body, (*path, 2 * k), inside | own)
                visit(node.orelse, (*path, 2 * k + 1), inside)

    visit(tree.body, (), frozenset())
    first = {name: found[0] for name, found in places.items()}
    lines = {
        name: line
        for name, (block, line) in first.items()
        if line is not None and all(path[: len(block)] == block for path, _ in places[name])
    }
    return lines, (loops & places.keys()) - {"_"}
