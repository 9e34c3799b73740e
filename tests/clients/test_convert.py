"""Labels in other formats say the same: read back by their own libraries, schemas or readers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boxlift.datasets import open_source
from boxlift.errors import BoxliftError, DatasetError, OptionsError
from boxlift.formats import argoverse2_boxes, kitti_label
from boxlift.formats.nuscenes_boxes import NuscenesBoxes
from boxlift.formats.point_cloud import read_points
from boxlift.label_sets.index import read_sweeps_of
from boxlift.poses import rotation_of
from boxlift.sweep import EgoObject, SweepLabels
from boxlift_client.convert import Format, convert
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import LabelJob
from boxlift_client.runner import label_dataset
from clients.command import Boxlift
from model.datasets.nuscenes_files import SAMPLE, write_nuscenes
from model.datasets.town import pinhole_town
from model.datasets.vehicle import WORLD_SE3_EGO, objects_ego


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("nuscenes")
    write_nuscenes(root, pinhole_town())
    return root


@pytest.fixture(scope="module")
def label_set(data_set: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both cameras of a sample, labelled from its annotations."""
    out = tmp_path_factory.mktemp("labels")
    summary = label_dataset(LabelJob(data_set, out, prompts="annotations"), LocalEngine(1))
    assert summary.counted == 2
    return out


@pytest.fixture(scope="module")
def sweep(label_set: Path) -> SweepLabels:
    (labels,) = read_sweeps_of(label_set)
    return labels


def test_labels_of_two_cameras_are_the_truth_each_once(sweep: SweepLabels) -> None:
    """From annotations to merged labels in the ego frame: whatever is wrong on the way shows here."""
    centers = np.array([each.center_ego for each in sweep.objects])
    found = 0
    for true in objects_ego(pinhole_town()):
        near = np.linalg.norm(centers[:, :2] - true.center_ego[:2], axis=1) < 0.7
        assert near.sum() <= 1
        found += int(near.sum())
    assert found >= 7
    assert any(len(each.cameras) == 2 for each in sweep.objects)


def require_same(found: list[EgoObject], expected: SweepLabels, within: float = 1e-5) -> None:
    assert len(found) == len(expected.objects)
    for each, other in zip(found, expected.objects, strict=True):
        assert np.allclose(each.center_ego, other.center_ego, atol=within)
        assert np.allclose(each.ego_SO3_object, other.ego_SO3_object, atol=within)
        sizes = [(item.length_m, item.width_m, item.height_m) for item in (each, other)]
        assert sizes[0] == pytest.approx(sizes[1], abs=within)
        assert each.score == pytest.approx(other.score, abs=within)


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_argoverse2(label_set: Path, sweep: SweepLabels, tmp_path: Path, suffix: str) -> None:
    done = convert(label_set, Format.ARGOVERSE2, tmp_path / f"labels{suffix}")
    assert (done.units, done.boxes) == (1, len(sweep.objects))
    (found,) = argoverse2_boxes.read_boxes(tmp_path / f"labels{suffix}")
    assert (found.sweep, found.log, found.timestamp_ns) == (SAMPLE, "scene-0061", sweep.timestamp_ns)
    require_same(list(found.objects), sweep)
    assert {each.category for each in found.objects} <= {"REGULAR_VEHICLE", "TRUCK", "PEDESTRIAN", "BICYCLE"}
    assert [each.points for each in found.objects] == [each.points for each in sweep.objects]


def test_nuscenes(label_set: Path, sweep: SweepLabels, tmp_path: Path) -> None:
    convert(label_set, Format.NUSCENES, tmp_path / "results.json")
    (found,) = NuscenesBoxes(tmp_path / "results.json").sweeps({SAMPLE: WORLD_SE3_EGO})
    require_same(list(found.objects), sweep)
    content = json.loads((tmp_path / "results.json").read_text())
    assert set(content["meta"]) == {"use_camera", "use_lidar", "use_radar", "use_map", "use_external"}


def test_kitti(label_set: Path, tmp_path: Path) -> None:
    done = convert(label_set, Format.KITTI, tmp_path / "label_2", min_score=0.5)
    kept = 0
    for name in (f"{SAMPLE}_CAM_FRONT", f"{SAMPLE}_CAM_FRONT_LEFT"):
        ours = kitti_label.read_file(label_set / "data" / f"{name}.txt")
        theirs = kitti_label.read_file(tmp_path / "label_2" / f"{name}.txt")
        expected = [
            replace(each, score=None) for each in ours if each.score is not None and each.score >= 0.5
        ]
        assert theirs == expected
        kept += len(expected)
    assert (done.units, done.boxes) == (2, kept)


def test_openlabel(label_set: Path, sweep: SweepLabels, tmp_path: Path) -> None:
    from kognic.openlabel.models import OpenLabelAnnotation

    convert(label_set, Format.OPENLABEL, tmp_path)
    text = (tmp_path / "scene-0061.json").read_text()
    content = OpenLabelAnnotation.model_validate_json(text).openlabel
    (frame,) = content.frames.values()
    found = []
    for number, item in frame.objects.items():
        (cuboid,) = item.object_data.cuboid
        x, y, z, qx, qy, qz, qw, *sizes = cuboid.val
        scores = {each.name: each.val for each in cuboid.attributes.num}
        rotation = rotation_of(np.array([[qw, qx, qy, qz]]))[0]
        kind = content.objects[number].type
        length, width, height = sizes
        center = np.array([x, y, z])
        found.append(EgoObject(kind, center, rotation, length, width, height, scores["score"]))
    require_same(found, sweep)
    assert [each.category for each in found] == [each.category for each in sweep.objects]
    matrix = frame.frame_properties.transforms["ego_to_world"].transform_src_to_dst.root.matrix4x4
    assert np.allclose(np.array(matrix).reshape(4, 4), WORLD_SE3_EGO, atol=1e-6)
    assert frame.frame_properties.external_id == SAMPLE


def test_supervisely(label_set: Path, data_set: Path, sweep: SweepLabels, tmp_path: Path) -> None:
    done = convert(label_set, Format.SUPERVISELY, tmp_path, source=data_set)
    assert done.without_sensors == 0
    name = f"scene-0061_{SAMPLE}"
    content = json.loads((tmp_path / "ds0" / "ann" / f"{name}.pcd.json").read_text())
    classes = {each["key"]: each["classTitle"] for each in content["objects"]}
    scores = {each["key"]: each["tags"][0]["value"] for each in content["objects"]}
    found = []
    for figure in content["figures"]:
        parts = (figure["geometry"][part] for part in ("position", "rotation", "dimensions"))
        place, turn, sizes = ([part[axis] for axis in "xyz"] for part in parts)
        yaw = turn[2]
        rotation = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        key = figure["objectKey"]
        length, width, height = sizes
        found.append(EgoObject(classes[key], np.array(place), rotation, length, width, height, scores[key]))
    # Boxes lean with their camera by a fraction of a degree; a Supervisely cuboid stands upright.
    require_same(found, sweep, within=0.02)
    points = read_points(tmp_path / "ds0" / "pointcloud" / f"{name}.pcd").points
    assert len(points) == len(pinhole_town().points_velo)
    meta = json.loads((tmp_path / "meta.json").read_text())
    assert {each["title"] for each in meta["classes"]} == {each.category for each in sweep.objects}
    camera = json.loads(
        (tmp_path / "ds0" / "related_images" / f"{name}_pcd" / "CAM_FRONT.png.json").read_text()
    )["meta"]["sensorsData"]
    extrinsic = np.array(camera["extrinsicMatrix"]).reshape(3, 4)
    intrinsic = np.array(camera["intrinsicMatrix"]).reshape(3, 3)
    # A point goes where the frame's own calibration puts it.
    frame = open_source(data_set).load(f"{SAMPLE}_CAM_FRONT")
    ahead = frame.calibration.velo_to_cam(frame.points_velo)[:, 2] > 5
    expected, _ = frame.calibration.project(frame.calibration.velo_to_cam(frame.points_velo[ahead]))
    in_camera = points[ahead] @ extrinsic[:, :3].T + extrinsic[:, 3]
    image = in_camera @ intrinsic.T
    assert np.allclose(image[:, :2] / image[:, 2:], expected, atol=0.05)


def test_mcap(label_set: Path, data_set: Path, sweep: SweepLabels, tmp_path: Path) -> None:
    """Read back by MCAP's own library; and points and images by our reader of recordings."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    done = convert(label_set, Format.MCAP, tmp_path, source=data_set)
    assert (done.units, done.boxes) == (1, len(sweep.objects))
    path = tmp_path / "scene-0061.mcap"
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        (update,) = [each[3] for each in reader.iter_decoded_messages(["/boxlift/labels"])]
    (entity,) = update.entities
    assert entity.frame_id == "base_link"
    found = []
    for cube, text in zip(entity.cubes, entity.texts, strict=True):
        place, turn, size = cube.pose.position, cube.pose.orientation, cube.size
        rotation = rotation_of(np.array([[turn.w, turn.x, turn.y, turn.z]]))[0]
        category, score = text.text.split()
        center = np.array([place.x, place.y, place.z])
        found.append(EgoObject(category, center, rotation, size.x, size.y, size.z, score=float(score)))
    require_same(found, sweep, within=0.006)  # the text has two decimals of the score
    source = open_source(path)
    assert len(source.names) == 2
    frame = source.load(source.names[0], with_image=True)
    original = open_source(data_set).load(f"{SAMPLE}_CAM_FRONT", with_image=True)
    assert np.array_equal(frame.image, original.image)  # type: ignore[arg-type]
    here = frame.calibration.velo_to_cam(frame.points_velo)
    there = original.calibration.velo_to_cam(original.points_velo)
    assert np.allclose(here, there, atol=1e-3)


_BOXES3D = ("centers", "half_sizes", "quaternions", "labels")


def test_rerun(label_set: Path, data_set: Path, sweep: SweepLabels, tmp_path: Path) -> None:
    """Read back by Rerun's own reader."""
    from rerun.chunk import RrdReader

    done = convert(label_set, Format.RERUN, tmp_path, source=data_set)
    assert done.boxes == len(sweep.objects)
    path = tmp_path / "scene-0061.rrd"
    chunks = {str(each.entity_path): each.to_record_batch() for each in RrdReader(path).stream()}
    assert {"/ego/points", "/ego/CAM_FRONT", "/ego/CAM_FRONT_LEFT"} <= chunks.keys()
    boxes = {name: chunks["/ego/labels"].column(f"Boxes3D:{name}")[0].as_py() for name in _BOXES3D}
    quaternions = np.array(boxes["quaternions"])[:, [3, 0, 1, 2]]
    found = []
    for place, rotation, halves, text in zip(
        boxes["centers"], rotation_of(quaternions), boxes["half_sizes"], boxes["labels"], strict=True
    ):
        category, score = text.split()
        length, width, height = (2 * half for half in halves)
        found.append(EgoObject(category, np.array(place), rotation, length, width, height, float(score)))
    require_same(found, sweep, within=0.006)


def test_low_scores_are_left_out(label_set: Path, sweep: SweepLabels, tmp_path: Path) -> None:
    limit = sorted(each.score for each in sweep.objects)[1]
    done = convert(label_set, Format.ARGOVERSE2, tmp_path / "a.parquet", min_score=limit)
    assert done.boxes == sum(each.score >= limit for each in sweep.objects) < len(sweep.objects)


def test_a_source_that_lost_files_costs_no_label(label_set: Path, tmp_path: Path) -> None:
    root = tmp_path / "data"
    write_nuscenes(root, pinhole_town())
    next((root / "samples" / "LIDAR_TOP").iterdir()).unlink()
    done = convert(label_set, Format.MCAP, tmp_path / "out", source=root)
    assert (done.without_sensors, done.units) == (1, 1)
    assert done.boxes > 0


def test_classes_that_nuscenes_lacks_are_told(label_set: Path, tmp_path: Path) -> None:
    changed = tmp_path / "labels"
    (changed / "details").mkdir(parents=True)
    for path in (label_set / "details").iterdir():
        text = path.read_text().replace('"class": "Car"', '"class": "Tram"')
        (changed / "details" / path.name).write_text(text)
    done = convert(changed, Format.NUSCENES, tmp_path / "results.json")
    assert done.left_out["Tram"] > 0


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda there: (there, Format.ARGOVERSE2, there / "x.csv"), OptionsError, r"\.parquet or \.feather"),
        (lambda there: (there, Format.NUSCENES, there / "x"), OptionsError, r"\.json"),
        (lambda there: (there, Format.MCAP, there / "manifest.json"), OptionsError, "is a file"),
        (lambda there: (there, Format.KITTI, there / "data"), OptionsError, "own"),
        (lambda there: (there / "data", Format.MCAP, there / "x"), DatasetError, "no label set"),
    ],
)
def test_what_does_not_fit_is_refused(
    label_set: Path,
    make: Callable[[Path], tuple[Path, Format, Path]],
    error: type[BoxliftError],
    words: str,
) -> None:
    labels, to, out = make(label_set)
    with pytest.raises(error, match=words):
        convert(labels, to, out)


def test_a_source_is_refused_where_it_is_of_no_use(label_set: Path, data_set: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="no points"):
        convert(label_set, Format.KITTI, tmp_path, source=data_set)


def test_labels_without_poses_cannot_be_nuscenes_results(label_set: Path, tmp_path: Path) -> None:
    changed = tmp_path / "labels"
    (changed / "details").mkdir(parents=True)
    for path in (label_set / "details").iterdir():
        content = json.loads(path.read_text())
        content["view"]["world_SE3_ego"] = None
        (changed / "details" / path.name).write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="where the vehicle was"):
        convert(changed, Format.NUSCENES, tmp_path / "results.json")
    assert not (tmp_path / "results.json").exists()


def test_the_command(label_set: Path, tmp_path: Path, boxlift: Boxlift) -> None:
    ended = boxlift("convert", label_set, "--to", "argoverse2", "--out", tmp_path / "labels.parquet")
    assert ended.status == 0, ended.err
    assert "boxes of 1 sweep are in" in ended.out


def test_the_data_set_is_the_truth_that_its_labels_are_judged_by(
    label_set: Path, data_set: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    """The label set itself, and its results file, get the same numbers by nuScenes' rules."""
    convert(label_set, Format.NUSCENES, tmp_path / "results.json")
    cars = []
    for pred in (label_set, tmp_path / "results.json"):
        judged = boxlift("evaluate", "--metric", "nuscenes", "--gt", data_set, "--pred", pred, "--json")
        assert judged.status == 0, judged.err
        cars.append(json.loads(judged.out)["results"]["car"])
    assert cars[0]["ap"] > 50
    assert cars[0]["ap"] == pytest.approx(cars[1]["ap"], abs=1e-3)
