"""Calibration files: KITTI's text and our JSON.

KITTI text: one `KEY: numbers` a line. Read are the camera's projection (`P2`), `R0_rect` and
`Tr_velo_to_cam`, also in the spellings of KITTI's raw and tracking data (`P_rect_02`, `R_rect`,
`R_rect_00`, `Tr_velo_cam`; the colon may be missing). Other keys are skipped.

JSON: {"P2": 3 x 4, "cam_T_velo": 4 x 4} or, in place of the latter, {"R0_rect": 3 x 3,
"Tr_velo_to_cam": 3 x 4}; optionally "image_size": [width, height] in pixels, and for images that are not
rectified "distortion": [k1, k2, p1, p2, k3] (OpenCV's order) with "distortion_model": "plumb_bob" (the
default), "rational_polynomial" or "kannala_brandt" (fisheye). Other keys are errors.

Where only the camera counts (`camera_only`, as to find objects in an image), the projection is enough: what
either format says of a LiDAR is not read, and the calibration has a LiDAR in the camera's place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration, Floats
from boxlift.errors import CalibrationError, member
from boxlift.formats import archives
from boxlift.formats.json_text import finite_number, parse_json
from boxlift.lens import Lens
from boxlift.storage import read_input

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

SUFFIXES = (".txt", ".json")

_LARGEST_IMAGE_SIDE_PX = 65_535
# x_cam = -y_velo, y_cam = -z_velo, z_cam = x_velo.
_LIDAR_IN_PLACE_OF_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_LENS_KEYS = ("distortion", "distortion_model")
_JSON_KEYS = ("P2", "cam_T_velo", "R0_rect", "Tr_velo_to_cam", "image_size", *_LENS_KEYS)


@dataclass(frozen=True)
class ParsedCalibration:
    """What a calibration file says.

    image_size_px is (width, height) where it says so; lens that of an image which is not rectified yet.
    """

    calibration: Calibration
    image_size_px: tuple[int, int] | None = None
    lens: Lens | None = None


def parse_calibration(
    data: bytes | str,
    field: str = "calib",
    camera: int = 2,
    *,
    camera_only: bool = False,
    with_lens: bool = False,
) -> ParsedCalibration:
    """A calibration file's content -> calibration. What begins with { is JSON, else it is KITTI text.

    `field` is what errors call the file; `camera` the number of KITTI's camera (P0 to P3), for text;
    `camera_only` leaves the LiDAR out; only where the caller can rectify (`with_lens`) may there be a
    distortion. Raises CalibrationError that names key, value and remedy.
    """
    if isinstance(data, bytes):
        archive = archives.archive_kind(data)
        if archive is not None:
            raise CalibrationError(field, f"the data is {archive}.", archives.REMEDY)
        try:
            data = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise CalibrationError(
                field, "the data is not text.", "Give KITTI calibration text or JSON."
            ) from None
    if data.lstrip().startswith("{"):
        return _parse_json(data, field, camera_only, with_lens)
    return ParsedCalibration(_parse_kitti_text(data, field, camera, camera_only))


def read_calibration(
    path: AnyPath, camera: int = 2, *, camera_only: bool = False, with_lens: bool = False
) -> ParsedCalibration:
    """parse_calibration for a file. Raises CalibrationError, also where the file cannot be opened."""
    data = read_input(path, CalibrationError)
    return parse_calibration(data, str(path), camera, camera_only=camera_only, with_lens=with_lens)


def imu_to_velo(path: AnyPath) -> Floats:
    """(4, 4) of a calibration file's Tr_imu_to_velo, in either spelling. Raises CalibrationError."""
    lines = _keyed_lines(read_input(path, CalibrationError).decode(errors="replace"))
    return _compose(np.eye(3), _matrix(lines, ("Tr_imu_to_velo", "Tr_imu_velo"), (3, 4), str(path)))


def to_kitti_text(calibration: Calibration) -> str:
    """KITTI text with all of KITTI's keys; the rectification is the identity, as cam_SE3_velo holds it.

    The four cameras are given the same projection.
    """
    rows = {f"P{camera}": calibration.image_P_cam for camera in range(4)}
    rows["R0_rect"] = np.eye(3)
    rows["Tr_velo_to_cam"] = calibration.cam_SE3_velo[:3]
    rows["Tr_imu_to_velo"] = np.eye(4)[:3]
    return "".join(
        f"{key}: {' '.join(f'{n:.12e}' for n in matrix.ravel())}\n" for key, matrix in rows.items()
    )


def _parse_kitti_text(text: str, field: str, camera: int, camera_only: bool) -> Calibration:
    lines = _keyed_lines(text)
    image_P_cam = _matrix(lines, (f"P{camera}", f"P_rect_{camera:02d}"), (3, 4), field)
    if camera_only:
        return _camera(image_P_cam, f"{field}.P{camera}")
    rectification = _matrix(lines, ("R0_rect", "R_rect", "R_rect_00"), (3, 3), field)
    cam0_from_velo = _matrix(lines, ("Tr_velo_to_cam", "Tr_velo_cam"), (3, 4), field)
    return _calibration(
        image_P_cam, _compose(rectification, cam0_from_velo), f"{field}.P{camera}", f"{field}.Tr_velo_to_cam"
    )


def _keyed_lines(text: str) -> dict[str, list[str]]:
    lines: dict[str, list[str]] = {}
    for line in text.splitlines():
        words = line.replace(":", " ", 1).split()
        if words:
            lines[words[0]] = words[1:]
    return lines


def _matrix(lines: dict[str, list[str]], keys: tuple[str, ...], shape: tuple[int, int], field: str) -> Floats:
    """The first of the keys that is there; errors name it."""
    key = next((key for key in keys if key in lines), None)
    if key is None:
        found = f"its keys are {sorted(lines)[:12]}" if lines else "it is empty"
        raise CalibrationError(
            f"{field}.{keys[0]}",
            f"the calibration has no line {keys[0]}: ({found:.200}).",
            f"Add '{keys[0]}:' with {shape[0] * shape[1]} numbers.",
        )
    numbers = []
    for word in lines[key]:
        try:
            numbers.append(float(word))
        except ValueError:
            raise CalibrationError(
                f"{field}.{key}", f"{word!r:.40} is not a number.", f"Give {shape[0] * shape[1]} numbers."
            ) from None
    if len(numbers) != shape[0] * shape[1]:
        raise CalibrationError(
            f"{field}.{key}",
            f"the line has {len(numbers)} numbers.",
            f"Give {shape[0] * shape[1]} numbers ({shape[0]} x {shape[1]}, row by row).",
        )
    return _finite(np.array(numbers).reshape(shape), f"{field}.{key}")


def _parse_json(text: str, field: str, camera_only: bool, with_lens: bool) -> ParsedCalibration:
    values = parse_json(text, field, CalibrationError)
    if not isinstance(values, dict):
        raise CalibrationError(field, "the JSON is no object.", f"Give an object with {list(_JSON_KEYS)}.")
    for key in values:
        if key not in _JSON_KEYS:
            raise CalibrationError(
                member(field, key),
                f"the key {key!r:.40} is unknown.",
                f"Known keys: {', '.join(_JSON_KEYS)}.",
            )

    def matrix(key: str, shape: tuple[int, int]) -> Floats:
        where, remedy = f"{field}.{key}", f"Give {shape[0]} rows of {shape[1]} numbers."
        if key not in values:
            raise CalibrationError(where, f"the calibration has no {key}.", remedy)
        rows = values[key]
        if not isinstance(rows, list) or len(rows) != shape[0]:
            raise CalibrationError(where, f"{rows!r:.80} has not {shape[0]} rows.", remedy)
        numbers = np.empty(shape)
        for r, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != shape[1]:
                raise CalibrationError(f"{where}[{r}]", f"{row!r:.80} has not {shape[1]} numbers.", remedy)
            for c, value in enumerate(row):
                number = finite_number(value)
                if number is None:
                    raise CalibrationError(
                        f"{where}[{r}][{c}]", f"{value!r:.40} is no finite number.", remedy
                    )
                numbers[r, c] = number
        return numbers

    image_P_cam = matrix("P2", (3, 4))
    size = None if "image_size" not in values else _image_size(values["image_size"], f"{field}.image_size")
    lens = _lens(values, image_P_cam, field)
    if lens is not None and not with_lens:
        raise CalibrationError(
            f"{field}.distortion",
            "the image is not rectified.",
            "Rectify it and leave the distortion out, or label the folder with boxlift label, which does so.",
        )
    if camera_only:
        return ParsedCalibration(_camera(image_P_cam, f"{field}.P2"), size)
    by_parts = [key for key in ("R0_rect", "Tr_velo_to_cam") if key in values]
    if "cam_T_velo" in values:
        if by_parts:
            raise CalibrationError(
                f"{field}.{by_parts[0]}",
                f"{by_parts[0]} comes beside cam_T_velo.",
                "Give cam_T_velo, or R0_rect with Tr_velo_to_cam.",
            )
        cam_SE3_velo, lidar_key = matrix("cam_T_velo", (4, 4)), "cam_T_velo"
        if not np.allclose(cam_SE3_velo[3], (0, 0, 0, 1), atol=1e-9):
            raise CalibrationError(
                f"{field}.cam_T_velo[3]",
                f"the last row is {cam_SE3_velo[3].tolist()}.",
                "It must be [0, 0, 0, 1].",
            )
    elif by_parts:
        cam_SE3_velo = _compose(matrix("R0_rect", (3, 3)), matrix("Tr_velo_to_cam", (3, 4)))
        lidar_key = "Tr_velo_to_cam"
    else:
        raise CalibrationError(
            f"{field}.cam_T_velo",
            "the calibration does not say where the LiDAR is.",
            "Give cam_T_velo (4 x 4), or R0_rect (3 x 3) with Tr_velo_to_cam (3 x 4).",
        )
    calibration = _calibration(image_P_cam, cam_SE3_velo, f"{field}.P2", f"{field}.{lidar_key}")
    return ParsedCalibration(calibration, size, lens)


def _lens(values: dict[str, Any], image_P_cam: Floats, field: str) -> Lens | None:
    given = values.get("distortion", [])
    numbers = [finite_number(value) for value in given] if isinstance(given, list) else [None]
    if None in numbers:
        raise CalibrationError(
            f"{field}.distortion", f"{given!r:.80} is no list of numbers.", "Give OpenCV's coefficients."
        )
    try:
        model = values.get("distortion_model", "plumb_bob")
        return Lens.of(image_P_cam, str(model), [number for number in numbers if number is not None])
    except CalibrationError as error:
        raise CalibrationError(f"{field}.{error.field}", error.problem, error.remedy) from None


def _image_size(value: object, where: str) -> tuple[int, int]:
    numbers = [finite_number(side) for side in value] if isinstance(value, list) else []
    sides = [int(n) for n in numbers if n is not None and n == int(n) and 1 <= n <= _LARGEST_IMAGE_SIDE_PX]
    if len(numbers) != 2 or len(sides) != 2:
        raise CalibrationError(where, f"{value!r:.80} is no image size.", "Give [width, height] in pixels.")
    return sides[0], sides[1]


def _compose(rectification: Floats, cam0_from_velo: Floats) -> Floats:
    """R0_rect @ Tr_velo_to_cam as a 4 x 4 matrix."""
    cam_SE3_velo = np.eye(4)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused by _calibration
        cam_SE3_velo[:3] = rectification @ cam0_from_velo
    return cam_SE3_velo


def _finite(matrix: NDArray[np.float64], where: str) -> Floats:
    if not np.isfinite(matrix).all():
        raise CalibrationError(where, f"{matrix.tolist()} is not finite.", "Replace NaN and infinity.")
    return matrix


def _camera(image_P_cam: Floats, camera_key: str) -> Calibration:
    """The calibration of a camera alone."""
    return _calibration(image_P_cam, _LIDAR_IN_PLACE_OF_CAMERA, camera_key, camera_key)


def _calibration(image_P_cam: Floats, cam_SE3_velo: Floats, camera_key: str, lidar_key: str) -> Calibration:
    """Calibration whose errors name the file's own keys."""
    try:
        return Calibration(image_P_cam, cam_SE3_velo)
    except CalibrationError as error:
        where = camera_key if error.field == "image_P_cam" else lidar_key
        raise CalibrationError(where, error.problem, error.remedy) from None
