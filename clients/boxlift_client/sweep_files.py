"""Files of labels in the ego frame, of whatever format: truth and predictions to be judged together."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Literal

from boxlift.datasets import open_source
from boxlift.datasets.posed_source import PosedSource
from boxlift.errors import DatasetError, OptionsError
from boxlift.formats import argoverse2_boxes, kitti_label, tables
from boxlift.formats.ego_boxes import ego_objects_of_kitti
from boxlift.formats.nuscenes_boxes import NuscenesBoxes
from boxlift.label_sets.index import read_sweeps_of
from boxlift.storage import is_folder
from boxlift.sweep import SweepLabels

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_Kind = Literal["label set", "Argoverse 2", "nuScenes results", "data set", "KITTI"]
_ANNOTATIONS = "annotations.feather"


def read_truth_and_predictions(
    gt: AnyPath, pred: AnyPath, names: Collection[str] | None = None
) -> tuple[list[SweepLabels], list[SweepLabels]]:
    """Labels of both, in one and the same frame.

    Each is a label set of boxlift, an Argoverse 2 table (or a folder of logs with annotations.feather), a
    nuScenes results file, a data set with 3D annotations of its own, or a folder of KITTI text files, whose
    camera is taken for the ego frame; a label set beside KITTI files is read from its own. names: sweeps to
    keep, where not all.

    Raises DatasetError where there is nothing such, OptionsError where the frames cannot be the same,
    LabelFormatError for what cannot be read.
    """
    kinds = kind_of(gt), kind_of(pred)
    if "KITTI" in kinds:
        if not set(kinds) <= {"KITTI", "label set"}:
            other = next(each for each in kinds if each != "KITTI")
            raise OptionsError(
                "gt",
                f"one side is KITTI files, in the camera's frame, the other {other}, which is not.",
                "Judge KITTI files, or a label set, against KITTI files.",
            )
        truth, predictions = _read_kitti(gt), _read_kitti(pred)
    elif "nuScenes results" in kinds:
        truth, predictions = _read_with_poses(gt, pred, kinds)
    else:
        truth, predictions = _READERS[kinds[0]](gt), _READERS[kinds[1]](pred)
    if names is None:
        return truth, predictions
    chosen = set(names)
    kept = [each for each in truth if each.sweep in chosen]
    if missing := sorted(chosen - {each.sweep for each in kept}):
        raise DatasetError(
            str(gt),
            f"there is no sweep {missing[0]!r} ({len(missing)} are missing).",
            "Name sweeps of the truth.",
        )
    return kept, [each for each in predictions if each.sweep in chosen]


def kind_of(path: AnyPath) -> _Kind:
    """What a file or folder is. Raises DatasetError."""
    if path.is_file():
        if path.suffix == ".json":
            return "nuScenes results"
        if path.suffix in tables.SUFFIXES:
            return "Argoverse 2"
    elif is_folder(path):
        if is_folder(path / "details"):
            return "label set"
        if _tables(path):
            return "Argoverse 2"
        if _data_set(path) is not None:
            return "data set"
        if is_folder(path / "data") or next(iter(path.glob("*.txt")), None) is not None:
            return "KITTI"
    raise DatasetError(
        str(path),
        "there are no labels to judge." if path.exists() else "it is not there.",
        "Give a label set, an Argoverse 2 table, a nuScenes results file, a data set with annotations, or a "
        "folder of KITTI label files.",
    )


def _read_kitti(path: AnyPath) -> list[SweepLabels]:
    folder = path / "data" if is_folder(path / "data") else path
    return [
        SweepLabels(name, ego_objects_of_kitti(kitti_label.read_file(folder / f"{name}.txt")))
        for name in sorted(file.stem for file in folder.glob("*.txt"))
    ]


def _read_argoverse2(path: AnyPath) -> list[SweepLabels]:
    if path.is_file():
        return argoverse2_boxes.read_boxes(path)
    return [
        labels
        for table in _tables(path)
        for labels in argoverse2_boxes.read_boxes(
            table, table.parent.name if table.name == _ANNOTATIONS else ""
        )
    ]


def _tables(folder: AnyPath) -> list[AnyPath]:
    """The tables in a folder, else those of the logs in it."""
    own = sorted(each for each in folder.iterdir() if each.suffix in tables.SUFFIXES)
    return own or sorted(folder.glob(f"*/{_ANNOTATIONS}"))


def _read_label_set(path: AnyPath) -> list[SweepLabels]:
    return list(read_sweeps_of(path))


def _data_set(path: AnyPath) -> PosedSource | None:
    """A data set that has 3D annotations."""
    try:
        source = open_source(path)
    except DatasetError:
        return None
    return source if isinstance(source, PosedSource) and source.label_names else None


def _read_data_set(path: AnyPath) -> list[SweepLabels]:
    source = _data_set(path)
    assert source is not None
    # The first is of 3D boxes where there are several (Waymo's lidar_box before camera_box).
    return list(source.sweeps(source.label_names[0]))


def _read_with_poses(
    gt: AnyPath, pred: AnyPath, kinds: tuple[_Kind, _Kind]
) -> tuple[list[SweepLabels], list[SweepLabels]]:
    """At least one is of nuScenes, in the global frame: the other, or boxes of its own, know the poses."""
    paths = gt, pred
    files = {
        path: NuscenesBoxes(path)
        for path, kind in zip(paths, kinds, strict=True)
        if kind == "nuScenes results"
    }
    others = {
        path: _READERS[kind](path) for path, kind in zip(paths, kinds, strict=True) if path not in files
    }
    poses = {token: pose for each in files.values() for token, pose in each.positions().items()}
    for labels in others.values():
        poses |= {each.sweep: each.world_SE3_ego for each in labels if each.world_SE3_ego is not None}
    truth, predictions = (files[path].sweeps(poses) if path in files else others[path] for path in paths)
    return truth, predictions


_READERS: dict[_Kind, Callable[[AnyPath], list[SweepLabels]]] = {
    "label set": _read_label_set,
    "Argoverse 2": _read_argoverse2,
    "data set": _read_data_set,
    "KITTI": _read_kitti,
}
