from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from boxlift.errors import OptionsError
from boxlift_service.app import create_app
from boxlift_service.guards.api_keys import ApiKey, add_key, new_key, revoke_key
from boxlift_service.problems import ProblemDetails
from boxlift_service.settings import ServiceSettings
from service.frames import SmallFrame
from service.running import RunningService, running_service

PAGE = "https://tool.example"


@dataclass(frozen=True)
class Keyed:
    """A service that asks for keys, and the file that they lie in."""

    service: RunningService
    file: Path
    secret: str

    def post_label(self, frame: SmallFrame, **headers: str) -> httpx.Response:
        return self.service.client.post("/label", files=list(frame.fields().items()), headers=headers)

    def status(self, secret: str, path: str = "/models") -> int:
        headers = {"Authorization": f"Bearer {secret}"}
        return self.service.client.get(path, headers=headers).status_code

    def add(self, name: str, requests_per_minute: int | None = None) -> str:
        """A key that the running service has taken up."""
        secret, key = new_key(name, requests_per_minute)
        add_key(self.file, key)
        self.wait_for(secret, 200)
        return secret

    def wait_for(self, secret: str, status: int) -> None:
        end = time.monotonic() + 20
        while self.status(secret) != status:
            assert time.monotonic() < end
            time.sleep(0.1)


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Keyed]:
    file = tmp_path_factory.mktemp("keys") / "keys"
    secret, key = new_key("studio")
    add_key(file, key)
    # Listens everywhere: with keys it may.
    with running_service(host="0.0.0.0", api_keys=str(file), allowed_origins=PAGE) as service:
        url = service.url.replace("0.0.0.0", "127.0.0.1")
        with httpx.Client(base_url=url, timeout=60) as client:
            yield Keyed(RunningService(url, service.process, client), file, secret)


def test_every_route_but_the_probes_asks_for_a_key(keyed: Keyed) -> None:
    document = keyed.service.client.get("/openapi.json", headers={"Authorization": f"Bearer {keyed.secret}"})
    routes = [(method, path) for path, methods in document.json()["paths"].items() for method in methods]
    assert document.json()["security"] == [{"key": []}]
    assert ("post", "/label") in routes
    assert ("get", "/metrics") in routes
    for method, path in [*routes, ("get", "/openapi.json"), ("get", "/nothing"), ("options", "/label")]:
        for version in ("", "/v1"):
            response = keyed.service.client.request(method, version + path)
            if path in ("/healthz", "/readyz"):
                assert response.status_code == 200
                continue
            assert response.status_code == 401, path
            assert response.headers["www-authenticate"] == 'Bearer realm="boxlift"'
            assert ProblemDetails.model_validate_json(response.content).instance == version + path
            assert response.headers["x-request-id"]


def test_a_key_labels(keyed: Keyed, frame: SmallFrame) -> None:
    response = keyed.post_label(frame, Authorization=f"Bearer {keyed.secret}")
    assert response.status_code == 200
    assert response.json()["objects"]
    assert keyed.post_label(frame, Authorization=f"Bearer {keyed.secret[:-1]}").status_code == 401


def test_keys_rotate_under_requests(keyed: Keyed) -> None:
    old, new = keyed.add("old"), keyed.add("new")
    assert keyed.status(old) == keyed.status(new) == 200
    revoke_key(keyed.file, "old")
    keyed.wait_for(old, 401)
    assert keyed.status(new) == 200
    before = keyed.file.read_text()
    keyed.file.write_text("half a li")
    time.sleep(1.5)  # it looks once a second
    assert [keyed.status(secret) for secret in (new, keyed.secret)] == [200, 200]
    keyed.file.unlink()
    time.sleep(1.5)
    assert keyed.status(new) == 200
    keyed.file.write_text(before)
    assert keyed.status(old) == 401


def test_a_key_has_its_rate(keyed: Keyed) -> None:
    slow = keyed.add("slow", 3)
    statuses = [keyed.status(slow) for _ in range(4)]
    assert statuses[-1] == 429
    assert keyed.status(keyed.secret) == 200
    headers = {"Authorization": f"Bearer {keyed.secret}"}
    exposition = keyed.service.client.get("/metrics", headers=headers).text
    assert 'boxlift_refused_total{pool="http",reason="rate"}' in exposition
    assert 'boxlift_refused_total{pool="http",reason="key"}' in exposition


def test_pages_of_allowed_origins_may_call(keyed: Keyed, frame: SmallFrame) -> None:
    key = {"Authorization": f"Bearer {keyed.secret}"}
    response = keyed.post_label(frame, Origin=PAGE, **key)
    assert response.status_code == 200
    assert response.headers["access-control-allow-origin"] == PAGE
    # The page may read why it was refused, too.
    response = keyed.post_label(frame, Origin=PAGE)
    assert (response.status_code, response.headers["access-control-allow-origin"]) == (401, PAGE)
    response = keyed.post_label(frame, Origin="https://other.example", **key)
    assert response.status_code == 403
    preflight = {"Origin": PAGE, "Access-Control-Request-Method": "POST"}
    assert keyed.service.client.options("/label", headers=preflight).status_code == 200


def test_a_page_cannot_drive_a_service_without_keys(service: RunningService, frame: SmallFrame) -> None:
    for headers in ({"Origin": PAGE}, {"Origin": "null"}, {"Host": "rebound.example"}):
        response = service.client.post("/label", files=list(frame.fields().items()), headers=headers)
        assert response.status_code == 403
        assert ProblemDetails.model_validate_json(response.content).type.endswith(":forbidden-origin")


def test_it_does_not_start_where_others_could_use_it_without_keys() -> None:
    environment = {**os.environ, "BOXLIFT_PORT": "0", "BOXLIFT_HOST": "0.0.0.0"}
    command = [sys.executable, "-m", "boxlift_service"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == 1
    assert ran.stderr.splitlines()[-1].startswith("error: BOXLIFT_API_KEYS: is not set")
    create_app(ServiceSettings(host="0.0.0.0", allow_anonymous=True))


def test_a_broken_file_of_keys_or_origin_stops_the_start(tmp_path: Path) -> None:
    broken = tmp_path / "keys"
    broken.write_text(f"{ApiKey('studio', bytes(32)).line}\nbroken\n")
    with pytest.raises(OptionsError, match="keys:2: "):
        create_app(ServiceSettings(api_keys=broken))
    with pytest.raises(OptionsError, match="BOXLIFT_ALLOWED_ORIGINS"):
        create_app(ServiceSettings(allowed_origins=("*",)))
