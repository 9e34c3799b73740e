"""A real Prometheus with the configuration of docker/prometheus, on loopback."""

from __future__ import annotations

import math
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import yaml

from serving.service_process import free_port

DOCKER = Path(__file__).resolve().parents[2] / "docker"
STEP_S = 2


@dataclass(frozen=True)
class Series:
    """One line of a panel: seconds since the beginning, and values."""

    name: str
    times_s: list[float]
    values: list[float]


@dataclass(frozen=True)
class Prometheus:
    """A Prometheus that runs."""

    url: str

    def ask(self, expression: str, begin: float, end: float, legend: str = "") -> list[Series]:
        """What an expression was in a time; variables of Grafana stand for everything."""
        for variable in ("job", "instance", "route"):
            expression = expression.replace(f"${variable}", ".+")
        expression = expression.replace("$__rate_interval", f"{8 * STEP_S}s")
        query: dict[str, str | float] = {"query": expression, "start": begin, "end": end, "step": STEP_S}
        answer = httpx.get(f"{self.url}/api/v1/query_range", params=query).json()
        if answer["status"] != "success":
            raise RuntimeError(f"{answer['error']}: {expression}")
        found = []
        for result in answer["data"]["result"]:
            points = [(float(at), float(value)) for at, value in result["values"]]
            points = [(at, value) for at, value in points if math.isfinite(value)]
            name = legend
            for label, value in result["metric"].items():
                name = name.replace(f"{{{{{label}}}}}", value)
            if points:
                found.append(
                    Series(name or "value", [at - begin for at, _ in points], [value for _, value in points])
                )
        return found

    def rules(self) -> list[dict[str, Any]]:
        """The alerts, with their health and state."""
        groups = httpx.get(f"{self.url}/api/v1/rules").json()["data"]["groups"]
        return [rule for group in groups for rule in group["rules"]]


@contextmanager
def running_prometheus(service_url: str, key: str) -> Iterator[Prometheus]:
    """Prometheus on loopback with docker/prometheus, the target and the key's place exchanged."""
    configuration = yaml.safe_load((DOCKER / "prometheus" / "prometheus.yml").read_text())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "key").write_text(key)
        configuration["global"] = {"scrape_interval": f"{STEP_S}s", "evaluation_interval": f"{STEP_S}s"}
        configuration["rule_files"] = [
            str(DOCKER / "prometheus" / file) for file in configuration["rule_files"]
        ]
        (scrape,) = configuration["scrape_configs"]
        scrape["authorization"]["credentials_file"] = str(folder / "key")
        scrape["static_configs"] = [{"targets": [urlsplit(service_url).netloc]}]
        (folder / "prometheus.yml").write_text(yaml.safe_dump(configuration))
        address = f"127.0.0.1:{free_port()}"
        command = [
            "prometheus",
            f"--config.file={folder / 'prometheus.yml'}",
            f"--storage.tsdb.path={folder / 'data'}",
            f"--web.listen-address={address}",
            "--log.level=warn",
        ]
        with subprocess.Popen(command) as process:
            try:
                _wait_until_ready(f"http://{address}/-/ready")
                yield Prometheus(f"http://{address}")
            finally:
                process.terminate()


def _wait_until_ready(url: str) -> None:
    for _ in range(200):
        with suppress(httpx.TransportError):
            if httpx.get(url).status_code == 200:
                return
        time.sleep(0.1)
    raise RuntimeError("Prometheus does not start.")
