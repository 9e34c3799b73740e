"""MCAP recordings of a generated scene, written by Foxglove's SDK."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from boxlift.datasets import open_source
from boxlift.datasets.transform_tree import TimedTransform, TransformTree
from boxlift.errors import CalibrationError, DatasetError
from model.datasets.mcap_files import SWEEP_NS, TOPICS, write_recording
from model.datasets.town import pinhole_town, require_same_view
from model.datasets.vehicle import WORLD_SE3_EGO

_TIME = SWEEP_NS + 2_000_000


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "drive.mcap"
    write_recording(path, pinhole_town(), sweeps=3)
    return path


@pytest.mark.parametrize("camera", sorted(TOPICS))
def test_images_near_a_sweep_are_frames(recording: Path, camera: str) -> None:
    source = open_source(recording)
    assert source.layout == "MCAP"
    assert source.names == (f"drive_{_TIME}_camera-front-image", f"drive_{_TIME}_camera-left-image")
    assert open_source(recording.parent).names == source.names
    frame = source.load(f"drive_{_TIME}_camera-{camera}-image", with_image=True)
    require_same_view(frame, pinhole_town().cameras[camera])
    assert frame.view is not None
    assert (frame.view.sweep, frame.view.timestamp_ns) == (f"drive_{_TIME}", SWEEP_NS)
    assert frame.view.world_SE3_ego is not None
    assert np.allclose(frame.view.world_SE3_ego, WORLD_SE3_EGO, atol=1e-6)


def test_without_a_vehicle_the_lidar_is_the_ego_frame(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.mcap", pinhole_town(), vehicle=False)
    source = open_source(tmp_path)
    frame = source.load(source.names[0])
    require_same_view(frame, pinhole_town().cameras["front"])
    assert frame.view is not None
    assert frame.view.world_SE3_ego is None


def test_images_with_distortion_are_rectified(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.mcap", pinhole_town(), distortion=(-0.1, 0.02, 0, 0, 0))
    source = open_source(tmp_path)
    frame = source.load(source.names[0], with_image=True)
    stored = pinhole_town().cameras["front"].frame.image
    assert frame.lens is not None
    assert frame.image is not None
    assert stored is not None
    assert np.array_equal(frame.image, frame.lens.rectified_image(stored))


def test_lenses_that_are_not_known_are_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.mcap", pinhole_town(), distortion=(0.1,) * 6, model="fisheye62")
    source = open_source(tmp_path)
    with pytest.raises(CalibrationError, match="'fisheye62' is not known"):
        source.load(source.names[0])


def test_files_that_are_no_recordings(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"not a recording")
    with pytest.raises(DatasetError, match="no MCAP recording"):
        _ = open_source(tmp_path).names
    (tmp_path / "a.mcap").unlink()
    with pytest.raises(DatasetError, match="no dataset"):
        open_source(tmp_path)


def test_a_recording_that_was_cut_off_has_no_index(recording: Path, tmp_path: Path) -> None:
    data = recording.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(DatasetError, match="MCAP"):
        _ = open_source(tmp_path).names


def test_other_schemas_are_named(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
        channel = writer.register_channel("/points", "cdr", schema)
        writer.add_message(channel, 5, b"1234", 5)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(DatasetError, match=r"sensor_msgs/msg/PointCloud2 \(cdr\)"):
        _ = open_source(path).names


def step(parent: str, child: str, time: int, x: float) -> TimedTransform:
    return TimedTransform(parent, child, time, np.array([x, 0, 0]), np.array([1.0, 0, 0, 0]))


def test_transforms_are_interpolated_along_the_chain() -> None:
    tree = TransformTree([step("map", "base", 0, 0), step("map", "base", 10, 4), step("base", "lidar", 3, 1)])
    found = tree.between("map", "lidar", 5)
    assert found is not None
    assert found[:3, 3] == pytest.approx((3, 0, 0))
    back = tree.between("lidar", "map", 5)
    assert back is not None
    assert np.allclose(back @ found, np.eye(4))
    later = tree.between("map", "base", 99)
    assert later is not None
    assert later[0, 3] == 4
    assert tree.between("elsewhere", "lidar", 5) is None


def test_a_ring_of_transforms_does_not_hang() -> None:
    tree = TransformTree([step("a", "b", 0, 1), step("b", "a", 0, 1)])
    assert tree.between("c", "a", 0) is None
