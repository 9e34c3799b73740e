"""docker/compose.yaml: hardened, and every file that it names is there."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from docker.files import DOCKER, ROOT, compose, settings_in, yaml_documents

SERVICES = sorted(compose()["services"])


def _service(name: str = "boxlift") -> dict[str, Any]:
    service = compose()["services"][name]
    assert isinstance(service, dict)
    return service


def _mounts(name: str) -> dict[str, dict[str, Any]]:
    return {mount["target"]: mount for mount in _service(name)["volumes"]}


@pytest.mark.parametrize("name", SERVICES)
def test_nobody_gains_rights(name: str) -> None:
    service = _service(name)
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert "privileged" not in service


@pytest.mark.parametrize("name", SERVICES)
def test_only_this_machine_reaches_the_ports(name: str) -> None:
    assert all(port.startswith("127.0.0.1:") for port in _service(name)["ports"])


@pytest.mark.parametrize("name", ["grafana", "prometheus"])
def test_images_are_of_a_fixed_version(name: str) -> None:
    assert re.fullmatch(r"[a-z/]+:v?\d+\.\d+\.\d+", _service(name)["image"])


def test_service_writes_nowhere_but_to_tmp_and_label_sets() -> None:
    service = _service()
    assert service["read_only"] is True
    assert [mount.partition(":")[0] for mount in service["tmpfs"]] == ["/tmp"]
    writable = [mount["target"] for mount in service["volumes"] if not mount.get("read_only")]
    assert writable == ["/label-sets"]
    assert settings_in(service["environment"]).label_sets == Path("/label-sets")
    # The image makes the folder as the service's user: a volume takes that over.
    assert "install -d -o 10001 -g 10001 /label-sets" in (DOCKER / "Dockerfile").read_text()


def test_service_has_settings_that_exist_and_keys() -> None:
    settings = settings_in(_service()["environment"])
    assert settings.api_keys is not None
    assert not settings.allow_anonymous
    # A mount of the file alone would keep the old one when a new one takes its place.
    assert str(settings.api_keys.parent) in _mounts("boxlift")


def test_service_has_time_to_finish() -> None:
    settings = settings_in(_service()["environment"])
    grace_s = int(_service()["stop_grace_period"].removesuffix("s"))
    assert grace_s >= settings.drain_s + settings.frame_limit_s + 5


def test_service_has_room_for_the_bodies_that_it_holds() -> None:
    settings = settings_in(_service()["environment"])
    limit = int(_service()["deploy"]["resources"]["limits"]["memory"].removesuffix("G")) * 2**30
    assert limit >= 2 * settings.max_held_bytes


@pytest.mark.parametrize("name", SERVICES)
def test_mounted_files_are_there(name: str) -> None:
    for mount in _mounts(name).values():
        source = mount["source"]
        if mount["type"] == "volume":
            assert source in compose()["volumes"]
        elif not source.startswith("./keys/"):
            assert (DOCKER / source).is_dir()


def test_secrets_are_declared_and_stay_out_of_git() -> None:
    secrets = compose()["secrets"]
    used = {secret for name in SERVICES for secret in _service(name).get("secrets", [])}
    assert used == set(secrets)
    paths = [secret["file"] for secret in secrets.values()] + ["./keys/service/api-keys"]
    for path in paths:
        ignored = subprocess.run(
            ["git", "check-ignore", "--quiet", DOCKER / path], cwd=ROOT, check=False, timeout=30
        )
        assert ignored.returncode == 0, f"git does not ignore {path}"


def test_grafana_finds_its_data_and_its_dashboard() -> None:
    mounts = _mounts("grafana")
    (source,) = yaml_documents(DOCKER / "grafana/provisioning/datasources/prometheus.yaml")
    (datasource,) = source["datasources"]
    assert datasource["url"] == "http://prometheus:9090"
    (providers,) = yaml_documents(DOCKER / "grafana/provisioning/dashboards/boxlift.yaml")
    (provider,) = providers["providers"]
    folder = DOCKER / mounts[provider["options"]["path"]]["source"]
    home = _service("grafana")["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
    assert home == f"{provider['options']['path']}/boxlift.json"
    assert (folder / "boxlift.json").is_file()


def test_prometheus_finds_the_service_its_key_and_the_rules() -> None:
    (configuration,) = yaml_documents(DOCKER / "prometheus" / "prometheus.yml")
    (scrape,) = configuration["scrape_configs"]
    settings = settings_in(_service()["environment"])
    assert scrape["static_configs"] == [{"targets": [f"boxlift:{settings.port}"]}]
    (secret,) = _service("prometheus")["secrets"]
    assert scrape["authorization"]["credentials_file"] == f"/run/secrets/{secret}"
    assert all((DOCKER / "prometheus" / name).is_file() for name in configuration["rule_files"])
    assert _mounts("prometheus")["/etc/prometheus"]["source"] == "./prometheus"
