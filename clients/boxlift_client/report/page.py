"""A report: everything gathered in one pass over the details, then pictures, then the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from boxlift.datasets import load_objects
from boxlift.drawing import draw_objects
from boxlift.errors import BoxliftError, DatasetError, MissingExtraError
from boxlift.evaluation import Evaluation, evaluate_tables
from boxlift.evaluation.label_table import LabelTable
from boxlift.evaluation.results import two_decimals
from boxlift.formats.details import kitti_object_of
from boxlift.formats.image import encoded_jpeg
from boxlift.formats.kitti_label import KittiObject
from boxlift.label_sets.files import details_path, read_objects
from boxlift.label_sets.index import LabelSetIndex
from boxlift.label_sets.ledger_parts import LEDGER
from boxlift.label_sets.manifest import MANIFEST, read_manifest
from boxlift.label_sets.reader import LabelSetReader
from boxlift_client.drive_record import read_records
from boxlift_client.ledger import read_rows
from boxlift_client.report.charts import bars, reliability_diagram
from boxlift_client.report.contents import DEPTH_STEP_M, Contents, SizeRow, Timing, timing_of
from boxlift_client.report.judgement import (
    JudgedObject,
    Suspect,
    judge_frame,
    recall_by_points,
    reliability,
    worst,
)
from boxlift_client.report.reviews import Reviews

if TYPE_CHECKING:
    from boxlift.storage import AnyPath
    from boxlift_client.cli.progress import OnProgress

_WORST_BOXES = 20
_MOST_SUSPECTS = 50
_JPEG_QUALITY = 72


@dataclass
class _Truth:
    """What was gathered against the truth, frame by frame."""

    truths: list[list[KittiObject]] = field(default_factory=list)
    predictions: list[list[KittiObject]] = field(default_factory=list)
    judged: list[JudgedObject] = field(default_factory=list)
    suspects: list[Suspect] = field(default_factory=list)
    without: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Picture:
    caption: str
    data: str


def write_report(
    label_set: AnyPath,
    source: AnyPath | None,
    gt: str | None,
    pictures: int,
    on_progress: OnProgress,
) -> str:
    """The HTML of a label set's report.

    source: its data set, where it has moved. gt: the truth, as `boxlift show` takes it; None: without.
    pictures: frames to draw at most. Raises DatasetError, LabelFormatError, MissingExtraError, OSError.
    """
    manifest = read_manifest(label_set)
    if manifest is None:
        raise DatasetError(str(label_set), f"it has no {MANIFEST}.", "Give what `boxlift label` wrote.")
    reader = LabelSetReader(label_set, manifest, source)
    contents = Contents(kept_frames=pictures)
    reviews = Reviews.of(label_set)
    truth = None if gt is None else _Truth()
    names = LabelSetIndex.names_in(label_set)
    for at, name in enumerate(names):
        on_progress(at, len(names))
        details = reader.details(name)
        contents.add(details)
        reviews.add(details)
        if truth is None or gt is None:
            continue
        try:
            objects = load_objects(gt, reader.source_of(name), name)
        except DatasetError:
            truth.without.append(name)
            continue
        judged, suspects = judge_frame(details, objects)
        truth.truths.append(objects)
        truth.predictions.append([kitti_object_of(each.kitti) for each in details.objects if each.kitti])
        truth.judged += judged
        truth.suspects += suspects
    if truth is not None and not truth.truths:
        raise DatasetError(str(gt), "no frame of the label set has a truth there.", "Check --gt.")
    drawn_frames = contents.frames_worth_a_look()
    if truth is not None:
        drawn_frames = list(dict.fromkeys(each.frame for each in worst(truth.judged, _WORST_BOXES)))
    drawn, not_drawn = _pictures(reader, label_set, drawn_frames[:pictures], gt)
    if truth is not None and truth.without:
        not_drawn.append(f"{len(truth.without)} frames have no truth, e.g. {truth.without[0]}.")
    values: dict[str, Any] = {
        "name": label_set.name,
        "manifest": manifest,
        "contents": contents,
        "timing": _timing(label_set),
        "result_table": _result_table(contents),
        "charts": _charts(contents),
        "size_table": [_size_cells(row) for row in contents.sizes()],
        "flag_table": [
            (flag.replace("_", " "), count, f"{count / contents.boxes:.2f}")
            for flag, count in contents.flags.most_common()
        ],
        "verdict_table": reviews.verdict_table(),
        "share_table": [
            (each.name, each.boxes, f"{each.right / each.boxes:.2f}", f"{each.mean_score:.2f}")
            for each in reviews.shares()
        ],
        "drive_table": _drive_table(label_set),
        "truth": None if truth is None else _truth_values(truth),
        "pictures": drawn,
        "not_drawn": not_drawn,
    }
    return _rendered(values)


def _rendered(values: dict[str, Any]) -> str:
    try:
        from jinja2 import Environment, StrictUndefined
    except ModuleNotFoundError:
        raise MissingExtraError("jinja2", "client") from None
    template = (files("boxlift_client.report") / "report.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return environment.from_string(template).render(values)


def _timing(label_set: AnyPath) -> Timing | None:
    rows = read_rows(label_set / LEDGER)
    return timing_of((row.frame, row.seconds) for row in rows if row.error is None)


def _pictures(
    reader: LabelSetReader, label_set: AnyPath, names: Sequence[str], gt: str | None
) -> tuple[list[_Picture], list[str]]:
    """JPEGs of the frames; and a sentence for each that cannot be drawn."""
    drawn, not_drawn = [], []
    for name in names:
        try:
            frame = reader.load(name, (), with_image=True)
            truth = load_objects(gt, reader.source_of(name), name) if gt else []
            picture = draw_objects(frame, read_objects(details_path(label_set, name)), truth)
        except BoxliftError as error:
            not_drawn.append(f"{name} is not drawn: {error}")
            continue
        data = base64.b64encode(encoded_jpeg(picture, _JPEG_QUALITY)).decode()
        drawn.append(_Picture(name, data))
    return drawn, not_drawn


def _result_table(contents: Contents) -> list[list[object]]:
    results = sorted({result for counts in contents.results.values() for result in counts})
    rows: list[list[object]] = [["class", *results, "all"]]
    for category, counts in sorted(contents.results.items()):
        rows.append([category, *(counts[result] for result in results), counts.total()])
    return rows


def _drive_table(label_set: AnyPath) -> list[list[object]]:
    """A row per tracked drive: what its frames said one by one, and what the drive says."""

    def metres(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

    return [
        [
            each.drive or "drive",
            each.frames,
            each.boxes_before,
            each.boxes_after,
            each.given_a_box,
            each.filled,
            ", ".join(f"{count} {motion}" for motion, count in sorted(each.objects.items())),
            metres(each.place_m),
            metres(each.length_m),
            each.turned,
        ]
        for each in read_records(label_set)
    ]


def _charts(contents: Contents) -> list[tuple[str, str]]:
    farthest = max(contents.depths, default=0)
    tenths = [f".{at}" for at in range(10)]
    depths = [str(DEPTH_STEP_M * at) for at in range(farthest + 1)]
    scores = [contents.scores[at] for at in range(10)]
    by_depth = [contents.depths[at] for at in range(farthest + 1)]
    return [
        ("Boxes by score", bars("Boxes by score", "score from", tenths, scores)),
        ("Boxes by depth", bars("Boxes by depth", "depth from, m", depths, by_depth)),
    ]


def _size_cells(row: SizeRow) -> list[object]:
    def cell(quantiles: tuple[float, ...]) -> str:
        low, median, high = quantiles
        return f"{median:.2f} ({low:.2f}-{high:.2f})"

    return [row.category, row.boxes, cell(row.length_m), cell(row.width_m), cell(row.height_m)]


def _truth_values(truth: _Truth) -> dict[str, Any]:
    evaluation = evaluate_tables(
        LabelTable.from_frames(truth.truths), LabelTable.from_frames(truth.predictions)
    )
    suspects = sorted(truth.suspects, key=lambda each: (-each.score, each.frame))[:_MOST_SUSPECTS]
    return {
        "ap_table": _ap_table(evaluation),
        "quality_table": _quality_table(evaluation),
        "points_table": [
            (row.points, row.truths, f"{row.recall_loose:.2f}", f"{row.recall_strict:.2f}")
            for row in recall_by_points(truth.judged)
        ],
        "reliability": reliability_diagram(reliability(truth.judged)),
        "suspects": [(each.frame, each.index, each.category, f"{each.score:.2f}") for each in suspects],
        "worst_table": [
            (
                each.frame,
                each.index,
                each.category,
                f"{each.iou:.2f}",
                f"{each.probability:.2f}",
                each.points,
            )
            for each in worst(truth.judged, _WORST_BOXES)
        ],
    }


def _ap_table(evaluation: Evaluation) -> list[list[object]]:
    def cell(values: Sequence[float | None]) -> str:
        return ", ".join("-" if value is None else f"{value:.1f}" for value in values)

    return [
        [category, f"{entry.iou_3d:g}", cell(entry.ap_bev), cell(entry.ap_3d), entry.truths[-1]]
        for category, entries in evaluation.results.items()
        for entry in entries
        if entry.recall_points == "R40" and entry.truths[-1]
    ]


def _quality_table(evaluation: Evaluation) -> list[list[object]]:
    rows: list[list[object]] = []
    for category, groups in evaluation.pseudo_labels.items():
        for group in (each for each in groups if each.truths):
            strict, loose = group.at_iou
            errors = group.size_error_lwh_m
            sizes = "-" if errors is None else ", ".join(f"{each:.2f}" for each in errors)
            rows.append(
                [
                    category,
                    group.group,
                    group.truths,
                    two_decimals(loose.recall_3d),
                    two_decimals(strict.recall_3d),
                    two_decimals(group.center_error_median_m),
                    sizes,
                    two_decimals(group.yaw_error_modulo_180_median_deg),
                ]
            )
    return rows
