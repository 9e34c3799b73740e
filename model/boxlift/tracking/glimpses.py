"""What one frame saw of one object: as much of the view as the evidence on its box is weighed by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boxlift.accurate.view import Region, View, region_of
from boxlift.poses import Floats, inverse

# Object points reach this much above the class's height, as in the labelling of single frames.
_ABOVE_M = 0.2


@dataclass(frozen=True)
class Glimpse:
    """One object in one frame: the points in and around its prompt, and where all of it is.

    view holds those points alone, region their rows. world_SE3_cam: (4, 4). own: (7,) the frame's own box, in
    its camera.
    """

    sweep: int
    view: View
    region: Region
    world_SE3_cam: Floats
    own: Floats

    @classmethod
    def of(
        cls, view: View, index: int, sweep: int, world_SE3_cam: Floats, height_m: float, own: Floats
    ) -> Glimpse:
        """Of prompt `index` of a view; objects of its class are height_m high."""
        nobody = np.zeros(len(view.points_cam), dtype=np.bool_)
        region = region_of(view, index, nobody, height_m + _ABOVE_M)
        rows = np.union1d(region.inside, region.around)
        # Nothing that holds on to the sweep: a track has dozens of these.
        frame = replace(view.frame, points_velo=np.empty((0, 3)), image=None, instance_ids=None, prompts=())
        ground = replace(view.ground, is_ground=np.empty(0, dtype=np.bool_))
        kept = View(frame, ground, view.points_cam[rows], view.pixels[rows], view.above_m[rows])
        found = replace(
            region,
            inside=np.searchsorted(rows, region.inside),
            around=np.searchsorted(rows, region.around),
        )
        return cls(sweep, kept, found, world_SE3_cam, own)

    @property
    def points_world(self) -> Floats:
        """(M, 3) a sample of the points in the prompt that are off the ground and not too high."""
        return moved(self.world_SE3_cam, self.view.points_cam[self.region.inside])

    def origin_world(self, ray_origin: str) -> Floats:
        """(3,) where the rays start, see LossSettings.ray_origin."""
        from_lidar = ray_origin == "lidar"
        calibration = self.view.frame.calibration
        origin = self.view.sensor_cam if from_lidar else calibration.camera_center_cam
        return moved(self.world_SE3_cam, origin)

    @property
    def image_P_world(self) -> Floats:
        """(3, 4)."""
        image_P_cam = self.view.frame.calibration.image_P_cam
        image_P_world: Floats = image_P_cam @ inverse(self.world_SE3_cam)
        return image_P_world

    def ground_world(self, bottom_world: Floats) -> tuple[Floats, bool]:
        """(3,) the ground over or under a place (3,), and whether it was seen there."""
        x, _, z = moved(inverse(self.world_SE3_cam), bottom_world)
        at = np.array([x]), np.array([z])
        ground_cam = np.array([x, float(self.view.ground.y_at(*at)[0]), z])
        return moved(self.world_SE3_cam, ground_cam), bool(self.view.ground.is_known(*at)[0])


def moved(a_SE3_b: Floats, points_b: Floats) -> Floats:
    """(..., 3) points of frame b -> of frame a."""
    points_a: Floats = points_b @ a_SE3_b[:3, :3].T + a_SE3_b[:3, 3]
    return points_a
