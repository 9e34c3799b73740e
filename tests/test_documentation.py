"""What the documentation shows is what the code does."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from boxlift_client.cli import app

_ROOT = Path(__file__).resolve().parents[1]
_PAGES = sorted([*(_ROOT / "docs").glob("*.md"), _ROOT / "README.md", _ROOT / "CONTRIBUTING.md"])


def test_the_picture_of_conventions_is_drawn_by_the_code() -> None:
    drawn = subprocess.run(
        [sys.executable, _ROOT / "scripts" / "conventions_picture.py"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert drawn.stdout == (_ROOT / "docs" / "pictures" / "conventions.svg").read_text()


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.name)
def test_commands_exist_with_their_options(page: Path) -> None:
    """`boxlift COMMAND --option` in fenced blocks, continued lines joined."""
    import typer.main

    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    blocks = re.findall(r"```[a-z]*\n(.*?)```", page.read_text(), re.DOTALL)
    for line in "\n".join(blocks).replace("\\\n", " ").splitlines():
        words = line.split("#")[0].split()
        for at, word in enumerate(words[:-1]):
            if word != "boxlift" or words[at + 1] not in commands:
                continue
            command = commands[words[at + 1]]
            known = {name for parameter in command.params for name in parameter.opts}
            for sub_command in getattr(command, "commands", {}).values():
                known |= {name for parameter in sub_command.params for name in parameter.opts}
            asked = {
                each.strip("[]`").split("=")[0]
                for each in words[at + 2 :]
                if each.strip("[").startswith("--")
            }
            assert asked <= known, f"{page.name}: {line}"
