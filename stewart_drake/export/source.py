"""Sources of laws: their syntax, their comments, and where C can declare their variables."""

from __future__ import annotations

import ast
import inspect
import io
import textwrap
import tokenize
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, get_type_hints

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.records import Record
from stewart_drake.export.types import Untyped

ALLOWED = "what can be printed as C, see docs/export.md"
_ROOT = Path(__file__).parents[2]


RESERVED = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register"  # noqa: SIM905
    " restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true"
    " false main loop y0 y1 yn j0 j1 jn gamma exp log pow sqrt fabs abs min max".split()
)


class Source(NamedTuple):
    """A function."""

    file: str
    tree: ast.FunctionDef
    comments: dict[int, str]  # Line -> comment; only comments on a line of their own.
    types: dict[str, object]  # Types of the arguments, and of the result as `return`.
    scope: dict[str, int]  # Variable -> line of its first assignment, if C can declare it there.
    leaking: set[str]  # Variables of loops that are used outside of them.
    avoided: frozenset[str]  # Names that no variable can have.

    def c_name(self, name: str) -> str:
        """A variable's name in C."""
        name = name.strip("_") or "unused"
        return f"{name}_" if name in self.avoided else name

    def refusal(self, line: int, given: str, reason: str) -> ConfigurationError:
        """The error of a line that cannot be printed."""
        return ConfigurationError(f"{self.file}:{line}", given, f"{ALLOWED}; this is {reason}")


@lru_cache(maxsize=1024)
def _parsed(thing: Callable[..., object]) -> tuple[ast.stmt, dict[int, str], dict[int, str]]:
    """Syntax of a function or class, and its comments by line: on separate lines, and beside code."""
    source, start = inspect.getsourcelines(thing)
    text = textwrap.dedent("".join(source))
    alone: dict[int, str] = {}
    beside: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments = alone if token.line.lstrip().startswith("#") else beside
            comments[token.start[0] + start - 1] = token.string.lstrip("# ")
    return ast.increment_lineno(ast.parse(text), start - 1).body[0], alone, beside


@lru_cache(maxsize=1024)
def source_of(function: Callable[..., object]) -> Source:
    """The source of a law, compiled or not."""
    function = getattr(function, "py_func", function)
    try:
        (tree, comments, _), types = _parsed(function), get_type_hints(function, include_extras=True)
    except (OSError, TypeError, SyntaxError, NameError):
        tree = ast.Pass()
    if not isinstance(tree, ast.FunctionDef):
        raise Untyped(f"{getattr(function, '__name__', function)}, which is no function with source and types")
    path = Path(inspect.getfile(function))
    file = str(path.relative_to(_ROOT) if path.is_relative_to(_ROOT) else path)
    called = {last_name(node.func).strip("_") for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return Source(file, tree, comments, types, *scope_of(tree), RESERVED | called)


def last_name(node: ast.expr) -> str:
    """The part of a name after its last dot."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def field_comments(kind: type[Record]) -> dict[str, str]:
    """The comments beside the fields of a record."""
    comments: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        tree, _, beside = _parsed(base)
        fields = [field for field in ast.walk(tree) if isinstance(field, ast.AnnAssign)]
        comments |= {ast.unparse(field.target): beside.get(field.lineno, "") for field in fields}
    return comments


def comment(text: str, indent: str = "") -> str:
    """A text as a comment of C with an end of line; an empty text stays empty."""
    if not text:
        return ""
    lines = inspect.cleandoc(text.replace("*/", "* /")).splitlines()
    return f"{indent}/* " + f"\n{indent}   ".join(lines).replace("   \n", "\n") + " */\n"


def scope_of(tree: ast.FunctionDef) -> tuple[dict[str, int], set[str]]:
    """Where C can declare variables, and variables of loops that are used outside of them.

    A variable can be declared on the line that first sets it if it is only used in that line's block.
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
                variable = {ast.unparse(node.target)} if isinstance(node, ast.For) else set()
                loops.update(variable)
                visit(node.body, (*path, 2 * k), inside | variable)
                visit(node.orelse, (*path, 2 * k + 1), inside)

    visit(tree.body, (), frozenset())
    lines = {}
    for name, ((block, line), *others) in places.items():
        if line is not None and all(path[: len(block)] == block for path, _ in others):
            lines[name] = line
    return lines, (loops & places.keys()) - {"_"}
