"""A few generated frames of a small camera, written as a dataset, and configurations to train on them."""

from __future__ import annotations

from pathlib import Path

from boxlift.datasets.generated import generate
from boxlift.datasets.generated.rig import Rig
from boxlift.datasets.generated.write import write_dataset

# A third of KITTI's camera: pictures that a test can train on.
SMALL_RIG = Rig("small", image_size_px=(416, 125), focal_px=240.0, principal_px=(203.0, 58.0))
SEEDS = (3, 5)


def write_frames(root: Path) -> Path:
    """The dataset's folder."""
    write_dataset(root, [generate(seed, SMALL_RIG) for seed in SEEDS])
    return root


def toml(**sections: str) -> str:
    """A configuration that trains on the dataset `data` beside it and is judged on the same frames."""
    frames = '[[data.train]]\nsource = "data"\n[[data.validate_on]]\nsource = "data"\n'
    return frames + "".join(f"[{name.replace('__', '.')}]\n{text}\n" for name, text in sections.items())
