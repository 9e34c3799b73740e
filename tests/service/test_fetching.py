"""What is fetched, what is refused, and that nobody learns of a network by asking."""

from __future__ import annotations

import asyncio
import gzip
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from ipaddress import ip_address
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift.errors import OptionsError
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.recognition.fetching import Fetcher
from boxlift_service.recognition.guarded_network import Address, is_allowed
from boxlift_service.settings import ServiceSettings
from service.file_server import FileServer, answer, file_server


@pytest.fixture(scope="module")
def server() -> Iterator[FileServer]:
    with file_server() as running:
        running.files["/xtreme1/a.pcd"] = b"points"
        running.files["/secret"] = b"secret"
        yield running


def fetcher(*prefixes: str, private: bool = True, limit_s: float = 10.0, **more: Any) -> Fetcher:
    settings = ServiceSettings(fetch_from=prefixes, fetch_private=private, fetch_limit_s=limit_s)
    return Fetcher(settings, **more)


def fetched(how: Fetcher, url: str, max_bytes: int = 1000) -> bytes:
    return asyncio.run(how.fetch(url, "pointCloudUrl", max_bytes))


def problem(how: Fetcher, url: str, max_bytes: int = 1000) -> ProblemError:
    with pytest.raises(ProblemError) as caught:
        fetched(how, url, max_bytes)
    assert caught.value.field == "pointCloudUrl"
    assert caught.value.remedy
    return caught.value


def free_port() -> int:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        return int(unused.getsockname()[1])


@pytest.mark.parametrize("prefix", ["", "/", "/xtreme1", "/xtreme1/", "/xtreme1/a.pcd", "/%78treme1/"])
def test_a_file_below_a_prefix(server: FileServer, prefix: str) -> None:
    how = fetcher("https://elsewhere.example/", server.url + prefix)
    assert fetched(how, f"{server.url}/xtreme1/a.pcd?X-Amz-Signature=a%2Fb&x=1") == b"points"
    path, headers = server.asked[-1]
    assert path == "/xtreme1/a.pcd?X-Amz-Signature=a%2Fb&x=1"  # a signature holds for these bytes
    assert headers["Host"] == f"127.0.0.1:{server.port}"
    assert headers["Accept-Encoding"] == "identity"
    assert not {"Cookie", "Authorization", "Proxy-Authorization"} & set(headers)


@pytest.mark.parametrize(
    "url",
    [
        "http://127.0.0.1:{port}/secret",
        "http://127.0.0.1:{port}/xtreme12/a.pcd",
        "http://127.0.0.1:{port}/XTREME1/a.pcd",
        "http://127.0.0.1:{port}/xtreme1/../secret",
        "http://127.0.0.1:{port}/xtreme1/%2e%2e/secret",
        "http://127.0.0.1:{port}/xtreme1/%252e%252e/secret",
        "http://127.0.0.1:{port}/xtreme1/.%2e/secret",
        "http://127.0.0.1:{port}/xtreme1/..;/secret",
        "http://127.0.0.1:{port}/xtreme1/..%2fsecret",
        "http://127.0.0.1:{port}/xtreme1/..%5csecret",
        "http://127.0.0.1:{port}/xtreme1\\..\\secret",
        "http://127.0.0.1:{port}/xtreme1/%0d%0aHost:%20x",
        "http://127.0.0.1:{port}/xtreme1/a.pcd\r\nHost: x",
        "http://127.0.0.1:{port}/xtreme1/a b",
        "http://127.0.0.1:{port}/xtreme1/%00",
        "http://127.0.0.1:{port}/xtreme1/a#b",
        "http://127.0.0.1:{port}//xtreme1/a.pcd",
        "http://127.0.0.1:{port}?/xtreme1/",
        "http://127.0.0.1:{port}@elsewhere.example/xtreme1/a.pcd",
        "http://user:password@127.0.0.1:{port}/xtreme1/a.pcd",
        "http://127.0.0.1:{port}.elsewhere.example/xtreme1/a.pcd",
        "http://127.0.0.1.elsewhere.example:{port}/xtreme1/a.pcd",
        "http://127.0.0.1:{port}0/xtreme1/a.pcd",
        "http://127.0.0.1/xtreme1/a.pcd",
        "https://127.0.0.1:{port}/xtreme1/a.pcd",
        "http://127.1:{port}/xtreme1/a.pcd",
        "http://2130706433:{port}/xtreme1/a.pcd",
        "http://0x7f000001:{port}/xtreme1/a.pcd",
        "http://[::ffff:127.0.0.1]:{port}/xtreme1/a.pcd",
        "http://localhost:{port}/xtreme1/a.pcd",
        "http://127。0。0。1:{port}/xtreme1/a.pcd",
        "http:/127.0.0.1:{port}/xtreme1/a.pcd",
        "//127.0.0.1:{port}/xtreme1/a.pcd",
        "ftp://127.0.0.1:{port}/xtreme1/a.pcd",
        "file:///etc/passwd",
        "http://127.0.0.1:{port}/xtreme1/" + "a" * 5000,
        "http://127.0.0.1:99999/xtreme1/a.pcd",
        "",
    ],
)  # fmt: skip
def test_whatever_is_outside_is_refused_unasked(server: FileServer, url: str) -> None:
    before = len(server.asked)
    refused = problem(fetcher(f"{server.url}/xtreme1/"), url.format(port=server.port))
    assert refused.kind is Kind.FETCH_REFUSED
    assert "BOXLIFT_FETCH_FROM" in refused.remedy
    assert len(refused.problem) < 500
    assert len(server.asked) == before


@given(st.text(), st.sampled_from(["", "http://files.example/", "http://files.example/a/", "http://"]))
def test_any_text_is_refused_or_below_the_prefix(text: str, before: str) -> None:
    """Nothing but a host of the list is ever looked up."""
    asked: list[str] = []

    async def resolve(host: str, _: int) -> list[Address]:
        asked.append(host)
        raise OSError("no such host")

    problem(fetcher("http://files.example/a/", resolve=resolve), before + text)
    assert set(asked) <= {"files.example"}


def test_without_prefixes_nothing_is_fetched(server: FileServer) -> None:
    assert problem(fetcher(), f"{server.url}/xtreme1/a.pcd").kind is Kind.FETCH_REFUSED


@pytest.mark.parametrize(
    ("prefix", "says"),
    [
        ("minio:9000", "not http"),
        ("ftp://minio/", "not http"),
        ("http://", "not http"),
        ("http://user@minio/", "not http"),
        ("http://minio/?a=b", "query"),
        ("http://minio/a/../b/", "'..'"),
        ("http://minio:0/", "no port 0"),
        ("http://[::1/", "not http"),
        ("http://[12345::]/", "12345"),
    ],
)
def test_prefixes_that_are_none(prefix: str, says: str) -> None:
    with pytest.raises(OptionsError, match="BOXLIFT_FETCH_FROM") as caught:
        fetcher(prefix)
    assert says in caught.value.problem
    assert prefix in caught.value.problem


def test_inside_and_unreachable_are_told_alike(server: FileServer) -> None:
    """The same words for addresses that are not connected to, ports that are shut and names without any."""
    urls = (
        f"http://127.0.0.1:{server.port}/xtreme1/a.pcd",
        f"http://localhost:{server.port}/xtreme1/a.pcd",
        f"http://[::1]:{server.port}/xtreme1/a.pcd",
        f"http://[::ffff:127.0.0.1]:{server.port}/xtreme1/a.pcd",
        "http://169.254.169.254/latest/meta-data/",
        "http://0.0.0.0/a",
        "http://surely.invalid/a",
        f"http://{'a' * 64}.example/a",
    )
    before = len(server.asked)
    guarded = fetcher(*urls, private=False)
    told = {url: problem(guarded, url) for url in urls}
    shut = f"http://127.0.0.1:{free_port()}/a"
    told[shut] = problem(fetcher(shut), shut)
    assert {(found.kind, found.problem.replace(url, "URL"), found.remedy) for url, found in told.items()} == {
        (
            Kind.FETCH_FAILED,
            "'URL' could not be reached.",
            "Check the URL, and that the service may reach it.",
        )
    }
    assert len(server.asked) == before


def test_a_name_is_resolved_once_and_its_address_is_used(server: FileServer) -> None:
    """What a name resolves to the second time does not matter: it is not asked again."""
    answers = [["127.0.0.1"], ["192.0.2.1"]]
    asked: list[str] = []

    async def resolve(host: str, _: int) -> list[Address]:
        asked.append(host)
        return [ip_address(address) for address in answers.pop(0)]

    how = fetcher(f"http://files.example:{server.port}/xtreme1/", resolve=resolve)
    assert fetched(how, f"http://Files.EXAMPLE:{server.port}/xtreme1/a.pcd") == b"points"
    assert asked == ["files.example"]
    assert server.asked[-1][1]["Host"] == f"files.example:{server.port}"


def test_one_bad_address_among_good_ones_is_enough(server: FileServer) -> None:
    async def resolve(_: str, __: int) -> list[Address]:
        return [ip_address("127.0.0.1"), ip_address("169.254.169.254")]

    url = f"http://files.example:{server.port}/xtreme1/a.pcd"
    before = len(server.asked)
    assert problem(fetcher(url, resolve=resolve), url).kind is Kind.FETCH_FAILED
    assert len(server.asked) == before


def test_the_second_address_is_tried(server: FileServer) -> None:
    async def resolve(_: str, __: int) -> list[Address]:
        return [ip_address("127.0.0.2"), ip_address("::ffff:127.0.0.1")]

    url = f"http://files.example:{server.port}/xtreme1/a.pcd"  # nobody listens at 127.0.0.2
    assert fetched(fetcher(url, resolve=resolve), url) == b"points"


def test_tls_asks_for_the_name() -> None:
    """The greeting of a TLS client names the host, though its address was connected to."""
    greetings: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def greet() -> None:
            connection, _ = listener.accept()
            with connection:
                greetings.append(connection.recv(4096))

        listening = threading.Thread(target=greet)
        listening.start()

        async def resolve(_: str, __: int) -> list[Address]:
            return [ip_address("127.0.0.1")]

        url = f"https://files.example:{listener.getsockname()[1]}/a"
        assert "could not be reached" in problem(fetcher(url, resolve=resolve), url).problem
        listening.join()
    assert greetings[0][0] == 22  # a TLS handshake
    assert b"files.example" in greetings[0]


@pytest.mark.parametrize(
    "location", ["/xtreme1/a.pcd", "/secret", "http://169.254.169.254/", "file:///etc/passwd"]
)
def test_redirects_are_refused(server: FileServer, location: str) -> None:
    server.files["/xtreme1/moved"] = answer(b"", 302, Location=location)
    before = len(server.asked)
    refused = problem(fetcher(f"{server.url}/xtreme1/"), f"{server.url}/xtreme1/moved?signature=1")
    assert refused.problem == f"'{server.url}/xtreme1/moved' is a redirect (302)."
    assert server.paths[before:] == ["/xtreme1/moved?signature=1"]


def test_other_answers_than_success(server: FileServer) -> None:
    refused = problem(fetcher(server.url), f"{server.url}/absent")
    assert (refused.kind, "status 404" in refused.problem) == (Kind.FETCH_FAILED, True)


def test_a_file_at_the_limit_and_one_beyond(server: FileServer) -> None:
    server.files["/large"] = b"x" * 1000
    assert len(fetched(fetcher(server.url), f"{server.url}/large", 1000)) == 1000
    assert "more than 999 bytes" in problem(fetcher(server.url), f"{server.url}/large", 999).problem


def test_an_endless_file_is_cut_off(server: FileServer) -> None:
    def endless(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.end_headers()
        try:
            while True:
                handler.wfile.write(b"x" * 65_536)
        except OSError:
            gone.set()

    gone = threading.Event()
    server.files["/endless"] = endless
    refused = problem(fetcher(server.url), f"{server.url}/endless", 2**20)
    assert "more than 1048576 bytes" in refused.problem
    assert gone.wait(10)


def test_a_gzip_bomb_is_not_unpacked(server: FileServer) -> None:
    server.files["/bomb"] = answer(gzip.compress(bytes(10**7)), Content_Encoding="gzip")
    refused = problem(fetcher(server.url), f"{server.url}/bomb", 10**5)
    assert "Content-Encoding 'gzip'" in refused.problem


@pytest.mark.parametrize(
    ("sent", "limit_s", "says"),
    [
        (b"", 0.2, "could not be reached"),
        (b"HTTP/1.1 200 OK\r\n", 0.2, "could not be reached"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nhalf", 2.0, "was not complete after 2 s"),
    ],
)
def test_a_slow_server_is_given_up(server: FileServer, sent: bytes, limit_s: float, says: str) -> None:
    def stall(handler: BaseHTTPRequestHandler) -> None:
        handler.wfile.write(sent)
        released.wait(10)

    released = threading.Event()
    server.files["/slow"] = stall
    try:
        refused = problem(fetcher(server.url, limit_s=limit_s), f"{server.url}/slow")
    finally:
        released.set()
    assert (refused.kind, says in refused.problem) == (Kind.FETCH_FAILED, True)


@pytest.mark.parametrize(
    ("sent", "says"),
    [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nhalf", "broke off"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nZZ\r\n", "broke off"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "could not be reached"),
        (b"HTTP/1.1 200 OK\r\nX: " + b"x" * 200_000, "could not be reached"),
    ],
)
def test_what_is_no_whole_answer(server: FileServer, sent: bytes, says: str) -> None:
    server.files["/broken"] = lambda handler: void(handler.wfile.write(sent))
    assert says in problem(fetcher(server.url), f"{server.url}/broken").problem


def void(_: object) -> None:
    """Whatever it was, nobody wants it."""


def test_proxies_of_the_environment_are_not_used(server: FileServer, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, f"http://127.0.0.1:{free_port()}")
    assert fetched(fetcher(server.url), f"{server.url}/xtreme1/a.pcd") == b"points"


def test_few_at_a_time(server: FileServer) -> None:
    """Of twenty fetches that all wait for each other's server, eight are on their way."""
    arrived, released = threading.Semaphore(0), threading.Event()

    def wait(handler: BaseHTTPRequestHandler) -> None:
        arrived.release()
        released.wait(10)
        answer(b"late")(handler)

    server.files["/wait"] = wait
    how = fetcher(server.url)

    async def fetch_all() -> list[bytes]:
        fetches = [asyncio.ensure_future(how.fetch(f"{server.url}/wait", "a", 10)) for _ in range(20)]
        for _ in range(8):
            assert await asyncio.to_thread(arrived.acquire, timeout=10)
        assert not await asyncio.to_thread(arrived.acquire, timeout=0.2)
        released.set()
        return await asyncio.gather(*fetches)

    assert asyncio.run(fetch_all()) == [b"late"] * 20


@pytest.mark.parametrize(
    ("address", "public", "with_private"),
    [
        ("93.184.216.34", True, True),
        ("2606:2800:220:1::1", True, True),
        ("::ffff:93.184.216.34", True, True),
        ("64:ff9b::5db8:d822", True, True),
        ("10.0.0.1", False, True),
        ("172.17.0.2", False, True),
        ("192.168.1.1", False, True),
        ("100.64.0.1", False, True),
        ("127.0.0.1", False, True),
        ("127.8.8.8", False, True),
        ("::1", False, True),
        ("fd12:3456::1", False, True),
        ("::ffff:127.0.0.1", False, True),
        ("::ffff:10.0.0.1", False, True),
        ("64:ff9b::a00:1", False, True),
        ("169.254.169.254", False, False),
        ("169.254.170.2", False, False),
        ("::ffff:169.254.169.254", False, False),
        ("64:ff9b::a9fe:a9fe", False, False),
        ("fd00:ec2::254", False, False),
        ("100.100.100.200", False, False),
        ("168.63.129.16", False, False),
        ("192.0.0.192", False, False),
        ("0.0.0.0", False, False),
        ("0.1.2.3", False, False),
        ("::", False, False),
        ("::7f00:1", False, False),
        ("fe80::1", False, False),
        ("fe80::1%1", False, False),
        ("fec0::1", False, False),
        ("224.0.0.1", False, False),
        ("ff02::1", False, False),
        ("240.0.0.1", False, False),
        ("255.255.255.255", False, False),
        ("2002:7f00:1::", False, False),
        ("2001:0:7f00:1::", False, False),
        ("64:ff9b:1::7f00:1", False, False),
    ],
)
def test_addresses(address: str, public: bool, with_private: bool) -> None:
    assert is_allowed(ip_address(address), private=False) is public
    assert is_allowed(ip_address(address), private=True) is with_private
