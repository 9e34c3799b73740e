"""What tracking is worth: labels before and after, on real drives and on generated ones.

    python benchmarks/tracking.py [real] [generated] [--drives 8] [--prompts NAME] [--keep DIR]

Real: the two drives in ../shared/kitti/sequences, prompts from their labels (label_02) or the detector's.
Generated: drives with exact truth, prompts from it; by what their objects do. Everything runs through what
users have: a data set is labelled, the label set tracked.

Recall and precision (of all boxes, those that no truth has included) are in %, at 3D IoU .5 and .7 for
vehicles and .25 and .5 for people. Errors are means of length and width (m), of the centre (m), and medians
of the heading (degrees; front and back alike, then told apart). Switches: boxes of a truth whose track
differs from that of its box before; before tracking, boxes have the ids of those they overlap a frame before.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from boxlift.datasets.generated import DriveSettings, generate_drive, write_drive
from boxlift.evaluation import LabelTable
from boxlift.evaluation.identities import Tracked, judge_identities
from boxlift.evaluation.pseudo_labels import PseudoLabelQuality, judge_pseudo_labels
from boxlift.formats.details import FrameDetails, kitti_object_of
from boxlift.formats.ego_boxes import boxes_in_camera, sweep_labels_of_details
from boxlift.formats.kitti_tracks import NO_TRACK, read_tracks
from boxlift.label_sets.index import read_details
from boxlift.overlap import bev_iou_matrix
from boxlift.poses import inverse
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import LabelJob
from boxlift_client.runner import label_dataset
from boxlift_client.tracking import TrackJob, track_label_set
from kitti_drives import LABELS, SHARED, drives_of, lay_out, log_of, truths_of

_FIRST_SEED = 300
_CLASSES = ("Car", "Van", "Truck", "Cyclist", "Pedestrian")
_MOVED_M, _TURNED_RAD, _HIDDEN = 1.0, 0.3, 2
_SAME_OBJECT_IOU = 0.1

# Frame -> its truth; (drive, frames in the order of time) with it.
Truth = dict[str, list[Tracked]]


def _tables(truth: Truth, found: dict[str, FrameDetails]) -> tuple[LabelTable, LabelTable]:
    return (
        LabelTable.from_frames([[line for _, line in objects] for objects in truth.values()]),
        LabelTable.from_frames(
            [[kitti_object_of(each.kitti) for each in found[name].objects if each.kitti] for name in truth]
        ),
    )


def _details(label_set: Path, names: Sequence[str]) -> dict[str, FrameDetails]:
    return {name: read_details(label_set / "details" / f"{name}.json") for name in names}


def _told(found: FrameDetails) -> list[Tracked]:
    """The boxes of a tracked frame, with their tracks."""
    return [
        (each.track.id if each.track else NO_TRACK, kitti_object_of(each.kitti))
        for each in found.objects
        if each.kitti
    ]


def _overlapping(frames: Sequence[FrameDetails]) -> Iterator[list[Tracked]]:
    """Ids of boxes that overlap from one frame to the next, in the world where poses are known."""
    before: list[int] = []
    boxes_before = None
    last = 0
    for frame in frames:
        labels = sweep_labels_of_details(frame)
        assert frame.view is not None
        world = np.eye(4) if labels.world_SE3_ego is None else labels.world_SE3_ego
        boxes = boxes_in_camera(labels.objects, inverse(world))
        ids = [0] * len(boxes)
        if boxes_before is not None:
            iou = bev_iou_matrix(boxes_before, boxes)
            for flat in np.argsort(-iou, axis=None):
                row, column = divmod(int(flat), max(len(boxes), 1))
                if len(boxes) == 0 or iou[row, column] < _SAME_OBJECT_IOU:
                    break
                taken = before[row]
                if not ids[column] and taken not in ids:
                    ids[column] = taken
        for column, known in enumerate(ids):
            if not known:
                last += 1
                ids[column] = last
        before, boxes_before = ids, boxes
        lines = [kitti_object_of(each.kitti) for each in frame.objects if each.kitti]
        yield list(zip(ids, lines, strict=True))


HEADER = f"{'':34} truths  recall l / s   precision l / s  IoU   length width centre  heading (full)"


def _row(title: str, quality: PseudoLabelQuality) -> str:
    strict, loose = quality.at_iou
    cells = [
        100 * (value or 0.0)
        for value in (
            loose.recall_3d,
            strict.recall_3d,
            loose.precision_of_all_3d,
            strict.precision_of_all_3d,
        )
    ]
    size = quality.size_error_lwh_m or (np.nan, np.nan, np.nan)
    return (
        f"{title:34} {quality.truths:6d}  {cells[0]:5.1f} / {cells[1]:5.1f}   "
        f"{cells[2]:5.1f} / {cells[3]:5.1f}   {quality.mean_iou_3d or 0:.3f}   "
        f"{size[0]:.2f}  {size[1]:.2f}   {quality.center_error_mean_m or 0:.2f}   "
        f"{quality.yaw_error_modulo_180_median_deg or 0:5.2f} ({quality.yaw_error_median_deg or 0:.1f})"
    )


def print_table(title: str, truth: Truth, before: Path, after: Path) -> None:
    """Before and after of one drive or several, class by class."""
    print(f"\n{title}\n{HEADER}")
    found = {"before": _details(before, list(truth)), "after": _details(after, list(truth))}
    for category in _CLASSES:
        for which, details in found.items():
            tables = _tables(truth, details)
            for quality in judge_pseudo_labels(*tables, category)[:3]:
                if quality.truths and (quality.group != "easy" or category == "Car"):
                    print(_row(f"{category} {quality.group}, {which}", quality))


def print_identities(title: str, truth: Truth, before: Path, after: Path) -> None:
    """Identity switches of one drive."""
    names = list(truth)
    earlier = _overlapping(list(_details(before, names).values()))
    later = (_told(each) for each in _details(after, names).values())
    for which, told in (("before", earlier), ("after", later)):
        found = judge_identities(zip(truth.values(), told, strict=True))
        print(
            f"{title} {which}: {found.truths} truths, {found.associated} boxes, {found.switches} switches, "
            f"{found.tracks_found} tracks have a share in a truth"
        )


def _label_and_track(source: Path, out: Path, prompts: str) -> Path:
    label_dataset(LabelJob(source, out, prompts), LocalEngine())
    print(track_label_set(TrackJob(out, out / "tracked")).text())
    return out / "tracked"


def real(scratch: Path, prompts: str) -> None:
    """The given drives."""
    source = lay_out(scratch / "drives")
    out = scratch / f"real-{prompts}"
    after = _label_and_track(source, out, LABELS if prompts == LABELS else prompts)
    everything: Truth = {}
    for drive in drives_of(SHARED):
        truth = {name: [(e.track, e.line) for e in objects] for name, objects in truths_of(drive).items()}
        everything |= truth
        print_table(f"{log_of(drive)}, prompts {prompts}", truth, out, after)
        print_identities(drive.name, truth, out, after)
    print_table(f"all, prompts {prompts}", everything, out, after)


def generated(scratch: Path, count: int) -> None:
    """Generated drives, all of it and by what its objects do."""
    source, out = scratch / "generated", scratch / "generated-labels"
    truth: Truth = {}
    does: dict[tuple[str, int], set[str]] = {}
    for seed in range(_FIRST_SEED, _FIRST_SEED + count):
        log = f"{seed:04d}"
        places = defaultdict(list)
        sweeps = []
        for sweep in generate_drive(seed, settings=DriveSettings(sweeps=40), with_images=False):
            sweeps.append(sweep)
            view = sweep.generated.frame.view
            assert view is not None
            assert view.world_SE3_ego is not None
            world_SE3_cam = view.world_SE3_ego @ view.ego_SE3_cam
            for track, line in sweep.tracked:
                x, y, z = line.bottom_center_cam
                place = world_SE3_cam[:3, :3] @ (x, y, z) + world_SE3_cam[:3, 3]
                turned = float(np.arctan2(world_SE3_cam[1, 2], world_SE3_cam[0, 2]))
                places[track].append((place, line.rotation_y - turned, line.occluded))
        write_drive(source, log, sweeps)
        for track, seen in places.items():
            moved = max(float(np.linalg.norm(place - seen[0][0])) for place, _, _ in seen) > _MOVED_M
            angles = np.unwrap([angle for _, angle, _ in seen])
            names = {"moving" if moved else "static"}
            if moved and np.ptp(angles) > _TURNED_RAD:
                names.add("turning")
            if any(occluded >= _HIDDEN for _, _, occluded in seen):
                names.add("occluded at times")
            does[log, track] = names
        tracks = read_tracks(source / "training" / "label_02" / f"{log}.txt")
        for number in range(len(sweeps)):
            own = [(e.track, e.line) for e in tracks.get(number, []) if e.line.has_box3d]
            truth[f"{log}_{number:06d}"] = own
    after = _label_and_track(source, out, LABELS)
    print_table(f"{count} generated drives", truth, out, after)
    for kind in ("static", "moving", "turning", "occluded at times"):
        chosen = {
            name: [(track, line) for track, line in objects if kind in does[name[:4], track]]
            for name, objects in truth.items()
        }
        print_table(f"generated, {kind} (precision counts all boxes)", chosen, out, after)
    for log in sorted({name[:4] for name in truth}):
        of_log = {name: objects for name, objects in truth.items() if name[:4] == log}
        print_identities(f"generated {log}", of_log, out, after)


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", default=["real", "generated"])
    parser.add_argument("--prompts", default=LABELS)
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--keep", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        scratch = arguments.keep or Path(temporary)
        scratch.mkdir(parents=True, exist_ok=True)
        if "real" in arguments.parts:
            real(scratch, arguments.prompts)
        if "generated" in arguments.parts:
            generated(scratch, arguments.drives)


if __name__ == "__main__":
    main()
