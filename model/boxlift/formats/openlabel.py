"""Labels as ASAM OpenLABEL 1.0: one JSON document for the sweeps of a log, or for one sweep.

A box is a cuboid in the coordinate system "ego": x, y, z of its centre, quaternion x, y, z, w, and its sizes
along its own x (length), y (width) and z (height). Where poses are known, each frame has the transform from
ego to "world". Source: the OpenLABEL standard and its JSON schema, through the models of kognic-openlabel,
which check what is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boxlift.errors import MissingExtraError
from boxlift.poses import quaternion_of
from boxlift.sweep import EgoObject, SweepLabels

_EGO, _WORLD = "ego", "world"


def openlabel_json(sweeps: Sequence[SweepLabels]) -> str:
    """Sweeps in their order -> the document. An object keeps its number where it has a track id.

    Raises MissingExtraError without kognic-openlabel.
    """
    try:
        from kognic.openlabel.models import OpenLabelAnnotation
    except ImportError:
        raise MissingExtraError("kognic-openlabel", "formats") from None
    numbers: dict[str, str] = {}
    objects: dict[str, Any] = {}
    frames: dict[str, Any] = {}
    for index, sweep in enumerate(sweeps):
        of_frame: dict[str, Any] = {}
        for position, each in enumerate(sweep.objects):
            key = each.track_id or f"{index}/{position}"
            number = numbers.setdefault(key, str(len(numbers)))
            objects[number] = {"name": each.track_id or f"object {number}", "type": each.category}
            of_frame[number] = {"object_data": {"cuboid": [_cuboid(each)]}}
        frames[str(index)] = {"frame_properties": _properties(sweep), "objects": of_frame}
    has_world = any(sweep.world_SE3_ego is not None for sweep in sweeps)
    systems: dict[str, Any] = {
        _EGO: {"type": "local_cs", "parent": _WORLD if has_world else "", "children": []}
    }
    if has_world:
        systems[_WORLD] = {"type": "scene_cs", "parent": "", "children": [_EGO]}
    log = sweeps[0].log if sweeps else ""
    document = {
        "openlabel": {
            "metadata": {"schema_version": "1.0.0", "annotator": "boxlift", "name": log or None},
            "coordinate_systems": systems,
            "objects": objects,
            "frames": frames,
            "frame_intervals": [{"frame_start": 0, "frame_end": len(sweeps) - 1}] if sweeps else [],
        }
    }
    checked = OpenLabelAnnotation.model_validate(document)
    text: str = checked.model_dump_json(exclude_none=True)
    return text + "\n"


def _cuboid(each: EgoObject) -> dict[str, Any]:
    w, x, y, z = quaternion_of(each.ego_SO3_object)
    attributes: dict[str, Any] = {"num": [{"name": "score", "val": each.score}]}
    if each.points is not None:
        attributes["num"].append({"name": "points", "val": each.points})
    texts = {"cameras": " ".join(each.cameras), "flags": " ".join(each.flags)}
    attributes["text"] = [{"name": name, "val": value} for name, value in texts.items() if value]
    sizes = (each.length_m, each.width_m, each.height_m)
    return {
        "name": "box",
        "val": [*each.center_ego.tolist(), x, y, z, w, *sizes],
        "coordinate_system": _EGO,
        "attributes": attributes,
    }


def _properties(sweep: SweepLabels) -> dict[str, Any]:
    properties: dict[str, Any] = {"external_id": sweep.sweep}
    if sweep.timestamp_ns is not None:
        properties["timestamp"] = str(sweep.timestamp_ns)
    if sweep.world_SE3_ego is not None:
        properties["transforms"] = {
            "ego_to_world": {
                "src": _EGO,
                "dst": _WORLD,
                "transform_src_to_dst": {"matrix4x4": sweep.world_SE3_ego.ravel().tolist()},
            }
        }
    return properties
