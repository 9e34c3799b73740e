"""What the review page asks for, asked without a page."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boxlift.corrections.store import FILE_NAME
from boxlift.datasets import open_source
from boxlift.label_sets.index import read_details
from boxlift_service.guards.api_keys import add_key, new_key
from boxlift_service.problems import ProblemDetails
from service.frames import SmallFrame
from service.review.label_sets import ACCEPTED, REJECTED, correct, drop
from service.running import RunningService, running_service

SET = "labels/dropped"


def test_a_dropped_frame_is_a_label_set_and_a_data_set(
    reviewed: RunningService, folder: Path, frame: SmallFrame
) -> None:
    assert drop(reviewed, frame, "first") == {"label_set": SET, "frame": "first"}
    assert SET in reviewed.client.get("/review/label-sets").json()["label_sets"]
    queue = reviewed.client.get("/review/queue", params={"set": SET}).json()
    entry = next(each for each in queue["entries"] if each["frame"] == "first")
    assert (entry["category"], entry["has_box"]) == ("Car", True)
    answer = reviewed.client.get("/review/frame", params={"set": SET, "frame": "first"}).json()
    assert answer["image_size"] == [1200, 360]
    (item,) = answer["details"]["objects"]
    assert item["box"]["center_cam"][2] == pytest.approx(17, abs=1)
    assert read_details(folder / "dropped" / "details" / "first.json").objects[0].index == 0
    assert open_source(folder / "dropped" / "frames").names[0] == "first"


def test_points_come_in_the_camera_frame(reviewed: RunningService, frame: SmallFrame) -> None:
    drop(reviewed, frame, "points")
    answer = reviewed.client.get("/review/points", params={"set": SET, "frame": "points"})
    points = np.frombuffer(answer.content, "<f4").reshape(-1, 3)
    x, y, z = frame.points_velo[0]
    assert len(points) == len(frame.points_velo)
    np.testing.assert_allclose(points[0], [-y, -z, x], atol=1e-5)
    image = reviewed.client.get("/review/image", params={"set": SET, "frame": "points"})
    assert image.content.startswith(b"\xff\xd8")


def test_another_frame_of_the_same_name_gets_another_one(reviewed: RunningService, frame: SmallFrame) -> None:
    assert drop(reviewed, frame, "twice")["frame"] == "twice"
    assert drop(reviewed, frame, "twice")["frame"] == "twice"
    other = SmallFrame(frame.points_velo[:-1])
    assert drop(reviewed, other, "twice")["frame"] == "twice-2"


@pytest.mark.parametrize("name", ["../../up", ".hidden", "a/b", "ä ö"])
def test_no_file_name_leads_out_of_the_folder(
    reviewed: RunningService, folder: Path, frame: SmallFrame, name: str
) -> None:
    kept = drop(reviewed, frame, name)["frame"]
    assert (folder / "dropped" / "frames" / "velodyne" / f"{kept}.bin").is_file()
    assert {path.name for path in folder.iterdir()} == {"dropped"}


def test_a_frame_that_cannot_be_labelled_leaves_nothing(
    reviewed: RunningService, folder: Path, frame: SmallFrame
) -> None:
    fields = frame.fields(calib=b"P2: 1 2 3", image=None)
    fields["points"] = ("broken.bin", fields["points"][1])
    answer = reviewed.client.post("/review/frames", files=list(fields.items()))
    assert answer.status_code == 422
    assert not list(folder.rglob("broken*"))


def test_corrections_are_kept_beside_the_labels_and_change_no_label(
    reviewed: RunningService, folder: Path, frame: SmallFrame
) -> None:
    drop(reviewed, frame, "kept")
    details = (folder / "dropped" / "details" / "kept.json").read_bytes()
    kept = correct(reviewed.client, "kept", ACCEPTED)
    assert (kept.status_code, kept.json()["revision"], kept.json()["author"]) == (201, 1, "ann")
    assert (folder / "dropped" / FILE_NAME).is_file()
    assert (folder / "dropped" / "details" / "kept.json").read_bytes() == details
    answer = reviewed.client.get("/review/frame", params={"set": SET, "frame": "kept"}).json()
    assert answer["corrections"] == [kept.json()]
    left = reviewed.client.get("/review/queue", params={"set": SET}).json()["entries"]
    assert "kept" not in {entry["frame"] for entry in left}


def test_the_second_of_two_is_told_what_the_first_said(reviewed: RunningService, frame: SmallFrame) -> None:
    drop(reviewed, frame, "both")
    first = correct(reviewed.client, "both", ACCEPTED)
    second = correct(reviewed.client, "both", REJECTED, author="bob")
    assert second.status_code == 409
    problem = ProblemDetails.model_validate_json(second.content)
    assert problem.field == "based_on"
    assert "ann" in problem.detail
    assert second.json()["latest"] == first.json()
    assert correct(reviewed.client, "both", REJECTED, based_on=1, author="bob").status_code == 201


def test_who_is_where_and_what_they_said(reviewed: RunningService, frame: SmallFrame) -> None:
    drop(reviewed, frame, "here")

    def beat(author: str, since: int = 0) -> dict[str, list[dict[str, object]]]:
        body = {
            "label_set": SET,
            "frame": "here",
            "session": f"session-{author}",
            "author": author,
            "since": since,
        }
        return dict(reviewed.client.post("/review/heartbeat", json=body).json())

    beat("ann")
    assert {"frame": "here", "author": "ann"} in beat("bob")["others"]
    said = correct(reviewed.client, "here", ACCEPTED).json()
    assert said in beat("bob")["corrections"]
    assert beat("bob", said["sequence"])["corrections"] == []


@pytest.mark.parametrize(
    ("path", "field"),
    [
        ("/review/queue", "set"),
        ("/review/queue?set=labels/nothing", "set"),
        ("/review/queue?set=..", "set"),
        ("/review/frame?set=labels/dropped", "frame"),
        ("/review/frame?set=labels/dropped&frame=nothing", "frame"),
        ("/review/points?set=labels/dropped&frame=../details/first", "frame"),
    ],
)
def test_what_is_not_there_is_named(
    reviewed: RunningService, frame: SmallFrame, path: str, field: str
) -> None:
    drop(reviewed, frame, "first")
    answer = reviewed.client.get(path)
    assert answer.status_code in (404, 422)
    assert ProblemDetails.model_validate_json(answer.content).field == field


def test_corrections_that_make_no_sense_are_refused(reviewed: RunningService, frame: SmallFrame) -> None:
    drop(reviewed, frame, "sense")
    changes: tuple[tuple[dict[str, Any], str], ...] = (
        ({"object_index": 7}, "object_index"),
        ({"opinion": {"verdict": "liked"}}, "opinion.verdict"),
        ({"based_on": -1}, "based_on"),
        ({"request_id": "x"}, "request_id"),
        ({"frame": "nothing"}, "frame"),
    )
    for change, field in changes:
        answer = correct(reviewed.client, **{"frame": "sense", "opinion": ACCEPTED, **change})
        assert answer.status_code in (404, 422), answer.text
        assert ProblemDetails.model_validate_json(answer.content).field == field


def test_where_keys_are_asked_for_the_key_says_who(tmp_path: Path, frame: SmallFrame) -> None:
    secret, key = new_key("studio")
    add_key(tmp_path / "keys", key)
    with running_service(label_sets=str(tmp_path / "labels"), api_keys=str(tmp_path / "keys")) as service:
        assert service.client.get("/").status_code == 200  # the page asks for the key
        assert service.client.get("/review/page.js").status_code == 200
        assert service.client.get("/review/label-sets").status_code == 401
        service.client.headers["Authorization"] = f"Bearer {secret}"
        drop(service, frame, "first")
        assert correct(service.client, "first", ACCEPTED).json()["author"] == "studio"


def test_nobodys_disk_is_written_to_beyond_loopback(frame: SmallFrame) -> None:
    with running_service(host="0.0.0.0", allow_anonymous="true") as service:
        url = service.url.replace("0.0.0.0", "127.0.0.1")
        answer = service.client.get(f"{url}/review/label-sets")
        assert answer.status_code == 404
        assert "--label-sets" in ProblemDetails.model_validate_json(answer.content).detail
        form = list(frame.fields().items())
        assert service.client.post(f"{url}/review/frames", files=form).status_code == 404


def test_confirmed_corrections_outlive_a_kill(tmp_path: Path, frame: SmallFrame) -> None:
    labels = str(tmp_path / "labels")
    with running_service(label_sets=labels) as service:
        drop(service, frame, "first")
        kept = [correct(service.client, "first", ACCEPTED, based_on=at).json() for at in range(5)]
        os.kill(service.process.pid, signal.SIGKILL)
        service.process.wait()
    with running_service(label_sets=labels) as service:
        assert service.client.get("/review/corrections", params={"set": SET}).json() == kept
