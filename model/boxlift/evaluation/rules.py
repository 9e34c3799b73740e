"""What KITTI's object benchmark counts: difficulties, classes, their IoUs and their look-alikes.

Source: evaluate_object.cpp and the readme of the KITTI object development kit (Geiger et al., CVPR 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

from boxlift.errors import OptionsError


@dataclass(frozen=True)
class Difficulty:
    """Truths that count: taller in the image than `min_height_px`, and at most so occluded and truncated.

    Cumulative: what is easy is also moderate and hard.
    """

    name: str
    min_height_px: float
    max_occluded: int
    max_truncated: float


EASY = Difficulty("easy", 40, 0, 0.15)
MODERATE = Difficulty("moderate", 25, 1, 0.30)
HARD = Difficulty("hard", 25, 2, 0.50)
DIFFICULTIES = (EASY, MODERATE, HARD)


@dataclass(frozen=True)
class IouSet:
    """From which IoU (exclusive) a detection is right, in the image, from above and in 3D."""

    iou_2d: float
    iou_bev: float
    iou_3d: float


@dataclass(frozen=True)
class ClassRules:
    """strict_iou: the benchmark's own. loose_iou: what the literature adds for BEV and 3D.
    neighbours: classes that may be found or missed without reward or harm."""

    strict_iou: float
    loose_iou: float
    neighbours: tuple[str, ...] = ()

    @property
    def iou_sets(self) -> tuple[IouSet, IouSet]:
        """Strict everywhere; then strict in the image and loose from above and in 3D."""
        strict, loose = self.strict_iou, self.loose_iou
        return IouSet(strict, strict, strict), IouSet(strict, loose, loose)


# The benchmark ranks Car, Pedestrian and Cyclist; Van and Truck are judged like cars.
CLASS_RULES = {
    "Car": ClassRules(0.7, 0.5, ("Van",)),
    "Van": ClassRules(0.7, 0.5),
    "Truck": ClassRules(0.7, 0.5),
    "Pedestrian": ClassRules(0.5, 0.25, ("Person_sitting",)),
    "Cyclist": ClassRules(0.5, 0.25),
}
BENCHMARK_CLASSES = ("Car", "Pedestrian", "Cyclist")


def rules_of(category: str) -> ClassRules:
    """The rules of a class; raises OptionsError where it has none."""
    if category not in CLASS_RULES:
        raise OptionsError(
            "classes", f"{category!r} has no rules for judging.", f"Known are {', '.join(CLASS_RULES)}."
        )
    return CLASS_RULES[category]
