"""docs/commands.md: every command with its arguments and options, from the commands themselves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer.main

from boxlift_client.cli import app
from documentation.schema_tables import cell


def made() -> dict[str, str | bytes]:
    """The page by its path below docs/."""
    lines = [
        "# Commands",
        "",
        "Made by `make docs` from the commands themselves; `boxlift COMMAND --help` says the same.",
        "",
    ]
    for name, command in _commands(typer.main.get_command(app)):
        lines += _section(name, command)
    return {"commands.md": "\n".join(lines)}


def _commands(group: Any, before: str = "boxlift") -> Iterator[tuple[str, Any]]:
    """Every command of a group of click, and those of its groups."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, f"{before} {name}")
        elif not command.hidden:
            yield f"{before} {name}", command


def _section(name: str, command: Any) -> list[str]:
    parameters = [
        each for each in command.params if not getattr(each, "hidden", False) and each.name != "help"
    ]
    arguments = [each for each in parameters if each.param_type_name == "argument"]
    usage = " ".join(_in_brackets(each) for each in arguments)
    text = " ".join((command.help or "").replace("\b", "").split())
    lines = [f"## {name}", "", text, "", "```", f"{name} {usage} [OPTIONS]".replace("  ", " "), "```", ""]
    if parameters:
        lines += ["| | default | |", "|---|---|---|"]
    for each in parameters:
        is_argument = each.param_type_name == "argument"
        names = f"`{each.metavar or each.name.upper()}`" if is_argument else _names(each)
        given = each.default
        hidden = given is None or given is False
        default = "required" if each.required else "" if hidden else f"`{given}`"
        lines.append(f"| {names} | {default} | {cell(each.help or '')} |")
    return [*lines, ""]


def _names(option: Any) -> str:
    value = "" if option.is_flag else f" {option.metavar or _values(option.type_descriptor)}"
    names = [*option.opts, *option.secondary_opts]
    return ", ".join(f"`{cell(name + value)}`" for name in names)


def _values(described: Any) -> str:
    """The choices, or what kind of value: INT, STR."""
    if described.is_choice:
        return "|".join(str(getattr(each, "value", each)) for each in described.choices)
    return str(described.annotation.__name__.upper())


def _in_brackets(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    return name if argument.required else f"[{name}]"
