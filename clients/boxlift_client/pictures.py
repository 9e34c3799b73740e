"""Pictures of frames and their labels, as files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boxlift.datasets import load_objects, load_prompts, open_source
from boxlift.drawing import draw_frame, draw_objects
from boxlift.errors import DatasetError, MissingExtraError, OptionsError
from boxlift.formats import kitti_label
from boxlift.formats.ego_boxes import sweep_labels_of_details
from boxlift.formats.kitti_label import KittiObject
from boxlift.label_sets.files import data_path, details_path, read_objects
from boxlift.label_sets.index import read_details
from boxlift.settings import LabellerSettings
from boxlift_client.job import DETECTOR
from boxlift_client.sensors import sensors_of

Picture = NDArray[np.uint8]


def draw_labels_on_disk(source: Path, name: str, pred: Path, gt: str | None = None) -> Picture:
    """(H, W, 3) RGB: a frame with the boxes of `pred` (its folder, or its data/) and the truth of `gt`.

    Prompts that got no box are drawn too where `pred` has details. Raises InputError where a file is
    missing or cannot be read.
    """
    folder = open_source(source)
    truth = load_objects(gt, folder, name) if gt else []
    frame = folder.load(name, with_image=True)
    return draw_objects(frame, _objects_on_disk(pred, name), truth)


def _objects_on_disk(pred: Path, name: str) -> list[KittiObject]:
    if pred.name == "data" and not (pred / "data").is_dir():
        pred = pred.parent
    details = details_path(pred, name)
    if details.is_file():
        return read_objects(details)
    labels = data_path(pred, name) if (pred / "data").is_dir() else pred / f"{name}.txt"
    if not labels.is_file():
        raise DatasetError(str(labels), f"frame {name!r} has no labels there.", "Label it first.")
    return kitti_label.read_file(labels)


def draw_new_labels(
    source: Path,
    name: str,
    prompts: str | None,
    gt: str | None,
    settings: LabellerSettings,
    detector: Path | None = None,
) -> Picture:
    """(H, W, 3) RGB: a frame, labelled here with `prompts` where they are given, and the truth of `gt`.

    prompts and detector: as in a LabelJob. Raises InputError where a file is missing or cannot be read.
    """
    folder = open_source(source)
    truth = load_objects(gt, folder, name) if gt else []
    if prompts is None:
        return draw_frame(folder.load(name, with_image=True), None, truth)
    from boxlift.labeller import Labeller

    frame = folder.load(name, with_image=True)
    if prompts == DETECTOR:
        from boxlift.detector import Detector, find_prompts

        frame = find_prompts(frame, Detector.open(detector), settings.detection)
    else:
        frame = replace(frame, prompts=load_prompts(prompts, folder, name))
    return draw_frame(frame, Labeller(settings).label(frame), truth)


def write_frame_recording(path: Path, source: Path, name: str, pred: Path) -> None:
    """One frame with the boxes of the label set `pred` as a recording of Rerun, with points and image.

    Raises InputError where a file is missing or cannot be read, MissingExtraError without rerun-sdk.
    """
    if path.suffix != ".rrd":
        raise OptionsError("out", f"{path.name!r} is no recording's name.", "Give a name that ends in .rrd.")
    from boxlift.formats.rerun_recording import write_recording

    details = read_details(details_path(pred, name))
    sensors = sensors_of(open_source(source), [name])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_recording([(sweep_labels_of_details(details), sensors)], path, name)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a PNG (or what the suffix says). Raises OptionsError for a suffix that is no picture's."""
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise MissingExtraError("pillow", "client") from None
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise OptionsError("out", f"{path.name!r} is no picture's name.", "Give a name that ends in .png.")
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(path)
