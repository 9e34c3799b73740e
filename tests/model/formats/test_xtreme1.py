"""Xtreme1's camera configurations and objects: by hand, there and back, and refusals that name the key."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift import Boxes3D, Calibration, FrameLabels, ObjectLabel, Prompt, Result
from boxlift.camera import Floats
from boxlift.errors import CalibrationError
from boxlift.formats.calibration import read_calibration
from boxlift.formats.xtreme1 import (
    CLASS_CODES,
    Xtreme1Object,
    boxes_of,
    merged,
    parse_camera_config,
    results_of,
)
from boxlift.frame import FrameWarning, RigDoubt

# The camera looks along the LiDAR's x, 0.3 m before it and 0.1 m below.
CAM_T_VELO: list[list[float]] = [[0.0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]]
INTERNAL = {"fx": 700.0, "fy": 710, "cx": 600, "cy": 180}
LEVEL = Calibration(np.array([[700.0, 0, 600, 0], [0, 710, 180, 0], [0, 0, 1, 0]]), np.array(CAM_T_VELO))


def camera(**changes: Any) -> dict[str, Any]:
    external = [number for row in CAM_T_VELO for number in row]
    given = {"camera_internal": INTERNAL, "camera_external": external, "width": 1200, "height": 360}
    return {key: value for key, value in (given | changes).items() if value != "-"}


def labels_of(*boxes: Boxes3D, category: str = "Car", score: float = 0.75) -> FrameLabels:
    prompt = Prompt(category, (0, 0, 10, 10))
    objects = (ObjectLabel(i, prompt, Result.FITTED, "A box.", box, score) for i, box in enumerate(boxes))
    return FrameLabels("frame", tuple(objects))


def box(center: tuple[float, float, float], rotation_y: float = 0.0, length_m: float = 4.0) -> Boxes3D:
    return Boxes3D(
        np.array([center]), np.array([length_m]), np.array([1.8]), np.array([1.5]), np.array([rotation_y])
    )


def objects_of(labels: FrameLabels, calibration: Calibration = LEVEL) -> list[Xtreme1Object]:
    return results_of(labels, calibration)["objects"]


def item(x: float, confidence: float, label: str = "CAR", **changes: float) -> Xtreme1Object:
    found = objects_of(labels_of(box((0.0, 1.0, 20.0), -math.pi / 2)))[0]
    return {**found, "label": label, "confidence": confidence, "x": x, **changes}  # type: ignore[typeddict-item]


def turned(angle_rad: float, axis: int) -> Floats:
    """(4, 4) rotation about an axis of the camera."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(4)
    turn[[a, a, b, b], [a, b, a, b]] = (
        math.cos(angle_rad),
        -math.sin(angle_rad),
        math.sin(angle_rad),
        math.cos(angle_rad),
    )
    return turn


def test_by_hand() -> None:
    """20 m ahead of the camera, 2 m to its right, 1 m below it; it drives to the right and a bit away."""
    (found,) = objects_of(labels_of(box((2.0, 1.0, 20.0), rotation_y=-0.25)))
    assert found == {
        "label": "CAR",
        "confidence": 0.75,
        "x": pytest.approx(20.3),
        "y": pytest.approx(-2.0),
        "z": pytest.approx(-1.1),
        "dx": 4.0,
        "dy": 1.8,
        "dz": 1.5,
        "rotX": pytest.approx(0),
        "rotY": pytest.approx(0),
        "rotZ": pytest.approx(0.25 - math.pi / 2, abs=1e-6),
    }
    assert all(type(value) in (float, str) for value in found.values())


@pytest.mark.parametrize(
    ("rotation_y", "rot_z"),
    [(-math.pi / 2, 0.0), (0.0, -math.pi / 2), (math.pi / 2 - 1e-9, -math.pi), (math.pi, math.pi / 2)],
)
def test_heading_is_measured_from_ahead_to_the_left(rotation_y: float, rot_z: float) -> None:
    (found,) = objects_of(labels_of(box((0.0, 1.0, 20.0), rotation_y)))
    assert math.remainder(found["rotZ"] - rot_z, 2 * math.pi) == pytest.approx(0, abs=1e-6)


def test_what_the_camera_leans_stays_in_the_box() -> None:
    """A camera that looks 0.1 rad down: a box ahead of it, level to it, leans 0.1 rad nose down."""
    leaning = Calibration(LEVEL.image_P_cam, turned(0.1, axis=0) @ CAM_T_VELO)
    (found,) = objects_of(labels_of(box((0.0, 0.0, 10.0), -math.pi / 2)), leaning)
    assert [found["rotX"], found["rotZ"]] == pytest.approx([0, 0])
    assert found["rotY"] == pytest.approx(0.1, abs=1e-6)
    assert found["z"] < -0.9


@given(
    center=st.tuples(st.floats(-50, 50), st.floats(-2, 3), st.floats(1, 90)),
    rotation_y=st.floats(-4, 4),
    tilts=st.tuples(st.floats(-0.5, 0.5), st.floats(-3, 3), st.floats(-0.5, 0.5)),
)
def test_there_and_back(
    center: tuple[float, float, float], rotation_y: float, tilts: tuple[float, float, float]
) -> None:
    turn = turned(tilts[0], 0) @ turned(tilts[1], 1) @ turned(tilts[2], 2)
    calibration = Calibration(LEVEL.image_P_cam, turn @ CAM_T_VELO)
    there = box(center, rotation_y)
    back = boxes_of(objects_of(labels_of(there), calibration), calibration)
    np.testing.assert_allclose(back.center_cam, there.center_cam, atol=1e-6)
    assert (back.length_m[0], back.width_m[0], back.height_m[0]) == (4.0, 1.8, 1.5)
    away = math.remainder(back.rotation_y[0] - there.rotation_y[0], 2 * math.pi)
    assert away == pytest.approx(0, abs=1e-6)


def test_corners_are_the_ones_that_the_tool_draws() -> None:
    """Unit cube, scaled, turned by Rx Ry Rz, moved: a corner of it is a corner of the fitted box."""
    calibration = Calibration(LEVEL.image_P_cam, turned(0.2, 0) @ turned(-0.1, 2) @ CAM_T_VELO)
    fitted = box((3.0, 1.2, 15.0), 0.7)
    (found,) = objects_of(labels_of(fitted), calibration)
    a, b, c = found["rotX"], found["rotY"], found["rotZ"]
    rotation = (turned(a, 0) @ turned(b, 1) @ turned(c, 2))[:3, :3]
    size = np.array([found["dx"], found["dy"], found["dz"]])
    front_left_bottom = np.array([found["x"], found["y"], found["z"]]) + rotation @ (size * (0.5, 0.5, -0.5))
    corner_cam = calibration.velo_to_cam(front_left_bottom[None])[0]
    np.testing.assert_allclose(corner_cam, fitted.corners()[0, 0], atol=1e-5)


def test_boxes_on_end_are_turned_one_way() -> None:
    """A cloud whose x is up: rotX and rotZ turn about one axis, and rotX does it."""
    upended = Calibration(LEVEL.image_P_cam, np.eye(4)[[1, 0, 2, 3]] * [[1], [-1], [1], [1]])
    for rotation_y in (-2.0, 0.3):
        there = box((1.0, 2.0, 30.0), rotation_y)
        found = objects_of(labels_of(there), upended)
        assert [abs(found[0]["rotY"]), found[0]["rotZ"]] == pytest.approx([math.pi / 2, 0])
        assert boxes_of(found, upended).rotation_y[0] == pytest.approx(rotation_y, abs=1e-6)


def test_classes() -> None:
    for category, code in [*CLASS_CODES.items(), ("Tram", "TRAM"), ("traffic cone", "TRAFFIC_CONE")]:
        (found,) = objects_of(labels_of(box((0, 1, 9)), category=category))
        assert found["label"] == code


def test_prompts_without_a_box_are_left_out() -> None:
    without = FrameLabels.without_boxes("frame", [Prompt("Car", (0, 0, 9, 9))], Result.NO_LIDAR)
    assert results_of(without, LEVEL) == {"objects": [], "warnings": []}
    assert len(boxes_of([], LEVEL)) == 0


def test_doubts_about_the_rig_come_along() -> None:
    doubt = FrameWarning(RigDoubt.TILTED, "The ground leans 30 degrees.")
    labels = FrameLabels("frame", labels_of(box((0, 1, 9))).objects, (doubt,))
    assert results_of(labels, LEVEL)["warnings"] == ["The ground leans 30 degrees."]


def test_bodies_seen_by_two_cameras_are_told_once() -> None:
    left = [item(10.0, 0.5), item(40.0, 0.9)]
    right = [item(10.4, 0.8, "TRUCK"), item(25.0, 0.2)]
    assert merged([left, right]) == [left[1], right[0], right[1]]


def test_objects_of_one_camera_are_never_merged() -> None:
    one = [item(10.0, 0.5), item(10.4, 0.8)]
    assert merged([one]) == [one[1], one[0]]
    assert merged([]) == merged([[], []]) == []


def test_equal_confidence_keeps_the_first_camera() -> None:
    assert merged([[item(10.0, 0.5, y=0.1)], [item(10.0, 0.5)]]) == [item(10.0, 0.5, y=0.1)]


@pytest.mark.parametrize(
    "config",
    [
        [camera()],
        camera(),
        [camera(rowMajor=True)],
        [camera(camera_external=np.array(CAM_T_VELO).T.ravel().tolist(), rowMajor=False)],
        [camera(camera_external=np.array(CAM_T_VELO).T.ravel().tolist())],
        [
            {
                "cameraInternal": INTERNAL,
                "cameraExternal": np.array(CAM_T_VELO).ravel().tolist(),
                "width": 1200,
                "height": 360,
                "distortion": "not looked at",
            }
        ],
    ],
)
def test_spellings_of_one_camera(config: Any) -> None:
    (parsed,) = parse_camera_config(json.dumps(config).encode())
    assert parsed is not None
    np.testing.assert_array_equal(parsed.calibration.image_P_cam, LEVEL.image_P_cam)
    np.testing.assert_array_equal(parsed.calibration.cam_SE3_velo, CAM_T_VELO)
    assert parsed.image_size_px == (1200, 360)


def test_cameras_that_the_tool_skips() -> None:
    skipped = [None, {}, camera(camera_external=[1, 2, 3]), camera(camera_external="-"), 7]
    parsed = parse_camera_config(json.dumps([*skipped, camera(width=0)]))
    assert [found is None for found in parsed] == [True] * 5 + [False]
    assert parsed[-1] is not None
    assert parsed[-1].image_size_px is None


def test_the_example_of_its_documentation() -> None:
    """docs.xtreme1.io, Coordinate System: column by column, LiDAR of a car with z up."""
    example = """{"cameraInternal": {"fx": 933.4667, "fy": 934.6754, "cx": 896.4692, "cy": 507.3557},
        "width": 1920, "height": 1080, "cameraExternal": [
        -0.7209479393140598, -0.04004438206239668, -0.6918312773097581, 0,
        0.6911177056736608, 0.0317737123271339, -0.7220434530617444, 0,
        0.05089583188421044, -0.9986925846676711, 0.004768189029478265, 0,
        0.009297776700688867, 1.6581292167169648, -1.0197515012137728, 1], "rowMajor": false}"""
    (parsed,) = parse_camera_config(example)
    assert parsed is not None
    upward_cam = parsed.calibration.cam_SE3_velo[:3, 2]
    np.testing.assert_allclose(upward_cam, (0, -1, 0), atol=0.06)  # z of the LiDAR is up in the image
    assert parsed.calibration.lidar_center_cam.tolist() == [
        0.009297776700688867,
        1.6581292167169648,
        -1.0197515012137728,
    ]


@pytest.mark.parametrize(
    ("config", "field", "says"),
    [
        ("[", "cameraConfig", "not JSON"),
        ("7", "cameraConfig", "holds 7"),
        ("[]", "cameraConfig", "0 cameras"),
        (json.dumps([None] * 101), "cameraConfig", "101 cameras"),
        (json.dumps([camera(camera_internal="-")]), "cameraConfig[0].camera_internal.fx", "None"),
        (json.dumps([camera(camera_internal=[1])]), "cameraConfig[0].camera_internal.fx", "focal length"),
        (json.dumps([None, camera(camera_internal=INTERNAL | {"fy": 0})]),
         "cameraConfig[1].camera_internal.fy", "0 is no focal length"),
        (json.dumps([camera(camera_internal=INTERNAL | {"cx": "600"})]),
         "cameraConfig[0].camera_internal.cx", "'600' is no number"),
        (json.dumps([camera(camera_external=[True] * 16)]),
         "cameraConfig[0].camera_external", "True is no finite number"),
        (json.dumps([camera(camera_external=[1.0] * 16)]), "cameraConfig[0].camera_external", "singular"),
        (json.dumps([camera(camera_external=[*range(15, 0, -1), 0])]),
         "cameraConfig[0].camera_external", "singular"),
        (json.dumps([camera(camera_internal=INTERNAL | {"fx": 1e300})]),
         "cameraConfig[0].camera_internal", "singular"),
    ],
)  # fmt: skip
def test_refusals(config: str, field: str, says: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        parse_camera_config(config)
    assert caught.value.field == field
    assert says in caught.value.problem
    assert caught.value.remedy


@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda rest: ("[{" + rest).encode())))
def test_random_content_is_refused(content: bytes) -> None:
    try:
        parsed = parse_camera_config(content)
    except CalibrationError:
        return
    assert all(camera is None for camera in parsed)


def test_real_calibrations(kitti_object_root: Path) -> None:
    """KITTI's cameras, written as Xtreme1's documentation says, and the labels of a frame there and back."""
    for path in sorted((kitti_object_root / "training" / "calib").iterdir()):
        kitti = read_calibration(path).calibration
        internal = np.eye(4)
        internal[:3, :3] = kitti.image_P_cam[:, :3]
        projection = np.eye(4)
        projection[:3] = kitti.image_P_cam
        external = np.linalg.inv(internal) @ projection @ kitti.cam_SE3_velo
        fx, fy = kitti.focal_px
        cx, cy = kitti.image_P_cam[:2, 2].tolist()
        config = camera(
            camera_internal={"fx": fx, "fy": fy, "cx": cx, "cy": cy},
            camera_external=external.ravel().tolist(),
        )
        (parsed,) = parse_camera_config(json.dumps([config]))
        assert parsed is not None
        points_velo = np.array([[10.0, -3, -1], [40, 8, 0.5]])
        expected, _ = kitti.project(kitti.velo_to_cam(points_velo))
        found, _ = parsed.calibration.project(parsed.calibration.velo_to_cam(points_velo))
        np.testing.assert_allclose(found, expected, atol=1e-6)
        there = box((-3.0, 1.6, 25.0), 1.2)
        results = objects_of(labels_of(there), parsed.calibration)
        assert abs(results[0]["rotX"]) < 0.03
        assert abs(results[0]["rotY"]) < 0.03
        back = boxes_of(results, parsed.calibration)
        np.testing.assert_allclose(back.center_cam, there.center_cam, atol=1e-6)
        assert back.rotation_y[0] == pytest.approx(1.2, abs=1e-6)
