"""nuScenes in its own layout, of a generated scene."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boxlift.datasets import open_source
from boxlift.datasets.posed_source import PosedSource
from boxlift.errors import DatasetError, LabelFormatError, PointCloudError
from boxlift.formats.ego_boxes import objects_in_view
from model.datasets.nuscenes_files import CHANNELS, SAMPLE, write_nuscenes
from model.datasets.town import pinhole_town, require_objects, require_same_view
from model.datasets.vehicle import WORLD_SE3_EGO, objects_ego


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("nuscenes")
    write_nuscenes(folder, pinhole_town())
    return folder


@pytest.mark.parametrize("camera", sorted(CHANNELS))
def test_each_camera_of_a_sample_is_a_frame(root: Path, camera: str) -> None:
    source = open_source(root)
    assert source.layout == "nuScenes"
    assert source.names == (f"{SAMPLE}_CAM_FRONT", f"{SAMPLE}_CAM_FRONT_LEFT")
    frame = source.load(f"{SAMPLE}_{CHANNELS[camera]}", with_image=True)
    require_same_view(frame, pinhole_town().cameras[camera])
    assert frame.view is not None
    assert (frame.view.sweep, frame.view.log) == (SAMPLE, "scene-0061")
    assert frame.view.timestamp_ns == 1532402927647951000
    assert frame.view.world_SE3_ego is not None
    assert np.allclose(frame.view.world_SE3_ego, WORLD_SE3_EGO, atol=1e-9)


@pytest.mark.parametrize("camera", sorted(CHANNELS))
def test_annotations_are_prompts(root: Path, camera: str) -> None:
    found = open_source(root / "v1.0-mini").objects("annotations", f"{SAMPLE}_{CHANNELS[camera]}")
    require_objects(found, pinhole_town().cameras[camera])
    assert {each.category for each in found} <= {"Car", "Truck", "Pedestrian", "Cyclist"}


def test_truth_is_that_of_the_sweep(root: Path) -> None:
    source = open_source(root)
    assert isinstance(source, PosedSource)
    (labels,) = source.sweeps("annotations")
    expected = objects_ego(pinhole_town())
    assert (labels.sweep, len(labels.objects)) == (SAMPLE, len(expected))
    for found, true in zip(labels.objects, expected, strict=True):
        assert np.allclose(found.center_ego, true.center_ego, atol=1e-6)
        assert found.yaw_rad == pytest.approx(true.yaw_rad, abs=1e-6)
        assert (found.length_m, found.width_m, found.height_m) == (true.length_m, true.width_m, true.height_m)
        assert found.points == 20
    assert labels.objects[0].category.startswith("vehicle.")
    assert labels.objects[0].attribute == "vehicle.parked"


def test_boxes_without_points_are_no_prompts(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, pinhole_town(), points_in_boxes=0)
    assert open_source(tmp_path).objects("annotations", f"{SAMPLE}_CAM_FRONT") == []


def test_what_lies_behind_or_beside_a_camera_is_not_in_its_view() -> None:
    scene = pinhole_town()
    left = scene.cameras["left"].frame
    mount = scene.velo_SE3_cam("left")
    lines = objects_in_view(scene.objects, mount, left.calibration, left.image_size_px)
    assert len(lines) < len(scene.objects)
    assert all(0 <= line.box_px[0] < line.box_px[2] <= 1241 for line in lines)
    assert all(np.linalg.det(each.ego_SO3_object) > 0.999 for each in scene.objects)
    turned = mount.copy()
    turned[:3, :3] = mount[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    assert objects_in_view(scene.objects, turned, left.calibration, left.image_size_px) == []


def test_the_test_split_has_no_annotations(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, pinhole_town())
    (tmp_path / "v1.0-mini" / "sample_annotation.json").write_text("[]")
    source = open_source(tmp_path)
    assert source.label_names == ()
    with pytest.raises(DatasetError, match="no annotations"):
        source.objects("annotations", f"{SAMPLE}_CAM_FRONT")


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (lambda root: (root / "v1.0-mini" / "ego_pose.json").unlink(), DatasetError, "ego_pose.json"),
        (lambda root: (root / "v1.0-mini" / "ego_pose.json").write_text("{"), LabelFormatError, "no table"),
        (lambda root: _cut(next((root / "samples" / "LIDAR_TOP").iterdir())), PointCloudError, "5 numbers"),
    ],
)
def test_what_is_broken_is_named(
    tmp_path: Path, spoil: Callable[[Path], Any], error: type[Exception], words: str
) -> None:
    write_nuscenes(tmp_path, pinhole_town())
    spoil(tmp_path)
    with pytest.raises(error, match=words):
        open_source(tmp_path).load(f"{SAMPLE}_CAM_FRONT")


def test_names_of_other_frames(root: Path) -> None:
    source = open_source(root)
    for name in ("nobody", f"{SAMPLE}_LIDAR_TOP", f"{SAMPLE}_CAM_BACK"):
        with pytest.raises(DatasetError, match="no frame"):
            source.load(name)


def test_records_between_key_frames_are_dropped_while_reading(root: Path) -> None:
    rows = json.loads((root / "v1.0-mini" / "sample_data.json").read_text())
    assert sum(not row["is_key_frame"] for row in rows) == 2
    assert len(open_source(root).names) == 2


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-7])
