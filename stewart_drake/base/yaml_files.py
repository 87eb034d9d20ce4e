"""YAML files such as scenarios, sweeps and comparisons: found by path or by name, and read as plain values."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import AliasEvent

from stewart_drake.base.atomic_files import PACKAGE, Document, read_checked
from stewart_drake.base.config import did_you_mean, shorten, to_plain
from stewart_drake.base.errors import ConfigurationError

MAX_BYTES = 1_000_000  # [byte]
_MARKS = {
    "scenario": ({"reference", "duration", "sensors", "plant"}, "stewart-drake run FILE"),
    "robot": ({"crank_length", "rod_length", "shaft_circle_radius"}, "stewart-drake run sway --set robot=FILE"),
    "sweep": ({"distributions"}, "stewart-drake sweep FILE"),
    "comparison": ({"controllers", "references"}, "stewart-drake compare FILE"),
    "controller": (set(), "stewart-drake drive FILE --machine sim:"),
}
"""Kind of a file -> keys that identify it, none where its keys are a scenario's too, and a command that uses it."""


def shipped_folder(kind: str) -> Path:
    """Folder of the package's files of a kind, such as `scenarios` (in a checkout: diagrams/KIND)."""
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / "diagrams" / kind


def find_file(kind: str, name: str | Path) -> Path:
    """The file of a `kind`, such as `scenario`, from its path, or for a file of the package from its stem."""
    path, shipped = Path(name), {file.stem: file for file in sorted(shipped_folder(f"{kind}s").glob("*.yaml"))}
    try:
        # A pipe or a device is refused later, when it is read.
        if path.exists() and not path.is_dir():
            return path
    except OSError as error:
        raise ConfigurationError(f"{kind} file", str(name), f"a path that can be read ({error.strerror})") from None
    if str(name) in shipped:
        return shipped[str(name)]
    for other, (_, use) in _MARKS.items():
        if (shipped_folder(f"{other}s") / f"{name}.yaml").is_file():
            raise _of_another_kind(kind, name, other, use)
    if path.suffix in (".yaml", ".yml"):
        raise ConfigurationError(f"{kind} file", str(name), "a file that exists")
    allowed = f"an existing file, or one of {', '.join(shipped)}{did_you_mean(str(name), shipped)}"
    raise ConfigurationError(f"{kind} file", str(name), allowed)


def _of_another_kind(kind: str, name: str | Path, other: str, use: str) -> ConfigurationError:
    return ConfigurationError(f"{kind} file", f"the {other} {name}", f"a {kind}; try: {use.replace('FILE', str(name))}")


def read_mapping(kind: str, path: Path, max_name: int) -> Document:
    """Keys and values of a file; the default of `name` is its stem, cut to `max_name` characters."""
    place = f"{kind} file {path}"
    try:
        text = read_checked(path, place, MAX_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ConfigurationError(place, str(error), "a YAML text in UTF-8") from None
    data = parse_yaml(text, place)
    if not isinstance(data, dict):
        raise ConfigurationError(place, "an empty file" if data is None else data, "a mapping of keys to values")
    expected = _MARKS.get(kind, (set(), ""))[0]
    for other, (keys, use) in _MARKS.items():
        if expected and not expected & set(data) and keys & set(data):
            raise _of_another_kind(kind, path, other, use)
    # Replaces characters that the name of a scenario may not have.
    data.setdefault("name", re.sub(r"^\W+|[^\w .+-]", "_", path.stem, flags=re.ASCII)[:max_name])
    return data


def _yaml() -> YAML:
    # YAML 1.2: 1e-3 is a number, duplicate keys are refused, and the safe loader builds only plain values.
    return YAML(typ="safe", pure=True)


@lru_cache(maxsize=64)
def _loaded(text: str) -> object:
    yaml = _yaml()
    yaml.Composer = _PlainComposer
    return yaml.load(text)


def parse_yaml(text: str, key: str) -> Any:
    """Plain values from a YAML text."""
    try:
        # Cached, because a robot's file is read with every scenario of the robot.
        return copy.deepcopy(_loaded(text))
    except Exception as error:
        # For a tag that does not fit its value (`!!bool 3`) the loader raises KeyError, IndexError and others.
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        problem = str(getattr(error, "problem", None) or f"{type(error).__name__}: {error}").removeprefix("but ")
        hint = "; indent with spaces" if "'\\t'" in problem else ""
        allowed = f"well-formed YAML without tags and aliases{hint}"
        raise ConfigurationError(key, f"{where}{' '.join(problem.split())}", allowed) from None


def parse_changes(texts: Iterable[str], example: str) -> Document:
    """Keys and plain values of `key=value` texts of `--set`; messages show `example`."""
    changes: Document = {}
    for text in texts:
        key, separator, value = (part.strip() for part in text.partition("="))
        if not separator or not key:
            raise ConfigurationError("--set", text, f"key=value, such as {example}")
        changes[key] = parse_yaml(value, f"--set {shorten(key)}")
    return changes


def to_yaml(data: object) -> str:
    """Plain values as YAML text that `parse_yaml` can read."""
    yaml, stream = _yaml(), StringIO()
    yaml.default_flow_style = None
    yaml.width = 120
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.dump(to_plain(data), stream)
    return stream.getvalue()


class _PlainComposer(Composer):
    """Refuses aliases, and so merge keys: a few nested ones can exhaust the memory."""

    def compose_node(self, parent: object, index: object) -> object:
        if self.parser.check_event(AliasEvent):
            event = self.parser.peek_event()
            raise MarkedYAMLError(problem=f"an alias, *{event.anchor}", problem_mark=event.start_mark)
        return super().compose_node(parent, index)
