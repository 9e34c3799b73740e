"""JSON Schema as Markdown tables: settings of pydantic and bodies of OpenAPI alike."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]

_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def cell(text: object) -> str:
    """Text that does not end a cell or a row of a table."""
    return " ".join(str(text).split()).replace("|", "\\|")


def name_of_reference(schema: Schema) -> str | None:
    """The name of the one schema that this one refers to, also where it may be null or is wrapped."""
    if "$ref" in schema:
        return str(schema["$ref"]).rsplit("/", 1)[-1]
    for part in (*schema.get("anyOf", ()), *schema.get("allOf", ())):
        if (name := name_of_reference(part)) is not None:
            return name
    items = schema.get("items") or schema.get("additionalProperties")
    return name_of_reference(items) if isinstance(items, dict) else None


def type_of(schema: Schema) -> str:
    """What a value may be, in words: its type, its choices, its limits."""
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{json.dumps(value)}`" for value in schema.get("enum", [schema.get("const")]))
    if "anyOf" in schema:
        return " or ".join(type_of(part) for part in schema["anyOf"])
    if "$ref" in schema:
        return str(name_of_reference(schema))
    if schema.get("format") == "binary":
        return "file"
    if "contentSchema" in schema:
        return f"JSON: {type_of(schema['contentSchema'])}"
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"array of {len(schema['prefixItems'])}"
        return f"array of {type_of(schema.get('items', {}))}"
    limits = [f"{sign} {schema[word]:g}" for word, sign in _LIMITS.items() if word in schema]
    return " ".join([str(schema.get("type", "any")), ", ".join(limits)]).strip()


def default_of(schema: Schema) -> str:
    """The default as code; nothing where there is none, or where the table of a part shows it."""
    default = schema.get("default")
    if "default" not in schema or isinstance(default, dict):
        return ""
    return "none" if default is None else f"`{json.dumps(default)}`"


def table(schema: Schema, *, with_defaults: bool = False) -> list[str]:
    """A row for every property; those that refer to another schema link to its heading."""
    required = set(schema.get("required", ()))
    head = "| field | type | default | |" if with_defaults else "| field | type | |"
    lines = [head, "|---" * (head.count("|") - 1) + "|"]
    for name, each in schema.get("properties", {}).items():
        kind = cell(type_of(each))
        reference = name_of_reference(each)
        if reference is not None:
            kind = kind.replace(reference, f"[{reference}](#{reference.lower()})")
        said = cell(each.get("description", ""))
        if with_defaults:
            shown = "required" if name in required else cell(default_of(each))
            lines.append(f"| `{name}` | {kind} | {shown} | {said} |")
        else:
            lines.append(f"| `{name}` | {kind} | {said} |")
    return lines
