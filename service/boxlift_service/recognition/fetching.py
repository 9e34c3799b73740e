"""Files from URLs that strangers name: from the operator's list of prefixes, and from nowhere else.

A URL is compared part by part with the prefixes, its host is resolved and judged by guarded_network, and what
comes back is cut off at a size and a time. Redirects are refused: no store of files needs them, and each
would be a URL to check anew. Nothing of the environment is used (no proxies, no .netrc), and neither cookies
nor credentials are sent.

Whether a host has an address that is not connected to, or none, or does not answer, is the service's log to
know: to the client it is one and the same sentence, so that nobody can map a network by asking.
"""

from __future__ import annotations

import asyncio
import logging
import re
from dataclasses import dataclass
from ipaddress import IPv6Address
from urllib.parse import unquote

import httpcore
import httpx

from boxlift.errors import OptionsError
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.recognition.guarded_network import GuardedNetwork, Resolve, system_addresses
from boxlift_service.settings import ServiceSettings

_log = logging.getLogger(__name__)

_LONGEST_URL = 4096
_MOST_AT_A_TIME = 8
_USED_ENCODINGS = ("", "identity")
_PORTS = {"http": 80, "https": 443}
# Printable ASCII in every part: no blanks, no line breaks, no user before the host, and no fragment.
_URL = re.compile(
    r"(?P<scheme>https?)://"
    r"(?P<host>[a-z0-9._-]+|\[[0-9a-f:.]+\])(?::(?P<port>[0-9]{1,5}))?"
    r"(?P<path>/[!-~]*?)?(?P<query>\?[!-~]*)?",
    re.IGNORECASE | re.ASCII,
)


@dataclass(frozen=True)
class _Url:
    """A URL taken apart. `segments` are those of its path, percent-decoded; `target` is what is asked for."""

    scheme: str
    host: str
    port: int
    segments: tuple[str, ...]
    target: str

    @classmethod
    def parse(cls, text: str) -> _Url:
        """Raises ValueError that says what is wrong with it."""
        if len(text) > _LONGEST_URL:
            raise ValueError(f"it has {len(text)} characters, at most {_LONGEST_URL} are taken")
        if "\\" in text or "#" in text or (found := _URL.fullmatch(text)) is None:
            raise ValueError("it is not http(s)://HOST[:PORT]/PATH in plain ASCII, without user and fragment")
        scheme = found["scheme"].lower()
        port = int(found["port"] or _PORTS[scheme])
        if not 0 < port < 65_536:
            raise ValueError(f"there is no port {port}")
        path = found["path"] or "/"
        return cls(scheme, _host(found["host"]), port, _segments(path), path + (found["query"] or ""))

    @property
    def authority(self) -> str:
        """Host and port as the Host header says them."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == _PORTS[self.scheme] else f"{host}:{self.port}"

    def begins_with(self, prefix: _Url) -> bool:
        """Whether scheme, host and port are those of the prefix, and its path's segments come first."""
        return (self.scheme, self.host, self.port) == (prefix.scheme, prefix.host, prefix.port) and (
            self.segments[: len(prefix.segments)] == prefix.segments
        )


class Fetcher:
    """Fetches from the prefixes of settings.fetch_from. Raises OptionsError where one of them is no prefix.

    `resolve` gives the addresses of a host; the system's are the default.
    """

    def __init__(self, settings: ServiceSettings, resolve: Resolve = system_addresses) -> None:
        self._prefixes = tuple(_parse_prefix(prefix) for prefix in settings.fetch_from)
        self._limit_s = settings.fetch_limit_s
        self._network = GuardedNetwork(settings.fetch_private, resolve)
        # The certificates of certifi, or of SSL_CERT_FILE.
        any_tls = any(prefix.scheme == "https" for prefix in self._prefixes)
        self._tls = httpx.create_ssl_context() if any_tls else None
        self._places = asyncio.Semaphore(_MOST_AT_A_TIME)

    async def fetch(self, url: str, field: str, max_bytes: int) -> bytes:
        """The content of a URL that `field` names.

        Raises ProblemError: the URL is not one to fetch from, or it could not be fetched whole and within
        the limits (both 422).
        """
        parsed = self._allowed(url, field)
        shown = repr(url.partition("?")[0])  # a query holds signatures
        async with self._places:
            answering = asyncio.Event()
            try:
                async with asyncio.timeout(self._limit_s):
                    return await self._read(parsed, field, shown, max_bytes, answering)
            except TimeoutError:
                reason = f"was not complete after {self._limit_s:g} s"
            except (httpcore.NetworkError, httpcore.ProtocolError, httpcore.TimeoutException) as error:
                _log.warning("%s was not fetched: %s", shown, error)
                reason = "broke off"
        if answering.is_set():
            raise _failed(field, shown, reason, "Give a URL of a file that is served whole and in time.")
        raise _failed(
            field, shown, "could not be reached", "Check the URL, and that the service may reach it."
        )

    def _allowed(self, url: str, field: str) -> _Url:
        remedy = "The service's operator lists prefixes in BOXLIFT_FETCH_FROM."
        shown = repr(url.partition("?")[0])[:200]
        try:
            parsed = _Url.parse(url)
        except ValueError as error:
            problem = f"{shown} is not fetched: {error}."
            raise ProblemError(Kind.FETCH_REFUSED, problem, remedy, field=field) from None
        if not any(parsed.begins_with(prefix) for prefix in self._prefixes):
            problem = f"{shown} begins with none of the prefixes that are fetched from."
            raise ProblemError(Kind.FETCH_REFUSED, problem, remedy, field=field)
        return parsed

    async def _read(
        self, url: _Url, field: str, shown: str, max_bytes: int, answering: asyncio.Event
    ) -> bytes:
        headers = {"Host": url.authority, "User-Agent": "boxlift", "Accept-Encoding": "identity"}
        pool = httpcore.AsyncConnectionPool(
            ssl_context=self._tls, network_backend=self._network, max_keepalive_connections=0
        )
        asked = httpcore.URL(scheme=url.scheme, host=url.host, port=url.port, target=url.target)
        async with pool, pool.stream("GET", asked, headers=list(headers.items())) as response:
            answering.set()
            said = {name.lower(): value for name, value in response.headers}
            encoding = said.get(b"content-encoding", b"").decode("latin-1")
            if 300 <= response.status < 400:
                remedy = "Give the URL that it leads to; redirects are not followed."
                raise _failed(field, shown, f"is a redirect ({response.status})", remedy)
            if response.status != 200:
                remedy = "Give a URL that can be read without a login; one that is signed may have run out."
                raise _failed(field, shown, f"was answered with status {response.status}", remedy)
            if encoding.strip().lower() not in _USED_ENCODINGS:
                problem = f"came with Content-Encoding {encoding!r:.40} though identity was asked for"
                raise _failed(field, shown, problem, "Serve the file as it is.")
            content = bytearray()
            async for chunk in response.aiter_stream():
                content += chunk
                if len(content) > max_bytes:
                    problem = f"has more than {max_bytes} bytes"
                    raise _failed(field, shown, problem, f"Give a file of at most {max_bytes} bytes.")
            return bytes(content)


def _parse_prefix(prefix: str) -> _Url:
    try:
        parsed = _Url.parse(prefix)
        if "?" in parsed.target:
            raise ValueError("it has a query")
    except ValueError as error:
        raise OptionsError(
            "BOXLIFT_FETCH_FROM",
            f"{prefix!r:.200} is no prefix: {error}.",
            "Give e.g. http://minio:9000/xtreme1/ (several with commas between them).",
        ) from None
    # The end of http://minio:9000/xtreme1/ is no segment of its own.
    segments = parsed.segments[:-1] if parsed.segments[-1] == "" else parsed.segments
    return _Url(parsed.scheme, parsed.host, parsed.port, segments, parsed.target)


def _host(host: str) -> str:
    """A name in lower case, or an IPv6 address in its one shortest spelling, without brackets."""
    return str(IPv6Address(host[1:-1])) if host.startswith("[") else host.lower()


def _segments(path: str) -> tuple[str, ...]:
    """The segments of a path, percent-decoded. Raises ValueError for one that could lead out of its folder.

    A server may decode once more than it should, cut a segment at a semicolon, or take either slash for one.
    """
    decoded = []
    for segment in path.split("/")[1:]:
        plain = unquote(segment)
        within = unquote(unquote(plain))
        if within.partition(";")[0] in (".", "..") or set("/\\") & set(within) or not within.isprintable():
            raise ValueError("its path holds '.', '..', an encoded slash or a control character")
        decoded.append(plain)
    return tuple(decoded)


def _failed(field: str, shown: str, what: str, remedy: str) -> ProblemError:
    return ProblemError(Kind.FETCH_FAILED, f"{shown:.200} {what}.", remedy, field=field)
