"""Who may ask: bearer keys (RFC 6750), and how often each of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from ipaddress import ip_address
from time import monotonic

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from boxlift.errors import OptionsError
from boxlift_service.guards.api_keys import ApiKey, ApiKeys
from boxlift_service.guards.rate_limit import RateLimits
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings

OnRefused = Callable[[str], None]
PAGE_PATHS = ("/", "/review/page.js", "/review/page.css", "/review/icon.svg")


def check_exposure(settings: ServiceSettings) -> None:
    """Raises OptionsError where others could reach the service, and neither keys nor a word allow that."""
    if settings.api_keys or settings.allow_anonymous or is_loopback(settings.host):
        return
    raise OptionsError(
        "BOXLIFT_API_KEYS",
        f"is not set, and others than this machine could reach {settings.host!r}.",
        "Make a key with `boxlift keys new NAME --file FILE` and set BOXLIFT_API_KEYS to FILE; or set "
        "BOXLIFT_ALLOW_ANONYMOUS=true where something before the service says who may ask.",
    )


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens on `host`, without asking a name server."""
    try:
        return host.lower() == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


class AuthMiddleware:
    """Answers 401 without a known key, 429 beyond the key's rate; else `request.state.key` is its name.

    The body of a refused request is left unread: BodyLimitMiddleware, around this, drops it. Probes and the
    review page's own files need no key, nor does /metrics where the settings say so. `on_refused` is called
    with "key" or "rate".
    """

    def __init__(
        self, app: ASGIApp, keys: ApiKeys, settings: ServiceSettings, on_refused: OnRefused = lambda _: None
    ) -> None:
        self._app = app
        self._keys = keys
        self._requests_per_minute = settings.requests_per_minute
        self._rates = RateLimits()
        self._on_refused = on_refused
        paths = ["/healthz", "/readyz", *(["/metrics"] if settings.open_metrics else [])]
        # The page itself holds nothing of anybody: it asks for a key, and sends it with all that it fetches.
        self._open_paths = {version + path for version in ("", "/v1") for path in (*paths, *PAGE_PATHS)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] not in self._open_paths:
            try:
                scope.setdefault("state", {})["key"] = self._admitted(Headers(scope=scope)).name
            except ProblemError as problem:
                await problem.response(scope["path"])(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _admitted(self, headers: Headers) -> ApiKey:
        secret = _bearer(headers)
        key = None if secret is None else self._keys.find(secret)
        if key is None:
            self._on_refused("key")
            raise _unauthorized(secret is not None)
        rate = self._requests_per_minute if key.requests_per_minute is None else key.requests_per_minute
        if wait_s := self._rates.wait_s(key.name, rate, monotonic()):
            self._on_refused("rate")
            raise ProblemError(
                Kind.RATE_LIMITED,
                f"The key {key.name!r} may send {rate} requests a minute.",
                f"Send the next one in {math.ceil(wait_s)} s.",
                headers={"Retry-After": str(math.ceil(wait_s))},
            )
        return key


def _bearer(headers: Headers) -> bytes | None:
    """What the request says its key is; None where it says nothing, or more than one thing."""
    match headers.getlist("authorization"):
        case [one]:
            scheme, _, secret = one.partition(" ")
            return secret.strip().encode("latin-1") if scheme.lower() == "bearer" else None
    return None


def _unauthorized(with_key: bool) -> ProblemError:
    # RFC 6750, section 3.1: no error code where the request has no key.
    error = ', error="invalid_token"' if with_key else ""
    return ProblemError(
        Kind.UNAUTHORIZED,
        "The request has no API key that is valid here.",
        "Send the header Authorization: Bearer KEY; who runs the service makes keys.",
        headers={"WWW-Authenticate": f'Bearer realm="boxlift"{error}'},
    )
