"""What OpenAPI says beyond the types: the forms of POST /label and /detect, examples, problems of a route."""

from __future__ import annotations

from typing import Any

from boxlift.settings import LabellerSettings
from boxlift_service import problems
from boxlift_service.problems import Kind, ProblemDetails
from boxlift_service.telemetry import timing
from boxlift_service.telemetry.observation import REQUEST_ID_HEADER

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
        "description": "Milliseconds per stage: receive, queue, decode, detect (without prompts), rig, "
        "ground, points, heading, fit, consistency, confidence, encode, total.",
        "schema": {"type": "string"},
        "example": "receive;dur=2.1, queue;dur=0.1, decode;dur=0.9, ..., total;dur=61.4",
    },
    REQUEST_ID_HEADER: {
        "description": "The request's own X-Request-ID, or one that was made for it.",
        "schema": {"type": "string"},
    },
}

DETECT_ANSWER_HEADERS: dict[str, Any] = {
    timing.HEADER: {
        "description": "Milliseconds per stage, summed over the images: receive, queue, decode, detect "
        "(by a detector of one's own), resize, network, encode, total.",
        "schema": {"type": "string"},
        "example": "receive;dur=2.1, queue;dur=1.1, decode;dur=11.9, ..., total;dur=81.4",
    },
    REQUEST_ID_HEADER: ANSWER_HEADERS[REQUEST_ID_HEADER],
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
            "description": "What to label; class and box in pixels, score optional. Without prompts, a "
            "detector finds them in the image.",
            "examples": [_PROMPTS_EXAMPLE],
        },
        "image": {
            **binary,
            "description": "The camera image, PNG or JPEG, needed without prompts. Beside prompts only its "
            "size is read.",
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
        "content": {
            "multipart/form-data": {"schema": schema, "encoding": encoding},
            "application/msgpack": {
                "schema": {
                    "description": "A map with the same fields, each a str or a bin; points_filename is the "
                    "file name of points.",
                    "type": "string",
                    "format": "binary",
                }
            },
        },
    }


def detect_request_body(max_images: int) -> dict[str, Any]:
    """The requestBody of POST /detect."""
    text = {"type": "string"}
    properties = {
        "image": {
            "type": "array",
            "items": {"type": "string", "format": "binary"},
            "minItems": 1,
            "maxItems": max_images,
            "description": "Rectified camera images, PNG or JPEG, each a part of its own. The stem of a "
            "part's file name is the name of its answer.",
        },
        "calib": {
            "type": "array",
            "items": text,
            "minItems": 1,
            "maxItems": max_images,
            "description": "The camera: KITTI calibration text with a line P2, or JSON with P2 3 x 4. One "
            "part for all images, or one for each, in their order. What it says of a LiDAR is not read.",
            "examples": [["P2: 721.5 0 609.6 44.9 0 721.5 172.9 0.2 0 0 1 0.003"]],
        },
        "prompts": {
            **text,
            "contentMediaType": "application/json",
            "contentSchema": {
                "anyOf": [_prompts_schema(), {"type": "array", "items": _prompts_schema()}],
            },
            "description": "The 2D objects to lift, as for POST /label; for several images a list of such "
            "lists, one per image. Without prompts the objects are found.",
            "examples": [_PROMPTS_EXAMPLE, f"[{_PROMPTS_EXAMPLE}, []]"],
        },
        "min_score": {
            **text,
            "description": "Objects that are found with a lower score are left out, a number from 0 to 1; "
            "given prompts never are. Default: the service's setting min_score.",
            "examples": ["0.25"],
        },
    }
    schema = {
        "type": "object",
        "properties": properties,
        "required": ["image", "calib"],
        "additionalProperties": False,
    }
    encoding = {
        "image": {"contentType": _IMAGE_ENCODING},
        "calib": {"contentType": "text/plain, application/json"},
        "prompts": {"contentType": "application/json"},
    }
    return {
        "required": True,
        "description": "Fields as files or as plain text; image and calib may come several times.",
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


_PROBLEM_EXAMPLES = {
    Kind.UNAUTHORIZED: (None, "The request has no API key that is valid here."),
    Kind.FORBIDDEN_ORIGIN: (None, "Pages of 'https://example.org' may not call."),
    Kind.TIMEOUT: (None, "The body stopped after 65536 bytes."),
    Kind.RATE_LIMITED: (None, "The key 'night-run' may send 60 requests a minute."),
    Kind.TOO_BUSY: (None, "15.9 of 16 permits for work are taken."),
    Kind.NOT_RELOADED: (None, "The models cannot be loaded (it is no ONNX file); those before are used on."),
    Kind.DEADLINE_EXCEEDED: (None, "There was no answer within the 2 s of X-Request-Timeout."),
    Kind.UNREADABLE_BODY: (None, "The form ends before its last boundary."),
    Kind.NOT_ACCEPTABLE: (None, "The client accepts 'image/png'."),
    Kind.TOO_LARGE: (None, "The body has 1073741824 bytes."),
    Kind.UNSUPPORTED_MEDIA_TYPE: (None, "The Content-Type is 'application/json'."),
    Kind.INVALID_FIELD: ("points", "none of the 120000 points is finite and within 100 km."),
    Kind.INTERNAL_ERROR: (None, "Request 5f0c failed for a reason that is ours."),
    Kind.WORKER_DIED: (None, "The detect worker was lost with this request: it was ended by SIGKILL."),
    Kind.MODEL_FAILED: (None, "its output 'scores' has 3 rows, boxes_px 4."),
    Kind.NO_DETECTOR: (None, "There is no detector (onnxruntime is not installed)."),
    Kind.NOT_READY: (None, "The warm-up has not ended yet."),
}


GUARD_KINDS = (Kind.UNAUTHORIZED, Kind.FORBIDDEN_ORIGIN, Kind.RATE_LIMITED)
"""How any route may end but the probes."""

WORK_KINDS = (
    *GUARD_KINDS,
    Kind.UNREADABLE_BODY,
    Kind.NOT_ACCEPTABLE,
    Kind.TIMEOUT,
    Kind.TOO_LARGE,
    Kind.UNSUPPORTED_MEDIA_TYPE,
    Kind.INVALID_FIELD,
    Kind.TOO_BUSY,
    Kind.INTERNAL_ERROR,
    Kind.WORKER_DIED,
    Kind.MODEL_FAILED,
    Kind.NO_DETECTOR,
    Kind.NOT_READY,
    Kind.DEADLINE_EXCEEDED,
)
"""How a route may end that computes in the workers."""

DEADLINE_PARAMETER: dict[str, Any] = {
    "name": "X-Request-Timeout",
    "in": "header",
    "description": "Seconds that the client waits; work that is not done by then is dropped.",
    "schema": {"type": "number", "exclusiveMinimum": 0, "maximum": 86400},
}


def with_keys(document: dict[str, Any]) -> dict[str, Any]:
    """The OpenAPI document of a service that asks for API keys."""
    schemes = document.setdefault("components", {}).setdefault("securitySchemes", {})
    schemes["key"] = {"type": "http", "scheme": "bearer", "description": "An API key."}
    document["security"] = [{"key": []}]
    for path in ("/healthz", "/readyz"):
        document["paths"][path]["get"]["security"] = []
    return document


def problem_responses(*kinds: Kind) -> dict[int | str, dict[str, Any]]:
    """The `responses` of a route that may end in these kinds of problems."""
    by_status: dict[int | str, list[Kind]] = {}
    for kind in kinds:
        by_status.setdefault(kind.status, []).append(kind)
    return {
        status: {
            "description": "; ".join(kind.title for kind in alike),
            "content": {
                problems.MEDIA_TYPE: {
                    "schema": ProblemDetails.model_json_schema(),
                    "example": _problem_example(alike[0]),
                }
            },
        }
        for status, alike in by_status.items()
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
