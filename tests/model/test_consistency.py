from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift import Boxes3D, Calibration
from boxlift.camera import Floats
from boxlift.consistency import agree_with_prompts, cut_edges
from boxlift.settings import PAPER, RELEASE
from model.small_frame import CALIBRATION, IMAGE_SIZE_PX, car


def shifted(box: Boxes3D, *offset: float) -> Boxes3D:
    return replace(box, center_cam=box.center_cam + np.array(offset))


def agree(box: Boxes3D, prompts_px: Floats, settings: object = PAPER.consistency) -> Boxes3D:
    assert isinstance(settings, type(PAPER.consistency))
    return agree_with_prompts(box, prompts_px, CALIBRATION, IMAGE_SIZE_PX, settings)


@pytest.mark.parametrize("offset", [-0.6, 0.4, 1.0])
def test_paper_moves_y_back_to_the_prompt_and_nothing_else(offset: float) -> None:
    box = car(4.0, 18.0, -1.2)
    fixed = agree(shifted(box, 0, offset, 0), box.project(CALIBRATION))
    assert fixed.center_cam == pytest.approx(box.center_cam, abs=1e-3)
    assert fixed.height_m.tolist() == box.height_m.tolist()


def test_a_wrong_height_is_shared_between_top_and_bottom() -> None:
    box = car(0.0, 20.0, 0.0)
    low = replace(box, height_m=np.array([1.4]))
    fixed = agree(low, box.project(CALIBRATION))
    residual = (fixed.project(CALIBRATION) - box.project(CALIBRATION))[0]
    assert residual[1] == pytest.approx(-residual[3], rel=0.15)


def test_release_moves_x_y_and_height_within_its_limit() -> None:
    box = car(4.0, 18.0, -1.2)
    off = replace(shifted(box, 0.2, 0.2, 0), height_m=np.array([1.45]))
    fixed = agree(off, box.project(CALIBRATION), RELEASE.consistency)
    assert fixed.center_cam == pytest.approx(box.center_cam, abs=5e-3)
    assert fixed.height_m == pytest.approx(box.height_m, abs=5e-3)
    far_off = agree(shifted(box, 0, 1.0, 0), box.project(CALIBRATION), RELEASE.consistency)
    assert far_off.center_cam[0, 1] == pytest.approx(box.center_cam[0, 1] + 0.7, abs=1e-6)


def test_edges_cut_by_the_image_are_not_believed() -> None:
    box = car(0.3, 3.2, 0.0)  # its bottom edge lies below the image
    prompt = box.project(CALIBRATION).clip(0, (*IMAGE_SIZE_PX, *IMAGE_SIZE_PX))
    assert cut_edges(prompt, IMAGE_SIZE_PX).tolist() == [[False, False, True, True]]
    fixed = agree(shifted(box, 0, 0.3, 0), prompt)
    assert fixed.center_cam == pytest.approx(box.center_cam, abs=1e-3)


def test_all_edges_cut_leaves_the_box() -> None:
    box = car(0.0, 12.0, 0.0)
    prompt = np.array([[0.0, 0.0, 1242.0, 375.0]])
    assert agree(box, prompt).center_cam.tolist() == box.center_cam.tolist()


def test_a_box_that_reaches_behind_the_camera_stays() -> None:
    box = car(2.0, 1.0, -np.pi / 2)
    prompt = np.array([[700.0, 100.0, 1200.0, 300.0]])
    assert agree(box, prompt).center_cam.tolist() == box.center_cam.tolist()


@pytest.mark.parametrize("settings", [PAPER.consistency, RELEASE.consistency])
def test_a_camera_set_back_from_the_frame_gives_numbers(settings: object) -> None:
    """With P[2, 3] < 0 a corner may lie before the frame's origin and yet behind the camera."""
    matrix = CALIBRATION.image_P_cam.copy()
    matrix[2, 3] = -2.0
    calibration = Calibration(matrix, CALIBRATION.cam_SE3_velo)
    assert isinstance(settings, type(PAPER.consistency))
    for z in (1.5, 2.5, 4.0, 9.0):
        prompt = np.array([[700.0, 100.0, 1200.0, 300.0]])
        moved = agree_with_prompts(car(1.0, z, -1.2), prompt, calibration, IMAGE_SIZE_PX, settings)
        assert np.isfinite(moved.center_cam).all()
        assert np.isfinite(moved.height_m).all()


def test_boxes_do_not_influence_each_other() -> None:
    boxes = [car(4.0, 18.0, -1.2), car(-6.0, 30.0, 0.4)]
    together = Boxes3D(
        *(
            np.concatenate([getattr(b, f) for b in boxes])
            for f in ("center_cam", "length_m", "width_m", "height_m", "rotation_y")
        )
    )
    prompts = together.project(CALIBRATION)
    both = agree(shifted(together, 0, 0.5, 0), prompts)
    alone = [agree(shifted(b, 0, 0.5, 0), prompts[i : i + 1]) for i, b in enumerate(boxes)]
    assert both.center_cam == pytest.approx(np.concatenate([b.center_cam for b in alone]), abs=1e-9)


def test_nothing_to_do() -> None:
    assert len(agree(Boxes3D.empty(), np.empty((0, 4)))) == 0
