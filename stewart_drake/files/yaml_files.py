"""The package's YAML files: scenarios, sweeps, comparisons; found by path or by name, and read as plain values."""

from __future__ import annotations

import re
import warnings
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import AliasEvent
from ruamel.yaml.nodes import Node, ScalarNode
from ruamel.yaml.representer import SafeRepresenter

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import PACKAGE, read_checked

MAX_BYTES = 1_000_000
MAX_NODES = 100_000
"""Values and keys of a text, each as often as aliases and merge keys repeat it."""
MAX_DEPTH = 100
"""Sections and lists inside of each other."""
MAX_DIGITS = 400
"""Of a whole number: more than any number here may have, fewer than Python would refuse to write."""


def shipped_folder(kind: str) -> Path:
    """Folder of the files of a kind, such as `scenarios`, that the package carries (in a checkout: diagrams/KIND)."""
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / "diagrams" / kind


def find_file(kind: str, name: str | Path) -> Path:
    """The file that `name` means: a path, or the stem of a file of the package.

    Args:
        kind: `scenario`, `sweep` or `comparison`.
        name: What the user gave.

    Raises:
        ConfigurationError: Neither.
    """
    path, folder, what = Path(name), shipped_folder(f"{kind}s"), f"{kind} file"
    try:
        # What is a pipe or a device says so itself once it is to be read.
        if path.exists() and not path.is_dir():
            return path
        shipped = folder / f"{name}.yaml"
        if path.name == str(name) and shipped.is_file():
            return shipped
    except OSError as error:
        raise ConfigurationError(what, str(name), f"a path that can be read ({error.strerror})") from None
    known = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
    raise ConfigurationError(what, str(name), f"an existing file, or one of {known}")


def read_mapping(kind: str, path: Path, longest_name: int) -> dict[str, Any]:
    """Keys and values of a file; `name` is its stem where it has none.

    Args:
        kind: As in `find_file`, for messages.
        path: The file.
        longest_name: A name is cut to this.

    Raises:
        ConfigurationError: Unreadable, too large, malformed, or no mapping.
    """
    what = f"{kind} file {path}"
    try:
        text = read_checked(path, what, MAX_BYTES).decode()
    except UnicodeDecodeError as error:
        found = f"byte {error.object[error.start]:#04x} at {error.start}"
        raise ConfigurationError(what, found, "a YAML text in UTF-8") from None
    data = parse_yaml(text, what)
    if not isinstance(data, dict):
        raise ConfigurationError(what, "an empty file" if data is None else data, "a mapping of keys to values")
    # The name of a file may hold what the name of a scenario may not.
    data.setdefault("name", re.sub(r"^\W+|[^\w .+-]", "_", path.stem, flags=re.ASCII)[:longest_name])
    return data


def parse_yaml(text: str, key: str) -> Any:
    """Plain values from a YAML text.

    Raises:
        ConfigurationError: `key` is not well-formed YAML, or has tags; it is too large, see `MAX_NODES`, `MAX_DEPTH`
            and `MAX_DIGITS`; a section holds itself.
    """
    # YAML 1.2: 1e-3 is a number, duplicate keys are refused, and the safe loader builds plain values alone.
    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = _BoundedComposer
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return yaml.load(text)
    except _TooLargeError as error:
        raise ConfigurationError(key, error.found, error.allowed) from None
    except MarkedYAMLError as error:
        mark = error.problem_mark
        where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        what = " ".join(str(error.problem).removeprefix("but ").split())
        raise ConfigurationError(key, f"{where}{what}", "well-formed YAML without tags") from None
    except Exception as error:
        # Of a tag that does not fit its value (`!!bool 3`) the loader lets KeyError, IndexError and others escape.
        text = " ".join(str(error).split())
        raise ConfigurationError(key, f"{type(error).__name__}: {text}", "well-formed YAML without tags") from None


def to_yaml(data: Any) -> str:
    """Plain values as YAML that `parse_yaml` reads back."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.width = 120
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.Representer = _Representer
    stream = StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


class _Representer(SafeRepresenter):
    """Escapes Unicode's own line breaks, which a reader would fold into spaces."""

    def represent_str(self, data: str) -> Any:
        style = '"' if any(mark in data for mark in "\x85\u2028\u2029") else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Representer.add_representer(str, _Representer.represent_str)


class _TooLargeError(Exception):
    def __init__(self, line: int, found: str, allowed: str) -> None:
        self.found, self.allowed = f"line {line + 1}: {found}", allowed
        super().__init__(found)


class _BoundedComposer(Composer):
    """Measures a text while it becomes a graph, before any value is built from it.

    A node that an alias names is part of the graph once, but counts each time: whoever walks through the values meets
    it each time. A merge key is an alias too.
    """

    def __init__(self, loader: Any = None) -> None:
        super().__init__(loader)
        self._open = 0
        self._sizes: dict[Node, tuple[int, int]] = {}
        """Of each node that is complete: nodes in it, sections inside of each other."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        alias = self.parser.check_event(AliasEvent)
        self._open += 1
        self._refuse(self.parser.peek_event().start_mark.line, len(self._sizes), self._open)
        node = super().compose_node(parent, index)
        self._open -= 1
        line = node.start_mark.line
        if alias and node not in self._sizes:
            raise _TooLargeError(line, "a section that holds itself", "sections that end")
        if not alias:
            self._sizes[node] = self._measure(node)
        count, depth = self._sizes[node]
        self._refuse(line, count, self._open + depth)
        return node

    @staticmethod
    def _refuse(line: int, count: int, depth: int) -> None:
        if count > MAX_NODES:
            raise _TooLargeError(line, f"more than {MAX_NODES} values", f"at most {MAX_NODES}, aliases followed")
        if depth > MAX_DEPTH:
            raise _TooLargeError(line, f"sections {depth} deep", f"at most {MAX_DEPTH} inside of each other")

    def _measure(self, node: Node) -> tuple[int, int]:
        if isinstance(node, ScalarNode):
            digits = len(re.sub(r"^[-+]?(0[box])?|_", "", node.value))
            if node.tag == "tag:yaml.org,2002:int" and digits > MAX_DIGITS:
                raise _TooLargeError(
                    node.start_mark.line, f"a whole number of {digits} digits", f"at most {MAX_DIGITS} digits"
                )
            return 1, 0
        parts = [part for entry in node.value for part in (entry if isinstance(entry, tuple) else (entry,))]
        sizes = [self._sizes[part] for part in parts]
        return 1 + sum(count for count, _ in sizes), 1 + max((depth for _, depth in sizes), default=0)
