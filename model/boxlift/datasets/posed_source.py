"""What layouts have in common that know vehicles: cameras mounted on an ego frame, and its poses.

A layout says what is in its files (a Shot, the points, the boxes); this module makes frames of it. Points are
handed on in a LiDAR frame whose axes are the ego frame's and whose origin is the LiDAR.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration, Floats
from boxlift.datasets.plain_folder import decode_rectified, read_instance_ids
from boxlift.errors import DatasetError
from boxlift.formats.class_names import boxlift_class
from boxlift.formats.ego_boxes import objects_in_view
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Frame, Prompt
from boxlift.lens import Lens
from boxlift.poses import inverse, pose
from boxlift.sweep import EgoObject, SweepLabels, SweepView

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

# What --prompts calls the boxes of data sets that have one kind of them.
ANNOTATIONS = "annotations"


@dataclass(frozen=True)
class Shot:
    """One camera's image of one sweep, and where both were taken.

    sweep, log, camera, timestamp_ns: see SweepView. image_P_cam: (3, 4) of the rectified camera.
    mount_SE3_cam: (4, 4) camera (x right, y down, z forward) -> ego frame, as it is mounted.
    lidar_origin_ego: (3,). world_SE3_ego: at the sweep's time; world_SE3_ego_at_image: when the image was
    taken, None for the same.
    """

    sweep: str
    log: str
    camera: str
    image_P_cam: Floats
    size_px: tuple[int, int]
    mount_SE3_cam: Floats
    lidar_origin_ego: Floats
    timestamp_ns: int | None = None
    world_SE3_ego: Floats | None = None
    world_SE3_ego_at_image: Floats | None = None
    lens: Lens | None = None

    @property
    def ego_SE3_cam(self) -> Floats:
        """(4, 4) camera when it saw -> ego frame when the LiDAR did."""
        if self.world_SE3_ego is None or self.world_SE3_ego_at_image is None:
            return self.mount_SE3_cam
        return inverse(self.world_SE3_ego) @ self.world_SE3_ego_at_image @ self.mount_SE3_cam

    @property
    def view(self) -> SweepView:
        """Where the frame belongs."""
        return SweepView(
            self.sweep, self.camera, self.ego_SE3_cam, self.log, self.timestamp_ns, self.world_SE3_ego
        )

    @property
    def calibration(self) -> Calibration:
        """From the LiDAR to the camera at their two moments. Raises CalibrationError."""
        ego_SE3_velo = pose(np.eye(3), self.lidar_origin_ego)
        return Calibration(self.image_P_cam, inverse(self.ego_SE3_cam) @ ego_SE3_velo)


class PosedSource(ABC):
    """FrameSource made of shots."""

    layout: str
    label_names: tuple[str, ...] = ()

    def __init__(self, root: AnyPath) -> None:
        self.root = root

    @property
    @abstractmethod
    def names(self) -> Sequence[str]:
        """Names of all frames, sorted."""

    @abstractmethod
    def shot(self, name: str) -> Shot:
        """What the files say of a frame, but for points and pixels. Raises DatasetError, CalibrationError."""

    @abstractmethod
    def points_ego(self, name: str) -> NDArray[np.floating]:
        """(N, 3+) points of a frame's sweep in the ego frame. Raises NoLidarError, PointCloudError."""

    @abstractmethod
    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """PNG or JPEG as the camera wrote it, and what errors call it. Raises DatasetError, ImageError."""

    def ego_objects(self, labels: str, name: str) -> Sequence[EgoObject]:
        """The annotations `labels` (of label_names) of a frame's sweep. Raises DatasetError."""
        raise DatasetError(labels, f"frame {name!r} has no such annotations.", "Give a folder of labels.")

    def objects(self, labels: str, name: str) -> list[KittiObject]:
        """See Source.objects. Classes are boxlift's where it has them; what holds no point is left out."""
        shot = self.shot(name)
        objects = [
            replace(each, category=boxlift_class(each.category, each.attribute))
            for each in self.ego_objects(labels, name)
            if each.points != 0
        ]
        return objects_in_view(objects, shot.ego_SE3_cam, shot.calibration, shot.size_px)

    def load(
        self,
        name: str,
        prompts: tuple[Prompt, ...] = (),
        *,
        masks: AnyPath | None = None,
        with_image: bool = False,
    ) -> Frame:
        """See FrameSource.load."""
        shot = self.shot(name)
        origin = np.asarray(shot.lidar_origin_ego)
        points_velo = np.array(self.points_ego(name), dtype=np.float32)
        points_velo[:, :3] -= origin.astype(np.float32)
        return Frame(
            name=name,
            points_velo=points_velo,
            calibration=shot.calibration,
            image_size_px=shot.size_px,
            prompts=prompts,
            image=decode_rectified(*self.encoded_image(name), shot.lens) if with_image else None,
            instance_ids=None if masks is None else read_instance_ids(masks, name, shot.lens),
            view=shot.view,
            lens=shot.lens,
        )

    def sweeps(self, labels: str) -> Iterator[SweepLabels]:
        """The annotations `labels` of every sweep, each once. Raises DatasetError."""
        seen: set[tuple[str, str]] = set()
        for name in self.names:
            shot = self.shot(name)
            if (shot.log, shot.sweep) in seen:
                continue
            seen.add((shot.log, shot.sweep))
            objects = tuple(self.ego_objects(labels, name))
            yield SweepLabels(shot.sweep, objects, shot.log, shot.timestamp_ns, shot.world_SE3_ego)

    def _no_frame(self, name: str) -> DatasetError:
        return DatasetError(
            str(self.root),
            f"there is no frame {name!r}.",
            f"Names are such as {next(iter(self.names), None)!r}.",
        )
