"""How good are labels? KITTI's average precision, and the quality of labels made from prompts."""

from __future__ import annotations

from boxlift.evaluation.folders import evaluate_folders
from boxlift.evaluation.kitti import AveragePrecision, KittiBenchmark
from boxlift.evaluation.label_table import LabelTable
from boxlift.evaluation.pseudo_labels import AtIou, PseudoLabelQuality, judge_pseudo_labels
from boxlift.evaluation.results import Evaluation
from boxlift.evaluation.rules import (
    BENCHMARK_CLASSES,
    CLASS_RULES,
    DIFFICULTIES,
    ClassRules,
    Difficulty,
    IouSet,
)

__all__ = [
    "BENCHMARK_CLASSES",
    "CLASS_RULES",
    "DIFFICULTIES",
    "AtIou",
    "AveragePrecision",
    "ClassRules",
    "Difficulty",
    "Evaluation",
    "IouSet",
    "KittiBenchmark",
    "LabelTable",
    "PseudoLabelQuality",
    "evaluate_folders",
    "judge_pseudo_labels",
]
