from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
from collections.abc import Iterable, Iterator
from typing import Any, Self
from urllib.parse import urlsplit

import httpx
import msgpack
import pytest

from service.frames import CAR, SmallFrame, grey_png
from service.running import RunningService, running_service
from service.test_bad_input import assert_problem
from service.test_operation import Stopped, metric, wait_for_metric

HELD = "boxlift_held_bytes"
MAX_BYTES = 300_000


@pytest.fixture(scope="module")
def tight() -> Iterator[RunningService]:
    """One label worker, little permits, bodies of 300 kB; it is impatient, and its worker may be stopped."""
    limits = {"permits_per_worker": "0.5", "receive_idle_s": "3", "silence_s": "60"}
    with running_service(max_body_bytes=str(MAX_BYTES), **limits) as running:
        yield running


def packed(frame: SmallFrame, name: str | None, **changes: bytes | None) -> bytes:
    """A frame as it is streamed."""
    fields: dict[str, Any] = {} if name is None else {"name": name}
    fields |= {field: data for field, (_, data) in frame.fields(**changes).items()}
    fields["points_filename"] = "small.bin"
    data: bytes = msgpack.packb(fields)
    return data


def label_batch(
    service: RunningService, frames: Iterable[bytes], **headers: str
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The lines of the answer, and the last one."""
    headers = {"Content-Type": "application/msgpack", **headers}
    response = service.client.post("/label:batch", content=b"".join(frames), headers=headers)
    assert response.status_code == 200
    assert response.headers["content-type"] == "application/x-ndjson"
    assert response.headers["x-request-id"]
    *lines, last = map(json.loads, response.text.splitlines())
    return lines, last


class Stream:
    """A batch that is sent and read at the same time, over a connection of its own."""

    def __init__(self, service: RunningService) -> None:
        address = urlsplit(service.url)
        assert address.hostname is not None
        self._connection = http.client.HTTPConnection(address.hostname, address.port, timeout=60)
        self._connection.putrequest("POST", "/label:batch")
        self._connection.putheader("Content-Type", "application/msgpack")
        self._connection.putheader("Transfer-Encoding", "chunked")
        self._connection.endheaders()
        self._response: http.client.HTTPResponse | None = None

    def send(self, data: bytes) -> None:
        self._connection.send(b"%x\r\n%b\r\n" % (len(data), data))

    def end(self) -> None:
        self._connection.send(b"0\r\n\r\n")

    def line(self) -> dict[str, Any]:
        self._response = self._response or self._connection.getresponse()
        line: dict[str, Any] = json.loads(self._response.readline())
        return line

    def is_at_end(self) -> bool:
        assert self._response is not None
        return self._response.readline() == b""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()


def test_every_frame_is_answered_as_it_would_be_alone(service: RunningService, frame: SmallFrame) -> None:
    names = [f"frame {index} é" for index in range(5)]
    lines, last = label_batch(service, (packed(frame, name) for name in names))
    assert last == {"frames": 5, "labelled": 5, "failed": 0, "complete": True}
    assert {line["frame"]: line["index"] for line in lines} == {
        name: index for index, name in enumerate(names)
    }
    for line in lines:
        alone = service.label(frame.fields(name=line["frame"].encode())).json()
        assert line == {"frame": line["frame"], "index": line["index"], "status": 200, "answer": alone}


def test_prompts_are_found_where_none_come(service: RunningService, frame: SmallFrame) -> None:
    lines, last = label_batch(service, [packed(frame, "a", prompts=None, image=grey_png())])
    assert last["labelled"] == 1
    alone = service.label(frame.fields(name=b"a", prompts=None, image=grey_png())).json()
    assert lines[0]["answer"] == alone
    assert alone["model_digest"]


def test_a_frame_at_fault_fails_by_itself(tight: RunningService, frame: SmallFrame) -> None:
    frames = [
        packed(frame, "good"),
        packed(frame, "unreadable points", points=b"hello"),
        packed(frame, "unknown field", lidar=b"1"),
        packed(frame, "no calib", calib=None),
        packed(frame, "large", points=bytes(MAX_BYTES + 1)),
        packed(frame, "large together", points=bytes(MAX_BYTES - 99), image=grey_png()),
        packed(frame, None),
        packed(frame, "good"),
        packed(frame, "line\nbreak"),
        packed(frame, "last"),
    ]
    lines, last = label_batch(tight, frames)
    assert last == {"frames": 10, "labelled": 2, "failed": 8, "complete": True}
    outcomes = {line["index"]: (line["frame"], line["status"]) for line in lines}
    assert outcomes == {
        0: ("good", 200),
        1: ("unreadable points", 422),
        2: ("unknown field", 422),
        3: ("no calib", 422),
        4: ("large", 413),
        5: ("large together", 413),
        6: (None, 422),
        7: ("good", 422),
        8: ("line\nbreak", 422),
        9: ("last", 200),
    }
    problems = {line["index"]: line["problem"] for line in lines if line["status"] != 200}
    fields = {1: "points", 2: "lidar", 3: "calib", 4: "points", 5: None, 6: "name", 7: "name", 8: "name"}
    assert {index: problem.get("field") for index, problem in problems.items()} == fields
    for index, problem in problems.items():
        assert problem["status"] == outcomes[index][1]
        assert problem["detail"] == f"{problem['problem']} {problem['remedy']}"
        assert problem["instance"] == "/label:batch"
        assert problem["type"].startswith("urn:boxlift:problem:")
    assert metric(tight, HELD) == 0


def test_a_stream_without_frames(service: RunningService) -> None:
    assert label_batch(service, []) == ([], {"frames": 0, "labelled": 0, "failed": 0, "complete": True})


def test_answers_come_while_frames_are_sent(service: RunningService, frame: SmallFrame) -> None:
    with Stream(service) as stream:
        for index in range(3):
            data = packed(frame, str(index))
            stream.send(data[:1000])
            stream.send(data[1000:])
            line = stream.line()
            assert (line["frame"], line["index"], line["status"]) == (str(index), index, 200)
        stream.end()
        assert stream.line() == {"frames": 3, "labelled": 3, "failed": 0, "complete": True}
        assert stream.is_at_end()


def test_answers_come_in_order_of_completion(tight: RunningService, frame: SmallFrame) -> None:
    with Stream(tight) as stream:
        with Stopped(tight):
            stream.send(packed(frame, "waits") + packed(frame, "fails", lidar=b"1"))
            assert stream.line()["frame"] == "fails"
        assert stream.line()["frame"] == "waits"
        stream.end()
        assert stream.line()["complete"]


def test_no_frame_is_read_before_there_is_a_worker_for_it(tight: RunningService, frame: SmallFrame) -> None:
    """And none is refused, though far more come than there are permits, or bytes in a body."""
    frames = [packed(frame, f"{index:02}", image=grey_png()) for index in range(40)]
    assert sum(map(len, frames)) > 5 * MAX_BYTES
    fields = msgpack.unpackb(frames[0])
    kept_bytes = sum(len(data) for name, data in fields.items() if name != "points_filename")
    with Stream(tight) as stream:
        with Stopped(tight):
            stream.send(frames[0] + frames[1] + frames[2] + frames[3])
            wait_for_metric(tight, HELD, 2 * kept_bytes)
            assert metric(tight, 'boxlift_permits_taken{pool="label"}') <= 0.5
        for data in frames[4:]:
            stream.send(data)
            assert stream.line()["status"] == 200
            assert metric(tight, HELD) <= 2 * kept_bytes
        stream.end()
        assert [stream.line()["status"] for _ in range(4)] == [200] * 4
        assert stream.line() == {"frames": 40, "labelled": 40, "failed": 0, "complete": True}


MALFORMED = {
    "no map": b"[1, 2]",
    "a list in it": msgpack.packb({"name": "bad", "points": b"", "calib": ["P2"]}),
    "cut": msgpack.packb({"name": "bad", "points": bytes(99)})[:-9],
}


@pytest.mark.parametrize("malformed", MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_stream_ends_and_the_frames_before_are_answered(
    service: RunningService, frame: SmallFrame, malformed: bytes
) -> None:
    frames = [packed(frame, "a"), packed(frame, "b"), malformed]
    if malformed != MALFORMED["cut"]:
        frames.append(packed(frame, "never read"))
    lines, last = label_batch(service, frames)
    assert last == {"frames": 3, "labelled": 2, "failed": 1, "complete": False}
    assert {line["frame"]: line["status"] for line in lines} == {"a": 200, "b": 200, None: 400}
    (problem,) = (line["problem"] for line in lines if line["status"] == 400)
    assert problem["type"] == "urn:boxlift:problem:unreadable-body"


def test_a_stream_that_stops_ends(tight: RunningService, frame: SmallFrame) -> None:
    with Stream(tight) as stream:
        stream.send(packed(frame, "a") + packed(frame, "b")[:-1])
        assert stream.line()["status"] == 200
        line = stream.line()
        assert (line["frame"], line["index"], line["status"]) == (None, 1, 408)
        assert stream.line() == {"frames": 2, "labelled": 1, "failed": 1, "complete": False}
        assert stream.is_at_end()


@pytest.mark.parametrize("sent_whole", [False, True], ids=["mid-upload", "mid-answer"])
def test_a_client_that_goes_leaves_nothing(
    tight: RunningService, frame: SmallFrame, sent_whole: bool
) -> None:
    dropped = 'boxlift_dropped_total{pool="label",reason="client_gone"}'
    gone = 'boxlift_requests_total{method="POST",route="/label:batch",status="499"}'
    dropped_before, gone_before = metric(tight, dropped), metric(tight, gone)
    with Stopped(tight):
        with Stream(tight) as stream:
            stream.send(packed(frame, "a"))
            if sent_whole:
                stream.end()
            else:
                stream.send(packed(frame, "b")[:1000])
            wait_for_metric(tight, 'boxlift_permits_taken{pool="label"}', 0.25)
        wait_for_metric(tight, dropped, dropped_before + 1)
        wait_for_metric(tight, gone, gone_before + 1)
        assert metric(tight, HELD) == 0
        assert metric(tight, 'boxlift_permits_taken{pool="label"}') == 0
    assert label_batch(tight, [packed(frame, "a")])[1]["labelled"] == 1


def test_a_deadline_is_each_frames_own(tight: RunningService, frame: SmallFrame) -> None:
    with Stopped(tight):
        lines, last = label_batch(
            tight, [packed(frame, "a"), packed(frame, "b")], **{"X-Request-Timeout": "0.3"}
        )
    assert [line["status"] for line in lines] == [504, 504]
    assert last == {"frames": 2, "labelled": 0, "failed": 2, "complete": True}


def test_a_service_that_ends_finishes_the_frames_it_has(frame: SmallFrame) -> None:
    with running_service() as ending, Stream(ending) as stream:
        stream.send(packed(frame, "a"))
        assert stream.line()["status"] == 200
        with Stopped(ending):
            stream.send(packed(frame, "b"))
            wait_for_metric(ending, 'boxlift_running_requests{pool="label"}', 1)
            os.kill(ending.process.pid, signal.SIGTERM)
            with contextlib.suppress(httpx.ConnectError):
                while True:  # until its port is closed
                    httpx.get(f"{ending.url}/healthz")
        lines = [stream.line()]
        stream.send(packed(frame, "c"))
        lines.append(stream.line())
        assert [(line["frame"], line["status"]) for line in lines] == [("b", 200), (None, 503)]
        assert stream.line() == {"frames": 3, "labelled": 2, "failed": 1, "complete": False}
        assert stream.is_at_end()
        assert ending.process.wait(timeout=30) in (0, -signal.SIGTERM)


def test_what_is_refused_at_once(service: RunningService, frame: SmallFrame) -> None:
    data = packed(frame, "a")
    content_type = {"Content-Type": "application/msgpack"}

    refused = service.client.post("/label:batch", files=list(frame.fields().items()))
    assert_problem(refused, 415, None, "multipart/form-data")
    assert refused.headers["accept-post"] == "application/msgpack"
    headers = {**content_type, "Accept": "application/json"}
    assert_problem(service.client.post("/label:batch", content=data, headers=headers), 406, None, "")
    headers = {**content_type, "X-Request-Timeout": "soon"}
    refused = service.client.post("/label:batch", content=data, headers=headers)
    assert_problem(refused, 422, "X-Request-Timeout", "soon")
    assert service.client.get("/label:batch").status_code == 405


def test_results_and_stages_are_counted(service: RunningService, frame: SmallFrame) -> None:
    fitted = 'boxlift_results_total{result="FITTED",route="/label:batch"}'
    before = metric(service, fitted)
    prompts = json.dumps([CAR, CAR]).encode()
    response = service.client.post(
        "/v1/label:batch",
        content=packed(frame, "a") + packed(frame, "b", prompts=prompts),
        headers={"Content-Type": "application/msgpack"},
    )
    assert response.status_code == 200
    assert metric(service, fitted) == before + 3
    assert metric(service, 'boxlift_stage_seconds_count{route="/label:batch",stage="fit"}') >= 2
