"""The reference of every YAML key as Markdown, from the keys of the sections; `reference.py` writes it."""

import re
from collections import defaultdict
from collections.abc import Iterator

from pydantic import TypeAdapter

from stewart_drake.base.keys import Key, keys_of, sections_at
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.comparison_file import CompareFile
from stewart_drake.studies.sweep import SweepFile

TEXT = """Files are YAML. Every key has a default unless it says *required*. An unknown key is refused, with the
one that you perhaps meant. `--set controller.period=0.002` changes a key on the command line. A number that has a unit
may be written with another one: `30 deg`, `5 mm`. Where a section has kinds, the word in brackets after a key is its
kind, and in a scenario a name such as `sensors: encoders` stands for a section of that kind alone. Sizes by default are
those of the paper's robot; for another one they change in proportion. `stewart-drake schema` prints the JSON schema,
with which editors complete keys.
"""


def key_lines(key: Key, root: dict, label: str) -> str:
    """One key: what is allowed, its unit and default, what it does."""
    inside = list(sections_at(key.schema, root, ""))
    if "default" in key.schema:
        default = f"default `{key.default}`"
    elif key.required or not (inside or key.allowed.startswith("names")):
        default = "required"
    else:
        default = "default: its own keys have theirs" if inside and not inside[0][0] else "default: none"
    facts = filter(None, [key.allowed, key.unit and f"unit {key.unit}".replace("unit -", "no unit"), default])
    text = key.text
    if not re.match(r"\w+:", text):  # a value that is explained
        text = text[:1].upper() + text[1:]
    return f"````{{key}} {label}\n{' · '.join(facts)}\n\n{text}\n````\n"


def section_lines(path: str, section: dict, root: dict, described: set[str], kind: str = "") -> Iterator[str]:
    """The keys of a section, then of those sections in it that are not `described` elsewhere on the page."""
    keys = keys_of(section, root, path)
    family = section["properties"].get("kind", {})
    kind = family.get("const", "a class of yours" if "pattern" in family else kind)
    title = f"{path}{kind and f': {kind}'}"
    yield f"## {'Keys' if title.isidentifier() else title}\n\n{section.get('description', '').strip()}\n"
    inside = [each for key in keys for each in sections_at(key.schema, root, key.name)]
    lines = []
    for key in keys:
        value = key.schema.get("const", key.default or "...")
        if value != "..." or not list(sections_at(key.schema, root, "")):
            lines.append(f"{'    ' if lines and path.endswith('[i]') else '  '}{key.name.rpartition('.')[2]}: {value}")
    if path.endswith("[i]") and lines:
        lines[0] = f"  - {lines[0].strip()}"
    yield "\n".join(["```yaml", f"{path.rpartition('.')[2].removesuffix('[i]')}:", *lines, "```\n"])
    yield from (key_lines(key, root, f"{key.name}{kind and f' ({kind})'}") for key in keys if "const" not in key.schema)
    for place, each in inside:
        if each["title"] not in described:
            yield from section_lines(place, each, root, described | {each["title"]}, kind)


def pages() -> Iterator[tuple[str, str]]:
    """A page for each kind of file and for each section family of a scenario, and one that lists all keys."""
    texts = {}
    for file, section in {"scenario": Scenario, "sweep": SweepFile, "comparison": CompareFile}.items():
        root = TypeAdapter(section).json_schema()
        texts[file] = [f"# {file}\n", f"{root['description'].strip()}\n"]
        below = []
        for key in keys_of(root, root):
            inside = list(sections_at(key.schema, root, key.name))
            texts[file].append(key_lines(key, root, key.name if file == "scenario" else f"{key.name} ({file})"))
            titles = {each["title"] for _, each in inside} | ({"RobotParameters"} if key.name != "robot" else set())
            lines = [line for place, each in inside for line in section_lines(place, each, root, titles)]
            if file != "scenario":
                below += lines
            elif inside:
                texts[key.name] = [f"# {key.name}\n", f"{key.text}\n", *lines]
        texts[file] += below
    by_name = defaultdict(list)
    for name in sorted(re.findall(r"````\{key\} (.*)", "\n".join(line for page in texts.values() for line in page))):
        by_name[name.partition(" ")[0].rpartition(".")[2]].append(f"{{key}}`{name}`")
    index = [f"- **{name}**: {', '.join(places)}" for name, places in sorted(by_name.items())]
    tree = ["```{toctree}", ":titlesonly:", *(f"keys_{name}" for name in texts), "```\n"]
    yield "keys", "\n".join(["# YAML keys\n", TEXT, *tree, "## All keys, by name\n", *index])
    yield from ((f"keys_{name}", "\n".join(lines)) for name, lines in texts.items())
