"""Other cameras: depth errors of the monocular model in generated scenes, by focal length and image size.

    python benchmarks/monocular_cameras.py [--scenes 12] [--model FILE]

The pictures are drawn and not taken, so that appearance says less than on a street; what the table shows is
whether an error grows with the lens. Every camera sees the same scenes. Cars at least 25 px tall, not
cut off and visible for the most part; prompts are the 2D boxes of the truth, then the model's own. Beside it
geometry alone: frozen height over height in the image.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from boxlift.datasets.generated import KITTI_RIG, GeneratedFrame, Rig, generate
from boxlift.formats.kitti_label import KittiObject, prompts_of
from boxlift.monocular import Monocular
from boxlift.overlap import iou_2d
from boxlift.priors import SIZE_PRIORS

_SIZES_PX = ((1242, 375), (1600, 900))
_FOCALS_PX = (500.0, 721.5, 1200.0)
_LEAST_HEIGHT_PX = 25
_SAME_OBJECT_IOU = 0.5


def rig_of(focal_px: float, size_px: tuple[int, int]) -> Rig:
    """KITTI's car with another camera that looks straight ahead."""
    width, height = size_px
    return replace(
        KITTI_RIG,
        name=f"{focal_px:.0f}px_{width}x{height}",
        image_size_px=size_px,
        focal_px=focal_px,
        principal_px=(width / 2, 0.46 * height),
    )


def counted(truth: KittiObject) -> bool:
    """Whether a car is large and whole enough to be judged."""
    height = truth.box_px[3] - truth.box_px[1]
    return (
        truth.category == "Car"
        and height >= _LEAST_HEIGHT_PX
        and truth.occluded <= 1
        and truth.truncated < 0.15
    )


def errors_of(frame: GeneratedFrame, model: Monocular, *, given: bool) -> list[tuple[float, float]]:
    """Relative depth errors of the model and of geometry alone, for every counted car that has a box."""
    assert frame.frame.image is not None
    cars = [truth for truth in frame.truth if counted(truth)]
    prompts = prompts_of(cars) if given else None
    if not cars:
        return []
    labels = model.detect(frame.frame.name, frame.frame.image, frame.frame.calibration, prompts).fitted
    found_px = np.array([label.prompt.box_px for label in labels]).reshape(-1, 4)
    size = SIZE_PRIORS["Car"].templates[0]
    errors = []
    for truth in cars:
        overlap = iou_2d(found_px, np.broadcast_to(np.array(truth.box_px), found_px.shape))
        if not len(overlap) or overlap.max() < _SAME_OBJECT_IOU:
            continue
        label = labels[int(overlap.argmax())]
        assert label.box is not None
        _, top, _, bottom = label.prompt.box_px
        depth = truth.bottom_center_cam[2]
        by_height = size.height_m * frame.rig.focal_px / (bottom - top) + size.length_m / 2
        errors.append((label.box.center_cam[0, 2] / depth - 1, by_height / depth - 1))
    return errors


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--model", type=Path, help="default: the model that comes with boxlift")
    options = parser.parse_args()
    model = Monocular.open(options.model)
    print("| focal length, image | 2D boxes | cars | median depth error | bias | geometry: error | bias |")
    print("|---|---|---|---|---|---|---|")
    for size_px in _SIZES_PX:
        for focal_px in _FOCALS_PX:
            rig = rig_of(focal_px, size_px)
            frames = [generate(5000 + seed, rig) for seed in range(options.scenes)]
            for given in (True, False):
                errors = np.array([e for frame in frames for e in errors_of(frame, model, given=given)])
                cells = [
                    f"{value:.3f}"
                    for column in errors.reshape(-1, 2).T
                    for value in (np.median(np.abs(column)), np.median(column))
                ]
                boxes = "truth's" if given else "detector's"
                size = f"{size_px[0]} x {size_px[1]}"
                print(
                    f"| {focal_px:g} px, {size} | {boxes} | {len(errors)} | {' | '.join(cells)} |", flush=True
                )


if __name__ == "__main__":
    main()
