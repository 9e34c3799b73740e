"""What an evaluation says, as data, as JSON and as text for a terminal."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from boxlift.evaluation.kitti import FULL_CURVE_TRUTHS, AveragePrecision
from boxlift.evaluation.pseudo_labels import PseudoLabelQuality

_JSON_DECIMALS = 4


@dataclass(frozen=True)
class Evaluation:
    """Predictions of `frame_count` frames against their truth, by class."""

    frame_count: int
    results: Mapping[str, tuple[AveragePrecision, ...]]
    pseudo_labels: Mapping[str, tuple[PseudoLabelQuality, ...]]

    def to_json(self) -> dict[str, object]:
        """Plain data for `json.dumps`: floats rounded to 4 decimals, null where nothing was counted.

        `results`: class -> entries with recall_points, iou_2d, iou_bev, iou_3d and, in percent as
        [easy, moderate, hard], ap_2d, ap_bev, ap_3d, aos. `pseudo_labels`: class -> groups.
        """
        return {
            "frames": self.frame_count,
            "results": {name: plain(entries) for name, entries in self.results.items()},
            "pseudo_labels": {name: plain(groups) for name, groups in self.pseudo_labels.items()},
        }

    def to_table(self) -> str:
        """Plain text, under 110 characters wide; classes without a truth are left out."""
        frames = "1 frame" if self.frame_count == 1 else f"{self.frame_count} frames"
        blocks = [f"KITTI average precision in %, {frames}", _precision_table(self.results)]
        few = [name for name, entries in self.results.items() if _has_few_truths(entries)]
        if few:
            blocks.append(
                f"Fewer than {FULL_CURVE_TRUTHS} truths at a difficulty of {', '.join(few)}: "
                "there even perfect labels stay below 100."
            )
        if any(group.truths for groups in self.pseudo_labels.values() for group in groups):
            blocks.append("\nLabels from 2D prompts: each truth against the box of its own prompt")
        for name, groups in self.pseudo_labels.items():
            if any(group.truths for group in groups):
                blocks.append(f"\n{_pseudo_label_table(name, groups)}")
        return "\n".join(blocks)


def plain(value: object, decimals: int = _JSON_DECIMALS) -> object:
    """Dataclasses, tuples, dicts and numbers -> what `json.dumps` takes; floats rounded."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: plain(getattr(value, field.name), decimals) for field in dataclasses.fields(value)
        }
    if isinstance(value, dict):
        return {key: plain(item, decimals) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item, decimals) for item in value]
    return round(value, decimals) if isinstance(value, float) else value


def _has_few_truths(entries: Sequence[AveragePrecision]) -> bool:
    return any(0 < count < FULL_CURVE_TRUTHS for entry in entries for count in entry.truths)


def _precision_table(results: Mapping[str, Sequence[AveragePrecision]]) -> str:
    rows = [["", "", "IoU", "R40 easy", "moderate", "hard", "R11 easy", "moderate", "hard"]]
    for name, entries in results.items():
        by_points = {
            points: [entry for entry in entries if entry.recall_points == points] for points in ("R40", "R11")
        }
        seen: set[tuple[str, float]] = set()
        class_rows = []
        for r40, r11 in zip(by_points["R40"], by_points["R11"], strict=True):
            for metric, iou, left, right in (
                ("2D", r40.iou_2d, r40.ap_2d, r11.ap_2d),
                ("AOS", r40.iou_2d, r40.aos, r11.aos),
                ("BEV", r40.iou_bev, r40.ap_bev, r11.ap_bev),
                ("3D", r40.iou_3d, r40.ap_3d, r11.ap_3d),
            ):
                if (metric, iou) not in seen:
                    seen.add((metric, iou))
                    class_rows.append(["", metric, f"{iou:.2f}", *(two_decimals(n) for n in (*left, *right))])
        if any(cell != "-" for row in class_rows for cell in row[3:]):
            class_rows[0][0] = name
            rows += class_rows
    return aligned(rows, names=2)


def _pseudo_label_table(category: str, groups: Sequence[PseudoLabelQuality]) -> str:
    truths = max(group.truths for group in groups)
    if not any(group.associated for group in groups):
        return f"{category}: {truths} truths, none of them has a box"
    strict, loose = (f"@{at.iou:g}".replace("@0", "@") for at in groups[0].at_iou)
    rows = [
        ["", "", "", *["recall"] * 4, *["precision"] * 2, "mean", "median", "median"],
        [
            *(category, "truths", "boxes", f"BEV{strict}", f"3D{strict}", f"BEV{loose}", f"3D{loose}"),
            *(f"3D{strict}", f"3D{loose}", "IoU 3D", "centre m", "yaw deg"),
        ],
    ]
    for group in (group for group in groups if group.truths):
        at_strict, at_loose = group.at_iou
        numbers = (
            *(at_strict.recall_bev, at_strict.recall_3d, at_loose.recall_bev, at_loose.recall_3d),
            *(at_strict.precision_3d, at_loose.precision_3d),
            *(group.mean_iou_3d, group.center_error_median_m, group.yaw_error_median_deg),
        )
        rows.append([group.group, str(group.truths), str(group.associated), *map(two_decimals, numbers)])
    return aligned(rows, names=1)


def two_decimals(number: float | None) -> str:
    """For a cell of a table; a dash where there is nothing."""
    return "-" if number is None else f"{number:.2f}"


def aligned(rows: Sequence[Sequence[str]], names: int) -> str:
    """Columns of equal width: the first `names` to the left, numbers to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if index < names else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )
