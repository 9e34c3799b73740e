"""A server that answers what a test says, and both clients to ask it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send

import boxlift
from boxlift_client.async_client import AsyncClient
from boxlift_client.client import Client
from service.served import served


@dataclass(frozen=True)
class Scripted:
    """An answer; one that is cut ends with the connection."""

    status: int = 200
    content: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    is_cut: bool = False


@dataclass(frozen=True)
class Asked:
    """A request that came."""

    path: str
    headers: Mapping[str, str]
    body: bytes


@dataclass
class Script:
    """Answers in their order, the last one again and again, and what was asked."""

    url: str
    answers: list[Scripted]
    asked: list[Asked] = field(default_factory=list)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        body, more = b"", True
        while more:
            message = await receive()
            body += message.get("body", b"")
            more = message.get("more_body", False)
        headers = {name.decode(): value.decode() for name, value in scope["headers"]}
        self.asked.append(Asked(scope["path"], headers, body))
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        named = [(name.encode(), value.encode()) for name, value in answer.headers.items()]
        await send({"type": "http.response.start", "status": answer.status, "headers": named})
        # Without an end, the server breaks the connection off.
        await send({"type": "http.response.body", "body": answer.content, "more_body": answer.is_cut})


@contextmanager
def scripted(*answers: Scripted) -> Iterator[Script]:
    """A server with these answers on a free port."""
    script = Script("", list(answers))
    with served(script) as server:
        script.url = server.url
        yield script


def label_answer(name: str = "a", **changes: object) -> dict[str, Any]:
    """A label answer without objects."""
    return {
        "frame": name,
        "objects": [],
        "warnings": [],
        "dropped_points": 0,
        "preset": "accurate",
        "settings_fingerprint": "0",
        "model_digest": None,
        "api_version": "1",
        "boxlift_version": boxlift.__version__,
        **changes,
    }


def lines(*members: Mapping[str, Any]) -> bytes:
    """NDJSON."""
    return b"".join(json.dumps(line).encode() + b"\n" for line in members)


# (url, method, *its arguments, client=options of the client, **its keyword arguments)
Ask = Callable[..., Any]


def ask_client(
    url: str, method: str, *arguments: Any, client: Mapping[str, Any] = {}, **keywords: Any
) -> Any:
    """What a method of Client returns, its iterators as lists."""
    with Client(url, **client) as asking:
        answer = getattr(asking, method)(*arguments, **keywords)
        return list(answer) if isinstance(answer, Iterator) else answer


def ask_async_client(
    url: str, method: str, *arguments: Any, client: Mapping[str, Any] = {}, **keywords: Any
) -> Any:
    """The same of AsyncClient."""

    async def ask() -> Any:
        async with AsyncClient(url, **client) as asking:
            answer = getattr(asking, method)(*arguments, **keywords)
            if isinstance(answer, AsyncIterator):
                return [item async for item in answer]
            return await answer

    return asyncio.run(ask())


with_both_clients = pytest.mark.parametrize(
    "ask", [ask_client, ask_async_client], ids=["Client", "AsyncClient"]
)
