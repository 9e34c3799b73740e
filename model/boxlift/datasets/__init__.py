"""Where frames come from: one file per layout, all behind FrameSource."""

from boxlift.datasets.image_folder import ImageFolder, open_images
from boxlift.datasets.source import FrameSource, find_labels, load_objects, load_prompts, open_source

__all__ = [
    "FrameSource",
    "ImageFolder",
    "find_labels",
    "load_objects",
    "load_prompts",
    "open_images",
    "open_source",
]
