"""Argoverse 2 in its own layout, of a generated scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from boxlift.datasets import open_source
from boxlift.datasets.posed_source import PosedSource
from boxlift.errors import DatasetError, LabelFormatError, NoLidarError
from model.datasets.argoverse2_files import CAMERAS, LOG, SWEEP_NS, write_log
from model.datasets.town import pinhole_town, require_objects, require_same_view
from model.datasets.vehicle import WORLD_SE3_EGO, objects_ego


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("argoverse2")
    write_log(folder / "val" / LOG, pinhole_town())
    return folder


@pytest.mark.parametrize("camera", sorted(CAMERAS))
def test_each_camera_near_a_sweep_is_a_frame(root: Path, camera: str) -> None:
    source = open_source(root)
    assert source.layout == "Argoverse 2"
    assert source.names == tuple(f"{LOG}_{SWEEP_NS}_{name}" for name in sorted(CAMERAS.values()))
    frame = source.load(f"{LOG}_{SWEEP_NS}_{CAMERAS[camera]}", with_image=True)
    require_same_view(frame, pinhole_town().cameras[camera])
    assert frame.view is not None
    assert (frame.view.sweep, frame.view.log) == (str(SWEEP_NS), LOG)
    assert frame.view.world_SE3_ego is not None
    assert np.allclose(frame.view.world_SE3_ego, WORLD_SE3_EGO, atol=1e-9)


def test_a_split_and_a_log_are_data_sets_too(root: Path) -> None:
    names = open_source(root).names
    assert open_source(root / "val").names == names
    assert open_source(root / "val" / LOG).names == names


@pytest.mark.parametrize("camera", sorted(CAMERAS))
def test_annotations_are_prompts(root: Path, camera: str) -> None:
    found = open_source(root).objects("annotations", f"{LOG}_{SWEEP_NS}_{CAMERAS[camera]}")
    require_objects(found, pinhole_town().cameras[camera])
    assert {each.category for each in found} <= {"Car", "Truck", "Pedestrian", "Cyclist"}


def test_truth_is_that_of_the_sweep(root: Path) -> None:
    source = open_source(root)
    assert isinstance(source, PosedSource)
    (labels,) = source.sweeps("annotations")
    expected = objects_ego(pinhole_town())
    assert [each.track_id for each in labels.objects] == [f"track-{n}" for n in range(len(expected))]
    for found, true in zip(labels.objects, expected, strict=True):
        assert np.allclose(found.center_ego, true.center_ego, atol=1e-6)
        assert found.yaw_rad == pytest.approx(true.yaw_rad, abs=1e-6)


def test_what_is_missing_or_broken_is_named(tmp_path: Path) -> None:
    log = tmp_path / LOG
    write_log(log, pinhole_town())
    source, name = open_source(log), f"{LOG}_{SWEEP_NS}_ring_front_center"
    (log / "annotations.feather").unlink()
    with pytest.raises(DatasetError, match="no annotations"):
        source.objects("annotations", name)
    assert open_source(log).label_names == ()
    (log / "sensors" / "lidar" / f"{SWEEP_NS}.feather").unlink()
    with pytest.raises(NoLidarError, match="not there"):
        source.load(name)
    (log / "calibration" / "intrinsics.feather").write_bytes(b"no table")
    with pytest.raises(LabelFormatError, match=r"intrinsics\.feather"):
        open_source(log).shot(name)  # type: ignore[attr-defined]
    with pytest.raises(DatasetError, match="no frame"):
        source.load(f"{LOG}_{SWEEP_NS}_ring_rear_left")
