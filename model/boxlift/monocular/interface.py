"""What an ONNX file must offer to be used as monocular model ("monocular/1").

With prompts M = N, rows in the order of the prompts; without (N = 0) the model finds the objects itself.
Boxes and the projection are in pixels of the image that is given, with (0, 0) the centre of the top left
pixel; the rest is in the rectified camera frame, metres and radians.

    boxes_px          x1, y1, x2, y2
    categories        index into the property `classes`
    detection_scores  of the 2D object; 1 for prompts, whose own score is multiplied in outside
    centers_cam       geometric centre x, y, z
    sizes_m           length, width, height
    rotations_y       about the y axis; heading is (cos, 0, -sin) of it
    depth_spread      relative standard deviation of the depth
    scores            confidence in the 3D box, that in the 2D object multiplied in

Properties: `classes` (JSON list of names), `focal_px` (focal length at which the model knows the world:
images are resized to it before they are given). Optional: `heading_period` (`pi` where front and back are
not told apart, as of ours; `2pi` where they are). What else a file says of itself (training_data, licence,
...) is shown to users as it is.
"""

from __future__ import annotations

from boxlift.onnx_model import Interface, Tensor

MONOCULAR = Interface(
    inputs=(
        Tensor("image", "uint8", ("H", "W", 3)),
        Tensor("image_P_cam", "float32", (3, 4)),
        Tensor("prompt_boxes_px", "float32", ("N", 4)),
        Tensor("prompt_categories", "int64", ("N",)),
    ),
    outputs=(
        Tensor("boxes_px", "float32", ("M", 4)),
        Tensor("categories", "int64", ("M",)),
        Tensor("detection_scores", "float32", ("M",)),
        Tensor("centers_cam", "float32", ("M", 3)),
        Tensor("sizes_m", "float32", ("M", 3)),
        Tensor("rotations_y", "float32", ("M",)),
        Tensor("depth_spread", "float32", ("M",)),
        Tensor("scores", "float32", ("M",)),
    ),
    metadata={"boxlift_interface": "monocular/1", "classes": None, "focal_px": None},
    remedy="Give a model with the interface of boxlift.monocular.interface.",
)
