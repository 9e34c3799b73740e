"""A real drive is labelled better than its frames one by one, with one track for one object."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boxlift.datasets import FrameSource, open_source
from boxlift.evaluation.identities import judge_identities
from boxlift.formats.details import FrameDetails, details_of, kitti_object_of, view_details_of
from boxlift.formats.kitti_label import boxes3d_of, prompts_of
from boxlift.formats.kitti_tracks import TrackedObject, read_tracks
from boxlift.frame import Frame, Prompt
from boxlift.labeller import Labeller
from boxlift.overlap import iou_3d
from boxlift.poses import inverse
from boxlift.settings import ACCURATE
from boxlift.sweep import SweepView
from boxlift.tracking import DriveTracker, SweepFrames
from model.tracking.drives import box_of

FRAMES = 26


@dataclass(frozen=True)
class RealDrive:
    """The first frames of a drive, labelled from the 2D boxes of its truth. Reads as a DriveReader."""

    sources: dict[str, tuple[FrameSource, str]]
    truth: dict[str, list[TrackedObject]]
    labelled: dict[str, FrameDetails]

    @classmethod
    def read(cls, folder: Path) -> RealDrive:
        tracks = read_tracks(folder / "label_02.txt")
        beside = folder.parent.parent
        opened = {part: open_source(beside / part) for part in ("weak", "object")}
        sources, truth, labelled = {}, {}, {}
        labeller = Labeller(ACCURATE)
        with (folder / "frames.csv").open(newline="") as lines:
            rows = list(csv.DictReader(lines))[:FRAMES]
        for row in rows:
            number, path = int(row["raw_frame"]), Path(row["files"])
            name = f"{number:06d}"
            sources[name] = opened[path.parts[0]], path.name
            truth[name] = [each for each in tracks.get(number, []) if each.line.has_box3d]
            frame = sources[name][0].load(path.name, prompts_of([each.line for each in truth[name]]))
            view = SweepView(name, "image_02", inverse(frame.calibration.cam_SE3_velo), folder.name)
            details = details_of(labeller.label(frame))
            labelled[name] = details.model_copy(update={"frame": name, "view": view_details_of(view)})
        return cls(sources, truth, labelled)

    def details(self, name: str) -> FrameDetails:
        return self.labelled[name]

    def load(self, name: str, prompts: tuple[Prompt, ...]) -> Frame:
        source, own = self.sources[name]
        return source.load(own, prompts)


def test_a_parked_street_gains_without_any_pose_and_keeps_its_tracks(kitti_sequences_root: Path) -> None:
    drive = RealDrive.read(kitti_sequences_root / "0009")
    sweeps = [SweepFrames((name,), int(name) * 100_000_000) for name in drive.truth]
    after = {each.frame: each for each in DriveTracker(ACCURATE).track(sweeps, drive)}
    overlaps: dict[str, list[float]] = {"before": [], "after": []}
    for name, truths in drive.truth.items():
        for which, details in (("before", drive.labelled[name]), ("after", after[name])):
            for number, each in enumerate(truths):
                box = box_of(details.objects[number])
                overlap = 0.0 if box is None else float(iou_3d(box, boxes3d_of([each.line]))[0])
                overlaps[which].append(overlap)
    strict = {which: float(np.mean(np.array(values) > 0.7)) for which, values in overlaps.items()}
    assert strict["after"] > strict["before"] + 0.05
    assert np.mean(np.array(overlaps["after"]) > 0.5) >= np.mean(np.array(overlaps["before"]) > 0.5)
    told = (
        [(e.track.id, kitti_object_of(e.kitti)) for e in each.objects if e.track and e.kitti]
        for each in after.values()
    )
    found = judge_identities(
        zip(([(e.track, e.line) for e in truths] for truths in drive.truth.values()), told, strict=True)
    )
    # Two neighbours whose prompts overlap are taken for each other once.
    assert found.switches <= 4
    # Nothing was filled that a truth lacks, but for the odd car that its annotators saw later.
    filled = sum(each.result == "FILLED" for details in after.values() for each in details.objects)
    assert filled <= 3
