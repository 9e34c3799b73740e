"""A web server on loopback whose files, and misbehaviour, a test decides."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

# Writes what it likes to the client of the handler.
Answer = Callable[[BaseHTTPRequestHandler], None]


@dataclass(frozen=True)
class FileServer:
    """`files` by path; `asked` are the path and the headers of every request."""

    port: int
    files: dict[str, bytes | Answer] = field(default_factory=dict)
    asked: list[tuple[str, Message[str, str]]] = field(default_factory=list)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def paths(self) -> list[str]:
        return [path for path, _ in self.asked]


@contextmanager
def file_server() -> Iterator[FileServer]:
    """A server without files yet, until the end of the `with`."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            server.asked.append((self.path, self.headers))
            content = server.files.get(self.path.partition("?")[0])
            if callable(content):
                content(self)
            else:
                answer(b"" if content is None else content, 404 if content is None else 200)(self)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http_server:
        http_server.daemon_threads = True
        server = FileServer(http_server.server_address[1])
        threading.Thread(target=http_server.serve_forever, args=(0.05,), daemon=True).start()
        try:
            yield server
        finally:
            http_server.shutdown()


def answer(content: bytes, status: int = 200, **headers: str) -> Answer:
    """An answer with these headers (underscores for hyphens)."""

    def write(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        for name, value in {"Content-Length": str(len(content)), **headers}.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(content)

    return write
