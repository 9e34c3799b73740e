from __future__ import annotations

import json
import logging
import os
import re
import socket
import subprocess
import sys
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from boxlift_service.telemetry.logs import JsonFormatter, TextFormatter, of_request

HOSTILE = "\r\n2026-01-01T00:00:00.000Z INFO boxlift_service: all is well\x1b[2J\u2028\x85\x00\udcff"


def record_of(message: str, *args: object, exception: BaseException | None = None) -> logging.LogRecord:
    exc_info = (type(exception), exception, exception.__traceback__) if exception else None
    return logging.LogRecord("boxlift_service", logging.WARNING, __file__, 1, message, args, exc_info)


def raised(message: str) -> Exception:
    try:
        raise ValueError(message)
    except ValueError as error:
        return error


def lines_of(log_format: str, code: str, log_level: str = "info") -> list[str]:
    """What a process of its own writes to stderr that logs in `log_format`."""
    configure = f"boxlift_service.telemetry.logs.configure_logging({log_format!r}, {log_level!r})"
    program = f"import boxlift_service.telemetry.logs\n{configure}\n{code}"
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    )
    assert ended.stdout == ""
    return ended.stderr.splitlines()


def test_text_line_says_when_what_where() -> None:
    record = record_of("took %d s", 3)

    line = TextFormatter().format(record)

    moment, rest = line.split(" ", 1)
    assert rest == "WARNING boxlift_service: took 3 s"
    assert moment.endswith("Z")
    logged = datetime.fromisoformat(moment)
    assert abs(logged.timestamp() - record.created) < 0.001
    assert logged.tzinfo == UTC


def test_json_line_has_members() -> None:
    record = record_of("took %d s", 3)
    record.fields = {"status": 200, "ms": 61.4}

    members = json.loads(JsonFormatter().format(record))

    assert members.pop("time").endswith("Z")
    assert members == {
        "level": "warning",
        "logger": "boxlift_service",
        "message": "took 3 s",
        "status": 200,
        "ms": 61.4,
    }


def test_lines_of_a_request_say_its_id() -> None:
    token = of_request.set({"request_id": "4711", "trace_id": "ab"})
    try:
        text = TextFormatter().format(record_of("hello"))
        members = json.loads(JsonFormatter().format(record_of("hello")))
    finally:
        of_request.reset(token)

    assert text.endswith("boxlift_service: hello [4711]")
    assert (members["request_id"], members["trace_id"]) == ("4711", "ab")


@pytest.mark.parametrize("formatter", [TextFormatter(), JsonFormatter()])
def test_what_a_client_sent_begins_no_line(formatter: logging.Formatter) -> None:
    formatted = formatter.format(record_of("got %s", HOSTILE))

    assert len(formatted.splitlines()) == 1
    assert not re.search(r"[\x00-\x1f\x7f-\x9f]", formatted)
    # Readers get it whole.
    shown = json.loads(formatted)["message"] if isinstance(formatter, JsonFormatter) else formatted
    assert "INFO boxlift_service: all is well" in shown


def test_traceback_is_one_string_in_json() -> None:
    formatted = JsonFormatter().format(record_of("failed", exception=raised(HOSTILE)))

    assert "\n" not in formatted
    exception = json.loads(formatted)["exception"]
    assert exception.startswith("Traceback (most recent call last):\n")
    assert "ValueError" in exception


def test_traceback_in_text_begins_no_line_either() -> None:
    first, *rest = TextFormatter().format(record_of("failed", exception=raised(HOSTILE))).splitlines()

    assert first.endswith("WARNING boxlift_service: failed")
    assert rest[0] == "    | Traceback (most recent call last):"
    assert all(line.startswith("    | ") for line in rest)
    assert "\x1b" not in "".join(rest)


def test_fields_need_not_be_json() -> None:
    record = record_of("hello")
    record.fields = {"error": ValueError("odd")}

    assert json.loads(JsonFormatter().format(record))["error"] == "odd"


LIBRARIES = """
import logging, warnings
message = "Uvicorn running on %s://%s:%d (Press CTRL+C to quit)"
logging.getLogger("uvicorn.error").info(message, "http", "::1", 8000, extra={"color_message": "unseen"})
logging.getLogger("boxlift.labeller").info("from the craft")
logging.getLogger("urllib3").info("chatter")
logging.getLogger("python_multipart").warning("malformed")
warnings.warn("old\\nnews")
"""


@pytest.mark.parametrize("log_format", ["text", "json"])
def test_everything_is_told_in_the_format(log_format: str) -> None:
    lines = lines_of(log_format, LIBRARIES)

    found = [re.search(r"running on (http://\S+)", line) for line in lines]
    assert [match[1] for match in found if match] == ["http://::1:8000"]
    assert len(lines) == 3
    assert "from the craft" in lines[1]
    assert "UserWarning: old" in lines[2]
    if log_format == "json":
        members: list[dict[str, Any]] = [json.loads(line) for line in lines]
        assert [line["level"] for line in members] == ["info", "info", "warning"]
        assert "color_message" not in members[0]


def test_level_is_that_of_the_settings() -> None:
    code = """
import logging
for name in ("boxlift_service", "uvicorn.error", "boxlift"):
    logging.getLogger(name).info("quiet")
    logging.getLogger(name).error("loud")
"""
    assert [line.split(": ")[1] for line in lines_of("text", code, "error")] == ["loud"] * 3


def test_every_line_of_the_service_is_an_object() -> None:
    environment = {**os.environ, "BOXLIFT_PORT": "0", "BOXLIFT_LOG_FORMAT": "json"}
    with subprocess.Popen(
        [sys.executable, "-m", "boxlift_service"], env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            lines.append(json.loads(line))
            if found := re.search(r"running on (http://\S+)", line):
                break
        else:
            pytest.fail("it does not say where it listens")
        headers = {"X-Request-ID": "4711"}
        httpx.post(f"{found[1]}/label", content=b"nonsense", headers=headers)
        httpx.get(f"{found[1]}/%0a%22nothing", headers=headers)
        with socket.create_connection((urlsplit(found[1]).hostname, urlsplit(found[1]).port)) as connection:
            connection.sendall(b"nonsense\r\n\r\n")
            assert connection.recv(100).startswith(b"HTTP/1.1 400")
        process.terminate()
        lines += [json.loads(line) for line in process.stderr]

    assert all({"time", "level", "logger", "message"} <= set(line) for line in lines)
    told = [line for line in lines if line["logger"] == "boxlift_service.requests"]
    assert [(line["method"], line["route"], line["status"]) for line in told] == [
        ("POST", "/label", 415),
        ("GET", "other", 404),
    ]
    assert [line["request_id"] for line in told] == ["4711", "4711"]
    assert told[1]["path"] == '/\n"nothing'
