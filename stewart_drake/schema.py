"""JSON schema of a section with families of kinds in it, for editors."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from stewart_drake.files.code_path import CLASS_PATH


def json_schema(root: Any) -> dict[str, Any]:
    """JSON schema of a section, with every kind of its families among the definitions."""
    schema: dict[str, Any] = TypeAdapter(root).json_schema()
    definitions: dict[str, Any] = schema.setdefault("$defs", {})

    def with_references(part: Any) -> Any:
        if isinstance(part, list):
            return [with_references(each) for each in part]
        if not isinstance(part, dict):
            return part
        if "kinds" not in part:
            return {key: with_references(value) for key, value in part.items()}
        rest = {key: value for key, value in part.items() if key not in ("kinds", "default kind", "own")}
        ways = [reference(each, kind == part["default kind"]) for kind, each in part["kinds"].items()]
        alone = [kind for kind, each in part["kinds"].items() if not needed(each)]
        ways += [{"type": "string", "enum": alone}] if alone else []
        if part["own"] is not None:
            ways += [by_path(part["own"]), {"type": "string", "pattern": CLASS_PATH}]
        return {**rest, "anyOf": ways}

    def reference(section: Any, default: bool = False) -> dict[str, Any]:
        name = section.__name__
        if name not in definitions:
            definitions[name] = {}
            made = TypeAdapter(section).json_schema()
            definitions.update({each: with_references(value) for each, value in made.pop("$defs", {}).items()})
            definitions[name] = with_references(made)
        return {"$ref": f"#/$defs/{name}", **({} if default else {"required": ["kind"]})}

    def needed(section: Any) -> bool:
        return any(field.is_required() for field in section.__pydantic_fields__.values())

    def by_path(section: Any) -> dict[str, Any]:
        """The section of a user's class, whose path stands under `kind`."""
        found, key = reference(section), section.path_key
        if key == "kind":
            return found
        name = f"{section.__name__}ByPath"
        properties = dict(definitions[section.__name__]["properties"])
        properties["kind"] = properties.pop(key)
        definitions[name] = {**definitions[section.__name__], "properties": properties, "required": ["kind"]}
        return {"$ref": f"#/$defs/{name}"}

    inner = list(definitions)
    schema = with_references({key: value for key, value in schema.items() if key != "$defs"})
    definitions.update({name: with_references(definitions[name]) for name in inner})
    return {**schema, "$defs": definitions}
