"""Keys of sections: what `Section.keys()` gives to messages, commands and pages, from the JSON schema."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import Document

Schema = Document
TINY = float(np.finfo(float).tiny)
"""Smallest number with a finite reciprocal; positive numbers must be at least this."""
_LARGEST_SHOWN = 1e15  # Larger bounds are left out of messages.
_NOUNS = {"boolean": "true or false", "string": "a text", "number": "a number", "integer": "a whole number"}
_BOUNDS = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}


class Key(NamedTuple):
    """A key of a section; `name` is dotted, `kind` is that of the section, an empty `default` means none."""

    name: str
    kind: str
    unit: str
    text: str
    allowed: str
    default: str
    required: bool
    schema: Schema

    @property
    def sentence(self) -> str:
        """The first sentence of the text."""
        return re.split(r"(?<=[a-z)])\. |; ", self.text.removesuffix("."))[0]

    @property
    def chooses_kind(self) -> bool:
        """Whether it is the kind of its section."""
        return self.name.rpartition(".")[2] == "kind" and "enum" not in self.schema


def keys_of(section: Schema, root: Schema, path: str = "") -> list[Key]:
    """The keys of a section in a JSON schema."""
    keys, properties = [], section["properties"]
    for name, schema in properties.items():
        unit, text = unit_and_text(" ".join(schema.get("description", "").split()))
        kind, required = properties.get("kind", {}).get("const", ""), name in section.get("required", ())
        keys.append(Key(f"{path}.{name}".removeprefix("."), kind, unit, text, *_facts(schema, root), required, schema))
    return keys


def all_keys(section: Schema, root: Schema, path: str = "", depth: int = 4) -> Iterator[Key]:
    """The keys of a section and of the sections in it, to a depth; the text of `kind` is that of its section."""
    for key in keys_of(section, root, path):
        about = " ".join(section["description"].partition("\n\n")[0].split())
        yield key._replace(text=about) if key.chooses_kind else key
        for _, inner in sections_at(key.schema, root, "") if depth else ():
            yield from all_keys(inner, root, key.name, depth - 1)


def sections_at(schema: Schema, root: Schema, path: str) -> Iterator[tuple[str, Schema]]:
    """Path and schema of the sections at a key, one per kind; in a list at path[i], in a mapping at path.NAME."""
    for way in _ways(schema, root):
        if "properties" in way:
            yield path, way
        for inner in _items(way):
            yield from sections_at(inner, root, f"{path}[i]" if way.get("type") == "array" else f"{path}.NAME")


def unit_and_text(description: str) -> tuple[str, str]:
    """The unit in brackets before a text, such as `rad, m`, empty without; and the text."""
    match = re.match(r"\[([^]]*)\] ?", description)
    return (match[1], description[match.end() :]) if match else ("", description)


def join_or(choices: Sequence[str]) -> str:
    """Choices as a list in English."""
    return choices[0] if len(choices) == 1 else f"{', '.join(choices[:-1])} or {choices[-1]}"


def _facts(schema: Schema, root: Schema) -> tuple[str, str]:
    """What a key allows, and its default as YAML has it, with numbers in six digits."""
    default = schema.get("default", "")
    if isinstance(default, list) and len(default) == 6 and len(set(map(str, default))) == 1:
        default = default[0]
    if not isinstance(default, str):
        default = json.dumps(json.loads(json.dumps(default), parse_float=lambda text: float(f"{float(text):.6g}")))
    return allowed_text(schema, root), default


def allowed_text(schema: Schema, root: Schema, unit: str = "") -> str:
    """What a part of a JSON schema allows, in words, with the unit behind numbers."""
    texts, null, behind = [], "", unit and f" [{unit}]"
    for way in _ways(schema, root):
        kind, inner = str(way.get("type")), (_items(way) or [{}])[0]
        if "const" in way or "enum" in way:
            texts += [str(choice) for choice in way.get("enum", [way.get("const")])]
        elif "properties" in way:
            texts.append("a section")
        elif kind == "array":
            least, is_fixed = way.get("minItems", 0), way.get("minItems") == way.get("maxItems")
            count = f" of {'' if is_fixed else 'at least '}{least}" if least else ""
            is_plain = is_fixed and allowed_text(inner, root) == "a number"
            items = f" numbers{behind}" if is_plain else f", each {allowed_text(inner, root, unit)}"
            texts.append(f"a list{count}{items}")
        elif kind == "object":
            texts.append(f"names, each with {allowed_text(inner, root)}")
        elif ":" in way.get("pattern", ""):
            texts.append("path/to/file.py:Class")
        elif kind == "null":
            null = ", or null"
        else:
            noun = _NOUNS.get(kind, "any value")
            noun = noun.replace("a ", "a positive ", 1) if way.get("minimum") == TINY else noun
            ends = {text: way[key] for key, text in _BOUNDS.items() if TINY != way.get(key, TINY) < _LARGEST_SHOWN}
            bounds = [f"{text} {f'{end:g}' if abs(end) < 1e5 else f'{end:,.0f}'}" for text, end in ends.items()]
            texts.append(" ".join([noun + behind, " and ".join(bounds)]).strip())
    return join_or(list(dict.fromkeys(texts))) + null


def part_at(schema: Schema, root: Schema, path: Sequence[int | str], unit: str) -> tuple[Schema, str]:
    """The schema at a path in lists and mappings of a schema, and its unit among those of the whole."""
    for step in path:
        inside = next(((way, item) for way in _ways(schema, root) for item in _items(way)), None)
        if inside is None:
            break
        count, units = len(inside[0].get("prefixItems", ())), unit.split(", ")
        unit = units[step * len(units) // count] if isinstance(step, int) and step < count else unit
        schema = inside[1]
    return schema, unit


def _ways(schema: Schema, root: Schema) -> Iterator[Schema]:
    """What a part of a schema may be, references followed; a number that may have a unit counts as a number."""
    if "$ref" in schema:
        yield from _ways(root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    elif "anyOf" in schema:
        for way in schema["anyOf"]:
            yield from _ways(way, root)
    else:
        kind = schema.get("type")
        yield {**schema, "type": kind[0]} if isinstance(kind, list) else schema


def _items(schema: Schema) -> list[Schema]:
    """What the values in a list or mapping may be."""
    inner = [*schema.get("prefixItems", [])[:1], schema.get("items"), schema.get("additionalProperties")]
    return [schema for schema in inner if isinstance(schema, dict)]
