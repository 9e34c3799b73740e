"""What a training frame is: image, projection, 2D boxes and what supervises each of them.

Targets are extracted once by the labeller's own steps and kept in one .npz file. Drawn labels are read only
where a comparison trains on them.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets import FrameSource, load_objects, load_prompts, open_source
from boxlift.datasets.frames_file import read_frames
from boxlift.errors import DatasetError, NoLidarError
from boxlift.formats import image as image_files
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Frame
from boxlift.network.checkpoint import write_atomically
from boxlift.network.config import DataSettings, FrameSet
from boxlift.network.targets import Targets, find_targets, no_targets
from boxlift.object_points import check_prompt
from boxlift.settings import PAPER

# Of what is extracted and how: files of another number are made anew.
_FORMAT = 1


@dataclass(frozen=True)
class TrainingFrame:
    """A frame with N 2D boxes.

    image_P_cam (3, 4); lidar_center_cam (3,); boxes_px (N, 4); score (N,) of the 2D boxes; category (N,)
    index into the training's classes; targets: see there, N rows.
    """

    name: str
    image_path: Path
    image_P_cam: Floats
    lidar_center_cam: Floats
    boxes_px: Floats
    score: Floats
    category: NDArray[np.int64]
    targets: Targets

    def read_image(self) -> NDArray[np.uint8]:
        """(H, W, 3) RGB. Raises ImageError."""
        return image_files.decode_image(self.image_path, str(self.image_path))


@dataclass(frozen=True)
class JudgedFrame:
    """A frame that a model is judged on, and its drawn labels. Its targets are empty."""

    frame: TrainingFrame
    truth: tuple[KittiObject, ...]


def load_frames(sets: Sequence[FrameSet], data: DataSettings, cache: Path | None) -> list[TrainingFrame]:
    """All frames of the sets that have LiDAR and a usable 2D box, with what supervises them.

    cache: a file to read the targets from, or to write them to. Raises DatasetError where frames, images or
    prompts are not there.
    """
    chosen = data.model_dump(mode="json", exclude={"train", "validate_on"})
    key = json.dumps([_FORMAT, chosen, [each.model_dump(mode="json") for each in sets]])
    known = _read_cache(cache, key)
    frames = []
    for number, each, source, name in _named(sets):
        loaded = _load(source, each, name)
        if loaded is None:
            continue
        rows = _usable(loaded, each, data)
        key_of_frame = f"{number}/{name}"
        if key_of_frame not in known:
            known[key_of_frame] = find_targets(loaded, rows, source, each, data)
        frames.append(_training_frame(loaded, source, rows, data, known[key_of_frame]))
    if cache is not None:
        _write_cache(cache, key, known)
    return [frame for frame in frames if len(frame.boxes_px)]


def load_judged(sets: Sequence[FrameSet], data: DataSettings) -> list[JudgedFrame]:
    """All frames of the sets that have LiDAR, with their drawn labels. Raises DatasetError as load_frames."""
    frames = []
    for _, each, source, name in _named(sets):
        loaded = _load(source, each, name)
        if loaded is not None:
            rows = _usable(loaded, each, data)
            frame = _training_frame(loaded, source, rows, data, no_targets(loaded, rows))
            frames.append(JudgedFrame(frame, tuple(load_objects(each.labels, source, name))))
    return frames


def find_image(source: FrameSource, name: str) -> Path:
    """The image of a frame. Raises DatasetError where there is none."""
    for suffix in image_files.SUFFIXES:
        path = Path(str(source.root)) / "image_2" / f"{name}{suffix}"
        if path.is_file():
            return path
    raise DatasetError(
        str(source.root / "image_2"), f"frame {name!r} has no image.", "Add it, or leave the frame out."
    )


def _named(sets: Sequence[FrameSet]) -> Iterator[tuple[int, FrameSet, FrameSource, str]]:
    for number, each in enumerate(sets):
        source = open_source(each.source)
        for name in source.names if each.frames is None else read_frames(each.frames):
            yield number, each, source, name


def _load(source: FrameSource, frame_set: FrameSet, name: str) -> Frame | None:
    try:
        return source.load(name, load_prompts(frame_set.prompts, source, name), masks=frame_set.masks)
    except NoLidarError:
        return None


def _usable(frame: Frame, frame_set: FrameSet, data: DataSettings) -> list[int]:
    """The prompts to train on or to judge by: of the classes, sure enough, inside the image."""
    return [
        index
        for index, prompt in enumerate(frame.prompts)
        if prompt.category in data.categories
        and prompt.score >= frame_set.min_score
        and check_prompt(prompt, index, frame.image_size_px, PAPER.sizes) is None
    ]


def _training_frame(
    frame: Frame, source: FrameSource, rows: Sequence[int], data: DataSettings, targets: Targets
) -> TrainingFrame:
    chosen = [frame.prompts[index] for index in rows]
    return TrainingFrame(
        name=frame.name,
        image_path=find_image(source, frame.name),
        image_P_cam=frame.calibration.image_P_cam,
        lidar_center_cam=frame.calibration.lidar_center_cam,
        boxes_px=np.array([prompt.box_px for prompt in chosen], dtype=np.float64).reshape(-1, 4),
        score=np.array([prompt.score for prompt in chosen], dtype=np.float64),
        category=np.array([data.categories.index(prompt.category) for prompt in chosen], dtype=np.int64),
        targets=targets,
    )


def _read_cache(path: Path | None, key: str) -> dict[str, Targets]:
    if path is None or not path.exists():
        return {}
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
            if str(stored["key"]) != key:
                return {}
            columns = {each.name: stored[each.name] for each in fields(Targets)}
            names, ends = stored["names"].tolist(), stored["ends"].tolist()
    except (OSError, ValueError, KeyError, BadZipFile):
        return {}  # of another program, or damaged: made anew
    starts = [0, *ends[:-1]]
    return {
        name: Targets(**{column: values[start:end] for column, values in columns.items()})
        for name, start, end in zip(names, starts, ends, strict=True)
    }


def _write_cache(path: Path, key: str, known: dict[str, Targets]) -> None:
    if not known:
        return
    columns: dict[str, Any] = {
        each.name: np.concatenate([getattr(targets, each.name) for targets in known.values()])
        for each in fields(Targets)
    }
    ends = np.cumsum([len(targets.weight) for targets in known.values()])
    buffer = io.BytesIO()
    np.savez_compressed(buffer, key=np.array(key), names=np.array(list(known)), ends=ends, **columns)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())
