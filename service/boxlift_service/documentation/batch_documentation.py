"""What OpenAPI says of POST /label:batch."""

from __future__ import annotations

from typing import Any

from boxlift_service.documentation import documentation
from boxlift_service.problems import Kind
from boxlift_service.telemetry.observation import REQUEST_ID_HEADER

_EXAMPLE = """{"frame": "000124", "index": 1, "status": 200, "answer": {"frame": "000124", ...}}
{"frame": "000123", "index": 0, "status": 422, "problem": {"type": "urn:boxlift:problem:invalid-field", ...}}
{"frames": 2, "labelled": 1, "failed": 1, "complete": true}
"""

_KINDS = (
    *documentation.GUARD_KINDS,
    Kind.NOT_ACCEPTABLE,
    Kind.UNSUPPORTED_MEDIA_TYPE,
    Kind.INVALID_FIELD,
    Kind.INTERNAL_ERROR,
)


def responses() -> dict[int | str, dict[str, Any]]:
    """The answers of POST /label:batch."""
    answer = {
        "description": "One line for each frame, in order of completion: frame (its name; null where it has "
        "none that can be read), index (its place in the stream, from 0), status, and answer (as of POST "
        "/label) where the status is 200, else problem (RFC 9457). The last line counts them; complete says "
        "whether the stream was read to its end. Without that line the answer was cut.",
        "content": {"application/x-ndjson": {"schema": {"type": "string"}, "example": _EXAMPLE}},
        "headers": {REQUEST_ID_HEADER: documentation.ANSWER_HEADERS[REQUEST_ID_HEADER]},
    }
    return {200: answer, **documentation.problem_responses(*_KINDS)}


def extra() -> dict[str, Any]:
    """The request of POST /label:batch."""
    stream = {
        "type": "string",
        "format": "binary",
        "description": "msgpack maps, one after the other. Their keys are the fields of POST /label, and "
        "points_filename; their values are bin or str: the bytes that the field of the form would have. "
        "name is required, and no two frames have the same.",
    }
    return {
        "parameters": [
            {
                **documentation.DEADLINE_PARAMETER,
                "description": "Seconds that the client waits for a frame, from when it has been sent.",
            }
        ],
        "requestBody": {"required": True, "content": {"application/msgpack": {"schema": stream}}},
    }
