"""The built wheel works outside the checkout, and what it is tested with can be installed."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

_ROOT = Path(__file__).resolve().parents[1]
_PACKAGES = ("boxlift", "boxlift_service", "boxlift_client")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=_ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


def test_holds_the_packages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    roots = {name.split("/")[0] for name in names}
    assert {root for root in roots if not root.endswith(".dist-info")} == set(_PACKAGES)
    assert {f"{package}/py.typed" for package in _PACKAGES} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert {"boxlift_service/review/static/page.js", "boxlift_client/report/report.html.j2"} <= set(names)
    weights = "boxlift/detector/weights"
    for file in ("nanodet_g.onnx", "README.md", "LICENSE-nanodet.txt", "LICENSE-human-models.txt"):
        assert f"{weights}/{file}" in names
    weights = "boxlift/monocular/weights"
    for file in ("monocular.onnx", "monocular_small.onnx", "MODEL_CARD.md", "LICENSE-monocular.txt"):
        assert f"{weights}/{file}" in names


def test_runs_the_demo_from_elsewhere(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"]
    subprocess.run([*install, str(site), str(wheel)], check=True, capture_output=True)
    # Earlier on the path than the editable install of this environment.
    environment = os.environ | {"PYTHONPATH": str(site)}

    def run(*command: str) -> str:
        answer = subprocess.run(
            [sys.executable, *command],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert answer.returncode == 0, answer.stderr
        return answer.stdout

    where = run(
        "-c", f"import {', '.join(_PACKAGES)}; print(*(m.__file__ for m in ({', '.join(_PACKAGES)})))"
    )
    assert all(Path(path).is_relative_to(site) for path in where.split())
    printed = run(str(site / "bin" / "boxlift"), "demo", "--frames", "1", "--out", "demo")
    assert "Labelled over HTTP" in printed
    assert len(list((tmp_path / "demo" / "pictures").glob("*.png"))) == 1


def test_every_pin_installs_on_debians_own_python() -> None:
    """Debian 12 has Python 3.11.2: a pin that asks for a later 3.11 fails there alone."""
    pinned = re.findall(r"^([\w.-]+)==", (_ROOT / "constraints.txt").read_text(), re.MULTILINE)
    asked = {}
    for name in pinned:
        with contextlib.suppress(metadata.PackageNotFoundError):  # of another platform
            asked[name] = metadata.metadata(name)["Requires-Python"] or ""
    assert len(asked) > 200
    assert [name for name, versions in asked.items() if "3.11.2" not in SpecifierSet(versions)] == []
