"""What a client asks, step by step, without saying how it waits: Client and AsyncClient take the same steps.

A call is a generator of steps: it yields a request and gets its answer, or yields a pause, and returns
what was asked for. Errors of the connection are thrown into it where it waits for an answer.
"""

from __future__ import annotations

import random
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, Generic, TypeVar

from boxlift.errors import MissingExtraError
from boxlift_client.errors import ServiceUnreachableError
from boxlift_client.label_answer import problem_error
from boxlift_client.request_parts import Form, Parts

try:
    import httpx as httpx  # the other modules take it from here
except ModuleNotFoundError:
    raise MissingExtraError("httpx", "client") from None

T = TypeVar("T")

# Connections that the service closed while they lay idle break at their next use: asking again is safe,
# for the same frame gets the same labels.
_ATTEMPTS = 2
_BROKEN_CONNECTION = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError)
_LATER = (429, 503)
# Clients that were sent away together shall not come back together.
_JITTER = 0.5
_SHORTEST_PAUSE_S = 0.05


@dataclass(frozen=True)
class Request:
    """A request; its body is a form, or `content` of the type that a header names."""

    method: str
    path: str
    form: Form | Parts | None = None
    content: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def arguments(self) -> dict[str, Any]:
        """As httpx calls them."""
        return {
            "method": self.method,
            "url": self.path,
            "files": self.form,
            "content": self.content,
            "headers": self.headers,
        }


@dataclass(frozen=True)
class Pause:
    """Wait for so long."""

    seconds: float


@dataclass(frozen=True)
class Done(Generic[T]):
    """What a call ends with."""

    value: T


Steps = Generator[Request | Pause, httpx.Response | None, T]


def next_step(
    steps: Steps[T], answer: httpx.Response | None, error: Exception | None = None
) -> Request | Pause | Done[T]:
    """The step after the one that brought an answer (None for the first, and for a pause) or an error."""
    try:
        return steps.send(answer) if error is None else steps.throw(error)
    except StopIteration as stop:
        return Done(stop.value)


def exchange(url: str, request: Request, patience_s: float = 0.0) -> Steps[bytes]:
    """The body of a success. Raises ServiceError for everything else.

    A service that says when to ask again (429 and 503 with Retry-After) is asked again, for up to
    `patience_s` in all.
    """
    until = monotonic() + patience_s
    attempt = 1
    while True:
        try:
            response = yield request
        except _BROKEN_CONNECTION as error:
            if attempt == _ATTEMPTS:
                raise _unreachable(url, error) from None
            attempt += 1
            continue
        except httpx.TimeoutException as error:
            raise ServiceUnreachableError(url, f"no answer in time ({type(error).__name__}).") from None
        except (httpx.RequestError, httpx.InvalidURL) as error:
            raise _unreachable(url, error) from None
        assert response is not None
        if response.is_success:
            return response.content
        wait_s = _retry_after_s(response)
        if wait_s is None or monotonic() + wait_s > until:
            raise problem_error(url, response.status_code, response.content)
        yield Pause(jittered(wait_s))


def jittered(seconds: float) -> float:
    """A little longer, by chance."""
    return max(seconds, _SHORTEST_PAUSE_S) * random.uniform(1.0, 1.0 + _JITTER)


def _retry_after_s(response: httpx.Response) -> float | None:
    """Seconds; None where the service does not say, or names a date."""
    seconds = response.headers.get("retry-after", "")
    return float(seconds) if response.status_code in _LATER and seconds.isdecimal() else None


def _unreachable(url: str, error: Exception) -> ServiceUnreachableError:
    return ServiceUnreachableError(
        url, f"no boxlift service answers ({error}). Start one with: boxlift serve"
    )
