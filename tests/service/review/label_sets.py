"""Label sets for the review page: small frames, dropped onto a running service."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from uuid import uuid4

import httpx

from service.frames import CAR, SmallFrame, grey_png
from service.running import RunningService

ACCEPTED = {"verdict": "accepted", "box": None, "category": None}
REJECTED = {"verdict": "rejected", "box": None, "category": None}


def drop(
    service: RunningService, frame: SmallFrame, name: str, cars: int = 1, more: Sequence[object] = ()
) -> dict[str, str]:
    """Drop a small frame, with prompts for its car and `more` prompts: label_set and frame."""
    import json

    fields = frame.fields(image=grey_png(), prompts=json.dumps([CAR] * cars + [*more]).encode())
    fields["points"] = (f"{name}.bin", fields["points"][1])
    answer = service.client.post("/review/frames", files=list(fields.items()))
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def correct(
    client: httpx.Client, frame: str, opinion: dict[str, Any], based_on: int = 0, **changes: Any
) -> httpx.Response:
    """POST /review/corrections about the first object of a frame in the label set `labels`."""
    body = {
        "label_set": "labels/dropped",
        "frame": frame,
        "object_index": 0,
        "based_on": based_on,
        "opinion": opinion,
        "author": "ann",
        "request_id": str(uuid4()),
        **changes,
    }
    return client.post("/review/corrections", json=body)
