"""KITTI raw's tracklet_labels.xml -> boxes by frame, in the LiDAR frame.

A tracklet has one size and a pose per frame: the centre of the bottom face and rz, about z. Source: readme of
the KITTI raw development kit (Geiger et al., IJRR 2013).
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from boxlift.errors import LabelFormatError
from boxlift.poses import about_z
from boxlift.storage import read_whole
from boxlift.sweep import EgoObject

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

# Truncation of a pose: 0 in the image, 1 cut by its border, 2 outside, 99 behind the camera.
_OUTSIDE_IMAGE = (2, 99)


def read_tracklets(path: AnyPath) -> dict[int, list[EgoObject]]:
    """Objects by frame number; the LiDAR frame is the ego frame. Raises LabelFormatError, OSError."""
    try:
        root = ElementTree.fromstring(read_whole(path))
    except ElementTree.ParseError as error:
        raise LabelFormatError(
            str(path), f"the file is no XML ({error}).", "Give tracklet_labels.xml."
        ) from None
    boxes: dict[int, list[EgoObject]] = {}
    for number, tracklet in enumerate(root.findall("./tracklets/item")):
        try:
            category = tracklet.findtext("objectType", "")
            height, width, length = (_number(tracklet, key) for key in "hwl")
            first = int(_number(tracklet, "first_frame"))
            for offset, place in enumerate(tracklet.findall("./poses/item")):
                if int(float(place.findtext("truncation", "0"))) in _OUTSIDE_IMAGE:
                    continue
                x, y, bottom, yaw_rad = (_number(place, key) for key in ("tx", "ty", "tz", "rz"))
                boxes.setdefault(first + offset, []).append(
                    EgoObject(
                        category=category,
                        center_ego=np.array([x, y, bottom + height / 2]),
                        ego_SO3_object=about_z(yaw_rad),
                        length_m=length,
                        width_m=width,
                        height_m=height,
                        track_id=str(number),
                    )
                )
        except (TypeError, ValueError) as error:
            raise LabelFormatError(
                str(path), f"tracklet {number} is incomplete ({error}).", "See KITTI raw's readme."
            ) from None
    return boxes


def _number(element: ElementTree.Element, key: str) -> float:
    number = float(element.findtext(key, ""))
    if not np.isfinite(number):
        raise ValueError(f"{key} is {number}")
    return number
