"""Which web pages may call: none, but those of allowed origins (CORS) and of the service itself."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Receive, Scope, Send

from boxlift.errors import OptionsError
from boxlift_service.guards.auth import OnRefused, is_loopback
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings

_TOLD_TO_PAGES = ("X-Request-ID", "Server-Timing", "Retry-After")
_TAKEN_FROM_PAGES = ("Authorization", "X-Request-ID", "X-Request-Timeout")

_ORIGIN = re.compile(r"(https?)://([a-z0-9._-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?")
_HOST = re.compile(r"([^\s:@/\[\]]+|\[[0-9A-Fa-f:.]+\])(:[0-9]*)?")
_DEFAULT_PORTS = {"http": ":80", "https": ":443"}


def add_origin_layers(
    app: Starlette, settings: ServiceSettings, on_refused: OnRefused = lambda _: None
) -> None:
    """Put the guard, and CORS inside it, around what `app` has so far.

    Raises OptionsError where an allowed origin is none. `on_refused` is called with "origin".
    """
    origins = allowed_origins(settings)
    if origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=origins,
            allow_methods=("GET", "POST"),
            allow_headers=_TAKEN_FROM_PAGES,
            expose_headers=_TOLD_TO_PAGES,
        )
    # With keys, a page that got itself our host's name still has no key.
    hosts_checked = is_loopback(settings.host) and settings.api_keys is None
    app.add_middleware(OriginGuard, origins=origins, hosts_checked=hosts_checked, on_refused=on_refused)


def allowed_origins(settings: ServiceSettings) -> tuple[str, ...]:
    """The allowed origins as browsers write them. Raises OptionsError for what is no origin."""
    return tuple(map(_as_browsers_write, settings.allowed_origins))


def _as_browsers_write(origin: str) -> str:
    match = _ORIGIN.fullmatch(origin.lower().removesuffix("/"))
    if match is None:
        raise OptionsError(
            "BOXLIFT_ALLOWED_ORIGINS",
            f"{origin!r:.80} is no origin.",
            "Write each as https://HOST or https://HOST:PORT; there is no *.",
        )
    scheme, host, port = match.groups()
    return f"{scheme}://{host}{'' if port == _DEFAULT_PORTS[scheme] else port or ''}"


class OriginGuard:
    """Answers 403 to web pages of other origins, before anything of the body is read.

    A browser sends what a page tells it to, also to a service without keys on the visitor's own machine, and
    names the page's origin. Where `hosts_checked`, the Host must be this machine too: a foreign page may have
    pointed a name of its own here (DNS rebinding), and then its origin is no other.
    """

    def __init__(
        self,
        app: ASGIApp,
        origins: tuple[str, ...],
        hosts_checked: bool,
        on_refused: OnRefused = lambda _: None,
    ) -> None:
        self._app = app
        self._origins = frozenset(origins)
        self._hosts = frozenset(urlsplit(origin).hostname for origin in origins)
        self._hosts_checked = hosts_checked
        self._on_refused = on_refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and (problem := self._refusal(Headers(scope=scope))):
            self._on_refused("origin")
            await problem.response(scope["path"])(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _refusal(self, headers: Headers) -> ProblemError | None:
        host = headers.get("host", "")
        if host and self._hosts_checked and not self._is_ours(host):
            return ProblemError(
                Kind.FORBIDDEN_ORIGIN,
                f"The Host {host!r:.80} is not this machine, and the service asks for no key.",
                "Call it as localhost; or let it ask for keys (BOXLIFT_API_KEYS), or name the origin "
                "that a proxy serves it under in BOXLIFT_ALLOWED_ORIGINS.",
            )
        own = {f"{scheme}://{host}".lower() for scheme in _DEFAULT_PORTS}
        for origin in headers.getlist("origin"):
            if origin.lower() not in own | self._origins:
                return ProblemError(
                    Kind.FORBIDDEN_ORIGIN,
                    f"Pages of {origin!r:.80} may not call.",
                    "Who runs the service can name the origin in BOXLIFT_ALLOWED_ORIGINS.",
                )
        return None

    def _is_ours(self, host: str) -> bool:
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = match[1].strip("[]").lower()
        return is_loopback(name) or name in self._hosts
