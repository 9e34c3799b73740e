"""Generated scenes: a seeded piece of town, seen by a LiDAR and a camera, with exact KITTI truth.

>>> from boxlift.datasets.generated import generate, write_dataset
>>> write_dataset(Path("town"), (generate(seed) for seed in range(12)))  # doctest: +SKIP
"""

from boxlift.datasets.generated.drive import DriveSettings, GeneratedSweep, generate_drive, write_drive
from boxlift.datasets.generated.frames import GeneratedFrame, generate
from boxlift.datasets.generated.rig import FAR_APART_RIG, KITTI_RIG, RIGS, ROOF_32_RIG, Rig
from boxlift.datasets.generated.scene import SceneSettings
from boxlift.datasets.generated.write import write_dataset, write_frame

__all__ = [
    "FAR_APART_RIG",
    "KITTI_RIG",
    "RIGS",
    "ROOF_32_RIG",
    "DriveSettings",
    "GeneratedFrame",
    "GeneratedSweep",
    "Rig",
    "SceneSettings",
    "generate",
    "generate_drive",
    "write_dataset",
    "write_drive",
    "write_frame",
]
