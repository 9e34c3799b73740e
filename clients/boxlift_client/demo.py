"""The demo: generated frames, the real service, the batch client, the evaluator, pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

from boxlift.datasets.generated import GeneratedFrame, generate, write_dataset
from boxlift.evaluation import Evaluation, evaluate_folders
from boxlift_client.cli.progress import OnProgress, progress_bar
from boxlift_client.engines.http import HttpEngine
from boxlift_client.job import DETECTOR, LabelJob
from boxlift_client.pictures import draw_labels_on_disk, write_picture
from boxlift_client.runner import label_dataset
from boxlift_client.service_process import running_service

_LABEL_2 = "label_2"
_WHENCE = {
    _LABEL_2: f"2D boxes from {_LABEL_2}",
    DETECTOR: "2D boxes found in the images by the detector",
}
_COLUMNS = "{:12}{:>8}{:>8}{:>14}{:>14}{:>13}{:>11}{:>13}"


def run_demo(out: Path, frame_count: int, seed: int) -> bool:
    """Write OUT/dataset, OUT/labels, OUT/labels_from_images and OUT/pictures, and print what happens.

    Returns whether every frame was labelled.
    """
    dataset, pictures = out / "dataset", out / "pictures"
    given, found = out / "labels", out / "labels_from_images"
    truth = dataset / "training" / "label_2"

    start = perf_counter()
    with progress_bar("Generating") as progress:
        names = write_dataset(dataset, _generated(frame_count, seed, progress))
    print(f"Generated {frame_count} frames in {perf_counter() - start:.0f} s: {dataset}")

    complete = True
    with running_service() as url:
        print(f"Started the service: {url}")
        for prompts, labels in ((_LABEL_2, given), (DETECTOR, found)):
            with progress_bar("Labelling") as progress:
                summary = label_dataset(LabelJob(dataset, labels, prompts), HttpEngine(url), names, progress)
            complete &= summary.complete
            print(f"\nLabelled over HTTP, {_WHENCE[prompts]}: {labels}\n{summary.text()}")
            print(_quality_table(evaluate_folders(truth, labels, names)))

    for name in names:
        write_picture(pictures / f"{name}.png", draw_labels_on_disk(dataset, name, given, _LABEL_2))
    print(f"\nPictures of labels (coloured) and truth (white): {pictures}/*.png")
    print(f"Every number: boxlift evaluate --gt {truth} --pred {given}")
    return complete


def _generated(frame_count: int, seed: int, on_progress: OnProgress) -> Iterator[GeneratedFrame]:
    for index in range(frame_count):
        on_progress(index, frame_count)
        yield generate(seed + index)


def _quality_table(evaluation: Evaluation) -> str:
    """One line per class: each truth that KITTI's hard difficulty counts against its own prompt's box."""
    head = ("class", "truths", "boxes", "BEV strict", "BEV loose", "mean IoU 3D", "centre m", "yaw mod 180")
    lines = [
        "Each truth against the box of its own prompt (medians of centre and yaw):",
        _COLUMNS.format(*head),
    ]
    for category, groups in evaluation.pseudo_labels.items():
        for group in (group for group in groups if group.group == "hard" and group.truths):
            found = [f"{_decimals(at.recall_bev)} @ {at.iou:g}" for at in group.at_iou]
            errors = (group.mean_iou_3d, group.center_error_median_m, group.yaw_error_modulo_180_median_deg)
            cells = (group.truths, group.associated, *found, *map(_decimals, errors))
            lines.append(_COLUMNS.format(category, *cells))
    return "\n".join(lines)


def _decimals(number: float | None) -> str:
    return "-" if number is None else f"{number:.2f}"
