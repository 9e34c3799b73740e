"""Labels of every format that is judged in the ego frame: the same boxes, whichever file they come from."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from pyarrow import feather, parquet

from boxlift.boxes import Boxes3D
from boxlift.errors import BoxliftError, DatasetError, LabelFormatError, OptionsError
from boxlift.formats.details import BoxDetails, FrameDetails, ObjectDetails, PointDetails, ViewDetails
from boxlift.formats.kitti_label import from_box3d, to_text
from boxlift.sweep import SweepLabels
from boxlift_client.cli.evaluate import evaluate
from boxlift_client.sweep_files import read_truth_and_predictions

# x, y, z, length, width, height, yaw in the ego frame; scores; one sweep of two boxes, one of none.
ROWS = np.array([[20.0, 3.0, 0.5, 4.0, 1.8, 1.5, 0.3], [30.0, -5.0, 0.2, 4.4, 1.9, 1.6, -2.5]])
SCORES = (0.9, 0.4)
TIME = 1_000_000_000
# The camera looks to the left and stands 1.5 m high; the vehicle is far from the origin and turned.
EGO_SE3_CAM = np.array([[1, 0, 0, 0.2], [0, 0, 1, 0.1], [0, -1, 0, 1.5], [0, 0, 0, 1]], dtype=np.float64)
WORLD_SE3_EGO = np.array(
    [[0.6, -0.8, 0, 4000], [0.8, 0.6, 0, 900], [0, 0, 1, 7], [0, 0, 0, 1]], dtype=np.float64
)
WORLD_YAW = float(np.arctan2(0.8, 0.6))


def argoverse2(path: Path) -> Path:
    """A table of detections."""
    yaw = ROWS[:, 6]
    columns: dict[str, Any] = {
        "timestamp_ns": [TIME] * 2,
        "category": ["REGULAR_VEHICLE"] * 2,
        "log_id": ["drive"] * 2,
        "score": list(SCORES),
        **dict(zip(("tx_m", "ty_m", "tz_m", "length_m", "width_m", "height_m"), ROWS.T, strict=False)),
        **dict(
            zip(("qw", "qx", "qy", "qz"), (np.cos(yaw / 2), yaw * 0, yaw * 0, np.sin(yaw / 2)), strict=True)
        ),
    }
    table = pyarrow.table(columns)
    if path.suffix == ".parquet":
        parquet.write_table(table, path)
    else:
        feather.write_feather(table, path)
    return path


def nuscenes(path: Path, **more: Any) -> Path:
    """A results file."""
    boxes = []
    for row, score in zip(ROWS, SCORES, strict=True):
        turn = (row[6] + WORLD_YAW) / 2
        center = WORLD_SE3_EGO[:3, :3] @ row[:3] + WORLD_SE3_EGO[:3, 3]
        boxes.append(
            {
                "translation": center.tolist(),
                "size": row[[4, 3, 5]].tolist(),
                "rotation": [np.cos(turn), 0, 0, np.sin(turn)],
                "detection_name": "car",
                "detection_score": score,
                "attribute_name": "vehicle.parked",
                **{key: make(center) for key, make in more.items()},
            }
        )
    path.write_text(json.dumps({"meta": {}, "results": {str(TIME): boxes, "empty": []}}))
    return path


def in_camera(ego_SE3_cam: np.ndarray) -> Boxes3D:
    """The boxes as a camera has them."""
    cam_SE3_ego = np.linalg.inv(ego_SE3_cam)
    heading = np.stack([np.cos(ROWS[:, 6]), np.sin(ROWS[:, 6]), ROWS[:, 6] * 0])
    along = cam_SE3_ego[:3, :3] @ heading
    return Boxes3D(
        ROWS[:, :3] @ cam_SE3_ego[:3, :3].T + cam_SE3_ego[:3, 3],
        ROWS[:, 3],
        ROWS[:, 4],
        ROWS[:, 5],
        np.arctan2(-along[2], along[0]),
    )


def label_set(folder: Path) -> Path:
    """Two views of one sweep: each has one of the boxes."""
    boxes = in_camera(EGO_SE3_CAM)
    (folder / "details").mkdir(parents=True)
    for index in range(2):
        x, y, z = boxes.center_cam[index]
        frame = FrameDetails(
            frame=f"view{index}",
            objects=(
                ObjectDetails(
                    index=0,
                    category="Car",
                    prompt_box_px=(0, 0, 1, 1),
                    prompt_score=1,
                    result="FITTED",
                    sentence="",
                    score=SCORES[index],
                    flags=(),
                    box=BoxDetails(
                        center_cam=(x, y, z),
                        length_m=boxes.length_m[index],
                        width_m=boxes.width_m[index],
                        height_m=boxes.height_m[index],
                        rotation_y=boxes.rotation_y[index],
                    ),
                    kitti=None,
                    losses=None,
                    points=PointDetails(in_prompt=0, above_ground=0, in_cluster=0, used=0),
                    rejected=(),
                ),
            ),
            view=ViewDetails(
                sweep=str(TIME),
                camera=f"camera{index}",
                log="drive",
                ego_SE3_cam=tuple(map(tuple, EGO_SE3_CAM.tolist())),
                world_SE3_ego=tuple(map(tuple, WORLD_SE3_EGO.tolist())),
            ),
        )
        (folder / "details" / f"view{index}.json").write_text(frame.model_dump_json(by_alias=True))
    return folder


def assert_same(labels: list[SweepLabels]) -> None:
    objects = {each.sweep: each.objects for each in labels}[str(TIME)]
    rows = [[*each.center_ego, each.length_m, each.width_m, each.height_m, each.yaw_rad] for each in objects]
    np.testing.assert_allclose(rows, ROWS, atol=1e-6)
    assert tuple(each.score for each in objects) == SCORES
    up = np.array([each.ego_SO3_object[:, 2] for each in objects])
    np.testing.assert_allclose(up, [[0, 0, 1]] * 2, atol=1e-9)


@pytest.mark.parametrize(
    "write",
    [
        lambda folder: argoverse2(folder / "found.feather"),
        lambda folder: argoverse2(folder / "found.parquet"),
        lambda folder: label_set(folder / "other"),
        lambda folder: nuscenes(folder / "found.json"),
    ],
)
def test_the_same_boxes_from_every_format(write: Callable[[Path], Path], tmp_path: Path) -> None:
    truth, found = read_truth_and_predictions(label_set(tmp_path / "truth"), write(tmp_path))
    assert_same(truth)
    assert_same(found)


def test_logs_of_annotations(tmp_path: Path) -> None:
    for log in ("one", "two"):
        (tmp_path / log).mkdir()
        argoverse2(tmp_path / log / "annotations.feather")
    truth, _ = read_truth_and_predictions(tmp_path, tmp_path / "one" / "annotations.feather")
    assert [each.sweep for each in truth] == [str(TIME)] * 2


def test_nuscenes_files_alone_say_where_the_vehicle_was(tmp_path: Path) -> None:
    # As the devkit writes its own boxes; without turning, the range is right, and so is everything relative.
    from_ego = {
        "ego_translation": lambda center: (center - WORLD_SE3_EGO[:3, 3]).tolist(),
        "num_pts": lambda _: 7,
    }
    truth, found = read_truth_and_predictions(
        nuscenes(tmp_path / "truth.json", **from_ego), nuscenes(tmp_path / "found.json")
    )
    distance = [float(np.linalg.norm(each.center_ego)) for each in found[0].objects]
    np.testing.assert_allclose(distance, np.linalg.norm(ROWS[:, :3], axis=1))
    assert [each.points for each in truth[0].objects] == [7, 7]
    assert [each.attribute for each in found[0].objects] == ["vehicle.parked"] * 2
    with pytest.raises(DatasetError, match="where the vehicle was"):
        read_truth_and_predictions(tmp_path / "found.json", tmp_path / "found.json")


def test_kitti_files_are_judged_in_the_camera_s_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    looking_ahead = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
    boxes = in_camera(looking_ahead)
    lines = [
        from_box3d("Car", (0, 0, 1, 1), boxes[index : index + 1], score=SCORES[index]) for index in range(2)
    ]
    found = label_set(tmp_path / "found")
    for folder in (tmp_path / "truth", found / "data"):
        folder.mkdir()
        (folder / f"{TIME}.txt").write_text(to_text(lines))
    truth, predictions = read_truth_and_predictions(tmp_path / "truth", found)
    for labels in (truth, predictions):
        rows = [[*each.center_ego, each.yaw_rad] for each in labels[0].objects]
        np.testing.assert_allclose(rows, ROWS[:, [0, 1, 2, 6]], atol=0.006)  # two decimals

    evaluate(str(tmp_path / "truth"), str(found), metric="waymo", as_json=True)
    written = json.loads(capsys.readouterr().out)
    assert written["results"]["Vehicle"][1]["ap_3d"] == pytest.approx(100)
    evaluate(str(tmp_path / "truth"), str(found), metric="nuscenes")
    assert "nuScenes average precision in % and errors, 1 sweep" in capsys.readouterr().out


def test_chosen_sweeps(tmp_path: Path) -> None:
    truth = nuscenes(tmp_path / "truth.json")
    kept, found = read_truth_and_predictions(label_set(tmp_path / "set"), truth, [str(TIME)])
    assert [each.sweep for each in (*kept, *found)] == [str(TIME)] * 2
    with pytest.raises(DatasetError, match="no sweep 'b'"):
        read_truth_and_predictions(tmp_path / "set", truth, ["b"])


def test_what_cannot_be_read(tmp_path: Path) -> None:
    table = argoverse2(tmp_path / "a.feather")
    kitti = tmp_path / "kitti"
    kitti.mkdir()
    (kitti / "0.txt").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.feather").write_text("no table")
    (tmp_path / "bad.parquet").write_text("no table")
    (tmp_path / "bad.json").write_text("[]")
    (tmp_path / "bad_box.json").write_text(
        '{"results": {"0": [{"translation": [1, 2], "ego_translation": [1, 2, 3]}]}}'
    )
    feather.write_feather(pyarrow.table({"category": ["BUS"]}), tmp_path / "other.feather")
    broken = label_set(tmp_path / "set") / "details" / "broken.json"
    broken.write_text("{}")
    cases: list[tuple[Path, type[BoxliftError], str]] = [
        (kitti, OptionsError, "camera's frame"),
        (tmp_path / "empty", DatasetError, "no labels to judge"),
        (tmp_path / "absent", DatasetError, "not there"),
        (tmp_path / "bad.feather", LabelFormatError, "no table"),
        (tmp_path / "bad.parquet", LabelFormatError, "no table"),
        (tmp_path / "bad.json", LabelFormatError, "no nuScenes results file"),
        (tmp_path / "bad_box.json", LabelFormatError, "no usable 'translation'"),
        (tmp_path / "other.feather", LabelFormatError, "no column timestamp_ns"),
        (tmp_path / "set", LabelFormatError, "no details of boxlift"),
    ]
    for path, error, problem in cases:
        with pytest.raises(error, match=problem):
            read_truth_and_predictions(table, path)
    with pytest.raises(OptionsError, match="has its own"):
        evaluate("a", "b", iou=0.5)
