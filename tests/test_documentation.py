"""What the documentation shows is what the code does."""

from __future__ import annotations

import copy
import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image

from boxlift_client.cli import app

_ROOT = Path(__file__).resolve().parents[1]
_PAGES = sorted([*(_ROOT / "docs").glob("*.md"), _ROOT / "README.md", _ROOT / "CONTRIBUTING.md"])


def test_what_the_code_makes_is_up_to_date(tmp_path: Path) -> None:
    """`make docs` has nothing to change: the same text, and pictures that the eye cannot tell apart."""
    command: list[str | Path] = [
        sys.executable,
        _ROOT / "scripts" / "make_documentation.py",
        "--out",
        tmp_path,
    ]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": str(_ROOT / "benchmarks")})
    made = [path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()]
    assert len(made) > 15
    for name in made:
        kept = _ROOT / "docs" / name
        if name.suffix in (".jpg", ".png"):
            # Fonts and codecs may differ by a shade between machines.
            pixels = [np.asarray(Image.open(path).convert("RGB"), float) for path in (kept, tmp_path / name)]
            assert pixels[0].shape == pixels[1].shape, name
            assert np.abs(pixels[0] - pixels[1]).mean() < 2, f"{name}: make docs"
        else:
            assert kept.read_text() == (tmp_path / name).read_text(), f"{name}: make docs"


def _notebook() -> nbformat.NotebookNode:
    text = (_ROOT / "docs" / "notebook.ipynb").read_text()
    notebook = nbformat.reads(text, as_version=4)  # type: ignore[no-untyped-call]
    assert isinstance(notebook, nbformat.NotebookNode)
    return notebook


def test_the_notebook_runs(tmp_path: Path) -> None:
    kept = _notebook()
    client = NotebookClient(copy.deepcopy(kept), timeout=300, resources={"metadata": {"path": tmp_path}})
    ran = client.execute()
    for before, after in zip(kept.cells, ran.cells, strict=True):
        kinds = [[output.output_type for output in cell.get("outputs", ())] for cell in (before, after)]
        assert kinds[0] == kinds[1], "the outputs in the file are of another version: make docs"
    shown = [output for cell in ran.cells for output in cell.get("outputs", ())]
    assert any("image/jpeg" in output.get("data", {}) for output in shown)


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
