"""Are the views of a sweep merged right? Generated sweeps, labelled in three cameras whose images overlap.

    python benchmarks/merging.py [--sweeps 40] [--first-seed 500]

Cameras look ahead and 50 degrees to either side, each 80 degrees wide; prompts are the truth's 2D boxes. A
label belongs to the true object whose centre is nearest, within 3 m. Per threshold on the 3D IoU: objects
that two or three cameras labelled, how many of them are one label afterwards, how many are still two, and
true objects that had a label before and have none: another's took it.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from boxlift.datasets.generated import KITTI_RIG, generate
from boxlift.formats.details import details_of, view_details_of
from boxlift.formats.ego_boxes import ego_objects_of_kitti, sweep_labels_of_details
from boxlift.labeller import Labeller
from boxlift.merging import SAME_OBJECT_IOU, merge_views
from boxlift.poses import inverse
from boxlift.sweep import SweepLabels, SweepView

_YAWS_DEG = {"left": 50.0, "front": 0.0, "right": -50.0}
_THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
_OWN_WITHIN_M = 3.0


def labelled_views(seed: int, labeller: Labeller) -> tuple[list[SweepLabels], np.ndarray]:
    """The views of a sweep, and the centres (N, 3) of its true objects in the ego frame."""
    rig = replace(KITTI_RIG, projection_offset=(0.0, 0.0, 0.0))
    views, centers = [], np.empty((0, 3))
    for name, yaw_deg in _YAWS_DEG.items():
        generated = generate(seed, rig.turned(yaw_deg, name))
        ego_SE3_cam = inverse(generated.frame.calibration.cam_SE3_velo)
        for each in ego_objects_of_kitti(generated.truth, ego_SE3_cam):
            if not len(centers) or np.linalg.norm(centers - each.center_ego, axis=1).min() > 0.1:
                centers = np.vstack([centers, each.center_ego])
        details = details_of(labeller.label(generated.frame))
        place = view_details_of(SweepView(str(seed), name, ego_SE3_cam))
        views.append(sweep_labels_of_details(details.model_copy(update={"view": place})))
    return views, centers


def owners(labels: SweepLabels, centers: np.ndarray) -> list[int]:
    """The true object that each label is nearest to; -1 where none is near."""
    found = []
    for each in labels.objects:
        distances = np.linalg.norm(centers - each.center_ego, axis=1) if len(centers) else np.array([np.inf])
        found.append(int(distances.argmin()) if distances.min() < _OWN_WITHIN_M else -1)
    return found


def main() -> None:
    """Label, merge, count, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sweeps", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=500)
    arguments = parser.parse_args()
    labeller = Labeller()
    sweeps = [
        labelled_views(seed, labeller)
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.sweeps)
    ]
    before = sum(len(view.objects) for views, _ in sweeps for view in views)
    print(f"{arguments.sweeps} sweeps, {before} labels of views")
    print(f"threshold now: {SAME_OBJECT_IOU}")
    heads = ("seen by 2+", "one label", "still twice", "swallowed", "labels")
    print(f"{'IoU':>5}" + "".join(f"{head:>12}" for head in heads))
    for threshold in _THRESHOLDS:
        shared = once = twice = swallowed = total = 0
        for views, centers in sweeps:
            seen = Counter(owner for view in views for owner in set(owners(view, centers)) if owner >= 0)
            merged = merge_views(views, threshold)
            total += len(merged.objects)
            after = Counter(owners(merged, centers))
            several = [owner for owner, count in seen.items() if count > 1]
            shared += len(several)
            once += sum(after[owner] == 1 for owner in several)
            twice += sum(after[owner] > 1 for owner in several)
            swallowed += sum(after[owner] == 0 for owner in seen)
        counts = (shared, once, twice, swallowed, total)
        print(f"{threshold:>5}" + "".join(f"{count:>12}" for count in counts))


if __name__ == "__main__":
    main()
