from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from boxlift.datasets import load_objects, open_source
from boxlift.errors import DatasetError
from boxlift.network.config import DataSettings, FrameSet
from boxlift.network.targets import POINTS
from boxlift.network.training_frames import TrainingFrame, load_frames, load_judged
from model.network.generated_data import write_frames


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_frames(tmp_path_factory.mktemp("generated"))


def _frames(dataset: Path, targets: str, cache: Path | None = None, **changes: object) -> list[TrainingFrame]:
    sets = (FrameSet.model_validate({"source": dataset, **changes}),)
    return load_frames(sets, DataSettings.model_validate({"targets": targets}), cache)


def test_points_lie_on_their_objects(dataset: Path) -> None:
    for frame in _frames(dataset, "points"):
        targets = frame.targets
        assert targets.points_cam.shape == (len(frame.boxes_px), POINTS, 3)
        assert (targets.weight == (targets.point_count > 0)).all()
        for row in np.flatnonzero(targets.weight):
            points = targets.points_cam[row, : targets.point_count[row]]
            image = points @ frame.image_P_cam[:, :3].T + frame.image_P_cam[:, 3]
            pixels = image[:, :2] / image[:, 2:]
            x1, y1, x2, y2 = frame.boxes_px[row]
            assert ((pixels >= [x1, y1]) & (pixels <= [x2, y2])).all()
            assert -np.pi <= targets.heading[row] <= np.pi


@pytest.mark.parametrize("targets", ["paper", "accurate"])
def test_pseudo_labels_are_near_the_truth(dataset: Path, targets: str) -> None:
    frames = _frames(dataset, targets)
    drawn = {frame.name: frame.targets for frame in _frames(dataset, "label_2")}
    error = np.concatenate(
        [
            np.linalg.norm(frame.targets.center_cam - drawn[frame.name].center_cam, axis=1)[
                frame.targets.weight > 0
            ]
            for frame in frames
        ]
    )
    assert len(error) >= 3
    assert np.median(error) < 1.0
    assert all(((frame.targets.weight >= 0) & (frame.targets.weight <= 1)).all() for frame in frames)


def test_drawn_labels_are_read_only_where_they_are_asked_for(dataset: Path) -> None:
    source = open_source(dataset)
    for frame in _frames(dataset, "label_2"):
        cars = [label for label in load_objects("label_2", source, frame.name) if label.category == "Car"]
        assert (frame.targets.weight == 1).all()
        np.testing.assert_allclose(frame.targets.size_m[:, 0], [car.size_hwl_m[2] for car in cars])
    # Without its labels a frame trains on points all the same.
    assert _frames(dataset, "points", labels="nowhere")
    with pytest.raises(DatasetError, match="nowhere"):
        _frames(dataset, "label_2", labels="nowhere")


def test_targets_are_kept(dataset: Path, tmp_path: Path) -> None:
    cache = tmp_path / "targets.npz"
    first = _frames(dataset, "points", cache)
    written = cache.read_bytes()
    again = _frames(dataset, "points", cache)
    for one, other in zip(first, again, strict=True):
        for name in vars(one.targets):
            np.testing.assert_array_equal(getattr(one.targets, name), getattr(other.targets, name))
    assert cache.read_bytes() == written
    # Another question, or a damaged file, is answered anew.
    assert (_frames(dataset, "label_2", cache)[0].targets.point_count == 0).all()
    cache.write_bytes(written[:100])
    assert (_frames(dataset, "points", cache)[0].targets.point_count > 0).any()


def test_frames_and_scores_choose(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "one.txt").write_text("000001\n")
    (frame,) = _frames(dataset, "points", frames=tmp_path / "one.txt")
    assert frame.name == "000001"
    (tmp_path / "none.txt").write_text("000009\n")
    with pytest.raises(DatasetError, match="000009"):
        _frames(dataset, "points", frames=tmp_path / "none.txt")


def test_judged_frames_bring_their_truth(dataset: Path) -> None:
    judged = load_judged((FrameSet(source=dataset),), DataSettings())
    assert [each.frame.name for each in judged] == ["000000", "000001"]
    assert all(each.truth and not each.frame.targets.weight.any() for each in judged)
