"""The tables of nuScenes, read as far as a labeller of key frames needs them.

Most of the data set's records are of the sweeps between key frames: they are dropped while the JSON is
parsed, so that the tables of 850 scenes stay small. Source: docs/schema_nuscenes.md of nuscenes-devkit.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from boxlift.errors import DatasetError, LabelFormatError
from boxlift.poses import Floats, pose, rotation_of
from boxlift.storage import read_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_Record = dict[str, Any]
LIDAR = "LIDAR_TOP"


class NuscenesTables:
    """Tables in a folder such as v1.0-mini. Each is read when it is first asked for.

    Raises DatasetError where one is missing, LabelFormatError where it is no table.
    """

    def __init__(self, folder: AnyPath) -> None:
        self._folder = folder

    @cached_property
    def samples(self) -> dict[str, _Record]:
        """Key frames by token: timestamp (microseconds), scene_token."""
        return self._by_token("sample")

    @cached_property
    def scene_names(self) -> dict[str, str]:
        """Names such as scene-0061 by token."""
        return {token: str(each["name"]) for token, each in self._by_token("scene").items()}

    @cached_property
    def channels(self) -> dict[str, dict[str, _Record]]:
        """Key frames' files: sample token -> channel -> record of sample_data. LiDAR and cameras only."""
        channel_of = {
            token: str(self._sensors[str(each["sensor_token"])]["channel"])
            for token, each in self.calibrated.items()
        }
        of_sample: dict[str, dict[str, _Record]] = defaultdict(dict)
        for each in self._rows("sample_data", lambda row: "is_key_frame" not in row or row["is_key_frame"]):
            channel = channel_of[str(each["calibrated_sensor_token"])]
            if channel == LIDAR or channel.startswith("CAM_"):
                of_sample[str(each["sample_token"])][channel] = each
        return dict(of_sample)

    @cached_property
    def calibrated(self) -> dict[str, _Record]:
        """How each sensor is mounted, by token."""
        return self._by_token("calibrated_sensor")

    @cached_property
    def poses(self) -> dict[str, Floats]:
        """world_SE3_ego (4, 4) at the moment of each key frame's file, by token."""
        used = {str(each["ego_pose_token"]) for files in self.channels.values() for each in files.values()}
        rows = self._rows("ego_pose", lambda row: row.get("token") in used)
        return {str(row["token"]): transform_of(row) for row in rows}

    @cached_property
    def annotations(self) -> dict[str, list[_Record]]:
        """Boxes by sample token, each with "category" and "attribute" besides."""
        categories = {token: str(each["name"]) for token, each in self._by_token("category").items()}
        instances = {
            token: categories[str(each["category_token"])]
            for token, each in self._by_token("instance").items()
        }
        attributes = {token: str(each["name"]) for token, each in self._by_token("attribute").items()}
        of_sample: dict[str, list[_Record]] = defaultdict(list)
        for each in self._rows("sample_annotation"):
            each["category"] = instances[str(each["instance_token"])]
            each["attribute"] = next((attributes[str(token)] for token in each["attribute_tokens"]), None)
            of_sample[str(each["sample_token"])].append(each)
        return of_sample

    @property
    def has_annotations(self) -> bool:
        """The test split has an empty table."""
        path = self._folder / "sample_annotation.json"
        return path.is_file() and path.stat().st_size > 10

    @cached_property
    def _sensors(self) -> dict[str, _Record]:
        return self._by_token("sensor")

    def _by_token(self, table: str) -> dict[str, _Record]:
        return {str(each["token"]): each for each in self._rows(table)}

    def _rows(self, table: str, keep: Callable[[_Record], Any] = lambda _: True) -> list[_Record]:
        path = self._folder / f"{table}.json"
        try:
            rows = json.loads(read_whole(path), object_hook=lambda row: row if keep(row) else None)
            return [row for row in rows if row is not None]
        except OSError as error:
            raise DatasetError(
                str(path), f"the table cannot be read ({error.strerror}).", "Add it: see nuScenes' schema."
            ) from None
        except (ValueError, TypeError) as error:
            raise LabelFormatError(
                str(path), f"the file is no table of nuScenes ({error!s:.80}).", "See nuScenes' schema."
            ) from None


def transform_of(row: _Record) -> Floats:
    """A record's "rotation" (w, x, y, z) and "translation" -> (4, 4)."""
    rotation = rotation_of(np.array([row["rotation"]], dtype=np.float64))[0]
    return pose(rotation, np.array(row["translation"], dtype=np.float64))
