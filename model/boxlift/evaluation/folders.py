"""Judge a folder of predictions against a folder of truths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from boxlift.errors import DatasetError
from boxlift.evaluation.kitti import KittiBenchmark
from boxlift.evaluation.label_table import LabelTable, read_table
from boxlift.evaluation.pseudo_labels import judge_pseudo_labels
from boxlift.evaluation.results import Evaluation
from boxlift.evaluation.rules import BENCHMARK_CLASSES, CLASS_RULES, rules_of
from boxlift.storage import is_folder

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


def evaluate_folders(
    gt_dir: AnyPath,
    pred_dir: AnyPath,
    frames: Sequence[str] | None = None,
    classes: Sequence[str] = BENCHMARK_CLASSES,
    pseudo_label_classes: Sequence[str] = tuple(CLASS_RULES),
) -> Evaluation:
    """KITTI's average precision of `classes` and the pseudo-label quality of `pseudo_label_classes`.

    gt_dir: KITTI label files STEM.txt. pred_dir: KITTI result files of the same names, or a folder that
        holds them in data/; a file without scores is read as if every score were 1.
    frames: stems to judge; by default all of gt_dir. Name those that have LiDAR where some have none.

    Raises DatasetError where a folder or a frame's file is not there, LabelFormatError for a line that
    is not KITTI's, OptionsError for a class without rules.
    """
    for category in (*classes, *pseudo_label_classes):
        rules_of(category)
    for folder in (gt_dir, pred_dir):
        if not is_folder(folder):
            raise DatasetError(str(folder), "the folder is not there.", "Give a folder of KITTI label files.")
    names = sorted(path.stem for path in gt_dir.glob("*.txt")) if frames is None else list(frames)
    if not names:
        raise DatasetError(str(gt_dir), "there is no frame to judge.", "Give a folder of KITTI label files.")

    truths = read_table(gt_dir, names)
    data_dir = pred_dir / "data"  # where the development kit, and `boxlift label`, put the files
    predictions = read_table(data_dir if is_folder(data_dir) else pred_dir, names)
    return evaluate_tables(truths, predictions, classes, pseudo_label_classes)


def evaluate_tables(
    truths: LabelTable,
    predictions: LabelTable,
    classes: Sequence[str] = BENCHMARK_CLASSES,
    pseudo_label_classes: Sequence[str] = tuple(CLASS_RULES),
) -> Evaluation:
    """As evaluate_folders, of labels that are in memory. Raises OptionsError for a class without rules."""
    benchmark = KittiBenchmark(truths, predictions)
    return Evaluation(
        frame_count=truths.frame_count,
        results={name: benchmark.average_precision(name) for name in classes},
        pseudo_labels={name: judge_pseudo_labels(truths, predictions, name) for name in pseudo_label_classes},
    )
