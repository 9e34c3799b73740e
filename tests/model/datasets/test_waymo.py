"""Waymo's version 2 in its own layout, of a generated scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.posed_source import PosedSource
from boxlift.datasets.waymo_range_image import points_of_range_image
from boxlift.errors import DatasetError, NoLidarError
from boxlift.poses import about_z, pose
from model.datasets.town import pinhole_town, require_objects
from model.datasets.vehicle import WORLD_SE3_EGO, objects_ego
from model.datasets.waymo_files import CAMERAS, SEGMENT, TIME, write_waymo

# Half a pixel of the range image at 60 m: 2 pi / 2650 / 2 across, its beams' gaps up and down.
_WITHIN_M = 0.12


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, NDArray[np.int64]]:
    root = tmp_path_factory.mktemp("waymo")
    return root, write_waymo(root / "training", pinhole_town())


@pytest.mark.parametrize("camera", sorted(CAMERAS))
def test_each_camera_of_a_sweep_is_a_frame(written: tuple[Path, NDArray[np.int64]], camera: str) -> None:
    root, chosen = written
    source = open_source(root)
    assert source.layout == "Waymo"
    assert source.names == tuple(f"{SEGMENT}_{TIME}_{name}" for name in ("FRONT", "FRONT_LEFT"))
    assert open_source(root / "training").names == source.names
    frame = source.load(f"{SEGMENT}_{TIME}_{CAMERAS[camera][1]}", with_image=True)
    expected = pinhole_town().cameras[camera].frame
    assert np.array_equal(frame.image, expected.image)  # type: ignore[arg-type]
    found = frame.calibration.velo_to_cam(frame.points_velo)
    true = expected.calibration.velo_to_cam(expected.points_velo[chosen])
    assert found.shape == true.shape
    near = np.linalg.norm(true, axis=1) < 60
    assert np.abs(np.linalg.norm(found - true, axis=1)[near]).max() < _WITHIN_M
    assert frame.view is not None
    assert (frame.view.sweep, frame.view.log) == (str(TIME), SEGMENT)
    assert np.allclose(frame.view.world_SE3_ego, WORLD_SE3_EGO)  # type: ignore[arg-type]


@pytest.mark.parametrize("camera", sorted(CAMERAS))
def test_boxes_of_the_lidar_are_prompts(written: tuple[Path, NDArray[np.int64]], camera: str) -> None:
    source = open_source(written[0])
    assert source.label_names == ("lidar_box", "camera_box")
    found = source.objects("lidar_box", f"{SEGMENT}_{TIME}_{CAMERAS[camera][1]}")
    require_objects(found, pinhole_town().cameras[camera], within_m=0.1)


def test_truth_has_levels_and_points(written: tuple[Path, NDArray[np.int64]]) -> None:
    source = open_source(written[0])
    assert isinstance(source, PosedSource)
    (labels,) = source.sweeps("lidar_box")
    expected = objects_ego(pinhole_town())
    assert len(labels.objects) == len(expected)
    assert [each.difficulty for each in labels.objects][:2] == [2, None]
    assert {each.points for each in labels.objects} == {12}
    assert {each.category for each in labels.objects} <= {"Vehicle", "Pedestrian", "Cyclist"}


@pytest.mark.parametrize("camera", sorted(CAMERAS))
def test_drawn_boxes_are_prompts(written: tuple[Path, NDArray[np.int64]], camera: str) -> None:
    prompts = load_prompts("camera_box", open_source(written[0]), f"{SEGMENT}_{TIME}_{CAMERAS[camera][1]}")
    expected = pinhole_town().cameras[camera].frame.prompts
    assert np.allclose([each.box_px for each in prompts], [each.box_px for each in expected], atol=1e-6)


def test_images_and_drawn_boxes_are_rectified(tmp_path: Path) -> None:
    scene = pinhole_town()
    write_waymo(tmp_path / "validation", scene, distorted=True)
    source = open_source(tmp_path)
    frame = source.load(source.names[0], with_image=True)
    assert frame.lens is not None
    assert frame.image is not None
    stored = scene.cameras["front"].frame.image
    assert stored is not None
    assert np.array_equal(frame.image, frame.lens.rectified_image(stored))
    drawn = scene.cameras["front"].frame.prompts[0].box_px
    assert load_prompts("camera_box", source, source.names[0])[0].box_px == pytest.approx(
        frame.lens.rectified_box(drawn, frame.image_size_px)
    )


def test_pixel_poses_make_good_what_the_vehicle_moved() -> None:
    """Two returns straight ahead at 10 m, the second after the vehicle went 1 m on."""
    image = np.zeros((1, 4, 2))
    image[0, 1:3, 0] = 10
    poses = np.zeros((1, 4, 6))
    poses[0, 2, 3] = 1.0
    world = pose(np.eye(3), np.array([1.0, 0, 0]))
    still = points_of_range_image(image, [0.0], (0, 0), np.eye(4), None, np.eye(4))
    moved = points_of_range_image(image, [0.0], (0, 0), np.eye(4), poses, world)
    assert np.allclose(still[:, 0], 10 * np.cos(np.pi / 4), atol=1e-5)
    assert np.allclose(still[:, 1], (10 * np.sin(np.pi / 4), -10 * np.sin(np.pi / 4)), atol=1e-5)
    assert np.allclose(moved[:, 0] - still[:, 0], (-1, 0), atol=1e-5)


def test_a_turned_lidar_begins_behind_the_vehicle_too() -> None:
    """The first column looks back wherever the LiDAR's x points; beams may share the limits."""
    image = np.ones((2, 360, 2))
    turned = points_of_range_image(image, None, (-0.2, 0.2), pose(about_z(2.0), np.zeros(3)), None, np.eye(4))
    straight = points_of_range_image(image, None, (-0.2, 0.2), np.eye(4), None, np.eye(4))
    assert np.allclose(turned, straight, atol=1e-6)
    assert straight[0, 0] < -0.9
    assert straight[0, 2] == pytest.approx(np.sin(0.1), abs=1e-6)
    assert straight[-1, 2] == pytest.approx(np.sin(-0.1), abs=1e-6)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    split = tmp_path / "training"
    write_waymo(split, pinhole_town(), pixel_poses=False)
    source = open_source(tmp_path)
    assert len(source.load(source.names[0]).points_velo) > 10_000
    (split / "lidar_box" / f"{SEGMENT}.parquet").unlink()
    with pytest.raises(DatasetError, match="no such boxes"):
        source.objects("lidar_box", source.names[0])
    with pytest.raises(DatasetError, match="no frame"):
        source.load(f"{SEGMENT}_{TIME + 1}_FRONT")
    (split / "lidar_calibration" / f"{SEGMENT}.parquet").unlink()
    with pytest.raises(DatasetError, match="component lidar_calibration"):
        open_source(tmp_path).load(source.names[0])


def test_a_sweep_without_roof_lidar(tmp_path: Path) -> None:
    import pyarrow.compute as pc
    from pyarrow import parquet

    write_waymo(tmp_path, pinhole_town())
    path = tmp_path / "lidar" / f"{SEGMENT}.parquet"
    table = parquet.read_table(path)
    parquet.write_table(table.filter(pc.field("key.laser_name") == 2), path)
    source = open_source(tmp_path)
    with pytest.raises(NoLidarError, match="no roof LiDAR"):
        source.load(source.names[0])
