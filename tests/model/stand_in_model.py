"""A monocular model made by hand: a real ONNX file with the real interface and simple arithmetic inside.

Each prompt is lifted by the height of a car, 1.5 m, in pixels, along the ray through the middle of its box;
without prompts there is one object, in the middle of the image, half as tall as it. Scores are the mean
brightness of the image over 255, halved: the image counts. Sizes are 4 x 1.7 x 1.5 m, the rotation .3, the
spread .05.
"""

from __future__ import annotations

import json
from pathlib import Path

from onnx import TensorProto, helper

from model.onnx_files import IMAGE, constant, save, value

FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64
FOCAL_PX = 700.0
HEIGHT_M = 1.5
METADATA = {
    "boxlift_interface": "monocular/1",
    "classes": json.dumps(["Car", "Pedestrian"]),
    "focal_px": str(FOCAL_PX),
    "training_data": "none",
    "licence": "Apache-2.0",
}


def stand_in_model(
    path: Path,
    *,
    height_m: float = HEIGHT_M,
    metadata: dict[str, str] | None = None,
    length_m: float = 4.0,
    brightest: int = 256,
) -> Path:
    """Write the model; `height_m` of NaN gives numbers that are none, a negative one depths behind.

    It fails on images whose mean brightness is `brightest` or more.
    """
    node = helper.make_node
    nodes = [
        constant("zero", INT64, [1], [0]),
        constant("one", INT64, [1], [1]),
        constant("two", INT64, [1], [2]),
        constant("three", INT64, [1], [3]),
        constant("height_m", FLOAT, [1], [height_m]),
        constant("half", FLOAT, [1], [0.5]),
        constant("to_score", FLOAT, [1], [0.5 / 255]),
        constant("size", FLOAT, [1, 3], [length_m, 1.7, HEIGHT_M]),
        constant("rotation", FLOAT, [1], [0.3]),
        constant("spread", FLOAT, [1], [0.05]),
        constant("unit", FLOAT, [1], [1.0]),
        constant("middle", FLOAT, [4], [0.25, 0.25, 0.75, 0.75]),
        # One object of its own in the middle of the image, used where there are no prompts.
        node("Shape", ["image"], ["shape"]),
        node("Cast", ["shape"], ["sides"], to=FLOAT),
        node("Gather", ["sides", "one"], ["width"]),
        node("Gather", ["sides", "zero"], ["height"]),
        node("Concat", ["width", "height", "width", "height"], ["whole"], axis=0),
        node("Mul", ["whole", "middle"], ["own_flat"]),
        node("Unsqueeze", ["own_flat", "zero"], ["own"]),
        node("Shape", ["prompt_categories"], ["prompts"]),
        node("Max", ["prompts", "one"], ["rows"]),
        node("Concat", ["prompt_boxes_px", "own"], ["all_boxes"], axis=0),
        node("Slice", ["all_boxes", "zero", "rows", "zero"], ["boxes_px"]),
        node("Concat", ["prompt_categories", "zero"], ["all_categories"], axis=0),
        node("Slice", ["all_categories", "zero", "rows", "zero"], ["categories"]),
        # depth = f_y H / h; x and y along the ray through the middle of the box.
        *(node("Gather", ["boxes_px", side], [edge], axis=1) for side, edge in _EDGES.items()),
        node("Gather", ["image_P_cam", "zero"], ["row_x"], axis=0),
        node("Gather", ["image_P_cam", "one"], ["row_y"], axis=0),
        node("Gather", ["row_x", "zero"], ["f_x"], axis=1),
        node("Gather", ["row_x", "two"], ["c_x"], axis=1),
        node("Gather", ["row_y", "one"], ["f_y"], axis=1),
        node("Gather", ["row_y", "two"], ["c_y"], axis=1),
        node("Sub", ["y2", "y1"], ["tall_px"]),
        node("Mul", ["f_y", "height_m"], ["f_times_height"]),
        node("Div", ["f_times_height", "tall_px"], ["depth"]),
        *_along_ray("x", "x1", "x2"),
        *_along_ray("y", "y1", "y2"),
        node("Concat", ["x_cam", "y_cam", "depth"], ["centers_cam"], axis=1),
        node("Concat", ["rows", "three"], ["rows_by_3"], axis=0),
        node("Expand", ["size", "rows_by_3"], ["sizes_m"]),
        node("Expand", ["rotation", "rows"], ["rotations_y"]),
        node("Expand", ["spread", "rows"], ["depth_spread"]),
        node("Expand", ["unit", "rows"], ["detection_scores"]),
        node("Cast", ["image"], ["bright"], to=FLOAT),
        node("ReduceMean", ["bright"], ["mean"], keepdims=0),
        constant("table", FLOAT, [brightest], [0.0] * brightest),
        node("Cast", ["mean"], ["place"], to=INT64),
        node("Gather", ["table", "place"], ["nothing"]),  # fails beyond the table's end
        node("Add", ["mean", "nothing"], ["brightness"]),
        node("Mul", ["brightness", "to_score"], ["score"]),
        node("Expand", ["score", "rows"], ["scores"]),
    ]
    inputs = [
        IMAGE,
        value("image_P_cam", FLOAT, (3, 4)),
        value("prompt_boxes_px", FLOAT, ("N", 4)),
        value("prompt_categories", INT64, ("N",)),
    ]
    outputs = [
        value("boxes_px", FLOAT, ("M", 4)),
        value("categories", INT64, ("M",)),
        value("detection_scores", FLOAT, ("M",)),
        value("centers_cam", FLOAT, ("M", 3)),
        value("sizes_m", FLOAT, ("M", 3)),
        value("rotations_y", FLOAT, ("M",)),
        value("depth_spread", FLOAT, ("M",)),
        value("scores", FLOAT, ("M",)),
    ]
    return save(path, nodes, inputs, outputs, METADATA if metadata is None else metadata)


_EDGES = {"zero": "x1", "one": "y1", "two": "x2", "three": "y2"}


def _along_ray(axis: str, low: str, high: str) -> list[object]:
    node = helper.make_node
    return [
        node("Add", [low, high], [f"{axis}_sum"]),
        node("Mul", [f"{axis}_sum", "half"], [f"{axis}_px"]),
        node("Sub", [f"{axis}_px", f"c_{axis}"], [f"{axis}_off"]),
        node("Div", [f"{axis}_off", f"f_{axis}"], [f"{axis}_ray"]),
        node("Mul", [f"{axis}_ray", "depth"], [f"{axis}_cam"]),
    ]
