"""Commands for what to write into a scenario, and whether all is well here: `list`, `explain`, `init`, `doctor`."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import click
from click.shell_completion import get_completion_class

from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, shown_compiling, tell
from stewart_drake.config import TINY, either, meant
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.yaml_files import read_mapping, shipped_folder
from stewart_drake.runs.outputs import write_text
from stewart_drake.scenario import load_scenario, scenario_schema

_DEPTH = 4  # Of keys in sections: a motion may be a sum of motions, and so on
_UNIT = re.compile(r"\[([^]]+)\] ?(.*)", re.DOTALL)
_FILES = ("scenarios", "comparisons", "sweeps", "robots")


class Key(NamedTuple):
    """A key of a scenario: its dotted name, the kind of its section, and its part of the JSON schema."""

    name: str
    kind: str
    schema: Mapping[str, Any]

    @property
    def unit(self) -> str:
        found = _UNIT.match(self.schema.get("description", ""))
        return found[1] if found else ""

    @property
    def text(self) -> str:
        """What it does, in its first paragraph."""
        text = self.schema.get("description", "").partition("\n\n")[0]
        found = _UNIT.match(text)
        return " ".join((found[2] if found else text).split())

    @property
    def chooses(self) -> bool:
        """Whether it is the kind of its section."""
        return self.name.rpartition(".")[2] == "kind" and "enum" not in self.schema

    @property
    def sentence(self) -> str:
        return re.split(r"(?<=[a-z)])\. |; ", self.text.removesuffix("."))[0]


def ways(root: Mapping[str, Any], schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """What a part of a schema may be, references followed; a number that may have a unit counts as a number."""
    if "$ref" in schema:
        yield from ways(root, root["$defs"][schema["$ref"].rpartition("/")[2]])
    elif "anyOf" in schema:
        for each in schema["anyOf"]:
            yield from ways(root, each)
    else:
        kind = schema.get("type")
        yield {**schema, "type": kind[0]} if isinstance(kind, list) else schema


def keys_of(root: Mapping[str, Any], schema: Mapping[str, Any], before: str = "", depth: int = 0) -> Iterator[Key]:
    """All keys of a scenario, those of each kind of section too."""
    for way in ways(root, schema):
        kind = way.get("properties", {}).get("kind", {}).get("const", "")
        for name, inner in way.get("properties", {}).items():
            # The text of a kind is its section's.
            key = Key(f"{before}{name}", kind, inner)
            about = {**inner, "description": way.get("description", "")}
            yield key._replace(schema=about) if key.chooses else key
            if depth < _DEPTH:
                inside = inner.get("items", inner)
                yield from keys_of(root, inside, f"{before}{name}.", depth + 1)


@command("list")
@click.argument("what", required=False, type=click.Choice([*_FILES, "kinds"]))
def list_(what: str | None) -> None:
    """WHAT: scenarios, comparisons, sweeps, robots, or kinds, those of a scenario's sections [default: all]."""
    for folder in _FILES:
        if what in (None, folder):
            files = sorted(shipped_folder(folder).glob("*.yaml"))
            print_table(folder, [(path.stem, _about(path)) for path in files], ("name", "what it is"), numbers=())
    if what in (None, "kinds"):
        schema = scenario_schema()
        rows = []
        for name, inner in schema["properties"].items():
            for way in ways(schema, inner.get("items", inner)):
                kind = way.get("properties", {}).get("kind", {}).get("const")
                if kind is not None:
                    rows.append((name, kind, Key(kind, "", way).text))
        print_table("kinds", rows, ("key", "kind", "what it is"), numbers=())


def _about(path: Path) -> str:
    """What a file says of itself, in a sentence."""
    given = read_mapping("file", path, 100).get("about")
    lines = [line for line in path.read_text().splitlines() if not line.startswith("# yaml-language-server")]
    comment = " ".join(line.removeprefix("#").strip() for line in takewhile(lambda line: line.startswith("#"), lines))
    return str(given or re.split(r"(?<=[.!?]) |: `", comment)[0])


@command("explain")
@click.argument("key")
def explain(key: str) -> None:
    """KEY is a scenario key such as controller.period, its last part such as period, or a section such as limits."""
    root = scenario_schema()
    every = list(keys_of(root, root))
    found = [each for each in every if each.name == key] or [each for each in every if each.name.endswith(f".{key}")]
    if not found:
        names = dict.fromkeys(name for each in every for name in (each.name, each.name.rpartition(".")[2]))
        raise ConfigurationError("KEY", key, f"a key of a scenario{meant(key, names)}")
    inside = [each for each in every if each.name.rpartition(".")[0] == found[0].name and not each.chooses]
    if found[0].chooses:
        print_table(key, [(each.kind, each.text) for each in found], ("kind", "what it is"), numbers=())
        return
    shown: dict[tuple[str, ...], list[str]] = {}
    for each in [*found, *inside]:
        default = _short(each.schema["default"]) if "default" in each.schema else ""
        name, text = (each.name.rpartition(".")[2], each.sentence) if each in inside else (each.name, each.text)
        shown.setdefault((name, text, each.unit, default, allowed(root, each.schema)), []).append(each.kind)
    rows = [(name, ", ".join(filter(None, kinds)), *rest) for (name, *rest), kinds in shown.items()]
    header = ("key", "of kind", "what it does", "unit", "default", "allowed")
    used = [place for place in range(len(header)) if any(row[place] for row in rows)]
    if len(rows) == 1:
        print_table(key, [(header[place], rows[0][place]) for place in used], numbers=())
    else:
        print_table(key, [[row[place] for place in used] for row in rows], [header[place] for place in used], ())


_NOUNS = {"boolean": "true or false", "string": "a text", "number": "a number", "integer": "a whole number"}
_BOUNDS = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}


def allowed(root: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """What a part of a JSON schema allows, in words."""
    texts, null = [], ""
    for way in ways(root, schema):
        kind, fixed = str(way.get("type")), way.get("prefixItems")
        if "const" in way or "enum" in way:
            texts += [str(each) for each in way.get("enum", [way.get("const")])]
        elif "properties" in way:
            texts.append("a section")
        elif kind == "array":
            count = f"a list of {len(fixed)}" if fixed else "a list"
            texts.append(f"{count}, each {allowed(root, fixed[0] if fixed else way.get('items', {}))}")
        elif kind == "object":
            inner = way.get("additionalProperties")
            texts.append(f"names, each with {allowed(root, inner if isinstance(inner, dict) else {})}")
        elif ":" in way.get("pattern", ""):
            texts.append("path/to/file.py:Class")
        elif kind == "null":
            null = ", or null"
        else:
            noun = _NOUNS.get(kind, "any value")
            noun = noun.replace("a ", "a positive ", 1) if way.get("minimum") == TINY else noun
            # Where a computer's numbers end nobody has to know.
            ends = {word: way[key] for key, word in _BOUNDS.items() if TINY != way.get(key, TINY) < 1e15}
            bounds = [f"{word} {f'{end:g}' if abs(end) < 1e5 else f'{end:,.0f}'}" for word, end in ends.items()]
            texts.append(" ".join([noun, " and ".join(bounds)]).strip())
    return either(list(dict.fromkeys(texts))) + null


def _short(value: Any) -> str:
    """A default, its numbers in six digits, equal ones once."""
    if isinstance(value, (list, tuple)) and len(value) == 6 and len(set(map(str, value))) == 1:
        value = value[0]
    return json.dumps(json.loads(json.dumps(value), parse_float=lambda text: float(f"{float(text):.6g}")))


@command("init")
@click.argument("file", type=opt.OUT_FILE, default="scenario.yaml")
def init(file: Path) -> None:
    """FILE is the scenario to write [default: scenario.yaml]."""
    if file.exists():
        raise ConfigurationError("FILE", str(file), "a new file")
    root = scenario_schema()
    texts: dict[str, Key] = {}
    given = read_mapping("scenario", shipped_folder("scenarios") / "exact_breathing.yaml", 100)
    given["reference"] = {"kind": "sine", "amplitude": [0.05, 0, 0, 0, 0, 0.01], "angular_frequency": 2}
    for key in keys_of(root, root):
        section = given.get(key.name.partition(".")[0])
        kind = section.get("kind") if isinstance(section, dict) else section
        if key.name not in texts or key.kind == kind:
            texts[key.name] = key
    others = [name for name in root["properties"] if name not in given]
    lines = [
        f"# A scenario: `stewart-drake run {file}` runs it, `stewart-drake check {file}` checks its motion,",
        "# `stewart-drake explain KEY` explains a key. The robot has encoders, delay and friction, as a real one.",
        *_commented({"name": file.stem, **{key: given[key] for key in given if key != "name"}}, texts),
        "",
        "# These keys have their defaults:",
        *(f"# {name}{_comment(texts[name])}" for name in others),
    ]
    write_text(file, "\n".join(lines) + "\n")
    load_scenario(file)
    tell(f"scenario in {file}; next: stewart-drake run {file}")


def _commented(data: Mapping[str, Any], texts: Mapping[str, Key], before: str = "") -> Iterator[str]:
    """Lines of YAML, each with what its key does."""
    indent = "  " * before.count(".")
    for name, value in data.items():
        comment = _comment(texts[before + name], value) if before + name in texts else ""
        if isinstance(value, dict):
            yield f"{indent}{name}:{comment}"
            yield from _commented(value, texts, f"{before}{name}.")
        else:
            plain = isinstance(value, str) and value.isidentifier()
            yield f"{indent}{name}: {value if plain else json.dumps(value)}{comment}"


def _comment(key: Key, value: Any = None) -> str:
    """What a key does; of a text that goes through the values, what this one does."""
    chosen = re.search(rf"(?:^|\. ){value}: ([^.]+)", key.text) if isinstance(value, str) else None
    sentence = chosen[1] if chosen else key.sentence
    words = f"[{key.unit}] {sentence}" if key.unit else sentence
    return f"  # {words.strip()}" if words else ""


@command("doctor")
def doctor() -> None:
    """Prints versions, graphviz, the cache of compiled code, the time of a control tick, and write permission."""
    from stewart_drake import jit
    from stewart_drake.logs.versions import collect_versions, package_version
    from stewart_drake.runs.simulation import run

    versions = collect_versions() | {
        name: package_version(name) for name in ("numba", "torch", "mujoco", "distributed")
    }
    rows = [(name, version or "not installed") for name, version in versions.items() if name != "source"]
    rows.append(("graphviz", shutil.which("dot") or "not installed: runs write diagram.dot, but no diagram.svg"))
    cache = jit._FOLDER
    kept = "not cached: set NUMBA_CACHE_DIR to a writable folder"
    if cache is not None:
        size = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file())
        kept = f"{cache}, {size / 1e6:.0f} MB"
    rows.append(("compiled code", kept))
    with shown_compiling():
        logs = [run(load_scenario("exact_breathing", ["plant.engine=reduced", "duration=1"])) for _ in range(2)]
    ticks = logs[1].end_time / logs[1].scenario.controller.period
    rows.append(("a tick of exact_breathing, fast engine", f"{1e6 * logs[1].wall_time / ticks:.0f} us of 1000 us"))
    rows.append(("cores", str(os.cpu_count())))
    rows.append(("this folder", "writable" if os.access(".", os.W_OK) else "not writable: use --out"))
    print_table("doctor", rows, numbers=())


@command("schema")
def schema() -> None:
    click.echo(json.dumps(scenario_schema(), indent=2))


@command("completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """For bash, add to ~/.bashrc: eval "$(stewart-drake completion bash)". Other shells: to their start file."""
    cls = get_completion_class(shell)
    assert cls is not None
    click.echo(cls(opt.cli, {}, "stewart-drake", "_STEWART_DRAKE_COMPLETE").source())
