"""Calibration files: KITTI text and JSON, and refusals that name key, value and remedy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift import Calibration
from boxlift.errors import CalibrationError
from boxlift.formats.calibration import parse_calibration, read_calibration, to_kitti_text

Matrix = list[list[float]]

P2: Matrix = [[700.0, 0, 600, 45], [0, 700, 180, 0.2], [0, 0, 1, 0.003]]
R0_RECT: Matrix = [[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]
TR_VELO_TO_CAM: Matrix = [[0.0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3]]
# R0_rect swaps y and z (and a sign) of what Tr_velo_to_cam gives.
CAM_T_VELO: Matrix = [[0.0, -1, 0, 0.1], [1, 0, 0, -0.3], [0, 0, 1, 0.2], [0, 0, 0, 1]]


def row(matrix: Matrix) -> str:
    return " ".join(str(number) for line in matrix for number in line)


def text(**lines: str) -> str:
    given = {"P2": row(P2), "R0_rect": row(R0_RECT), "Tr_velo_to_cam": row(TR_VELO_TO_CAM)} | lines
    return "".join(f"{key}: {numbers}\n" for key, numbers in given.items() if numbers != "-")


def as_json(**values: Any) -> str:
    given = {"P2": P2, "cam_T_velo": CAM_T_VELO} | values
    return json.dumps({key: value for key, value in given.items() if value != "-"})


def assert_as_given(calibration: Calibration) -> None:
    np.testing.assert_allclose(calibration.image_P_cam, P2)
    np.testing.assert_allclose(calibration.cam_SE3_velo, CAM_T_VELO)


@pytest.mark.parametrize(
    "content",
    [
        text(),
        text(P0="1 2 3", Tr_imu_to_velo="not looked at"),  # other keys are somebody else's
        text().replace(":", ""),  # KITTI tracking leaves the colon out
        text(R0_rect="-", R_rect=row(R0_RECT), Tr_velo_to_cam="-", Tr_velo_cam=row(TR_VELO_TO_CAM)),
        text(P2="-", P_rect_02=row(P2), R0_rect="-", R_rect_00=row(R0_RECT)),
        "\ufeff" + text().replace("\n", "\r\n"),
        as_json(),
        as_json(cam_T_velo="-", R0_rect=R0_RECT, Tr_velo_to_cam=TR_VELO_TO_CAM),
        "\n  " + as_json(),
    ],
)
def test_spellings_of_one_calibration(content: str) -> None:
    parsed = parse_calibration(content.encode())
    assert_as_given(parsed.calibration)
    assert parsed.image_size_px is None


def test_image_size_of_json() -> None:
    assert parse_calibration(as_json(image_size=[1242, 375])).image_size_px == (1242, 375)


def test_another_camera() -> None:
    other: Matrix = [[1.0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]]
    np.testing.assert_allclose(
        parse_calibration(text(P3=row(other)), camera=3).calibration.image_P_cam, other
    )


def test_text_round_trip(tmp_path: Path) -> None:
    calibration = parse_calibration(text()).calibration
    path = tmp_path / "calib.txt"
    path.write_text(to_kitti_text(calibration))
    assert_as_given(read_calibration(path).calibration)


@pytest.mark.parametrize(
    ("content", "field", "says"),
    [
        ("", "calib.P2", "empty"),
        (text(P2="-"), "calib.P2", "no line P2"),
        (text(R0_rect="-"), "calib.R0_rect", "no line R0_rect"),
        (text(Tr_velo_to_cam="-"), "calib.Tr_velo_to_cam", "no line"),
        (text(P2="1 2 3"), "calib.P2", "3 numbers"),
        (text(P2=row(P2).replace("700.0", "seven")), "calib.P2", "'seven' is not a number"),
        (text(R0_rect=row(R0_RECT).replace("-1", "nan")), "calib.R0_rect", "not finite"),
        (text(R0_rect=row(R0_RECT).replace("-1", "1e999")), "calib.R0_rect", "not finite"),
        (text(P2="0 " * 12), "calib.P2", "singular"),
        (text(Tr_velo_to_cam="1 " * 12), "calib.Tr_velo_to_cam", "singular"),
        (text(Tr_velo_to_cam="1e300 " * 12, R0_rect="1e300 " * 9), "calib.Tr_velo_to_cam", "not finite"),
        ("\x89PNG\r\n", "calib.P2", "no line P2"),
        ("{", "calib", "not JSON"),
        ("{" * 100_000, "calib", "not JSON"),
        ('{"P2": ' + "[" * 100_000, "calib", "nested"),
        (as_json(P3=P2), "calib.P3", "unknown"),
        (as_json(P2="-"), "calib.P2", "no P2"),
        (as_json(P2=P2[:2]), "calib.P2", "3 rows"),
        (as_json(P2=[P2[0][:3], *P2[1:]]), "calib.P2[0]", "4 numbers"),
        (as_json(P2="P2"), "calib.P2", "3 rows"),
        (as_json(P2=[["1", 0, 0, 0], *P2[1:]]), "calib.P2[0][0]", "'1' is no finite number"),
        (as_json(P2=[[True, 0, 0, 0], *P2[1:]]), "calib.P2[0][0]", "True"),
        (as_json(P2=[[10**400, 0, 0, 0], *P2[1:]]), "calib.P2[0][0]", "no finite number"),
        (as_json().replace("700.0", "NaN"), "calib", "NaN"),
        (as_json().replace("700.0", "-Infinity"), "calib", "-Infinity"),
        (as_json().replace("700.0", "1e999"), "calib.P2[0][0]", "inf"),
        (as_json().replace("{", '{"P2": 1, '), "calib", "repeats"),
        (as_json(cam_T_velo="-"), "calib.cam_T_velo", "where the LiDAR is"),
        (as_json(R0_rect=R0_RECT), "calib.R0_rect", "beside"),
        (as_json(cam_T_velo="-", R0_rect=R0_RECT), "calib.Tr_velo_to_cam", "no Tr_velo_to_cam"),
        (as_json(cam_T_velo=[[1.0, 0, 0, 0]] * 4), "calib.cam_T_velo[3]", "last row"),
        (as_json(cam_T_velo=[[0.0] * 4] * 3 + [[0, 0, 0, 1]]), "calib.cam_T_velo", "singular"),
        (as_json(image_size=[1242]), "calib.image_size", "no image size"),
        (as_json(image_size=[0, 375]), "calib.image_size", "no image size"),
        (as_json(image_size=[1242.5, 375]), "calib.image_size", "no image size"),
        (as_json(image_size="big"), "calib.image_size", "no image size"),
    ],
)  # fmt: skip
def test_refusals(content: str, field: str, says: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        parse_calibration(content)
    assert caught.value.field == field
    assert says in caught.value.problem
    assert caught.value.remedy
    assert len(str(caught.value)) < 1000


def test_bytes_that_are_no_text() -> None:
    with pytest.raises(CalibrationError, match="not text"):
        parse_calibration(b"\xff\xfe\x00")


def test_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"absent\.txt"):
        read_calibration(tmp_path / "absent.txt")


@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda rest: ("{" + rest).encode())))
def test_random_content_is_refused(content: bytes) -> None:
    with pytest.raises(CalibrationError):
        parse_calibration(content)


def test_real_calibrations(kitti_object_root: Path) -> None:
    for path in sorted((kitti_object_root / "training" / "calib").iterdir()):
        calibration = read_calibration(path).calibration
        again = parse_calibration(to_kitti_text(calibration)).calibration
        np.testing.assert_allclose(again.cam_SE3_velo, calibration.cam_SE3_velo, rtol=1e-11, atol=1e-12)
        # KITTI: the colour camera is 6 cm left of the rectified origin, the LiDAR 27 cm behind it.
        assert calibration.camera_center_cam[0] == pytest.approx(-0.06, abs=0.01)
        assert calibration.lidar_center_cam[2] == pytest.approx(-0.28, abs=0.06)


def test_a_camera_alone_needs_only_its_projection() -> None:
    text = b"P2: 700 0 600 45 0 700 180 0.2 0 0 1 0.003\nTr_velo_to_cam: not numbers\n"
    rows = [[700, 0, 600, 45], [0, 700, 180, 0.2], [0, 0, 1, 0.003]]
    as_json = json.dumps({"P2": rows, "cam_T_velo": "nowhere", "image_size": [1200, 360]})
    from_text = parse_calibration(text, camera_only=True)
    from_json = parse_calibration(as_json, camera_only=True)
    assert from_json.image_size_px == (1200, 360)
    for parsed in (from_text, from_json):
        np.testing.assert_array_equal(parsed.calibration.image_P_cam, rows)
        np.testing.assert_array_equal(parsed.calibration.velo_to_cam(np.array([[9.0, -2, 1]])), [[2, -1, 9]])
    with pytest.raises(CalibrationError, match=r"calib\.P2"):
        parse_calibration(b"P0: 1\n", camera_only=True)
    with pytest.raises(CalibrationError, match=r"calib\.P2.*singular"):
        parse_calibration(b"P2: 0 0 0 0 0 0 0 0 0 0 0 0\n", camera_only=True)
