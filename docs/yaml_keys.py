"""The reference of every YAML key as Markdown, from the JSON schemas of the sections; `reference.py` writes it."""

import json
import re
from collections import defaultdict
from collections.abc import Iterator

from pydantic import TypeAdapter

from stewart_drake.cli.lookup_commands import allowed, ways
from stewart_drake.scenario import Scenario
from stewart_drake.studies.comparison_file import CompareFile
from stewart_drake.studies.sweep import SweepFile

TEXT = """Files are YAML. Every key has a default unless it says *required*. An unknown key is refused, with the
one that you perhaps meant. `--set controller.period=0.002` changes a key on the command line. A number that has a unit
may be written with another one: `30 deg`, `5 mm`. Where a section has kinds, the word in brackets after a key is its
kind, and in a scenario a name such as `sensors: encoders` stands for a section of that kind alone. Sizes by default are
those of the paper's robot; for another one they change in proportion. `stewart-drake schema` prints the JSON schema,
with which editors complete keys.
"""


def items(schema: dict) -> list[dict]:
    """What the values in a list or mapping may be."""
    inner = [*schema.get("prefixItems", [])[:1], schema.get("items"), schema.get("additionalProperties")]
    return [each for each in inner if isinstance(each, dict)]


def sections(schema: dict, root: dict, path: str) -> list[tuple[str, dict]]:
    """Path and schema of the sections under a key, in it or in a list or mapping of it."""
    found = []
    for option in ways(root, schema):
        if "properties" in option:
            found.append((path, option))
        place = f"{path}[i]" if option.get("type") == "array" else f"{path}.NAME"
        found += [each for inner in items(option) for each in sections(inner, root, place)]
    return found


def plain(value: object) -> str:
    """A value as YAML has it."""
    return value if isinstance(value, str) else json.dumps(value)


def key(name: str, schema: dict, root: dict, required: bool, text: str = "") -> Iterator[str]:
    """One key: what is allowed, its unit and default, what it does."""
    unit, text = re.fullmatch(r"(?:\[(.*?)\] ?)?(.*)", schema.get("description", text), re.DOTALL).groups()
    kinds = {option.get("type"): option for option in ways(root, schema)}
    if "default" in schema:
        default = f"default `{plain(schema['default'])}`"
    elif required or "object" not in kinds:
        default = "required"
    else:
        default = "default: its own keys have theirs" if "properties" in kinds["object"] else "default: none"
    facts = filter(None, [allowed(root, schema), unit and f"unit {unit}".replace("unit -", "no unit"), default])
    if not re.match(r"\w+:", text):  # a value that is explained
        text = text[:1].upper() + text[1:]
    yield f"````{{key}} {name}\n{' · '.join(facts)}\n\n{text}\n````\n"


def key_lines(path: str, section: dict, root: dict, seen: set[str], kind: str = "") -> Iterator[str]:
    """The keys of a section, then of those sections in it that are not `seen` elsewhere on the page."""
    properties, required = section["properties"], section.get("required", [])
    family = properties.get("kind", {})
    kind = family.get("const", "a class of yours" if "pattern" in family else kind)
    about, _, keys = section.get("description", "").partition("Keys:")
    texts = dict(re.findall(r"^ +(\w+): (.*)$", keys, re.MULTILINE))  # of keys that the section has inherited
    inside = {name: sections(each, root, f"{path}.{name}") for name, each in properties.items()}
    title = f"{path}{kind and f': {kind}'}"
    yield f"## {'Keys' if title.isidentifier() else title}\n\n{about.strip()}\n"
    values = {name: plain(each.get("const", each.get("default", "..."))) for name, each in properties.items()}
    lines = [f"{name}: {value}" for name, value in values.items() if not inside[name] or value != "..."]
    dash = "  - " if path.endswith("[i]") else "  "
    lines = [f"{dash if line == lines[0] else ' ' * len(dash)}{line}" for line in lines]
    yield "\n".join(["```yaml", f"{path.rpartition('.')[2].removesuffix('[i]')}:", *lines, "```\n"])
    for name, each in properties.items():
        if "const" not in each:
            label = f"{path}.{name}{kind and f' ({kind})'}"
            yield from key(label, each, root, name in required, texts.get(name, ""))
    for place, each in (one for found in inside.values() for one in found):
        if each["title"] not in seen:
            yield from key_lines(place, each, root, seen | {each["title"]}, kind)


def pages() -> Iterator[tuple[str, str]]:
    """A page for each kind of file and for each section family of a scenario, and one that lists all keys."""
    texts = {}
    for file, section in {"scenario": Scenario, "sweep": SweepFile, "comparison": CompareFile}.items():
        root = TypeAdapter(section).json_schema()
        texts[file] = [f"# {file}\n", f"{root['description'].partition('Keys:')[0].strip()}\n"]
        below = []
        for name, schema in root["properties"].items():
            found = sections(schema, root, name)
            label = name if file == "scenario" else f"{name} ({file})"
            texts[file] += key(label, schema, root, name in root.get("required", []))
            titles = {each["title"] for _, each in found}
            lines = [line for place, each in found for line in key_lines(place, each, root, titles)]
            if file != "scenario":
                below += lines
            elif found and name != "model_robot":
                texts[name] = [f"# {name}\n", f"{schema.get('description', '')}\n", *lines]
        texts[file] += below
    by_name = defaultdict(list)
    for name in sorted(re.findall(r"````\{key\} (.*)", "\n".join(line for page in texts.values() for line in page))):
        by_name[name.partition(" ")[0].rpartition(".")[2]].append(f"{{key}}`{name}`")
    index = [f"- **{name}**: {', '.join(places)}" for name, places in sorted(by_name.items())]
    tree = ["```{toctree}", ":titlesonly:", *(f"keys_{name}" for name in texts), "```\n"]
    yield "keys", "\n".join(["# YAML keys\n", TEXT, *tree, "## All keys, by name\n", *index])
    yield from ((f"keys_{name}", "\n".join(lines)) for name, lines in texts.items())
