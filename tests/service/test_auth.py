from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from boxlift.errors import OptionsError
from boxlift_service.guards.api_keys import ApiKeys, add_key, new_key
from boxlift_service.guards.auth import AuthMiddleware, check_exposure
from boxlift_service.guards.body_limit import BodyLimitMiddleware
from boxlift_service.problems import ProblemDetails
from boxlift_service.settings import ServiceSettings
from service.served import Served, Upload, read_to_end, served

LARGE = 200 * 2**20


@dataclass
class Guarded:
    """A small service that asks for keys; `upload` is what lies behind them."""

    server: Served
    upload: Upload
    secret: str
    slow_secret: str
    refused: list[str]

    def get(self, path: str = "/x", *authorization: str) -> httpx.Response:
        """GET with any number of Authorization headers."""
        headers = [(b"authorization", value.encode("latin-1")) for value in authorization]
        return httpx.get(f"{self.server.url}{path}", headers=headers)


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Guarded]:
    path = tmp_path / "keys"
    secret, key = new_key("studio")
    slow_secret, slow_key = new_key("slow", 2)
    add_key(path, key)
    add_key(path, slow_key)
    settings = ServiceSettings(api_keys=path, open_metrics=True, max_body_bytes=2 * LARGE)
    upload, refused = Upload(), list[str]()
    auth = AuthMiddleware(upload, ApiKeys(path), settings, refused.append)
    with served(BodyLimitMiddleware(auth, settings)) as server:
        yield Guarded(server, upload, secret, slow_secret, refused)


def test_a_known_key_is_admitted_and_named(guarded: Guarded) -> None:
    for scheme in ("Bearer", "bearer", "BEARER"):
        assert guarded.get("/x", f"{scheme} {guarded.secret}").text == "done"
    assert guarded.upload.asked == [("/x", "studio")] * 3
    assert guarded.refused == []


def test_every_other_request_gets_the_same_answer(guarded: Guarded) -> None:
    with_key = [
        "Bearer x",
        "Bearer",
        f"Bearer {guarded.secret[:-1]}",
        f"Bearer {guarded.secret}x",
        f"Bearer {guarded.secret} {guarded.secret}",
        f"Bearer {guarded.secret.upper()}",
        "Bearer \xff\xfe",
        "Bearer studio",
    ]
    without = [(), (guarded.secret,), (f"Basic {guarded.secret}",), (f"Bearer{guarded.secret}",), ("",)]
    twice = (f"Bearer {guarded.secret}", f"Bearer {guarded.secret}")
    answers = {}
    for authorization in [*((value,) for value in with_key), *without, twice]:
        response = guarded.get("/x", *authorization)
        assert response.status_code == 401
        assert ProblemDetails.model_validate_json(response.content).type == "urn:boxlift:problem:unauthorized"
        answers[authorization] = response
    assert len({response.content for response in answers.values()}) == 1
    for value in with_key:
        assert answers[value,].headers["www-authenticate"] == 'Bearer realm="boxlift", error="invalid_token"'
    for authorization in (*without, twice):
        assert answers[authorization].headers["www-authenticate"] == 'Bearer realm="boxlift"'
    assert guarded.upload.asked == []
    assert guarded.refused == ["key"] * len(answers)


def test_probes_need_no_key(guarded: Guarded) -> None:
    paths = [f"{version}{path}" for version in ("", "/v1") for path in ("/healthz", "/readyz", "/metrics")]
    for path in paths:
        assert guarded.get(path).text == "done"
    assert guarded.upload.asked == [(path, None) for path in paths]
    for path in (
        "/healthz/",
        "//healthz",
        "/v2/healthz",
        "/HEALTHZ",
        "/models",
        "/x?/healthz",
        "/healthz%2f",
    ):
        assert guarded.get(path).status_code == 401


def test_metrics_need_a_key_unless_they_are_open(guarded: Guarded, tmp_path: Path) -> None:
    settings = ServiceSettings(api_keys=tmp_path / "keys")
    with served(AuthMiddleware(Upload(), ApiKeys(tmp_path / "keys"), settings)) as server:
        assert httpx.get(f"{server.url}/metrics").status_code == 401
        headers = {"Authorization": f"Bearer {guarded.secret}"}
        assert httpx.get(f"{server.url}/metrics", headers=headers).status_code == 200


def test_the_answer_is_there_before_the_body_is_read(guarded: Guarded) -> None:
    with guarded.server.connect() as connection:
        head = f"POST /label HTTP/1.1\r\nHost: x\r\nContent-Length: {LARGE}\r\n\r\n"
        connection.sendall(head.encode())
        assert connection.recv(65536).startswith(b"HTTP/1.1 401 ")
    assert guarded.upload.asked == []


def test_a_client_that_sends_everything_first_gets_its_answer(guarded: Guarded) -> None:
    with guarded.server.connect() as connection:
        head = f"POST /label HTTP/1.1\r\nHost: x\r\nContent-Length: {LARGE}\r\n\r\n"
        connection.sendall(head.encode())
        for _ in range(LARGE // 2**20):
            connection.sendall(bytes(2**20))
        assert read_to_end(connection).startswith(b"HTTP/1.1 401 ")
    assert guarded.upload.body_bytes == 0


def test_a_key_has_its_rate(guarded: Guarded) -> None:
    for _ in range(2):
        assert guarded.get("/x", f"Bearer {guarded.slow_secret}").status_code == 200
    response = guarded.get("/x", f"Bearer {guarded.slow_secret}")
    assert response.status_code == 429
    assert ProblemDetails.model_validate_json(response.content).type == "urn:boxlift:problem:rate-limited"
    assert 1 <= int(response.headers["retry-after"]) <= 30
    assert guarded.slow_secret not in response.text
    assert guarded.get("/x", f"Bearer {guarded.secret}").status_code == 200
    assert guarded.refused == ["rate"]


def test_the_settings_say_the_rate_where_the_line_does_not(guarded: Guarded, tmp_path: Path) -> None:
    settings = ServiceSettings(api_keys=tmp_path / "keys", requests_per_minute=1)
    statuses = []
    with served(AuthMiddleware(Upload(), ApiKeys(tmp_path / "keys"), settings)) as server:
        for secret in (guarded.secret, guarded.secret, guarded.slow_secret, guarded.slow_secret):
            headers = {"Authorization": f"Bearer {secret}"}
            statuses.append(httpx.get(f"{server.url}/x", headers=headers).status_code)
    assert statuses == [200, 429, 200, 200]


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.1", "localhost", "LOCALHOST", "::1"])
def test_loopback_needs_no_keys(host: str) -> None:
    check_exposure(ServiceSettings(host=host))


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "", "192.168.1.7", "10.0.0.1", "localhost.example", "128.0.0.1"]
)
def test_other_addresses_need_keys_or_a_word(host: str) -> None:
    with pytest.raises(OptionsError) as caught:
        check_exposure(ServiceSettings(host=host))
    assert caught.value.field == "BOXLIFT_API_KEYS"
    assert repr(host) in caught.value.problem
    assert "BOXLIFT_ALLOW_ANONYMOUS" in caught.value.remedy
    check_exposure(ServiceSettings(host=host, allow_anonymous=True))
    check_exposure(ServiceSettings(host=host, api_keys=Path("keys")))
