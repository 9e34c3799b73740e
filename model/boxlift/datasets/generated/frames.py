"""One seed, one frame: points, picture, masks and truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.datasets.generated.rig import KITTI_RIG, Rig
from boxlift.datasets.generated.scene import Scene, SceneSettings, build_scene
from boxlift.datasets.generated.sensors import NO_OBJECT, RayCaster, camera_rays, scan
from boxlift.datasets.generated.shading import picture
from boxlift.datasets.generated.truth import label
from boxlift.formats.kitti_label import KittiObject, prompts_of
from boxlift.frame import Frame


@dataclass(frozen=True)
class GeneratedFrame:
    """A frame whose truth is known.

    frame: points_velo is float32 (N, 4) with intensity; prompts are the labels' own 2D boxes.
    truth: label lines; those that are not DontCare come first, in the order of the prompts.
    point_instance_ids: (N,) prompt index + 1 of the object that each point lies on, 0 for none.
    objects: number in the scene of each prompt's object.
    """

    frame: Frame
    truth: tuple[KittiObject, ...]
    rig: Rig
    point_instance_ids: NDArray[np.uint16]
    objects: tuple[int, ...] = ()


def generate(seed: int, rig: Rig = KITTI_RIG, settings: SceneSettings | None = None) -> GeneratedFrame:
    """The frame of a seed; the same arguments give the same bytes.

    Raises MissingExtraError where Open3D is not installed.
    """
    scene = build_scene(seed, settings)
    return look(scene, rig, f"{seed:06d}", [seed])


def look(
    scene: Scene, rig: Rig, name: str, seeds: Sequence[int], *, with_image: bool = True
) -> GeneratedFrame:
    """What a rig sees of a scene; `seeds` are those of its noise. Raises MissingExtraError."""
    caster = RayCaster(scene)
    points_velo, point_object = scan(caster, rig, np.random.default_rng([*seeds, 2]))
    origin, directions = camera_rays(rig)
    pixels = caster.cast(origin, directions)
    object_px = np.where(pixels.face >= 0, caster.object_of_face[pixels.face], NO_OBJECT)
    labels = label(scene, rig, object_px)
    # A last entry for "no object", which is index -1.
    number = np.append(labels.mask_number, np.uint16(0))
    noise = np.random.default_rng([*seeds, 3])
    frame = Frame(
        name=name,
        points_velo=points_velo,
        calibration=rig.calibration,
        image_size_px=rig.image_size_px,
        prompts=prompts_of(labels.lines),
        image=picture(caster, scene, origin, directions, pixels, noise) if with_image else None,
        instance_ids=number[object_px],
    )
    shown = np.argsort(labels.mask_number)[np.sort(labels.mask_number) > 0]
    objects = tuple(int(index) for index in shown)
    return GeneratedFrame(frame, labels.lines, rig, number[point_object], objects)
