"""What two cameras saw of one object becomes one label."""

from __future__ import annotations

import numpy as np

from boxlift.formats.details import FrameDetails, details_of, view_details_of
from boxlift.formats.ego_boxes import sweep_labels_of_details
from boxlift.labeller import Labeller
from boxlift.merging import merge_views
from boxlift.poses import about_z
from boxlift.sweep import EgoObject, SweepLabels, SweepView
from model.datasets.town import Town, pinhole_town


def car(
    x: float, y: float, score: float, camera: str, category: str = "Car", yaw_rad: float = 0.3
) -> EgoObject:
    size = (0.6, 0.6, 1.7) if category == "Pedestrian" else (4.2, 1.8, 1.5)
    return EgoObject(category, np.array([x, y, 0.8]), about_z(yaw_rad), *size, score=score, cameras=(camera,))


def view(*objects: EgoObject) -> SweepLabels:
    return SweepLabels("sweep", objects, "log", 5)


def test_one_object_of_two_cameras_is_one_label_with_the_better_box() -> None:
    merged = merge_views([view(car(10, 5, 0.6, "front")), view(car(10.4, 5.3, 0.9, "left", "Van"))])
    (label,) = merged.objects
    assert (label.category, label.score, label.cameras) == ("Van", 0.9, ("front", "left"))
    assert (merged.sweep, merged.log, merged.timestamp_ns) == ("sweep", "log", 5)


def test_neighbours_stay_two() -> None:
    beside = merge_views([view(car(10, 5, 0.6, "front")), view(car(10, 7.0, 0.9, "left"))])
    assert len(beside.objects) == 2
    person = merge_views([view(car(10, 5, 0.6, "front")), view(car(10, 6.1, 0.9, "left", "Pedestrian"))])
    assert len(person.objects) == 2


def test_what_one_camera_has_twice_stays_twice() -> None:
    """Both of its boxes lie on the other camera's: one takes it, the other stays."""
    merged = merge_views(
        [view(car(10, 5, 0.9, "front"), car(10.5, 5, 0.4, "front")), view(car(10, 5, 0.5, "left"))]
    )
    assert sorted((each.score, len(each.cameras)) for each in merged.objects) == [(0.4, 1), (0.9, 2)]


def test_three_cameras_meet() -> None:
    merged = merge_views([view(car(10 + 0.2 * n, 5, 0.5 + 0.1 * n, name)) for n, name in enumerate("abc")])
    (label,) = merged.objects
    assert label.cameras == ("a", "b", "c")
    assert label.score == 0.7


def test_a_single_view_and_an_empty_one() -> None:
    alone = view(car(10, 5, 0.2, "front"), car(10, 5, 0.4, "front"))
    assert [each.score for each in merge_views([alone]).objects] == [0.4, 0.2]
    assert merge_views([view(), view()]).objects == ()


def labelled(scene: Town, camera: str) -> FrameDetails:
    frame = scene.cameras[camera].frame
    place = SweepView("sweep", camera, scene.velo_SE3_cam(camera))
    details = details_of(Labeller().label(frame))
    return details.model_copy(update={"view": view_details_of(place)})


def test_a_generated_sweep_has_every_object_once() -> None:
    """Labelled for real in both cameras: afterwards each true object that has a box has one."""
    scene = pinhole_town()
    views = [sweep_labels_of_details(labelled(scene, camera)) for camera in scene.cameras]
    both = sum(len(each.objects) for each in views)
    merged = merge_views(views)
    assert len(merged.objects) < both
    centers = np.array([each.center_ego for each in merged.objects])
    for true in scene.objects:
        assert (np.linalg.norm(centers[:, :2] - true.center_ego[:2], axis=1) < 1.0).sum() <= 1
    assert any(len(each.cameras) == 2 for each in merged.objects)
