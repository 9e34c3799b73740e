from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from starlette.applications import Starlette

from boxlift.errors import OptionsError
from boxlift_service.guards.body_limit import BodyLimitMiddleware
from boxlift_service.guards.origins import add_origin_layers, allowed_origins
from boxlift_service.problems import ProblemDetails
from boxlift_service.settings import ServiceSettings
from service.served import Served, Upload, served

PAGE = "https://tool.example"


def application(settings: ServiceSettings, upload: Upload) -> Starlette:
    app = Starlette()
    app.mount("/", upload)
    add_origin_layers(app, settings)
    app.add_middleware(BodyLimitMiddleware, settings=settings)
    return app


@pytest.fixture
def upload() -> Upload:
    return Upload()


@pytest.fixture
def closed(upload: Upload) -> Iterator[Served]:
    """On loopback, without keys and without allowed origins: the default."""
    with served(application(ServiceSettings(), upload)) as server:
        yield server


@pytest.fixture
def opened(upload: Upload) -> Iterator[Served]:
    """Pages of one origin may call."""
    settings = ServiceSettings.from_environment(
        {"BOXLIFT_ALLOWED_ORIGINS": f"{PAGE}, http://lan.example:8080"}
    )
    with served(application(settings, upload)) as server:
        yield server


def refused(response: httpx.Response) -> bool:
    if response.status_code == 403:
        problem = ProblemDetails.model_validate_json(response.content)
        assert problem.type == "urn:boxlift:problem:forbidden-origin"
        return True
    assert response.status_code == 200
    return False


def test_pages_of_other_origins_may_not_call(closed: Served, upload: Upload) -> None:
    here = f"http://127.0.0.1:{closed.port}"
    for origin in (
        PAGE,
        "null",
        "",
        "http://127.0.0.1",
        f"http://localhost:{closed.port}",
        f"{here}.example",
        "x",
    ):
        response = httpx.post(closed.url, headers={"Origin": origin}, content=b"body")
        assert refused(response), origin
        assert "access-control-allow-origin" not in response.headers
    two = [("Origin", here), ("Origin", PAGE)]
    assert refused(httpx.post(closed.url, headers=two))
    assert upload.asked == []
    assert not refused(httpx.post(closed.url, headers={"Origin": here}, content=b"body"))
    assert not refused(httpx.post(closed.url, content=b"body"))


def test_a_page_is_refused_before_its_body_is_read(closed: Served, upload: Upload) -> None:
    with closed.connect() as connection:
        head = f"POST / HTTP/1.1\r\nHost: localhost\r\nOrigin: {PAGE}\r\nContent-Length: 1000000\r\n\r\n"
        connection.sendall(head.encode())
        assert connection.recv(65536).startswith(b"HTTP/1.1 403 ")
    assert upload.asked == []


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:1", "127.0.0.1", "127.0.0.1:8000", "127.1.2.3", "[::1]", "[::1]:8000"]
)
def test_a_name_of_this_machine_is_served_without_keys(closed: Served, host: str) -> None:
    assert not refused(httpx.get(closed.url, headers={"Host": host}))


@pytest.mark.parametrize(
    "host",
    [
        "rebound.example",
        "rebound.example:8000",
        "127.0.0.1.rebound.example",
        "localhost.rebound.example",
        "0.0.0.0:8000",
        "192.168.1.7",
        "[::]",
        "[::1",
        "localhost:80:80",
        "rebound.example@localhost",
        "localhost@rebound.example",
        "tool.example",
    ],
)
def test_a_name_pointed_at_this_machine_is_not(closed: Served, upload: Upload, host: str) -> None:
    # Its page's origin is that name too, so that the Origin alone would not tell.
    for headers in ({"Host": host}, {"Host": host, "Origin": f"http://{host}"}):
        assert refused(httpx.get(closed.url, headers=headers))
    assert upload.asked == []


def test_a_request_without_a_host_is_no_browser_s(closed: Served) -> None:
    with closed.connect() as connection:
        connection.sendall(b"GET / HTTP/1.0\r\n\r\n")
        assert connection.recv(65536).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize(
    "settings",
    [
        ServiceSettings(host="0.0.0.0", allow_anonymous=True),
        ServiceSettings.from_environment({"BOXLIFT_API_KEYS": "keys"}),
    ],
)
def test_any_host_name_is_served_where_it_says_nothing(settings: ServiceSettings) -> None:
    with served(application(settings, Upload())) as server:
        assert not refused(httpx.get(server.url, headers={"Host": "boxlift.example"}))
        own = {"Host": "boxlift.example", "Origin": "https://boxlift.example"}
        assert not refused(httpx.get(server.url, headers=own))
        assert refused(httpx.get(server.url, headers={"Host": "boxlift.example", "Origin": PAGE}))


def test_allowed_pages_may_call_and_read_what_they_need(opened: Served) -> None:
    response = httpx.post(opened.url, headers={"Origin": PAGE}, content=b"body")
    assert not refused(response)
    assert response.headers["access-control-allow-origin"] == PAGE
    assert "Origin" in response.headers["vary"]
    exposed = response.headers["access-control-expose-headers"].split(", ")
    assert exposed == ["X-Request-ID", "Server-Timing", "Retry-After"]
    assert "access-control-allow-credentials" not in response.headers
    assert not refused(httpx.get(opened.url, headers={"Host": "tool.example:8443"}))
    for other in (
        "https://other.example",
        "http://tool.example",
        "https://tool.example:8443",
        "http://lan.example",
    ):
        response = httpx.post(opened.url, headers={"Origin": other})
        assert refused(response), other
        assert "access-control-allow-origin" not in response.headers


def preflight(server: Served, origin: str) -> httpx.Response:
    headers = {
        "Origin": origin,
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization,x-request-timeout,content-type",
    }
    return httpx.options(f"{server.url}/label", headers=headers)


def test_a_preflight_is_answered_for_allowed_pages_only(opened: Served, upload: Upload) -> None:
    response = preflight(opened, PAGE)
    assert response.status_code == 200
    assert response.headers["access-control-allow-origin"] == PAGE
    assert refused(preflight(opened, "https://other.example"))
    assert upload.asked == []


def test_origins_are_compared_as_browsers_write_them() -> None:
    written = ("https://Tool.Example/", "https://tool.example:443", "http://[::1]:80", "http://lan:8080")
    assert allowed_origins(ServiceSettings(allowed_origins=written)) == (
        "https://tool.example",
        "https://tool.example",
        "http://[::1]",
        "http://lan:8080",
    )


@pytest.mark.parametrize(
    "origin", ["*", "null", "tool.example", "https://tool.example/page", "https://*.example"]
)
def test_what_is_no_origin_stops_the_start(origin: str) -> None:
    with pytest.raises(OptionsError) as caught:
        add_origin_layers(Starlette(), ServiceSettings(allowed_origins=(origin,)))
    assert caught.value.field == "BOXLIFT_ALLOWED_ORIGINS"
    assert repr(origin) in caught.value.problem
