"""The 2D detector alone, and the 3D labels that come of its boxes, on a labelled dataset.

    python benchmarks/detector.py [FOLDER]

FOLDER is a dataset in KITTI object layout with label_2 (by default ../shared/kitti/object). First the time of
an image. Then the recall of truths in the image at IoU .5 and .7 (KITTI's cumulative difficulties; people:
hard) and the precision of cars, where a car box is wrong that has at least 25 pixels and neither a vehicle
nor a region of DontCare in its place; also in images of fewer and of more pixels, with the detector's own
limit and without. Then KITTI's AP (R40) and the recall of the 3D labels by least score, beside prompts of
label_2.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import onnx
import torch
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets import FrameSource, load_objects, open_source
from boxlift.detector import DEFAULT_FILE, Detector
from boxlift.evaluation import DIFFICULTIES, Difficulty, LabelTable, evaluate_folders
from boxlift.formats.image import decode_image, resized
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Prompt
from boxlift.overlap import intersection_2d, iou_2d
from boxlift.settings import ACCURATE
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import DETECTOR, LabelJob
from boxlift_client.runner import label_dataset
from presets import DEFAULT_FOLDER

_VEHICLES = ("Car", "Van", "Truck", "Misc", "Tram")
_PEOPLE = ("Pedestrian", "Cyclist")
_LEAST_PX = 25

Image = NDArray[np.uint8]


def boxes_of(items: Sequence[Prompt] | Sequence[KittiObject], categories: Sequence[str]) -> Floats:
    """(N, 4) boxes of some classes."""
    return np.array([item.box_px for item in items if item.category in categories]).reshape(-1, 4)


def best_iou(boxes_px: Floats, others_px: Floats) -> Floats:
    """(N,) the largest IoU of each box with one of the others."""
    rows = np.repeat(boxes_px, len(others_px), axis=0)
    iou = iou_2d(rows, np.tile(others_px, (len(boxes_px), 1)))
    best: Floats = iou.reshape(len(boxes_px), len(others_px)).max(axis=1, initial=0)
    return best


def recall(
    found: Sequence[Sequence[Prompt]],
    truths: Sequence[Sequence[KittiObject]],
    category: str,
    difficulty: Difficulty,
) -> tuple[int, float, float]:
    """Truths of a class that a difficulty counts, and the shares that are found at IoU .5 and .7."""
    best = []
    for prompts, labels in zip(found, truths, strict=True):
        table = LabelTable.from_frames([labels])
        asked = table.box_px[table.is_any_of([category]) & table.counts_as(difficulty)]
        best += best_iou(asked, boxes_of(prompts, (category,))).tolist()
    values = np.array(best)
    return len(values), float((values >= 0.5).mean()), float((values >= 0.7).mean())


def precision(found: Sequence[Sequence[Prompt]], truths: Sequence[Sequence[KittiObject]]) -> float:
    """Of the car boxes that are no region of DontCare, the share that has a vehicle (IoU .5)."""
    right = wrong = 0
    for prompts, labels in zip(found, truths, strict=True):
        boxes = boxes_of(prompts, ("Car",))
        hits = best_iou(boxes, boxes_of(labels, _VEHICLES)) >= 0.5
        ignored = boxes[:, 3] - boxes[:, 1] < _LEAST_PX
        for region in boxes_of(labels, ("DontCare",)):
            shared = intersection_2d(boxes, np.broadcast_to(region, boxes.shape))
            ignored |= shared > 0.5 * (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
        right += int(hits.sum())
        wrong += int((~hits & ~ignored).sum())
    return right / max(right + wrong, 1)


def print_line(
    title: str, found: Sequence[Sequence[Prompt]], truths: Sequence[Sequence[KittiObject]]
) -> None:
    """Cars by difficulty, people by the hardest, and how many boxes of cars are right."""
    cells = [recall(found, truths, "Car", difficulty) for difficulty in DIFFICULTIES]
    cells += [recall(found, truths, category, DIFFICULTIES[-1]) for category in _PEOPLE]
    texts = [f"{loose:.2f} {strict:.2f}" for _, loose, strict in cells]
    print(f"{title:26} {'   '.join(texts)}   {precision(found, truths):.2f}")


def enlarged(images: Sequence[Image], factor: float) -> list[Image]:
    """The images with so many times as many columns and rows."""
    return [
        resized(image, (round(image.shape[1] * factor), round(image.shape[0] * factor))) for image in images
    ]


def shrunk_boxes(found: Sequence[Sequence[Prompt]], factor: float) -> list[list[Prompt]]:
    """Detections in an enlarged image, in pixels of the image that it was."""
    return [[_shrunk(prompt, factor) for prompt in prompts] for prompts in found]


def _shrunk(prompt: Prompt, factor: float) -> Prompt:
    x1, y1, x2, y2 = (edge / factor for edge in prompt.box_px)
    return Prompt(prompt.category, (x1, y1, x2, y2), prompt.score)


def without_limit(folder: Path) -> Path:
    """The detector's file without the property that has large images scaled down."""
    model = onnx.load(DEFAULT_FILE)
    kept = [prop for prop in model.metadata_props if prop.key != "longest_side_px"]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    onnx.save(model, folder / "without_limit.onnx")
    return folder / "without_limit.onnx"


def print_times(images: Sequence[Image]) -> None:
    """The median of one image after the other."""
    for threads in (1, 2):
        detector = Detector.open(threads=threads)
        times = []
        for image in (images[0], *images):
            start = perf_counter()
            detector.detect(image)
            times.append(perf_counter() - start)
        shape = f"{images[0].shape[1]} x {images[0].shape[0]}"
        print(f"{shape} in {threads} threads: {1e3 * float(np.median(times[1:])):.0f} ms")


def print_labels(folder: Path, source: FrameSource, scratch: Path) -> None:
    """AP and recall of cars of 3D labels, by where their prompts come from."""
    print(f"\n{'cars, easy/moderate/hard':24} AP BEV @.5, @.7   AP 3D @.5, @.7   recall 3D @.5, @.7")
    for title, prompts, least in (
        *((f"detector from {least}", DETECTOR, least) for least in (0.2, 0.3, 0.4)),
        ("label_2", "label_2", 0.3),
    ):
        settings = ACCURATE.with_options({"detection": {"min_score": least}})
        job = LabelJob(folder, scratch / title, prompts, settings=settings)
        skipped = {report.frame for report in label_dataset(job, LocalEngine(2)).unlabelled}
        names = [name for name in source.names if name not in skipped]
        evaluation = evaluate_folders(source.root / "label_2", job.out, names)
        strict, loose = (entry for entry in evaluation.results["Car"] if entry.recall_points == "R40")
        groups = evaluation.pseudo_labels["Car"][:3]
        cells = [*_texts(loose.ap_bev, strict.ap_bev, 0), *_texts(loose.ap_3d, strict.ap_3d, 0)]
        by_iou = [{at.iou: at.recall_3d or 0.0 for at in group.at_iou} for group in groups]
        cells += _texts([at[0.5] for at in by_iou], [at[0.7] for at in by_iou], 2)
        print(f"{title:24} {'   '.join(cells)}")


def _texts(loose: Sequence[float | None], strict: Sequence[float | None], decimals: int) -> list[str]:
    return ["/".join(f"{value or 0:.{decimals}f}" for value in values) for values in (loose, strict)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT_FOLDER)
    folder: Path = parser.parse_args().folder
    torch.set_num_threads(1)
    source = open_source(folder)
    images = [decode_image(source.root / "image_2" / f"{name}.png") for name in source.names]
    truths = [load_objects("label_2", source, name) for name in source.names]
    detector = Detector.open()
    print(f"{len(images)} frames; {detector.name}, SHA-256 {detector.digest[:16]}")
    print_times(images)

    counts = [recall([[]] * len(truths), truths, "Car", difficulty)[0] for difficulty in DIFFICULTIES]
    print(
        f"\n{'recall at IoU .5, .7':26} cars: easy, moderate, hard {counts}; "
        "pedestrians; cyclists; precision of cars"
    )
    all_found = [detector.detect(image, min_score=0.0).prompts for image in images]
    for least in (0.15, 0.2, 0.3, 0.4, 0.5):
        found = [[p for p in prompts if p.score >= least] for prompts in all_found]
        print_line(f"scores from {least}", found, truths)
    with tempfile.TemporaryDirectory() as scratch:
        unlimited = Detector.open(without_limit(Path(scratch)))
        for factor in (0.5, 1.5, 2.0, 3.0):
            larger = enlarged(images, factor)
            for name, used in (("", detector), (", no limit", unlimited)):
                if factor > 1 or used is detector:
                    found_in = [used.detect(image).prompts for image in larger]
                    print_line(f"{factor} times the size{name}", shrunk_boxes(found_in, factor), truths)
        print_labels(folder, source, Path(scratch))


if __name__ == "__main__":
    main()
