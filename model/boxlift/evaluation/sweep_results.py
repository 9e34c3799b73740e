"""What the Waymo and the nuScenes metric say, as JSON and as text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping

from boxlift.evaluation.nuscenes import DISTANCES_M, NuscenesErrors, NuscenesEvaluation
from boxlift.evaluation.results import aligned, plain, two_decimals
from boxlift.evaluation.sweep_table import JudgedSweeps
from boxlift.evaluation.waymo import WaymoEvaluation

_JSON_DECIMALS = 4
_NAMES_SHOWN = 5

NO_DETECTION_SCORE = "Velocities are not known: no AVE, and no nuScenes detection score (NDS)."
NO_ATTRIBUTES = "No prediction has an attribute: no AAE."


def waymo_json(evaluation: WaymoEvaluation, decimals: int = _JSON_DECIMALS) -> dict[str, object]:
    """Plain data for `json.dumps`: null where there is no truth.

    `results`: class -> entries with range, level, truths and, in percent, ap_bev, ap_3d, aph_bev, aph_3d.
    """
    return {
        "metric": "waymo",
        "iou": evaluation.iou,
        **_sweeps_json(evaluation.sweeps),
        "truths_of_unknown_difficulty": evaluation.truths_of_unknown_difficulty,
        "truths_without_points": evaluation.truths_without_points,
        "scores_beyond_cutoffs": evaluation.scores_beyond_cutoffs,
        "results": plain(evaluation.results, decimals),
    }


def waymo_table(evaluation: WaymoEvaluation) -> str:
    """Plain text; classes without a truth are left out."""
    rows = [["", "", "", "truths", "AP BEV", "AP 3D", "APH BEV", "APH 3D"]]
    for name, entries in evaluation.results.items():
        title = name
        for entry in entries:
            if entry.truths:
                numbers = (entry.ap_bev, entry.ap_3d, entry.aph_bev, entry.aph_3d)
                rows.append([title, entry.level, entry.range, str(entry.truths), *map(two_decimals, numbers)])
                title = ""
    lines = [
        f"Waymo average precision in % at IoU {evaluation.iou:g}, {_sweeps(evaluation.sweeps.sweep_count)}",
        aligned(rows, names=3),
    ]
    if evaluation.truths_of_unknown_difficulty:
        lines.append(
            f"{evaluation.truths_of_unknown_difficulty} truths have neither a difficulty nor a count of "
            "points: they are taken as LEVEL_1."
        )
    if evaluation.truths_without_points:
        lines.append(f"{evaluation.truths_without_points} truths without points are left out.")
    if evaluation.scores_beyond_cutoffs:
        lines.append(
            f"{evaluation.scores_beyond_cutoffs} predictions have scores outside 0 to 1, the cutoffs' range."
        )
    return "\n".join([*lines, *_left_out(evaluation.sweeps)])


def nuscenes_json(evaluation: NuscenesEvaluation, decimals: int = _JSON_DECIMALS) -> dict[str, object]:
    """Plain data for `json.dumps`: null where there is no truth, and for what is not known.

    `results`: class -> truths, ap in percent, ap_at_m (by distance), errors (ate, ase, aoe, aae; ave is
    null). `means` and `means_of_ten`: classes, ap, errors. nds is null, `notes` says why.
    """

    def errors_json(errors: NuscenesErrors) -> dict[str, object]:
        return {"ate": errors.ate, "ase": errors.ase, "aoe": errors.aoe, "ave": None, "aae": errors.aae}

    written = {
        "metric": "nuscenes",
        **_sweeps_json(evaluation.sweeps),
        "results": {
            name: {
                "truths": each.truths,
                "ap": each.ap,
                "ap_at_m": each.ap_at_m,
                "errors": errors_json(each.errors),
            }
            for name, each in evaluation.results.items()
        },
        **{
            key: {"classes": means.classes, "ap": means.ap, "errors": errors_json(means.errors)}
            for key, means in (("means", evaluation.means), ("means_of_ten", evaluation.means_of_ten))
        },
        "nds": None,
        "notes": _notes(evaluation),
    }
    rounded = plain(written, decimals)
    assert isinstance(rounded, dict)
    return rounded


def nuscenes_table(evaluation: NuscenesEvaluation) -> str:
    """Plain text; classes without a truth are left out."""
    rows = [
        ["", "truths", "AP", *(f"AP {each:g} m" for each in DISTANCES_M), "ATE m", "ASE", "AOE rad", "AAE"]
    ]
    for name, each in evaluation.results.items():
        if each.truths:
            numbers = (each.ap, *each.ap_at_m.values(), *_error_columns(each.errors))
            rows.append([name, str(each.truths), *map(two_decimals, numbers)])
    untold = ("",) * len(DISTANCES_M)
    for title, means in (
        (f"mean of {evaluation.means.classes}", evaluation.means),
        (f"mean of {evaluation.means_of_ten.classes}", evaluation.means_of_ten),
    ):
        cells = map(two_decimals, _error_columns(means.errors))
        rows.append([title, "", two_decimals(means.ap), *untold, *cells])
    if evaluation.means.classes == evaluation.means_of_ten.classes:
        rows.pop()
    title = f"nuScenes average precision in % and errors, {_sweeps(evaluation.sweeps.sweep_count)}"
    return "\n".join([title, aligned(rows, names=1), *_notes(evaluation), *_left_out(evaluation.sweeps)])


def _error_columns(errors: NuscenesErrors) -> tuple[float | None, ...]:
    return errors.ate, errors.ase, errors.aoe, errors.aae


def _notes(evaluation: NuscenesEvaluation) -> list[str]:
    notes = [NO_DETECTION_SCORE, *([] if evaluation.attributes_known else [NO_ATTRIBUTES])]
    if evaluation.means.classes < evaluation.means_of_ten.classes:
        notes.append("The mean of 10 is the benchmark's: a class without truth counts as not found.")
    return notes


def _sweeps_json(sweeps: JudgedSweeps) -> dict[str, object]:
    return {
        "sweeps": sweeps.sweep_count,
        "sweeps_without_predictions": sweeps.without_predictions,
        "sweeps_without_truth": sweeps.without_truth,
        "truths_of_other_classes": dict(sweeps.other_truths),
        "predictions_of_other_classes": dict(sweeps.other_predictions),
    }


def _left_out(sweeps: JudgedSweeps) -> list[str]:
    lines: list[str] = []
    if sweeps.without_predictions:
        lines.append(f"{_sweeps(sweeps.without_predictions)} without predictions: nothing found there.")
    if sweeps.without_truth:
        lines.append(f"{_sweeps(sweeps.without_truth)} of the predictions without truth: left out.")
    for side, others in (("truths", sweeps.other_truths), ("predictions", sweeps.other_predictions)):
        if others:
            lines.append(f"Left out {side} of other classes: {_named(others)}.")
    return lines


def _named(counts: Mapping[str, int]) -> str:
    most = sorted(counts, key=lambda name: (-counts[name], name))
    shown = ", ".join(f"{counts[name]} {name}" for name in most[:_NAMES_SHOWN])
    return shown + (f" and {len(most) - _NAMES_SHOWN} more classes" if len(most) > _NAMES_SHOWN else "")


def _sweeps(count: int) -> str:
    return "1 sweep" if count == 1 else f"{count} sweeps"
