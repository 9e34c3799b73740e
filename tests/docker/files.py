"""What lies in docker/, read."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from boxlift_service.settings import ENVIRONMENT_PREFIX, ServiceSettings

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
KUBERNETES = DOCKER / "kubernetes"


def yaml_documents(path: Path) -> list[Any]:
    """The documents of a YAML file."""
    return [document for document in yaml.safe_load_all(path.read_text()) if document is not None]


def compose() -> dict[str, Any]:
    """The compose file."""
    (document,) = yaml_documents(DOCKER / "compose.yaml")
    assert isinstance(document, dict)
    return document


def manifest(kind: str) -> dict[str, Any]:
    """The only Kubernetes object of a kind."""
    found = [
        document
        for path in sorted(KUBERNETES.glob("*.yaml"))
        for document in yaml_documents(path)
        if document.get("kind") == kind
    ]
    (document,) = found
    assert isinstance(document, dict)
    return document


def dashboard() -> dict[str, Any]:
    """The dashboard of Grafana."""
    document = json.loads((DOCKER / "grafana" / "dashboards" / "boxlift.json").read_text())
    assert isinstance(document, dict)
    return document


def dockerfile() -> list[str]:
    """Instructions of the Dockerfile, each on one line, without comments."""
    text = (DOCKER / "Dockerfile").read_text()
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    return [line for line in "\n".join(lines).replace("\\\n", " ").splitlines() if line.strip()]


def last_stage() -> list[str]:
    """Instructions of the stage that becomes the image."""
    lines = dockerfile()
    begin = max(number for number, line in enumerate(lines) if line.startswith("FROM "))
    return lines[begin:]


def image_environment() -> dict[str, str]:
    """Variables of the image."""
    return {
        name: value
        for line in last_stage()
        if line.startswith("ENV ")
        for name, value in re.findall(r"([A-Z_]+)=(\S+)", line)
    }


def settings_in(environment: Mapping[str, object]) -> ServiceSettings:
    """Settings of a container that is given `environment`; every BOXLIFT_ variable must be one of ours."""
    variables = image_environment() | {name: str(value) for name, value in environment.items()}
    ours = {name for name in variables if name.startswith(ENVIRONMENT_PREFIX)}
    known = {f"{ENVIRONMENT_PREFIX}{field.upper()}" for field in ServiceSettings.model_fields}
    assert ours <= known, f"no settings of the service: {sorted(ours - known)}"
    return ServiceSettings.from_environment(variables)
