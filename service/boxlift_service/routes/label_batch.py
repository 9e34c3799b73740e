"""POST /label:batch: a stream of frames in, a line of JSON for each out, as they are done."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter, Request
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from boxlift_service.batch import PATH, Batch, BatchService
from boxlift_service.bodies.msgpack_frames import MEDIA_TYPE, is_msgpack
from boxlift_service.bodies.negotiation import negotiate
from boxlift_service.documentation import batch_documentation
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.workers.deadline import Deadline

NDJSON = "application/x-ndjson"


def label_batch_routes(service: BatchService) -> APIRouter:
    """POST /label:batch."""
    routes = APIRouter(tags=["labels"])

    @routes.post(
        PATH,
        summary="Label many frames, each answered as soon as it is done",
        response_class=Response,
        responses=batch_documentation.responses(),
        openapi_extra=batch_documentation.extra(),
    )
    async def label_batch(request: Request) -> Response:
        """Frames are labelled or fail one by one; the last line says whether all of the stream was read."""
        negotiate(request.headers.get("accept"), (NDJSON,))
        if not is_msgpack(content_type := request.headers.get("content-type", "")):
            raise ProblemError(
                Kind.UNSUPPORTED_MEDIA_TYPE,
                f"The Content-Type is {content_type!r:.80}." if content_type else "There is no Content-Type.",
                f"Send {MEDIA_TYPE}: one map after the other.",
                headers={"Accept-Post": MEDIA_TYPE},
            )
        Deadline.of(request)  # nonsense is refused before anything is read
        return _BatchResponse(Batch(request, service))

    return routes


class _BatchResponse(Response):
    """The answer that is sent while the request is read; it alone receives."""

    media_type = NDJSON

    def __init__(self, batch: Batch) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._batch = batch

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002
        async def send_lines() -> None:
            await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
            async for lines in self._batch.lines():
                await send({"type": "http.response.body", "body": lines, "more_body": True})
            await send({"type": "http.response.body", "body": b""})

        tasks = [asyncio.create_task(work) for work in (self._batch.work(), send_lines())]
        working = asyncio.gather(*tasks)
        leaving = asyncio.create_task(self._batch.client_gone())
        try:
            await asyncio.wait((working, leaving), return_when=asyncio.FIRST_COMPLETED)
            if not working.done():
                raise ClientDisconnect
            working.result()
        finally:
            for task in (*tasks, leaving):
                task.cancel()
            await asyncio.gather(*tasks, working, leaving, return_exceptions=True)
            await self._batch.drop()
