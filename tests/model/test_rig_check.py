"""Wrong rigs are noticed from the data, right ones are left in peace."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boxlift import Calibration, Frame, Prompt
from boxlift.camera import Floats
from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.generated import RIGS, Rig, generate
from boxlift.priors import SIZE_PRIORS
from boxlift.rig_check import check_rig, find_ground_velo
from model.small_frame import CALIBRATION, CAMERA_HEIGHT_M, IMAGE_SIZE_PX, car, frame_of

CARS = [car(-5.0, 17.0, -1.5), car(1.0, 16.0, -1.5), car(-2.0, 22.0, -1.5), car(5.0, 18.0, -1.5)]


def street() -> Frame:
    """Cars ahead that hide the ground behind them; to the other side ground alone."""
    seen_through = frame_of(CARS)
    points_cam = seen_through.calibration.velo_to_cam(seen_through.points_velo)
    pixels, depth_m = CALIBRATION.project(points_cam)
    is_ground = np.abs(points_cam[:, 1] - CAMERA_HEIGHT_M) < 0.1
    hidden = np.zeros(len(points_cam), dtype=np.bool_)
    for box, prompt in zip(CARS, seen_through.prompts, strict=True):
        x1, y1, x2, y2 = prompt.box_px
        inside = ((pixels >= (x1, y1)) & (pixels <= (x2, y2))).all(axis=1)
        hidden |= inside & (depth_m > box.center_cam[0, 2] + 2.5)
    behind = points_cam[is_ground] * (-1, 1, -1)
    points_velo = CALIBRATION.cam_to_velo(np.concatenate([points_cam[~hidden], behind]))
    return replace(seen_through, points_velo=points_velo)


FRAME = street()


def rotation(axis: int, degrees: float) -> Floats:
    one, other = (axis + 1) % 3, (axis + 2) % 3
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    matrix = np.eye(3)
    matrix[one, one] = matrix[other, other] = cos
    matrix[other, one], matrix[one, other] = sin, -sin
    return matrix


def mounted(turned: Floats, translation: tuple[float, float, float] = (0, -0.08, -0.27)) -> Frame:
    """FRAME with another rotation and translation from LiDAR to camera."""
    cam_SE3_velo = np.eye(4)
    cam_SE3_velo[:3, :3], cam_SE3_velo[:3, 3] = turned, translation
    return replace(FRAME, calibration=Calibration(CALIBRATION.image_P_cam, cam_SE3_velo))


def seen_by(
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    size_px: tuple[int, int] = IMAGE_SIZE_PX,
    prompts: tuple[Prompt, ...] | None = None,
) -> Frame:
    """FRAME with another projection, and other prompts where they are given."""
    projection = np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0]])
    calibration = Calibration(projection, CALIBRATION.cam_SE3_velo)
    chosen = FRAME.prompts if prompts is None else prompts
    return replace(FRAME, calibration=calibration, image_size_px=size_px, prompts=chosen)


def prompted(*boxes: tuple[float, float, float, float]) -> Frame:
    return replace(FRAME, prompts=tuple(Prompt("Car", box) for box in boxes))


def doubts(frame: Frame) -> list[str]:
    return [warning.doubt.name for warning in check_rig(frame, SIZE_PRIORS)]


TURN = CALIBRATION.cam_SE3_velo[:3, :3]
WIDTH, HEIGHT = IMAGE_SIZE_PX
IN_THE_SKY = [(x, 20.0, x + 60, 60.0) for x in (100.0, 400.0, 700.0)]


def test_a_right_rig_is_left_in_peace() -> None:
    assert doubts(FRAME) == []
    assert doubts(frame_of(CARS)) == []  # as if several sweeps were one: ground shows through the cars
    assert doubts(replace(FRAME, prompts=())) == []


@pytest.mark.parametrize(
    ("frame", "doubt", "words"),
    [
        (mounted(TURN.T), "TILTED", "leans 90 degrees .* transpose would stand upright"),
        (mounted(np.eye(3)), "TILTED", "leans 90 degrees .* turn x forward"),
        (mounted(rotation(2, 180) @ TURN), "TILTED", "leans 180 degrees .* upside down"),
        # 90 taken for radians is 116.6 degrees.
        (mounted(rotation(0, 26.6) @ TURN), "TILTED", "leans 27 degrees .* degrees and radians"),
        (mounted(TURN, (0.0, -80.0, -270.0)), "LIDAR_FAR_AWAY", "282 m away .* metres"),
        (mounted(TURN, (0.0, -2.0, 0.0)), "CAMERA_HEIGHT", r"be -0\.3 m above the ground"),
        (
            seen_by(720, 720, 610, 175, (WIDTH // 2, HEIGHT // 2), ()),
            "IMAGE_SIZE",
            "1220 x 350 .* has 621 x 187",
        ),
        (
            seen_by(720, 720, 610, 175, (2 * WIDTH, 2 * HEIGHT), ()),
            "IMAGE_SIZE",
            "1220 x 350 .* has 2484 x 750",
        ),
        (seen_by(0.58, 1.92, 0.49, 0.47), "FOCAL_LENGTH", r"0\.58 and 1\.92 would give 1242 pixels a view"),
        (seen_by(-720, 720, 610, 175), "FOCAL_LENGTH", "-720"),
        (prompted((2500, 90, 2600, 200), (1400, 90, 1500, 200)), "PROMPTS_OUTSIDE_IMAGE", "2 of 2 2D boxes"),
        (mounted(rotation(1, 180) @ TURN), "PROMPTS_WITHOUT_OBJECTS", "4 of 4 2D boxes hold no object"),
    ],
)
def test_a_wrong_rig_is_noticed_and_the_sentence_says_what(frame: Frame, doubt: str, words: str) -> None:
    first, *_ = check_rig(frame, SIZE_PRIORS)
    assert first.doubt.name == doubt
    assert re.search(words, first.sentence)


def test_a_camera_on_the_roof_of_a_lorry_is_right() -> None:
    assert doubts(replace(mounted(TURN, (0.0, 2.0, 0.0)), prompts=())) == []


def test_points_of_another_direction_are_noticed_without_boxes() -> None:
    only_ahead = frame_of(CARS).points_velo
    frame = replace(mounted(rotation(1, 180) @ TURN), points_velo=only_ahead, prompts=())
    (warning,) = check_rig(frame, SIZE_PRIORS)
    assert warning.sentence.startswith(
        f"Only 0 of {len(frame.points_velo)} LiDAR points fall into the image."
    )


def test_what_the_mounting_explains_is_not_said_again() -> None:
    assert doubts(replace(mounted(TURN.T), prompts=prompted(*IN_THE_SKY).prompts)) == ["TILTED"]


def test_a_cut_out_image_whose_boxes_hold_their_objects_is_right() -> None:
    """Its principal point is that of half an image; only the boxes can tell the two apart."""
    cut = seen_by(720, 720, 610, 175, (900, 268))
    assert doubts(cut) == []
    assert doubts(replace(cut, prompts=())) == ["IMAGE_SIZE"]


def test_few_points_and_odd_boxes_say_nothing() -> None:
    assert doubts(replace(FRAME, points_velo=np.empty((0, 3)))) == []
    assert doubts(replace(FRAME, points_velo=FRAME.points_velo[:150])) == []
    assert doubts(replace(FRAME, points_velo=np.ones((5000, 3)), prompts=())) == ["NOTHING_IN_VIEW"]
    nan, huge = float("nan"), 1e308
    odd = prompted((nan, 0, 9, 9), (-huge, -huge, huge, huge), (9, 9, 9, 9), (0, 0, float("inf"), 90))
    assert doubts(odd) == []


def test_without_ground_the_lidars_own_axis_has_to_do() -> None:
    cloud = np.random.default_rng(0).uniform(-20, 20, size=(5000, 3))
    assert find_ground_velo(cloud, "cloud") is None
    assert doubts(replace(FRAME, points_velo=cloud, prompts=())) == []
    assert doubts(replace(mounted(TURN.T), points_velo=cloud, prompts=())) == ["TILTED"]


def test_ground_is_found_on_a_slope_and_under_walls() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-30, 30, size=(2, 3000))
    road = np.stack([x, y, 0.1 * x - 1.8], axis=1)
    wall = np.stack([x, np.full_like(x, 8.0), rng.uniform(-1, 6, 3000)], axis=1)
    ground = find_ground_velo(np.concatenate([road, wall]), "slope")
    assert ground is not None
    assert np.rad2deg(np.arctan2(-ground.up[0], ground.up[2])) == pytest.approx(5.7, abs=0.3)
    assert ground.up @ (np.zeros(3) - ground.point) == pytest.approx(1.8, abs=0.1)


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        (lambda turned: turned, None),
        (lambda turned: turned.T, "TILTED"),
        (lambda turned: TURN.T @ turned, "TILTED"),
        (lambda turned: rotation(0, 26.6) @ turned, "TILTED"),
    ],
)
@pytest.mark.parametrize("rig", RIGS.values(), ids=list(RIGS))
def test_generated_rigs(rig: Rig, change: Callable[[Floats], Floats], doubt: str | None) -> None:
    width, height = rig.image_size_px
    coarse = replace(
        rig,
        image_size_px=(width // 4, height // 4),
        focal_px=rig.focal_px / 4,
        principal_px=(rig.principal_px[0] / 4, rig.principal_px[1] / 4),
        projection_offset=(0.0, 0.0, 0.0),
        azimuth_step_deg=0.5,
    )
    frame = generate(2, coarse).frame
    cam_SE3_velo = frame.calibration.cam_SE3_velo.copy()
    cam_SE3_velo[:3, :3] = change(cam_SE3_velo[:3, :3])
    frame = replace(frame, calibration=Calibration(frame.calibration.image_P_cam, cam_SE3_velo))
    assert doubts(frame) == ([] if doubt is None else [doubt])


def test_real_frames_raise_no_doubt_and_their_transposes_do(kitti_object_root: Path) -> None:
    source = open_source(kitti_object_root)
    for name in ("000007", "000031", "001206", "006920"):
        frame = source.load(name, load_prompts("label_2", source, name))
        assert doubts(frame) == []
        cam_SE3_velo = frame.calibration.cam_SE3_velo.copy()
        cam_SE3_velo[:3, :3] = cam_SE3_velo[:3, :3].T
        transposed = Calibration(frame.calibration.image_P_cam, cam_SE3_velo)
        assert doubts(replace(frame, calibration=transposed)) == ["TILTED"]
