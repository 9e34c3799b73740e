"""Where frames come from: one file per layout, all behind FrameSource."""

from boxlift.datasets.source import FrameSource, find_labels, load_objects, load_prompts, open_source

__all__ = ["FrameSource", "find_labels", "load_objects", "load_prompts", "open_source"]
