"""The preset as a user meets it: frames in, boxes and sentences out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift import Frame, Prompt, Result
from boxlift.datasets.generated import RIGS, SceneSettings, generate
from boxlift.formats import details
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.frame import FrameLabels, ObjectLabel
from boxlift.labeller import Labeller, StageTimes
from boxlift.overlap import iou_3d
from boxlift.settings import ACCURATE, RepairSettings
from model.small_frame import CALIBRATION, IMAGE_SIZE_PX, car, frame_of

CARS = [car(3.0, 14.0, -1.4), car(-5.0, 22.0, -1.7), car(12.0, 30.0, 0.0)]
ROAD = (560.0, 300.0, 640.0, 360.0)


def labelled(frame: Frame, **repairs: object) -> FrameLabels:
    return Labeller(ACCURATE.with_options({"repairs": repairs})).label(frame)


def told(frame: Frame, prompt: Prompt) -> ObjectLabel:
    """The label of a prompt that stands among usable ones, after seeing that those are as without it."""
    prompts = (frame.prompts[0], prompt, *frame.prompts[1:])
    first, label, *others = Labeller().label(replace(frame, prompts=prompts)).objects
    whole = Labeller().label(frame).objects
    assert [one.result for one in (first, *others)] == [one.result for one in whole]
    for one, alone in zip((first, *others), whole, strict=True):
        assert one.box is not None
        assert alone.box is not None
        # Samples of points are seeded by the number of a prompt, so these are not the same to the byte.
        assert iou_3d(one.box, alone.box)[0] > 0.9
    assert label.index == 1
    assert label.prompt == prompt
    return label


def test_a_label_has_a_box_a_probability_and_other_hypotheses_with_reasons() -> None:
    labels = labelled(frame_of(CARS))
    assert labels.counts() == {"FITTED": 3}
    for truth, label in zip(CARS, labels.objects, strict=True):
        assert label.box is not None
        assert iou_3d(label.box, truth)[0] > 0.8
        assert label.iou_probability is not None
        likely, strict = label.iou_probability
        assert 0 <= strict <= likely <= 1
        assert label.score == likely  # the prompts' own score is 1
        assert label.rejected
        for hypothesis in label.rejected:
            assert "Less likely by" in hypothesis.reason
            assert " against " in hypothesis.reason
        assert label.losses is not None
        assert 0 < label.points.used <= label.points.in_cluster
        assert label.points.above_ground <= label.points.in_prompt


def test_a_box_drives_away_from_the_camera() -> None:
    """Front and back look alike; of the two headings the one whose z is not negative is told."""
    for label in labelled(frame_of(CARS)).objects:
        for box in (label.box, *(hypothesis.box for hypothesis in label.rejected)):
            assert box is not None
            assert -np.pi <= box.rotation_y[0] <= 0


@pytest.mark.parametrize(("score", "share"), [(0.5, 0.5), (7.0, 1.0), (-3.0, 0.0)])
def test_the_prompts_score_is_a_factor_between_0_and_1(score: float, share: float) -> None:
    prompt = replace(frame_of(CARS[:1]).prompts[0], score=score)
    (label,) = labelled(frame_of(CARS[:1], [prompt])).objects
    assert label.iou_probability is not None
    assert label.score == pytest.approx(share * label.iou_probability[0])


def test_fixed_sizes_are_the_frozen_ones_to_the_bit() -> None:
    for label in labelled(frame_of(CARS), size="fixed").objects:
        assert label.box is not None
        for box in (label.box, *(hypothesis.box for hypothesis in label.rejected)):
            assert (box.length_m[0], box.width_m[0], box.height_m[0]) == (4.0, 1.8, 1.6)
            assert box.bottom_y[0] == pytest.approx(1.65, abs=0.2)
        assert "size_from_prior" in label.flags


def test_the_same_frame_gives_the_same_bytes() -> None:
    frame = frame_of(CARS)
    once, again = (details.to_text(labelled(frame)) for _ in range(2))
    assert once == again


@pytest.mark.parametrize(
    ("prompt", "result", "words"),
    [
        (Prompt("Tram", (700.0, 180.0, 820.0, 270.0)), Result.UNKNOWN_CLASS, "'Tram'"),
        (Prompt("Car", (5.0, 5.0, 5.0, 50.0)), Result.BAD_BOX, "no area"),
        (Prompt("Car", (float("nan"), 5.0, 9.0, 50.0)), Result.BAD_BOX, "absurd"),
        (Prompt("Car", (1300.0, 5.0, 1400.0, 50.0)), Result.BOX_OUTSIDE_IMAGE, "1242 x 375"),
        (Prompt("Car", (600.0, 10.0, 640.0, 60.0)), Result.TOO_FEW_POINTS, "(0, at least 2 are needed)"),
        (Prompt("Car", ROAD), Result.NO_OBJECT_POINTS, "they are ground"),
    ],
)
def test_a_prompt_that_cannot_be_used_says_why_and_costs_nobody_else_anything(
    prompt: Prompt, result: Result, words: str
) -> None:
    label = told(frame_of(CARS), prompt)
    assert label.result is result
    assert words in label.sentence
    assert "{" not in label.sentence
    assert label.box is None
    assert label.score == 0
    assert label.rejected == ()


def test_masks() -> None:
    """The first car's mask is exact, the second's is on the road, the third has none."""
    frame = frame_of(CARS)
    ids = np.zeros(IMAGE_SIZE_PX[::-1], dtype=np.uint16)
    x1, y1, x2, y2 = (int(edge) for edge in frame.prompts[0].box_px)
    ids[y1 : y2 + 1, x1 : x2 + 1] = 1
    left, _, _, bottom = (int(edge) for edge in frame.prompts[1].box_px)
    ids[bottom - 1 : bottom + 1, left : left + 4] = 2
    first, second, third = labelled(replace(frame, instance_ids=ids)).objects
    assert first.box is not None
    assert iou_3d(first.box, CARS[0])[0] > 0.8
    assert second.result in (Result.TOO_FEW_POINTS, Result.NO_OBJECT_POINTS)
    assert "mask" in second.sentence
    assert third.result is Result.EMPTY_MASK
    assert third.sentence == Result.EMPTY_MASK.value


def test_flags_name_what_to_look_at() -> None:
    whole, *_ = labelled(frame_of(CARS)).objects
    assert whole.flags == ("heading_ambiguous",)
    cut = car(-9.0, 10.0, -1.5)
    (label,) = labelled(frame_of([cut])).objects
    assert "truncated" in label.flags
    (label,) = labelled(frame_of(CARS[:1], ground_count=0)).objects
    assert "ground_uncertain" in label.flags


def test_a_prompt_that_nothing_supports_is_told_as_no_object() -> None:
    """A pedestrian as wide as a car: points, edges and size contradict one another."""
    frame = frame_of(CARS[:1])
    prompt = replace(frame.prompts[0], category="Pedestrian")
    (label,) = labelled(replace(frame, prompts=(prompt,))).objects
    assert label.result is Result.NO_OBJECT
    assert label.box is None
    assert label.score == 0
    assert "looks like a Pedestrian" in label.sentence


def test_few_points_are_flagged() -> None:
    frame = frame_of(CARS[:1])
    thin = np.concatenate([frame.points_velo[:6000], frame.points_velo[6000::30]])
    (label,) = labelled(replace(frame, points_velo=thin)).objects
    assert label.box is not None
    assert "few_points" in label.flags
    assert label.points.above_ground < 30


def test_times_name_the_stages_in_order() -> None:
    times = StageTimes()
    Labeller().label(frame_of(CARS[:1]), times)
    assert list(times.seconds) == ["rig", "ground", "scout", "fit", "polish", "evidence", "confidence"]


REPAIRS_OFF: list[dict[str, object]] = [
    {"claim": False},
    {"cluster_scales": (1.0,)},
    {"max_clusters": 1},
    {"closeness": False},
    {"perpendicular": False},
    {"prompt_placement": False},
    {"fits": 1},
    {"choose": "loss"},
    {"edges": False},
    {"exclusion_weight": 0.0},
    {"polish": False},
    {"size": "fixed"},
]


def test_every_repair_is_switched_off_here() -> None:
    assert {name for off in REPAIRS_OFF for name in off} == set(RepairSettings.model_fields)


@pytest.mark.parametrize(
    "off", [*REPAIRS_OFF, {k: v for off in REPAIRS_OFF for k, v in off.items()}], ids=str
)
def test_without_a_repair_cars_still_get_boxes(off: dict[str, object]) -> None:
    labels = labelled(frame_of(CARS), **off)
    assert labels.counts() == {"FITTED": 3}
    assert details.to_text(labels)


def test_adam_is_an_option() -> None:
    settings = ACCURATE.with_options({"fit": {"method": "adam", "adam_steps": 100}})
    (label,) = Labeller(settings).label(frame_of(CARS[:1])).objects
    assert label.box is not None
    assert iou_3d(label.box, CARS[0])[0] > 0.6


def test_without_ground_removal_the_camera_stands_at_its_usual_height() -> None:
    settings = ACCURATE.with_options({"ground": {"remove": False}})
    (label,) = Labeller(settings).label(frame_of(CARS[:1])).objects
    assert label.box is not None
    assert iou_3d(label.box, CARS[0])[0] > 0.7
    assert "ground_uncertain" in label.flags


@pytest.mark.parametrize(("rig", "seed"), [("kitti", 2), ("far_apart", 2)])
def test_generated_cars_in_plain_view_are_found(rig: str, seed: int) -> None:
    """Also where the LiDAR stands high and far beside the camera: it sees past what hides the car."""
    generated = generate(seed, RIGS[rig], SceneSettings(layout="street", relief=1.0))
    labels = Labeller().label(generated.frame)
    found = []
    for truth, label in zip(generated.truth, labels.objects, strict=False):
        tall = truth.box_px[3] - truth.box_px[1] >= 25
        if truth.category == "Car" and tall and truth.occluded == 0 and truth.truncated <= 0.3:
            found.append(label.box is not None and bool(iou_3d(label.box, boxes3d_of([truth]))[0] > 0.5))
    assert len(found) >= 2
    assert np.mean(found) > 0.6


def test_a_sweep_cropped_to_the_view_labels_alike() -> None:
    """What lies to the sides and behind has no part in it."""
    frame = frame_of(CARS)
    behind = frame.points_velo * np.array([-1.0, 1, 1])
    whole = replace(frame, points_velo=np.concatenate([frame.points_velo, behind]))
    assert CALIBRATION.velo_to_cam(behind)[:, 2].max() < 0
    assert details.to_text(labelled(whole)) == details.to_text(labelled(frame))
