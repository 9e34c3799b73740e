"""Results files of nuScenes <-> labels of sweeps.

{"meta": ..., "results": {sample token: [box, ...]}}, where a box has "translation" [x, y, z] in the global
frame, "size" [width, length, height], "rotation" [w, x, y, z], "detection_name", "detection_score" and
"attribute_name". What the devkit writes of its own boxes has "ego_translation" (the translation less the
vehicle's) and "num_pts" besides.
Source: docs of the nuScenes detection task; nuscenes/eval/common/data_classes.py of the devkit.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from boxlift.camera import Floats
from boxlift.errors import DatasetError, LabelFormatError
from boxlift.formats.class_names import NUSCENES_CLASSES, nuscenes_class
from boxlift.poses import quaternion_of, rotation_of
from boxlift.storage import read_whole
from boxlift.sweep import EgoObject, SweepLabels

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_UNKNOWN_POINTS = -1
_MOST_BOXES = 500


class NuscenesBoxes:
    """A results file, read but for where the vehicle was."""

    def __init__(self, path: AnyPath) -> None:
        """Raises LabelFormatError, OSError."""
        self._path = path
        try:
            content = json.loads(read_whole(path))
            results = content["results"]
            self._boxes: dict[str, list[dict[str, Any]]] = {
                str(token): [dict(each) for each in boxes] for token, boxes in results.items()
            }
        except (ValueError, KeyError, TypeError, AttributeError):
            raise LabelFormatError(
                str(path),
                "the file is no nuScenes results file.",
                "Give JSON with `results` by sample token.",
            ) from None

    def positions(self) -> dict[str, Floats]:
        """The vehicle's place (4, 4), not turned, in the samples whose boxes have "ego_translation"."""
        found: dict[str, Floats] = {}
        for token, boxes in self._boxes.items():
            for each in boxes[:1]:
                if (from_ego := each.get("ego_translation")) is not None and np.any(from_ego):
                    pose = np.eye(4)
                    pose[:3, 3] = np.subtract(self._numbers(each, "translation", 3), from_ego)
                    found[token] = pose
        return found

    def sweeps(self, world_SE3_ego: Mapping[str, Floats]) -> list[SweepLabels]:
        """Labels in the ego frame, by the vehicle's pose in each sample.

        Raises DatasetError where a sample with boxes has no pose, LabelFormatError.
        """
        labels: list[SweepLabels] = []
        for token, boxes in self._boxes.items():
            pose = world_SE3_ego.get(token)
            if pose is None and boxes:
                raise DatasetError(
                    str(self._path),
                    f"where the vehicle was in sample {token!r} is not known.",
                    "Give a truth that has poses (a label set), or boxes with ego_translation.",
                )
            labels.append(
                SweepLabels(
                    token,
                    () if pose is None else tuple(self._object(each, pose) for each in boxes),
                    world_SE3_ego=pose,
                )
            )
        return labels

    def _object(self, box: Mapping[str, Any], world_SE3_ego: Floats) -> EgoObject:
        ego_SO3_world = world_SE3_ego[:3, :3].T
        width, length, height = self._numbers(box, "size", 3)
        quaternion = self._numbers(box, "rotation", 4)
        if not quaternion.any():
            raise self._malformed("rotation")
        points = int(box.get("num_pts", _UNKNOWN_POINTS))
        return EgoObject(
            category=str(box.get("detection_name", "")),
            center_ego=ego_SO3_world @ (self._numbers(box, "translation", 3) - world_SE3_ego[:3, 3]),
            ego_SO3_object=ego_SO3_world @ rotation_of(quaternion[None])[0],
            length_m=float(length),
            width_m=float(width),
            height_m=float(height),
            score=_score(box),
            points=None if points == _UNKNOWN_POINTS else points,
            attribute=str(box.get("attribute_name") or "") or None,
        )

    def _numbers(self, box: Mapping[str, Any], key: str, count: int) -> Floats:
        try:
            numbers = np.array(box[key], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            raise self._malformed(key) from None
        if numbers.shape != (count,):
            raise self._malformed(key)
        return numbers

    def _malformed(self, key: str) -> LabelFormatError:
        return LabelFormatError(str(self._path), f"a box has no usable {key!r}.", "See the nuScenes devkit.")


def _score(box: Mapping[str, Any]) -> float:
    score = float(box.get("detection_score", 1.0))
    return 1.0 if score < 0 else score  # the devkit writes -1 where there is none


def results_of(sweeps: Iterable[SweepLabels]) -> tuple[dict[str, Any], Counter[str]]:
    """Labels of sweeps that are samples -> the content of a results file, and classes that it cannot hold.

    Boxes go to the global frame, by the vehicle's pose; of a sample the 500 with the best scores are kept,
    as the benchmark asks. Velocities are 0 and attributes empty: boxlift does not know them. Boxes of tracked
    labels have the fields of the tracking task too.

    Raises DatasetError where a sweep has no pose.
    """
    results: dict[str, list[dict[str, Any]]] = {}
    left_out: Counter[str] = Counter()
    for sweep in sweeps:
        pose = sweep.world_SE3_ego
        if pose is None:
            raise DatasetError(
                sweep.sweep,
                "where the vehicle was in this sweep is not known, so that its boxes have no global place.",
                "Convert a label set of nuScenes, or of a data set with poses.",
            )
        boxes: list[dict[str, Any]] = []
        for each in sorted(sweep.objects, key=lambda item: -item.score):
            index = nuscenes_class(each.category)
            if index is None:
                left_out[each.category] += 1
            elif len(boxes) < _MOST_BOXES:
                boxes.append(_result(each, sweep.sweep, pose, NUSCENES_CLASSES[index]))
        results[sweep.sweep] = boxes
    meta = dict.fromkeys(("use_radar", "use_map", "use_external"), False)
    return {"meta": {"use_camera": True, "use_lidar": True, **meta}, "results": results}, left_out


def _result(each: EgoObject, token: str, world_SE3_ego: Floats, name: str) -> dict[str, Any]:
    center = world_SE3_ego[:3, :3] @ each.center_ego + world_SE3_ego[:3, 3]
    track = {"tracking_id": each.track_id, "tracking_name": name, "tracking_score": each.score}
    return {
        **(track if each.track_id is not None else {}),
        "sample_token": token,
        "translation": center.tolist(),
        "size": [each.width_m, each.length_m, each.height_m],
        "rotation": list(quaternion_of(world_SE3_ego[:3, :3] @ each.ego_SO3_object)),
        "velocity": [0.0, 0.0],
        "detection_name": name,
        "detection_score": each.score,
        "attribute_name": each.attribute or "",
    }
