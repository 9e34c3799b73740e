"""What OpenAPI says beyond the types: the form of POST /label, examples, and the problems of a route."""

from __future__ import annotations

from typing import Any

import boxlift
from boxlift.formats.details import (
    BoxDetails,
    KittiDetails,
    LossDetails,
    ObjectDetails,
    PointDetails,
)
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift_service import problems, timing
from boxlift_service.answers import API_VERSION, LabelAnswer
from boxlift_service.problems import Kind, ProblemDetails
from boxlift_service.request_id import HEADER as REQUEST_ID_HEADER

_CALIB_JSON_EXAMPLE = """{"P2": [[721.5, 0, 609.6, 44.9], [0, 721.5, 172.9, 0.2], [0, 0, 1, 0.003]],
 "cam_T_velo": [[0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]],
 "image_size": [1242, 375]}"""
_CALIB_TEXT_EXAMPLE = """P2: 721.5 0 609.6 44.9 0 721.5 172.9 0.2 0 0 1 0.003
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
"""
_PROMPTS_EXAMPLE = '[{"class": "Car", "box": [587.0, 173.3, 614.1, 200.1], "score": 0.97}]'
_OPTIONS_EXAMPLE = '{"preset": "accurate", "repairs": {"size": "fixed"}}'
_IMAGE_ENCODING = "image/png, image/jpeg"

LABEL_TEXT_EXAMPLE = (
    "Car -1 -1 -1.63 587.00 173.30 614.10 200.10 1.60 1.80 4.00 -0.71 1.88 25.10 -1.66 0.8714\n"
)

ANSWER_HEADERS: dict[str, Any] = {
    timing.HEADER: {
        "description": "Milliseconds per stage: receive, queue, decode, rig, ground, points, heading, fit, "
        "consistency, confidence, encode, total.",
        "schema": {"type": "string"},
        "example": "receive;dur=2.1, queue;dur=0.1, decode;dur=0.9, ..., total;dur=61.4",
    },
    REQUEST_ID_HEADER: {
        "description": "The request's own X-Request-ID, or one that was made for it.",
        "schema": {"type": "string"},
    },
}


def label_request_body() -> dict[str, Any]:
    """The requestBody of POST /label."""
    text = {"type": "string"}
    binary = {"type": "string", "format": "binary"}
    properties = {
        "points": {
            **binary,
            "description": "LiDAR points in the LiDAR's frame (x forward, y left, z up), metres: KITTI .bin "
            "(float32 x, y, z, intensity), .npy or .npz array (N, 3+), .pcd, .ply. Points that are not "
            "finite are dropped and counted.",
        },
        "calib": {
            **text,
            "description": "KITTI calibration text, or JSON: P2 3 x 4; cam_T_velo 4 x 4, or R0_rect with "
            "Tr_velo_to_cam; image_size [width, height], needed where no image comes along.",
            "examples": [_CALIB_JSON_EXAMPLE, _CALIB_TEXT_EXAMPLE],
        },
        "prompts": {
            **text,
            "contentMediaType": "application/json",
            "contentSchema": _prompts_schema(),
            "description": "What to label; class and box in pixels, score optional. Without prompts a "
            "detector would be needed.",
            "examples": [_PROMPTS_EXAMPLE],
        },
        "image": {
            **binary,
            "description": "The camera image, PNG or JPEG. Beside prompts only its size is read.",
        },
        "masks": {
            **binary,
            "description": "16-bit PNG of the image's size: prompt index + 1 at the pixels of a prompt, 0 "
            "elsewhere. Only points in mask and box count as the object's.",
        },
        "options": {
            **text,
            "contentMediaType": "application/json",
            "contentSchema": _options_schema(),
            "description": "Preset and settings laid over it. `sizes` declares classes: height_m, width_m, "
            "length_m and their source; it lies over the built-in classes only, not over the service's.",
            "examples": [_OPTIONS_EXAMPLE],
        },
        "name": {
            **text,
            "minLength": 1,
            "maxLength": 200,
            "description": "Name of the frame. It seeds every random choice: same name and input, same "
            "labels. Default: the file name of `points` without its suffix, else 'frame'.",
            "examples": ["000123"],
        },
    }
    schema = {
        "type": "object",
        "properties": properties,
        "required": ["points", "calib"],
        "additionalProperties": False,
    }
    encoding = {
        "points": {"contentType": "application/octet-stream"},
        "calib": {"contentType": "text/plain, application/json"},
        "prompts": {"contentType": "application/json"},
        "image": {"contentType": _IMAGE_ENCODING},
        "masks": {"contentType": "image/png"},
        "options": {"contentType": "application/json"},
    }
    return {
        "required": True,
        "description": "Every field once, as a file or as plain text.",
        "content": {"multipart/form-data": {"schema": schema, "encoding": encoding}},
    }


def _prompts_schema() -> dict[str, Any]:
    prompt = {
        "type": "object",
        "properties": {
            "class": {"type": "string", "minLength": 1, "maxLength": 100},
            "box": {
                "type": "array",
                "items": {"type": "number"},
                "minItems": 4,
                "maxItems": 4,
                "description": "x1, y1, x2, y2 in pixels.",
            },
            "score": {"type": "number", "default": 1.0},
        },
        "required": ["class", "box"],
        "additionalProperties": False,
    }
    return {"type": "array", "items": prompt}


def _options_schema() -> dict[str, Any]:
    """The schema of LabellerSettings with its groups in place, so that it stands inside another one."""
    schema = LabellerSettings.model_json_schema()
    groups = schema.pop("$defs")

    def in_place(value: Any) -> Any:
        if isinstance(value, list):
            return [in_place(item) for item in value]
        if not isinstance(value, dict):
            return value
        if "$ref" in value:
            return in_place(groups[value["$ref"].rpartition("/")[2]])
        return {key: in_place(item) for key, item in value.items()}

    placed: dict[str, Any] = in_place(schema)
    return placed


def with_label_answer_example(document: dict[str, Any]) -> dict[str, Any]:
    """The OpenAPI document with an example of POST /label's JSON; FastAPI would strip its nulls."""
    answer = document["paths"]["/label"]["post"]["responses"]["200"]["content"]["application/json"]
    answer["example"] = _label_answer_example()
    return document


def _label_answer_example() -> dict[str, Any]:
    """An object that has a box and one that has none."""
    fitted = ObjectDetails(
        category="Car",
        index=0,
        prompt_box_px=(587.0, 173.3, 614.1, 200.1),
        prompt_score=0.97,
        result="FITTED",
        sentence="A box was fitted.",
        score=0.8714,
        flags=(),
        box=BoxDetails(
            center_cam=(-0.712, 1.081, 25.1), length_m=4.0, width_m=1.8, height_m=1.6, rotation_y=-1.66
        ),
        kitti=KittiDetails(
            type="Car",
            truncated=-1,
            occluded=-1,
            alpha=-1.63,
            bbox=(587.0, 173.3, 614.1, 200.1),
            dimensions=(1.6, 1.8, 4.0),
            location=(-0.71, 1.88, 25.1),
            rotation_y=-1.66,
            score=0.8714,
        ),
        losses=LossDetails(geometric=0.0512, ray_tracing=0.0731, center=1.2043, total=0.2447),
        points=PointDetails(in_prompt=181, above_ground=164, in_cluster=152, used=77),
        rejected=(),
    )
    unusable = ObjectDetails(
        category="Car",
        index=1,
        prompt_box_px=(10.0, 180.0, 16.0, 184.0),
        prompt_score=0.41,
        result="TOO_FEW_POINTS",
        sentence="Too few LiDAR points inside the 2D box (3, at least 10 are needed).",
        score=0.0,
        flags=(),
        box=None,
        kitti=None,
        losses=None,
        points=PointDetails(in_prompt=3, above_ground=0, in_cluster=0, used=0),
        rejected=(),
    )
    answer = LabelAnswer(
        frame="000123",
        objects=(fitted, unusable),
        warnings=(),
        dropped_points=0,
        preset=ACCURATE.preset,
        settings_fingerprint=ACCURATE.fingerprint(),
        model_digest=None,
        api_version=API_VERSION,
        boxlift_version=boxlift.__version__,
    )
    return answer.model_dump(mode="json", by_alias=True)


_PROBLEM_EXAMPLES = {
    Kind.UNREADABLE_BODY: (None, "The form ends before its last boundary."),
    Kind.NOT_ACCEPTABLE: (None, "The client accepts 'image/png'."),
    Kind.TOO_LARGE: (None, "The body has 1073741824 bytes."),
    Kind.UNSUPPORTED_MEDIA_TYPE: (None, "The Content-Type is 'application/json'."),
    Kind.INVALID_FIELD: ("points", "none of the 120000 points is finite and within 100 km."),
    Kind.INTERNAL_ERROR: (None, "Request 5f0c failed for a reason that is ours."),
    Kind.NO_DETECTOR: (None, "no detector is installed."),
    Kind.NOT_READY: (None, "The warm-up has not ended yet."),
}


def problem_responses(*kinds: Kind) -> dict[int | str, dict[str, Any]]:
    """The `responses` of a route that may end in these kinds of problems."""
    return {
        kind.status: {
            "description": kind.title,
            "content": {
                problems.MEDIA_TYPE: {
                    "schema": ProblemDetails.model_json_schema(),
                    "example": _problem_example(kind),
                }
            },
        }
        for kind in kinds
    }


def _problem_example(kind: Kind) -> dict[str, Any]:
    field, problem = _PROBLEM_EXAMPLES[kind]
    example = ProblemDetails(
        type=kind.uri,
        title=kind.title,
        status=kind.status,
        detail=problem,
        instance="/label",
        field=field,
        problem=problem,
    )
    return example.model_dump(exclude_none=True)
