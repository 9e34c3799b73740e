"""Log lines as text or as JSON objects; nothing a client sent can begin a line of its own."""

from __future__ import annotations

import json
import logging
import logging.config
import re
from collections.abc import Mapping
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any, Literal

of_request: ContextVar[Mapping[str, str] | None] = ContextVar("of_request", default=None)
"""What every line that is logged while a request is handled says, e.g. its `request_id`."""

_LINE_BREAKERS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")


def configure_logging(log_format: Literal["text", "json"], log_level: str) -> None:
    """Everything that this process logs or warns of goes to stderr in this format.

    `log_level` is the least level of boxlift and uvicorn; libraries are heard from WARNING on.
    """
    logging.config.dictConfig(log_config(log_format, log_level))
    logging.captureWarnings(True)


def log_config(log_format: Literal["text", "json"], log_level: str) -> dict[str, Any]:
    """The same as a dictConfig."""
    formatter = JsonFormatter if log_format == "json" else TextFormatter
    level = log_level.upper()
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"default": {"()": formatter}},
        "handlers": {
            "default": {
                "class": "logging.StreamHandler",
                "formatter": "default",
                "stream": "ext://sys.stderr",
            }
        },
        "root": {"handlers": ["default"], "level": "WARNING"},
        "loggers": {
            "boxlift": {"level": level},
            "boxlift_service": {"level": level},
            "uvicorn": {"level": level},
            # It would log a line for every malformed form, and the answer says it already.
            "python_multipart": {"level": "ERROR"},
        },
    }


class TextFormatter(logging.Formatter):
    """`TIME LEVEL LOGGER: MESSAGE [REQUEST ID]`; the lines of a traceback begin with a bar."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as a line, or, with an exception, as lines."""
        request_id = (of_request.get() or {}).get("request_id")
        line = f"{_time(record)} {record.levelname} {record.name}: {_escaped(record.getMessage())}"
        lines = [f"{line} [{request_id}]" if request_id else line]
        if (trace := _trace(self, record)) is not None:
            lines += ["    | " + _escaped(part) for part in trace.split("\n")]
        return "\n".join(lines)


class JsonFormatter(logging.Formatter):
    """One object a line: time, level, logger, message, what is known of the request, exception.

    `extra={"fields": {...}}` adds members.
    """

    def format(self, record: logging.LogRecord) -> str:
        """The record as a line; ASCII, since what a client sent need not be valid Unicode."""
        members = {
            "time": _time(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **(of_request.get() or {}),
            **getattr(record, "fields", {}),
        }
        if (trace := _trace(self, record)) is not None:
            members["exception"] = trace
        return json.dumps(members, default=str)


def _time(record: logging.LogRecord) -> str:
    """ISO 8601, UTC."""
    moment = datetime.fromtimestamp(record.created, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _trace(formatter: logging.Formatter, record: logging.LogRecord) -> str | None:
    return formatter.formatException(record.exc_info) if record.exc_info else None


def _escaped(text: str) -> str:
    """`text` on one line: what breaks lines or steers terminals is written as in Python."""
    return _LINE_BREAKERS.sub(lambda found: repr(found[0])[1:-1], text)
