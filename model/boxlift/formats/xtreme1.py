"""The annotation tool Xtreme1: its camera configurations, and the objects that a model answers it with.

Read, and written against, at github.com/xtreme1-io (Apache-2.0; nothing of it is copied):
- camera configuration: docs, product-guides/lidar-annotation-tool/coordinate-system.md; the tool itself reads
  it in xtreme1, frontend/pc-tool/src/packages/pc-editor/utils/common.ts (translateCameraConfig).
- objects: docs, developer-reference/model-integration-guide.md; xtreme1, backend/src/main/java/ai/basic/x1/
  adapter/port/rpc/dto/PointCloudDetectionObject.java; what the tool makes of them, pc-editor/utils/result.ts
  and pc-render/objects/Box.ts (the arrow of a box points along its x).
- classes: the model_class rows of model 1 in xtreme1, deploy/mysql/migration/V2__Init_data.sql.

A camera is {"camera_internal": {fx, fy, cx, cy}, "camera_external": [16 numbers], "width", "height"}, in
camelCase in newer files, where the external matrix brings a point of the LiDAR frame into the camera frame
(x right, y down, z forward). A configuration is a list of cameras, or one camera.

An object is a box in the LiDAR frame: geometric centre x, y, z; dx, dy, dz along its own axes (heading, left,
up: length, width, height); rotX, rotY, rotZ in radians, intrinsic about x, y, z (R = Rx Ry Rz). A box of ours
is level in the camera frame; what the camera leans against the LiDAR stays in rotX and rotY, so that the
box in the tool is the very box that was fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration, Floats
from boxlift.errors import CalibrationError
from boxlift.formats.calibration import ParsedCalibration
from boxlift.formats.json_text import finite_number, parse_json
from boxlift.frame import FrameLabels
from boxlift.overlap import iou_3d

# Xtreme1's own LiDAR model knows the ten classes of nuScenes. There a car may be a van, and the box of a
# bicycle holds its rider (nuscenes-devkit, docs/instructions_nuscenes.md). Other classes keep their names,
# spelt as Xtreme1 spells its codes.
CLASS_CODES = {
    "Car": "CAR",
    "Van": "CAR",
    "Truck": "TRUCK",
    "Bus": "BUS",
    "Motorcycle": "MOTORCYCLE",
    "Cyclist": "BICYCLE",
    "Pedestrian": "PEDESTRIAN",
    "Person_sitting": "PEDESTRIAN",
}

# More than any vehicle has; it bounds the work that one file makes.
_MOST_CAMERAS = 100
_INTERNAL_KEYS = ("cameraInternal", "camera_internal")
_EXTERNAL_KEYS = ("cameraExternal", "camera_external")
# Enough that boxes come back within a millionth of a metre or radian.
_DECIMALS, _SCORE_DECIMALS = 7, 4
# Bodies share no space, but two cameras that each see one end of a body agree on it only roughly (ours).
_SAME_BODY_IOU = 0.1
# Where sin(rotY) is this near to 1, rotX and rotZ turn about the same axis.
_GIMBAL_SINE = 1 - 1e-12
# x_cam = -y_velo, y_cam = -z_velo, z_cam = x_velo.
_LEVEL = Calibration(
    np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]),
    np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
)


class Xtreme1Object(TypedDict):
    """A box in the LiDAR frame as Xtreme1 takes it from a model, metres and radians; confidence in [0, 1]."""

    label: str
    confidence: float
    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    rotX: float
    rotY: float
    rotZ: float


class Xtreme1Results(TypedDict):
    """What is found with one camera: its objects, and doubts about its rig as sentences."""

    objects: list[Xtreme1Object]
    warnings: list[str]


def parse_camera_config(
    data: bytes | str, field: str = "cameraConfig"
) -> tuple[ParsedCalibration | None, ...]:
    """A camera configuration's JSON -> the calibration of each camera, None for one that the tool skips.

    The tool skips a camera without an external matrix of 16 numbers. It takes the matrix for column by
    column where rowMajor is false, or where it looks so; and so does this. `field` is what errors call the
    file. Raises CalibrationError that names camera, key and value.
    """
    cameras = parse_json(data, field, CalibrationError)
    if isinstance(cameras, dict):
        cameras = [cameras]
    if not isinstance(cameras, list) or not 0 < len(cameras) <= _MOST_CAMERAS:
        given = f"{len(cameras)} cameras" if isinstance(cameras, list) else f"{cameras!r:.60}"
        raise CalibrationError(
            field, f"it holds {given}.", f"Give a list of 1 to {_MOST_CAMERAS} cameras, image 0 first."
        )
    return tuple(_parse_camera(camera, f"{field}[{index}]") for index, camera in enumerate(cameras))


def results_of(labels: FrameLabels, calibration: Calibration) -> Xtreme1Results:
    """The boxes of a frame as Xtreme1's objects, in the order of their prompts, and its warnings."""
    velo_R_cam = _rotation(calibration).T
    objects: list[Xtreme1Object] = []
    for label in labels.objects:
        if label.box is None:
            continue
        box = label.box
        x, y, z = (_rounded(axis) for axis in calibration.cam_to_velo(box.center_cam)[0])
        roll, pitch, yaw = (_rounded(angle) for angle in _euler(velo_R_cam @ _box_axes_cam(box)))
        category = label.prompt.category
        objects.append(
            Xtreme1Object(
                label=CLASS_CODES.get(category, category.upper().replace(" ", "_")),
                confidence=_rounded(label.score, _SCORE_DECIMALS),
                x=x,
                y=y,
                z=z,
                dx=_rounded(box.length_m[0]),
                dy=_rounded(box.width_m[0]),
                dz=_rounded(box.height_m[0]),
                rotX=roll,
                rotY=pitch,
                rotZ=yaw,
            )
        )
    return Xtreme1Results(objects=objects, warnings=[warning.sentence for warning in labels.warnings])


def boxes_of(objects: Sequence[Xtreme1Object], calibration: Calibration) -> Boxes3D:
    """Objects of Xtreme1 -> boxes in the camera frame; what they lean against its horizontal is lost."""
    center_velo = np.array([[item["x"], item["y"], item["z"]] for item in objects]).reshape(-1, 3)
    cam_R_velo = _rotation(calibration)
    heading_cam = [
        cam_R_velo @ _rotation_from_euler(item["rotX"], item["rotY"], item["rotZ"])[:, 0] for item in objects
    ]
    x, _, z = np.array(heading_cam).reshape(-1, 3).T
    return Boxes3D(
        center_cam=calibration.velo_to_cam(center_velo),
        length_m=np.array([item["dx"] for item in objects]),
        width_m=np.array([item["dy"] for item in objects]),
        height_m=np.array([item["dz"] for item in objects]),
        rotation_y=np.arctan2(-z, x),
    )


def merged(cameras: Sequence[Sequence[Xtreme1Object]]) -> list[Xtreme1Object]:
    """Objects of several cameras -> each body once, the most confident first.

    Of objects of different cameras that share space the more confident stays, whatever its class. Objects of
    one camera stay as they are: its labels are told apart already.
    """
    objects = [item for camera in cameras for item in camera]
    camera_of = np.repeat(np.arange(len(cameras)), [len(camera) for camera in cameras])
    boxes = boxes_of(objects, _LEVEL)
    order = sorted(range(len(objects)), key=lambda index: -objects[index]["confidence"])
    kept = np.zeros(len(objects), np.bool_)
    for index in order:
        others = np.flatnonzero(kept & (camera_of != camera_of[index]))
        same = np.full(len(others), index)
        kept[index] = not (iou_3d(boxes[same], boxes[others]) > _SAME_BODY_IOU).any()
    return [objects[index] for index in order if kept[index]]


def _parse_camera(camera: object, where: str) -> ParsedCalibration | None:
    values = camera if isinstance(camera, dict) else {}
    external = next((values[key] for key in _EXTERNAL_KEYS if values.get(key)), None)
    if not isinstance(external, list) or len(external) != 16:
        return None
    numbers = [finite_number(value) for value in external]
    finite = [number for number in numbers if number is not None]
    if len(finite) != 16:
        raise CalibrationError(
            f"{where}.{_EXTERNAL_KEYS[1]}",
            f"{external[numbers.index(None)]!r:.40} is no finite number.",
            "Give 16 numbers, the matrix from LiDAR to camera row by row.",
        )
    cam_SE3_velo = np.array(finite).reshape(4, 4)
    if values.get("rowMajor") is False or _looks_column_major(cam_SE3_velo):
        cam_SE3_velo = cam_SE3_velo.T
    fx, fy, cx, cy = _internal(values, where)
    image_P_cam = np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0]])
    try:
        calibration = Calibration(image_P_cam, cam_SE3_velo)
    except CalibrationError as error:
        key = _INTERNAL_KEYS[1] if error.field == "image_P_cam" else _EXTERNAL_KEYS[1]
        raise CalibrationError(f"{where}.{key}", error.problem, error.remedy) from None
    return ParsedCalibration(calibration, _image_size(values))


def _looks_column_major(matrix: Floats) -> bool:
    """Whether the last column is that of a last row, and the last row holds a translation."""
    return not matrix[:3, 3].any() and bool(matrix[3, :3].any())


def _internal(values: dict[str, object], where: str) -> list[float]:
    """fx, fy, cx, cy in pixels."""
    internal = next((values[key] for key in _INTERNAL_KEYS if values.get(key)), None)
    found = []
    for key in ("fx", "fy", "cx", "cy"):
        value = internal.get(key) if isinstance(internal, dict) else None
        number = finite_number(value)
        if number is None or (key in ("fx", "fy") and number <= 0):
            raise CalibrationError(
                f"{where}.{_INTERNAL_KEYS[1]}.{key}",
                f"{value!r:.40} is no {'focal length' if key[0] == 'f' else 'number'}.",
                "Give pixels of the image, fx and fy above 0.",
            )
        found.append(number)
    return found


def _image_size(values: dict[str, object]) -> tuple[int, int] | None:
    """(width, height) where it says so; the tool goes by the image itself, and so must whoever has one."""
    width, height = (finite_number(values.get(key)) for key in ("width", "height"))
    return (int(width), int(height)) if width and height and width >= 1 and height >= 1 else None


def _rotation(calibration: Calibration) -> Floats:
    """(3, 3) rotation from the LiDAR to the camera frame that is nearest to the one that was calibrated."""
    u, _, vt = np.linalg.svd(calibration.cam_SE3_velo[:3, :3])
    nearest: Floats = u @ vt
    return nearest


def _box_axes_cam(box: Boxes3D) -> Floats:
    """(3, 3) axes of a box of length 1 in the camera frame, in columns: heading, left, up."""
    cos, sin = np.cos(box.rotation_y[0]), np.sin(box.rotation_y[0])
    return np.array([[cos, sin, 0], [0, 0, -1], [-sin, cos, 0]])


def _euler(rotation: Floats) -> tuple[float, float, float]:
    """(3, 3) -> angles about x, y, z with Rx Ry Rz = rotation."""
    sine = float(rotation[0, 2].clip(-1, 1))
    pitch = float(np.arcsin(sine))
    if abs(sine) > _GIMBAL_SINE:
        return float(np.arctan2(rotation[2, 1], rotation[1, 1])), pitch, 0.0
    roll = np.arctan2(-rotation[1, 2], rotation[2, 2])
    yaw = np.arctan2(-rotation[0, 1], rotation[0, 0])
    return float(roll), pitch, float(yaw)


def _rotation_from_euler(roll: float, pitch: float, yaw: float) -> Floats:
    """Angles about x, y, z -> (3, 3) Rx Ry Rz."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rotation: Floats = about_x @ about_y @ about_z
    return rotation


def _rounded(value: float, decimals: int = _DECIMALS) -> float:
    """A plain Python float without a negative zero."""
    return round(float(value), decimals) + 0.0
