"""How good are labels? The average precision of KITTI, Waymo and nuScenes, and the quality of labels made
from prompts."""

from __future__ import annotations

from boxlift.evaluation.folders import evaluate_folders, evaluate_tables
from boxlift.evaluation.kitti import AveragePrecision, KittiBenchmark
from boxlift.evaluation.label_table import LabelTable
from boxlift.evaluation.nuscenes import NuscenesEvaluation, judge_like_nuscenes
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
from boxlift.evaluation.sweep_results import nuscenes_json, nuscenes_table, waymo_json, waymo_table
from boxlift.evaluation.waymo import DEFAULT_IOU, WaymoEvaluation, judge_like_waymo

__all__ = [
    "BENCHMARK_CLASSES",
    "CLASS_RULES",
    "DEFAULT_IOU",
    "DIFFICULTIES",
    "AtIou",
    "AveragePrecision",
    "ClassRules",
    "Difficulty",
    "Evaluation",
    "IouSet",
    "KittiBenchmark",
    "LabelTable",
    "NuscenesEvaluation",
    "PseudoLabelQuality",
    "WaymoEvaluation",
    "evaluate_folders",
    "evaluate_tables",
    "judge_like_nuscenes",
    "judge_like_waymo",
    "judge_pseudo_labels",
    "nuscenes_json",
    "nuscenes_table",
    "waymo_json",
    "waymo_table",
]
