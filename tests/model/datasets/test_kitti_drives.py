"""KITTI raw and KITTI tracking, in their own layouts, of generated scenes."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.generated.write import calibration_text
from boxlift.datasets.posed_source import PosedSource
from boxlift.errors import CalibrationError, DatasetError, LabelFormatError, NoLidarError
from boxlift.formats import kitti_tracks
from boxlift.formats.kitti_tracks import TrackedObject
from model.datasets.town import FRONT, Town, require_objects, require_same_view, town

_DAY, _DRIVE = "2011_09_26", "2011_09_26_drive_0005"
# The GPS/IMU's place on KITTI's car is a turn and a shift; here it is made simple, to be seen in the poses.
_IMU = "R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.80\n"


def oxts_line(east_m: float, yaw_rad: float) -> str:
    """A record at the equator, where a degree of longitude is easily told in metres."""
    longitude = np.rad2deg(east_m / 6378137.0)
    return " ".join(str(value) for value in (0.0, longitude, 100.0, 0.0, 0.0, yaw_rad, *[0] * 24))


def write_raw(root: Path, scene: Town, frames: int = 2) -> Path:
    """The day's calibration and one drive that stands still; returns the drive's folder."""
    drive = root / _DAY / f"{_DRIVE}_sync"
    for part in ("image_02/data", "velodyne_points/data", "oxts/data"):
        (drive / part).mkdir(parents=True)
    rig = scene.cameras[FRONT].rig
    row = " ".join
    numbers: dict[str, Iterable[float]] = {
        "S_rect_02": rig.image_size_px,
        "P_rect_02": rig.projection.ravel(),
        "R_rect_00": rig.rectification.ravel(),
        "R_rect_02": np.full(9, 9.0),
    }
    lines = [f"{key}: {row(f'{value:.12e}' for value in values)}" for key, values in numbers.items()]
    (root / _DAY / "calib_cam_to_cam.txt").write_text("calib_time: now\n" + "\n".join(lines))
    transform = rig.unrectified_from_velo
    rotation, translation = (
        row(f"{value:.12e}" for value in part.ravel()) for part in (transform[:, :3], transform[:, 3])
    )
    (root / _DAY / "calib_velo_to_cam.txt").write_text(f"calib_time: now\nR: {rotation}\nT: {translation}\n")
    (root / _DAY / "calib_imu_to_velo.txt").write_text(_IMU)
    for number in range(frames):
        stem = f"{number:010d}"
        (drive / "image_02" / "data" / f"{stem}.png").write_bytes(scene.png(FRONT))
        (drive / "velodyne_points" / "data" / f"{stem}.bin").write_bytes(scene.points_velo.tobytes())
        (drive / "oxts" / "data" / f"{stem}.txt").write_text(oxts_line(2.0 * number, 0.0))
    times = (f"2011-09-26 13:02:{25 + number}.594360375\n" for number in range(frames))
    (drive / "velodyne_points" / "timestamps.txt").write_text("".join(times))
    (drive / "tracklet_labels.xml").write_text(tracklets_xml(scene, frames))
    return drive


def tracklets_xml(scene: Town, frames: int) -> str:
    """Every object, standing still, as KITTI's annotators' tool wrote them."""
    items = []
    for each in scene.objects:
        x, y, z = each.center_ego
        place = (
            f"<item><tx>{x}</tx><ty>{y}</ty><tz>{z - each.height_m / 2}</tz><rx>0</rx><ry>0</ry>"
            f"<rz>{each.yaw_rad}</rz><state>1</state><occlusion>0</occlusion><truncation>0</truncation></item>"
        )
        items.append(
            f"<item><objectType>{each.category}</objectType><h>{each.height_m}</h><w>{each.width_m}</w>"
            f"<l>{each.length_m}</l><first_frame>0</first_frame><poses><count>{frames}</count>"
            f"<item_version>2</item_version>{place * frames}</poses><finished>1</finished></item>"
        )
    return (
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        '<boost_serialization signature="serialization::archive" version="9"><tracklets class_id="0">'
        f"<count>{len(items)}</count><item_version>1</item_version>{''.join(items)}"
        "</tracklets></boost_serialization>"
    )


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("raw")
    write_raw(root, town())
    return root


def test_a_drive_of_kitti_raw(raw: Path) -> None:
    source = open_source(raw)
    assert source.layout == "KITTI raw"
    assert source.names == (f"{_DRIVE}_0000000000", f"{_DRIVE}_0000000001")
    frame = source.load(source.names[1], with_image=True)
    require_same_view(frame, town().cameras[FRONT])
    assert frame.view is not None
    assert (frame.view.log, frame.view.camera) == (_DRIVE, "image_02")
    assert frame.view.timestamp_ns == 1317042146594360375
    # The vehicle went 2 m east, which is ahead at yaw 0.
    start = source.load(source.names[0]).view
    assert start is not None
    assert start.world_SE3_ego is not None
    assert frame.view.world_SE3_ego is not None
    moved = frame.view.world_SE3_ego[:3, 3] - start.world_SE3_ego[:3, 3]
    assert np.allclose(moved, (2, 0, 0), atol=1e-6)


def test_a_day_and_a_drive_are_data_sets_too(raw: Path) -> None:
    names = open_source(raw).names
    assert open_source(raw / _DAY).names == names
    assert open_source(raw / _DAY / f"{_DRIVE}_sync").names == names


def test_tracklets_are_prompts_and_truth(raw: Path) -> None:
    source = open_source(raw)
    assert source.label_names == ("tracklets",)
    require_objects(source.objects("tracklets", source.names[0]), town().cameras[FRONT])
    prompts = load_prompts("tracklets", source, source.names[0])
    (front,) = [each for each in prompts if each.box_px[3] == max(p.box_px[3] for p in prompts)][:1]
    assert front.category == "Car"
    assert isinstance(source, PosedSource)
    sweeps = list(source.sweeps("tracklets"))
    assert [len(each.objects) for each in sweeps] == [len(town().objects)] * 2
    tracks = [sorted(str(item.track_id) for item in each.objects) for each in sweeps]
    assert tracks[0] == tracks[1]


def test_unsynchronised_drives_are_refused(tmp_path: Path) -> None:
    (tmp_path / f"{_DRIVE}_extract").mkdir()
    with pytest.raises(DatasetError, match="not rectified"):
        open_source(tmp_path)


def test_what_a_drive_lacks_is_named(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, town(), frames=1)
    source = open_source(tmp_path)
    name = source.names[0]
    (drive / "tracklet_labels.xml").write_text("<boost_serialization><tracklets><item>")
    with pytest.raises(LabelFormatError, match=r"tracklet_labels\.xml"):
        source.objects("tracklets", name)
    (tmp_path / _DAY / "calib_velo_to_cam.txt").write_text("R: 1 2\n")
    with pytest.raises(CalibrationError, match="9 numbers"):
        open_source(tmp_path).load(name)
    (drive / "velodyne_points" / "data" / "0000000000.bin").unlink()
    write_raw_again = open_source(tmp_path)
    assert write_raw_again.names == (name,)
    with pytest.raises(DatasetError, match="no frame 'nobody'"):
        write_raw_again.load("nobody")


def write_tracking(root: Path, scene: Town, frames: int = 2) -> None:
    training = root / "training"
    for part in ("image_02/0003", "velodyne/0003", "calib", "label_02", "oxts"):
        (training / part).mkdir(parents=True)
    generated = scene.cameras[FRONT]
    text = calibration_text(generated.rig)
    for ours, theirs in (
        ("R0_rect:", "R_rect"),
        ("Tr_velo_to_cam:", "Tr_velo_cam"),
        ("Tr_imu_to_velo:", "Tr_imu_velo"),
    ):
        assert ours in text
        text = text.replace(ours, theirs)
    (training / "calib" / "0003.txt").write_text(text)
    tracked = []
    for frame in range(frames):
        (training / "image_02" / "0003" / f"{frame:06d}.png").write_bytes(scene.png(FRONT))
        (training / "velodyne" / "0003" / f"{frame:06d}.bin").write_bytes(scene.points_velo.tobytes())
        tracked += [TrackedObject(frame, track, line) for track, line in enumerate(generated.truth)]
    (training / "label_02" / "0003.txt").write_text(kitti_tracks.to_text(tracked))
    (training / "oxts" / "0003.txt").write_text("\n".join(oxts_line(2.0 * n, 0.0) for n in range(frames)))


def test_a_sequence_of_kitti_tracking(tmp_path: Path) -> None:
    write_tracking(tmp_path, town())
    source = open_source(tmp_path)
    assert source.layout == "KITTI tracking"
    assert source.names == ("0003_000000", "0003_000001")
    frame = source.load("0003_000001", with_image=True)
    require_same_view(frame, town().cameras[FRONT])
    assert frame.view is not None
    assert frame.view.world_SE3_ego is not None
    assert frame.view.log == "0003"
    require_objects(source.objects("label_02", "0003_000001"), town().cameras[FRONT])
    truth = town().cameras[FRONT].truth
    assert [each.box_px for each in source.objects("label_02", "0003_000000")] == [e.box_px for e in truth]
    assert isinstance(source, PosedSource)
    assert [each.track_id for each in source.ego_objects("label_02", "0003_000000")][:2] == ["0", "1"]
    (tmp_path / "training" / "velodyne" / "0003" / "000001.bin").unlink()
    with pytest.raises(NoLidarError, match="'0003_000001' has no LiDAR points"):
        open_source(tmp_path).load("0003_000001")


def test_tracks_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "0000.txt"
    path.write_text("0 Car 0 0\n")
    with pytest.raises(LabelFormatError, match="no frame and track"):
        kitti_tracks.read_tracks(path)


def test_real_tracks_and_records(kitti_object_root: Path) -> None:
    """Drive 0009's own GPS/IMU: it drives, on a road, not through the air."""
    from boxlift.formats.oxts import imu_poses

    sequence = kitti_object_root.parent / "sequences" / "0009"
    if not sequence.is_dir():
        pytest.skip("no ../shared/kitti/sequences")
    files = sorted((sequence / "oxts").glob("*.txt"))
    poses = imu_poses([path.read_text() for path in files], "oxts")
    steps = [np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairwise(poses)]
    assert max(steps) < 40
    assert max(abs(each[2, 3]) for each in poses) < 20
    tracks = kitti_tracks.read_tracks(sequence / "label_02.txt")
    assert sum(len(each) for each in tracks.values()) > 100
