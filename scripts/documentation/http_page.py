"""docs/http.md: the service's routes, from its OpenAPI document."""

from __future__ import annotations

from typing import Any

from boxlift_service import ServiceSettings
from boxlift_service.app import create_app
from documentation.schema_tables import cell, name_of_reference, table

_HEAD = """# HTTP reference

Made by `make docs` from the document that the service itself serves at `GET /openapi.json`, which has every
range and example. {description}

How batches stream: [batches](batch.md). Limits, keys and time: [settings](settings.md),
[security](security.md), [operating](operating.md).
"""


def made() -> dict[str, str | bytes]:
    """The page by its path below docs/."""
    document = create_app(ServiceSettings()).openapi()
    schemas = document["components"]["schemas"]
    lines = [_HEAD.format(description=document["info"]["description"])]
    answers: list[str] = []
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            lines += _operation(f"{method.upper()} {path}", operation, answers)
    lines += ["## Problems", "", *_problem_table(document), ""]
    lines += ["## Answers", "", "Fields of what is answered as JSON; a batch and msgpack have the same.", ""]
    for name in _with_their_parts(answers, schemas):
        said = cell(schemas[name].get("description", ""))
        lines += [f"### {name}", "", said, "", *table(schemas[name]), ""]
    return {"http.md": "\n".join(lines)}


def _operation(title: str, operation: dict[str, Any], answers: list[str]) -> list[str]:
    lines = [
        f"## {title}",
        "",
        f"{operation['summary']}. {cell(operation.get('description', ''))}".strip(),
        "",
    ]
    if parameters := operation.get("parameters"):
        properties = {
            each["name"]: {**each["schema"], "description": each.get("description")} for each in parameters
        }
        lines += ["Headers and parameters:", "", *table({"properties": properties}), ""]
    body = operation.get("requestBody", {})
    for kind, content in body.get("content", {}).items():
        lines += [f"Body as `{kind}`: {cell(body.get('description', ''))}", ""]
        if "properties" in (schema := content.get("schema", {})):
            lines += [*table(schema, with_defaults=True), ""]
    lines += ["| status | as | |", "|---|---|---|"]
    for status, response in operation["responses"].items():
        kinds = ", ".join(f"`{kind}`" for kind in response.get("content", {}))
        said = cell(response.get("description", ""))
        schema = response.get("content", {}).get("application/json", {}).get("schema", {})
        if (name := name_of_reference(schema)) is not None:
            said += f" [{name}](#{name.lower()})"
            answers.append(name)
        lines.append(f"| {status} | {kinds} | {said} |")
    return [*lines, ""]


def _with_their_parts(names: list[str], schemas: dict[str, Any]) -> list[str]:
    """The names, each followed by those that it is made of, each once."""
    found: list[str] = []
    waiting = list(names)
    while waiting:
        name = waiting.pop(0)
        if name not in found:
            found.append(name)
            parts = (name_of_reference(each) for each in schemas[name].get("properties", {}).values())
            waiting = [part for part in parts if part is not None] + waiting
    return found


def _problem_table(document: dict[str, Any]) -> list[str]:
    """The members of an error, which are the same for every status."""
    refusal = document["paths"]["/label"]["post"]["responses"]["422"]
    return table(refusal["content"]["application/problem+json"]["schema"])
