"""Plain folders: any stems, any supported suffix, and what is said when a file is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift import Calibration, Prompt
from boxlift.datasets import load_objects, load_prompts, open_source
from boxlift.datasets.plain_folder import PlainFolder
from boxlift.errors import DatasetError, InputError, LabelFormatError, PointCloudError
from boxlift.formats import kitti_label
from boxlift.formats.calibration import to_kitti_text
from boxlift.formats.kitti_label import KittiObject

POINTS = np.arange(12, dtype=np.float32).reshape(3, 4)
CALIBRATION = to_kitti_text(
    Calibration(np.array([[100.0, 0, 50, 0], [0, 100, 40, 0], [0, 0, 1, 0]]), np.eye(4))
)
CALIBRATION_JSON = (
    '{"P2": [[100, 0, 50, 0], [0, 100, 40, 0], [0, 0, 1, 0]], "image_size": [64, 48],'
    ' "cam_T_velo": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}'
)
LABEL = "Car 0.00 0 0.00 1.00 2.00 3.00 4.00 1.60 1.80 4.00 1.00 2.00 9.00 0.00\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two frames: 'street 7' by its usual files, '12.b' by others."""
    for folder in ("velodyne", "calib", "image_2", "masks", "boxes"):
        (tmp_path / folder).mkdir()
    (tmp_path / "velodyne" / "street 7.bin").write_bytes(POINTS.tobytes())
    (tmp_path / "calib" / "street 7.txt").write_text(CALIBRATION)
    Image.new("RGB", (64, 48), (9, 8, 7)).save(tmp_path / "image_2" / "street 7.png")
    np.save(tmp_path / "velodyne" / "12.b.npy", POINTS)
    (tmp_path / "calib" / "12.b.json").write_text(CALIBRATION_JSON)
    (tmp_path / "velodyne" / ".street 7.bin").write_bytes(b"left by a file browser")
    (tmp_path / "velodyne" / "notes.md").write_text("no cloud")
    return tmp_path


def test_names_are_the_stems_sorted(root: Path) -> None:
    assert open_source(root).names == ("12.b", "street 7")


def test_frame_with_an_image(root: Path) -> None:
    prompts = (Prompt("Car", (1, 2, 3, 4)),)
    frame = open_source(root).load("street 7", prompts)
    assert frame.name == "street 7"
    assert frame.prompts == prompts
    assert frame.image_size_px == (64, 48)
    assert frame.calibration.focal_px == (100, 100)
    assert frame.image is None
    np.testing.assert_array_equal(frame.points_velo, POINTS)


def test_frame_without_an_image_takes_the_size_from_its_calibration(root: Path) -> None:
    frame = open_source(root).load("12.b", with_image=True)
    assert frame.image_size_px == (64, 48)
    assert frame.image is None


def test_pixels_only_when_asked_for(root: Path) -> None:
    path = root / "image_2" / "street 7.png"
    whole = path.read_bytes()
    image = open_source(root).load("street 7", with_image=True).image
    assert image is not None
    assert image[0, 0].tolist() == [9, 8, 7]
    path.write_bytes(whole[:45])  # the header alone
    assert open_source(root).load("street 7").image_size_px == (64, 48)
    with pytest.raises(InputError, match="decoded"):
        open_source(root).load("street 7", with_image=True)


def test_masks_only_when_asked_for(root: Path) -> None:
    ids = np.zeros((48, 64), np.uint16)
    ids[3, 4] = 1
    Image.fromarray(ids).save(root / "masks" / "street 7.png")
    assert open_source(root).load("street 7").instance_ids is None
    loaded = open_source(root).load("street 7", masks=root / "masks").instance_ids
    assert loaded is not None
    np.testing.assert_array_equal(loaded, ids)
    with pytest.raises(DatasetError, match=r"12\.b\.png"):
        open_source(root).load("12.b", masks=root / "masks")


@pytest.mark.parametrize("name", ["calib.txt", "calib.json"])
def test_one_calibration_for_all_frames(root: Path, name: str) -> None:
    (root / "calib" / "street 7.txt").unlink()
    (root / name).write_text(CALIBRATION_JSON if name.endswith("json") else CALIBRATION)
    assert open_source(root).load("street 7").calibration.focal_px == (100, 100)


def test_jpeg(root: Path) -> None:
    (root / "image_2" / "street 7.png").unlink()
    Image.new("RGB", (60, 40)).save(root / "image_2" / "street 7.JPEG")
    assert open_source(root).load("street 7").image_size_px == (60, 40)


def test_the_first_suffix_wins(root: Path) -> None:
    np.save(root / "velodyne" / "street 7.npy", POINTS[:1])
    assert len(open_source(root).load("street 7").points_velo) == 3


@pytest.mark.parametrize(
    ("missing", "name", "says"),
    [
        ("velodyne/street 7.bin", "street 7", "no LiDAR points"),
        ("calib/street 7.txt", "street 7", "no calibration"),
        ("velodyne/notes.md", "notes", "no frame 'notes'"),
        ("velodyne/notes.md", "../street 7", "no frame"),
    ],
)
def test_what_is_missing_is_named(root: Path, missing: str, name: str, says: str) -> None:
    (root / missing).unlink()
    source = open_source(root)
    with pytest.raises(DatasetError) as caught:
        source.load(name)
    assert says in caught.value.problem
    assert caught.value.remedy


def test_unknown_image_size_says_what_to_add(root: Path) -> None:
    (root / "image_2" / "street 7.png").unlink()
    with pytest.raises(DatasetError) as caught:
        open_source(root).load("street 7")
    assert "image_size" in caught.value.remedy


def test_calibration_of_another_image(root: Path) -> None:
    Image.new("RGB", (65, 48)).save(root / "image_2" / "12.b.png")
    with pytest.raises(DatasetError, match=r"\(65, 48\).*\(64, 48\)"):
        open_source(root).load("12.b")


def test_damaged_points_name_the_file(root: Path) -> None:
    (root / "velodyne" / "street 7.bin").write_bytes(POINTS.tobytes()[:-1])
    with pytest.raises(PointCloudError, match=r"street 7\.bin: 47 bytes"):
        open_source(root).load("street 7")


def test_prompts_of_a_folder(root: Path) -> None:
    (root / "boxes" / "street 7.txt").write_text(LABEL)
    source = open_source(root)
    assert load_prompts(root / "boxes", source, "street 7") == (Prompt("Car", (1, 2, 3, 4)),)
    assert load_prompts("boxes", source, "street 7") == (Prompt("Car", (1, 2, 3, 4)),)
    assert load_objects("boxes", source, "street 7")[0].bottom_center_cam == (1, 2, 9)
    with pytest.raises(DatasetError, match=r"12\.b\.txt"):
        load_prompts("boxes", source, "12.b")
    with pytest.raises(DatasetError, match="label_2"):
        load_prompts("label_2", source, "street 7")
    (root / "boxes" / "12.b.txt").write_text("Car 1\n")
    with pytest.raises(LabelFormatError, match=r"12\.b\.txt:1"):
        load_prompts("boxes", source, "12.b")


def test_folders_that_are_no_source(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="does not exist"):
        open_source(tmp_path / "absent")
    with pytest.raises(DatasetError, match="holds nothing"):
        open_source(tmp_path)
    (tmp_path / "holiday.jpg").touch()
    with pytest.raises(DatasetError, match=r"holiday\.jpg"):
        open_source(tmp_path)


def test_a_data_set_s_own_annotations_go_before_a_folder_of_that_name(tmp_path: Path) -> None:
    class Annotated(PlainFolder):
        label_names = ("boxes",)

        def objects(self, labels: str, name: str) -> list[KittiObject]:
            return kitti_label.parse_text(LABEL, f"{labels}/{name}")

    (tmp_path / "boxes").mkdir()
    (tmp_path / "boxes" / "a.txt").write_text("")
    assert load_prompts("boxes", Annotated(tmp_path), "a") == (Prompt("Car", (1, 2, 3, 4)),)
    assert load_prompts("boxes", PlainFolder(tmp_path), "a") == ()
    with pytest.raises(DatasetError, match="no such annotations"):
        PlainFolder(tmp_path).objects("boxes", "a")
