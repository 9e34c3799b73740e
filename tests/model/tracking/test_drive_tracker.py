"""A drive's frames after tracking: better boxes, one track for an object, nothing lost, nothing invented."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from boxlift.boxes import wrap_angle
from boxlift.formats.details import FrameDetails, view_details_of
from boxlift.formats.ego_boxes import sweep_labels_of_details
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.frame import Frame, Prompt, Result
from boxlift.settings import ACCURATE, PAPER
from boxlift.sweep import SweepView
from boxlift.tracking import DriveTracker, Fill, Motion, SweepFrames
from boxlift.tracking.relabel import NOT_SEEN_HERE, SINGLE_SIGHTING
from model.tracking.drives import Drive, box_of, drive, overlaps

SEEDS = (3, 300)


def tracked(driven: Drive, fill: Fill = "gaps", tracker: DriveTracker | None = None) -> list[FrameDetails]:
    tracker = tracker or DriveTracker(ACCURATE, fill=fill)
    return list(tracker.track(driven.frames, driven))


def longest_track(frames: Sequence[FrameDetails], motion: Motion) -> int:
    sightings = {
        each.track.id: each.track.sightings
        for frame in frames
        for each in frame.objects
        if each.track and each.track.motion == motion
    }
    return max(sightings, key=lambda track: sightings[track])


def numbers_of(frames: Sequence[FrameDetails], track: int) -> dict[str, int]:
    """Frame -> number of the track's object."""
    return {
        frame.frame: number
        for frame in frames
        for number, each in enumerate(frame.objects)
        if each.track and each.track.id == track
    }


def test_boxes_overlap_the_truth_more_than_before() -> None:
    before: list[float] = []
    after: list[float] = []
    for seed in SEEDS:
        driven = drive(seed)
        for sweep, details in zip(driven.sweeps, tracked(driven), strict=True):
            before += overlaps(sweep, driven.labelled[details.frame]).values()
            after += overlaps(sweep, details).values()
    assert np.mean(after) > np.mean(before) + 0.01
    assert np.mean(np.array(after) > 0.5) >= np.mean(np.array(before) > 0.5)
    assert np.mean(np.array(after) > 0.7) > np.mean(np.array(before) > 0.7)


def test_an_object_keeps_its_track_and_its_size() -> None:
    driven = drive(300)
    tracks: defaultdict[int, set[int]] = defaultdict(set)
    sizes: defaultdict[int, set[tuple[float, float, float]]] = defaultdict(set)
    for sweep, details in zip(driven.sweeps, tracked(driven), strict=True):
        for number, (true_track, _) in enumerate(sweep.tracked):
            item = details.objects[number]
            if item.track is None or item.box is None:
                continue
            tracks[true_track].add(item.track.id)
            if item.track.sightings > 1:
                size = item.box.length_m, item.box.width_m, item.box.height_m
                sizes[item.track.id].add(size)
    assert sum(len(each) for each in tracks.values()) <= len(tracks) + 1
    assert all(len(each) == 1 for each in sizes.values())


def test_what_moves_looks_ahead() -> None:
    driven = drive(306, 20)
    errors = []
    for sweep, details in zip(driven.sweeps, tracked(driven), strict=True):
        for number, (_, line) in enumerate(sweep.tracked):
            item = details.objects[number]
            if item.track and item.track.motion == Motion.MOVING and item.box and line.category == "Car":
                assert "heading_ambiguous" not in item.flags
                errors.append(abs(float(wrap_angle(np.array(item.box.rotation_y - line.rotation_y)))))
    assert len(errors) >= 20
    assert np.quantile(errors, 0.9) < 0.1


def test_every_frame_is_there_once_with_all_its_prompts() -> None:
    driven = drive(3)
    frames = tracked(driven)
    assert [each.frame for each in frames] == [name for each in driven.frames for name in each.frames]
    for frame in frames:
        own = driven.labelled[frame.frame].objects
        assert [each.index for each in frame.objects] == list(range(len(frame.objects)))
        assert len(frame.objects) >= len(own)
        for before, after in zip(own, frame.objects, strict=False):
            assert before.prompt_box_px == after.prompt_box_px
            assert before.box is None or after.box is not None


def test_what_the_frame_said_is_kept_beside_it() -> None:
    driven = drive(3)
    frames = tracked(driven)
    item = frames[0].objects[0]
    before = driven.labelled[frames[0].frame].objects[0]
    assert item.rejected[0].box == before.box
    assert item.rejected[0].reason == "What this frame alone says."
    assert item.iou_probability is None
    assert item.losses is not None
    assert item.losses != before.losses


def test_a_prompt_that_a_detector_missed_is_filled_and_only_in_between() -> None:
    driven = drive(3)
    frames = tracked(driven)
    track = longest_track(frames, Motion.STATIC)
    numbers = numbers_of(frames, track)
    names = list(numbers)
    missed = [names[0], names[len(names) // 2], names[-1]]
    gappy = driven.without(*[(name, numbers[name]) for name in missed])
    filled = {
        frame.frame: [each for each in frame.objects if each.result == Result.FILLED.name]
        for frame in tracked(gappy)
    }
    assert [name for name, each in filled.items() if each] == [missed[1]]
    (item,) = filled[missed[1]]
    assert item.track is not None
    assert NOT_SEEN_HERE in item.flags
    assert item.points.in_cluster >= 3
    assert item.kitti is not None
    whole = box_of(
        dict(zip(names, (f.objects[numbers[f.frame]] for f in frames if f.frame in numbers), strict=True))[
            missed[1]
        ]
    )
    found = box_of(item)
    assert whole is not None
    assert found is not None
    assert np.linalg.norm(whole.center_cam - found.center_cam) < 0.3
    # Asked for all that it is in view of, an end is filled too (the first is hidden); for none, nothing is.
    everywhere = [f.frame for f in tracked(gappy, "view") if any(e.result == "FILLED" for e in f.objects)]
    assert set(missed[1:]) <= set(everywhere)
    assert not any(e.result == "FILLED" for f in tracked(gappy, "none") for e in f.objects)


def test_a_prompt_without_a_box_gets_that_of_its_object() -> None:
    driven = drive(3)
    frames = tracked(driven)
    track = longest_track(frames, Motion.STATIC)
    numbers = numbers_of(frames, track)
    name = list(numbers)[3]
    details = driven.labelled[name]
    objects = list(details.objects)
    nothing = {"box": None, "kitti": None, "score": 0.0, "result": Result.TOO_FEW_POINTS.name}
    objects[numbers[name]] = objects[numbers[name]].model_copy(update=nothing)
    labelled = driven.labelled | {name: details.model_copy(update={"objects": tuple(objects)})}
    (item,) = [
        frame.objects[numbers[name]]
        for frame in tracked(replace(driven, labelled=labelled))
        if frame.frame == name
    ]
    assert item.result == Result.TRACKED.name
    assert item.sentence == Result.TRACKED.value
    assert item.box is not None
    assert item.kitti is not None
    assert 0 < item.score < 1


def test_a_box_of_one_frame_is_doubted() -> None:
    driven = drive(3)
    middle = driven.frames[6].frames[0]
    details = driven.labelled[middle]
    item = details.objects[0]
    assert item.box is not None
    # Where no other frame has anything: in the air over the road.
    lost = item.box.model_copy(update={"center_cam": (0.0, -4.0, 45.0)})
    phantom = item.model_copy(
        update={"box": lost, "index": len(details.objects), "prompt_box_px": (5, 5, 40, 40)}
    )
    changed = details.model_copy(update={"objects": (*details.objects, phantom)})
    labelled = driven.labelled | {middle: changed}
    (found,) = [
        f.objects[-1] for f in tracked(replace(driven, labelled=labelled), "none") if f.frame == middle
    ]
    assert found.score == pytest.approx(item.score / 2, abs=1e-3)
    assert SINGLE_SIGHTING in found.flags
    assert found.track is not None
    assert found.track.motion == Motion.UNKNOWN
    assert found.box == lost


def test_the_same_drive_gives_the_same_bytes() -> None:
    driven = drive(3)
    first, second = ([each.model_dump_json() for each in tracked(driven)] for _ in range(2))
    assert first == second


def test_frames_that_cannot_be_read_keep_what_they_have_and_cost_no_other() -> None:
    driven = drive(3)
    names = [name for each in driven.frames for name in each.frames]
    frames = tracked(replace(driven, unreadable=frozenset(names[3:5])))
    assert [each.frame for each in frames] == names
    assert all(each.track for frame in frames for each in frame.objects if each.box)
    nothing = tracked(replace(driven, unreadable=frozenset(names)))
    for frame in nothing:
        assert [each.box for each in frame.objects] == [
            each.box for each in driven.labelled[frame.frame].objects
        ]


def test_frames_without_a_view_pass_through() -> None:
    """As those without LiDAR do."""
    driven = drive(3)
    name = driven.frames[5].frames[0]
    blind = driven.labelled[name].model_copy(update={"view": None, "objects": ()})
    frames = tracked(replace(driven, labelled=driven.labelled | {name: blind}))
    assert frames[5] == blind
    assert len(frames) == len(driven.frames)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_short_drives(count: int) -> None:
    driven = replace(drive(3), sweeps=drive(3).sweeps[:count])
    frames = tracked(driven)
    assert len(frames) == count


def test_a_drive_without_boxes() -> None:
    driven = drive(3)
    empty = {name: each.model_copy(update={"objects": ()}) for name, each in driven.labelled.items()}
    assert all(each.objects == () for each in tracked(replace(driven, labelled=empty)))


def test_frozen_sizes_stay_frozen() -> None:
    driven = drive(3)
    (car,) = [PAPER.sizes["Car"]]
    for frame in tracked(driven, tracker=DriveTracker(PAPER)):
        for each in frame.objects:
            if each.track and each.track.sightings > 3 and each.category == "Car" and each.box:
                assert each.box.length_m == pytest.approx(car.length_m, abs=0.02)
                assert each.box.height_m == pytest.approx(car.height_m, abs=0.02)


def test_poses_of_the_data_set_are_taken_as_they_are() -> None:
    driven = drive(3)
    given, matched = DriveTracker(ACCURATE, "dataset"), DriveTracker(ACCURATE, "matched")
    first = tracked(driven, tracker=given)
    assert (
        np.mean([v for s, d in zip(driven.sweeps, first, strict=True) for v in overlaps(s, d).values()]) > 0.7
    )
    second = tracked(driven, tracker=matched)
    assert [each.frame for each in first] == [each.frame for each in second]


def test_two_cameras_of_a_sweep_have_one_track_for_what_both_see() -> None:
    """The same frame twice, as two cameras that look the same way."""
    driven = drive(3, 8)
    labelled = {}
    frames = []
    for number, each in enumerate(driven.sweeps):
        view = each.generated.frame.view
        assert view is not None
        names = []
        for camera in ("left", "right"):
            name = f"{each.generated.frame.name}-{camera}"
            own = SweepView(
                view.sweep, camera, view.ego_SE3_cam, view.log, view.timestamp_ns, view.world_SE3_ego
            )
            labelled[name] = driven.labelled[each.generated.frame.name].model_copy(
                update={"frame": name, "view": view_details_of(own)}
            )
            names.append(name)
        frames.append(SweepFrames(tuple(names), number * 100_000_000))

    class Twice:
        def details(self, name: str) -> FrameDetails:
            return labelled[name]

        def load(self, name: str, prompts: tuple[Prompt, ...]) -> Frame:
            return driven.load(name.rpartition("-")[0], prompts)

    found = list(DriveTracker(ACCURATE).track(frames, Twice()))
    assert len(found) == 16
    for left, right in zip(found[::2], found[1::2], strict=True):
        tracks = [[each.track.id for each in side.objects if each.track] for side in (left, right)]
        assert tracks[0] == tracks[1]
        boxes = [[each.box for each in side.objects] for side in (left, right)]
        assert boxes[0] == boxes[1]
    labels = sweep_labels_of_details(found[0])
    assert {each.track_id for each in labels.objects} == {
        str(each.track.id) for each in found[0].objects if each.track and each.box
    }


def test_the_world_may_be_far_away() -> None:
    """Poses in map coordinates."""
    driven = drive(3, 8)
    moved = {}
    for name, details in driven.labelled.items():
        assert details.view is not None
        pose = np.array(details.view.world_SE3_ego)
        pose[:2, 3] += (4.5e5, 5.4e6)
        matrix = tuple(tuple(float(v) for v in row) for row in pose)
        moved[name] = details.model_copy(
            update={"view": details.view.model_copy(update={"world_SE3_ego": matrix})}
        )
    there = tracked(replace(driven, labelled=moved))
    for here, far in zip(tracked(driven), there, strict=True):
        for a, b in zip(here.objects, far.objects, strict=True):
            if a.box and b.box:
                assert np.allclose(a.box.center_cam, b.box.center_cam, atol=0.02)


def test_truths_of_a_standing_car_stay_where_it_is() -> None:
    """What the other tests trust: poses and truth of generated drives agree."""
    places = defaultdict(list)
    for sweep in drive(3, 8).sweeps:
        view = sweep.generated.frame.view
        assert view is not None
        assert view.world_SE3_ego is not None
        world_SE3_cam = view.world_SE3_ego @ view.ego_SE3_cam
        for track, line in sweep.tracked:
            center = boxes3d_of([line]).center_cam[0]
            places[track].append(world_SE3_cam[:3, :3] @ center + world_SE3_cam[:3, 3])
    spreads = [float(np.ptp(np.array(each), axis=0).max()) for each in places.values() if len(each) > 5]
    assert np.min(spreads) < 0.02
    assert sum(spread < 0.02 for spread in spreads) >= 3
