from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift.datasets import ImageFolder, load_prompts, open_images
from boxlift.errors import CalibrationError, DatasetError

CAMERA = "P2: 700 0 600 0 0 700 180 0 0 0 1 0\n"


def write_image(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.zeros((4, 6, 3), np.uint8)).save(path)
    return path


def write_text(path: Path, text: str = CAMERA) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def focal_of(folder: ImageFolder, name: str) -> float:
    return folder.camera(name).calibration.focal_px[0]


def test_one_image_with_a_calibration_of_its_own_or_a_folder_of_them(tmp_path: Path) -> None:
    image = write_image(tmp_path / "street 7.jpg")
    calib = write_text(tmp_path / "calibs" / "street 7.txt")
    for given in (calib, calib.parent):
        folder = open_images(image, given)
        assert folder.names == ("street 7",)
        assert folder.image_path("street 7") == image
        assert focal_of(folder, "street 7") == 700


def test_a_folder_of_images(tmp_path: Path) -> None:
    for name in ("b.png", "a.jpeg", ".hidden.png", "notes.txt"):
        write_image(tmp_path / name) if name.endswith(("png", "jpeg")) else write_text(tmp_path / name)
    calib = write_text(tmp_path / "cameras" / "a.txt")
    write_text(tmp_path / "cameras" / "b.json", '{"P2": [[9, 0, 6, 0], [0, 9, 2, 0], [0, 0, 1, 0]]}')
    folder = open_images(tmp_path, calib.parent)
    assert folder.names == ("a", "b")
    assert (focal_of(folder, "a"), focal_of(folder, "b")) == (700, 9)
    assert focal_of(open_images(tmp_path, calib), "b") == 700
    with pytest.raises(DatasetError, match="image 'a' has no calibration"):
        open_images(tmp_path).camera("a")


@pytest.mark.parametrize("inside", [".", "training", "testing"])
def test_layouts_with_image_2(tmp_path: Path, inside: str) -> None:
    root = tmp_path / inside
    write_image(root / "image_2" / "000001.png")
    write_text(root / "calib" / "000001.txt")
    write_text(root / "label_2" / "000001.txt", "Car 0 0 0 1 2 3 4 1 1 1 1 1 1 1\n")
    folder = open_images(tmp_path)
    assert folder.root == root
    assert folder.names == ("000001",)
    assert focal_of(folder, "000001") == 700
    (prompt,) = load_prompts("label_2", folder, "000001")
    assert prompt.box_px == (1, 2, 3, 4)
    other = write_text(tmp_path / "other.txt", CAMERA.replace("700", "350"))
    assert focal_of(open_images(tmp_path, other), "000001") == 350


def test_one_calibration_beside_image_2(tmp_path: Path) -> None:
    write_image(tmp_path / "image_2" / "a.png")
    write_text(tmp_path / "calib.txt")
    assert focal_of(open_images(tmp_path), "a") == 700


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no such file or folder"):
        open_images(tmp_path / "nowhere")
    with pytest.raises(DatasetError, match="holds no image"):
        open_images(tmp_path)
    with pytest.raises(DatasetError, match="no image by its name"):
        open_images(write_text(tmp_path / "a.txt"))
    image = write_image(tmp_path / "a.png")
    with pytest.raises(DatasetError, match="calibration does not exist"):
        open_images(image, tmp_path / "nowhere.txt")
    folder = open_images(image, tmp_path)
    with pytest.raises(DatasetError, match="no image 'b'"):
        folder.image_path("b")
    (tmp_path / "a.txt").write_text("P2: nan")
    with pytest.raises(CalibrationError, match=r"a\.txt\.P2"):
        folder.camera("a")
