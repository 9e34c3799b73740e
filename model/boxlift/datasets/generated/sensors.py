"""Rays into a scene: the spinning LiDAR and the camera's pixels (Open3D's ray casting, Embree inside)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift import extras
from boxlift.camera import Floats
from boxlift.datasets.generated.meshes import Material, Mesh, joined
from boxlift.datasets.generated.rig import Rig
from boxlift.datasets.generated.scene import Scene

NO_OBJECT = -1

# What becomes of a beam that meets glass (ours): a return from the glass, from what is behind, or none.
_GLASS_RETURNS, _GLASS_PASSES = 0.12, 0.38
# Half the beams come back whose reflectance x cosine / range^2 is this: asphalt seen from 1.7 m at 45 m.
_HALF_SIGNAL = 3.0e-6
# A clear coat mirrors most of a beam away; what is left makes far and dark cars lose points as KITTI's do.
_GLOSSY_SIGNAL = 0.06
_LOST_ANYWAY = 0.015
_FOLIAGE_DEPTH_M = 0.12


@dataclass(frozen=True)
class Hits:
    """What rays (...,) met: range in metres and face (inf and -1 for the sky), unit normal (..., 3)."""

    range_m: Floats
    face: NDArray[np.int64]
    normal: Floats


class RayCaster:
    """A scene made ready for rays, with what each face is made of."""

    def __init__(self, scene: Scene) -> None:
        parts = [item.mesh for item in scene.objects] + [scene.scenery, scene.terrain.mesh()]
        mesh = joined(parts)
        faces = [len(part.triangles) for part in parts]
        owners = [*range(len(scene.objects)), NO_OBJECT, NO_OBJECT]
        self.object_of_face = np.repeat(np.array(owners), faces)
        surfaces = [mesh.surfaces[index] for index in range(len(mesh.surfaces))]
        self.rgb = np.array([surface.rgb for surface in surfaces])[mesh.face_surface]
        self.reflectance = np.array([surface.reflectance for surface in surfaces])[mesh.face_surface]
        self.material = np.array([int(surface.material) for surface in surfaces])[mesh.face_surface]
        self._all = _embree(mesh)
        self._opaque_faces = np.flatnonzero(self.material != Material.GLASS)
        self._opaque = _embree(mesh, self._opaque_faces)

    def cast(self, origin: Floats, directions: Floats) -> Hits:
        """Rays from one origin (3,) along unit directions (..., 3)."""
        return _cast(self._all, origin, directions)

    def cast_through_glass(self, origin: Floats, directions: Floats) -> Hits:
        """As `cast`, with every pane gone."""
        hits = _cast(self._opaque, origin, directions)
        face = np.where(hits.face >= 0, self._opaque_faces[hits.face], -1)
        return Hits(hits.range_m, face, hits.normal)

    def shadowed(self, points: Floats, sun: Floats) -> NDArray[np.bool_]:
        """Whether something stands between points (N, 3) and the sun."""
        rays = np.concatenate([points, np.broadcast_to(sun, points.shape)], axis=1).astype(np.float32)
        tensor = extras.open3d().core.Tensor(rays)
        occluded: NDArray[np.bool_] = self._all.test_occlusions(tensor).numpy()
        return occluded


def silhouette(mesh: Mesh, origin: Floats, directions: Floats) -> NDArray[np.bool_]:
    """Which rays would meet a mesh that stood alone."""
    return np.isfinite(_cast(_embree(mesh), origin, directions).range_m)


def camera_rays(rig: Rig) -> tuple[Floats, Floats]:
    """Optical centre (3,) and unit directions (H, W, 3) through the pixels' centres, scene frame."""
    calibration = rig.calibration
    width, height = rig.image_size_px
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    center_cam = calibration.camera_center_cam
    # P maps X to K (X - centre): a pixel's direction is K^-1 (u, v, 1).
    directions_cam = (
        np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(calibration.image_P_cam[:, :3]).T
    )
    directions_cam /= np.linalg.norm(directions_cam, axis=-1, keepdims=True)
    return cam_to_scene(center_cam, rig), directions_cam @ rig.cam_axes_of_scene


def cam_to_scene(points_cam: Floats, rig: Rig) -> Floats:
    """(..., 3) rectified camera frame -> scene frame."""
    from_car = (points_cam - np.array([0, rig.camera_height_m, 0])) @ rig.cam_axes_of_scene
    return np.asarray(from_car + np.array(rig.car_at_m))


def scene_to_cam(points: Floats, rig: Rig) -> Floats:
    """(..., 3) scene frame -> rectified camera frame."""
    from_car = points - np.array(rig.car_at_m)
    return np.asarray(from_car @ rig.cam_axes_of_scene.T + np.array([0, rig.camera_height_m, 0]))


def scan(
    caster: RayCaster, rig: Rig, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """One turn of the LiDAR: points_velo (N, 4) with intensity in 0..1, and each point's object (or -1)."""
    cam_SE3_velo = rig.calibration.cam_SE3_velo
    directions_velo = _beams(rig, rng)
    directions = directions_velo @ cam_SE3_velo[:3, :3].T @ rig.cam_axes_of_scene
    origin = cam_to_scene(cam_SE3_velo[:3, 3], rig)
    hits = caster.cast(origin, directions)
    range_m, face, normal = hits.range_m.copy(), hits.face.copy(), hits.normal.copy()
    chance = rng.random((4, len(face)))

    glass = (face >= 0) & (caster.material[face] == Material.GLASS) & (chance[0] > _GLASS_RETURNS)
    passes = glass & (chance[0] < _GLASS_RETURNS + _GLASS_PASSES)
    behind = caster.cast_through_glass(origin, directions[passes])
    range_m[passes], face[passes], normal[passes] = behind.range_m, behind.face, behind.normal
    seen = (face >= 0) & ~(glass & ~passes) & (range_m > rig.min_range_m) & (range_m < rig.max_range_m)

    reflectance = caster.reflectance[face]
    cosine = np.abs((normal * directions).sum(axis=1))
    signal = reflectance * np.maximum(cosine, 1e-3) / np.maximum(range_m, 1) ** 2
    signal *= np.where(caster.material[face] == Material.GLOSSY, _GLOSSY_SIGNAL, 1.0)
    seen &= chance[1] < (1 - _LOST_ANYWAY) * (1 - np.exp(-np.log(2) * signal / _HALF_SIGNAL))

    foliage = caster.material[face] == Material.FOLIAGE
    range_m = range_m + foliage * -_FOLIAGE_DEPTH_M * np.log1p(-chance[2])
    range_m = range_m + rng.normal(0, rig.range_noise_m, len(face))
    intensity = reflectance * (0.35 + 0.65 * cosine) * (0.8 + 0.4 * chance[3])
    points = np.column_stack([directions_velo[seen] * range_m[seen, None], intensity[seen].clip(0, 0.99)])
    # Millimetres and hundredths, as in KITTI's files.
    points = np.column_stack([points[:, :3].round(3), points[:, 3:].round(2)])
    return points.astype(np.float32), caster.object_of_face[face[seen]]


def _beams(rig: Rig, rng: np.random.Generator) -> Floats:
    """(beams * columns, 3) unit directions in the LiDAR frame, beam after beam from the top."""
    columns = round(360 / rig.azimuth_step_deg)
    elevation = np.deg2rad(np.array(rig.elevations_deg))[:, None]
    # The lasers of one column do not fire at once, and no two turns begin at the same angle.
    phase = rng.random((len(elevation), 1))
    azimuth = (np.arange(columns) + phase) * (2 * np.pi / columns)
    return np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) + 0 * azimuth,
        ],
        axis=-1,
    ).reshape(-1, 3)


def _embree(mesh: Mesh, faces: NDArray[np.int64] | None = None) -> Any:  # Open3D ships no types.
    open3d = extras.open3d()
    triangles = mesh.triangles if faces is None else mesh.triangles[faces]
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)), open3d.core.Tensor(triangles.astype(np.uint32))
    )
    return scene


def _cast(scene: Any, origin: Floats, directions: Floats) -> Hits:
    open3d = extras.open3d()
    rays = np.empty((*directions.shape[:-1], 6), dtype=np.float32)
    rays[..., :3], rays[..., 3:] = origin, directions
    answer = scene.cast_rays(open3d.core.Tensor(rays))
    range_m = answer["t_hit"].numpy().astype(np.float64)
    face = np.where(np.isfinite(range_m), answer["primitive_ids"].numpy().astype(np.int64), -1)
    return Hits(range_m, face, answer["primitive_normals"].numpy().astype(np.float64))
