"""Label sets and data sets in an object store, against a server that speaks S3."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from boxlift.datasets import open_source
from boxlift.errors import DatasetError, OptionsError
from boxlift.formats.argoverse2_boxes import read_boxes
from boxlift.storage import names_in, open_path, write_whole, writing_whole
from boxlift_client import LabelJob, Outcome, label_dataset
from boxlift_client.convert import Format, convert
from boxlift_client.engines.local import LocalEngine
from boxlift_client.ledger import read_rows
from clients.command import Boxlift
from clients.inline_engine import InlineEngine
from clients.label_sets import files_of
from clients.s3_server import BUCKET, running_s3

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

NAMES = ["000000", "000001", "000002"]


class Server:
    """The server's requests, from its log."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._read = 0

    def requests(self) -> list[str]:
        """METHOD /path of those since the last call."""
        lines = self._log.read_text().splitlines()[self._read :]
        self._read += len(lines)
        return [" ".join(found) for line in lines for found in re.findall(r'"([A-Z]+) (\S+) HTTP', line)]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    log = tmp_path_factory.mktemp("s3") / "log"
    with running_s3(log):
        yield Server(log)


@pytest.fixture(scope="module")
def there(server: Server, dataset: Path) -> AnyPath:  # noqa: ARG001 - it must run
    """The generated data set, in the bucket."""
    root = open_path(f"s3://{BUCKET}/kitti")
    for path in dataset.rglob("*"):
        if path.is_file():
            write_whole(root / path.relative_to(dataset).as_posix(), path.read_bytes())
    return root


def test_from_bucket_to_bucket_as_from_folder_to_folder(
    boxlift: Boxlift, dataset: Path, there: AnyPath, server: Server, tmp_path: Path
) -> None:
    label_dataset(LabelJob(dataset, tmp_path / "here", "label_2"), LocalEngine(1))
    server.requests()
    out = f"s3://{BUCKET}/labels"
    ran = boxlift("label", there, "--out", out, "--prompts", "label_2", "--workers", 1)
    assert (ran.status, ran.err) == (0, "")
    asked = server.requests()
    here = files_of(tmp_path / "here")
    del here["manifest.json"]  # it names the source
    assert {name: (open_path(out) / name).read_bytes() for name in here} == here
    assert [row.frame for row in read_rows(open_path(out) / "ledger")] == NAMES
    for name in NAMES:
        for file in (f"data/{name}.txt", f"details/{name}.json"):
            assert [line.split()[0] for line in asked if line.endswith(f"/labels/{file}")] == ["PUT"]
        reads = [line for line in asked if "/kitti/training/" in line and f"/{name}." in line]
        # Points, calibration, image and prompts, each read once; nothing is asked for beside.
        assert {line.split()[0] for line in reads} == {"GET"}
        assert sorted(line.rsplit("/", 2)[1] for line in reads) == [
            "calib", "image_2", "label_2", "velodyne"
        ]  # fmt: skip
    # Of a million frames a listing takes minutes: the runner makes one, workers none.
    listings = [line for line in asked if "list-type" in line and "max-keys=1" not in line]
    for part in ("velodyne", "calib", "image_2"):
        assert sum(f"/{part}/" in line for line in listings) == 1

    idle = boxlift("label", there, "--out", out, "--prompts", "label_2")
    assert "3 frames of them before this run." in idle.out


def test_shards_meet_in_one_label_set(there: AnyPath) -> None:
    out = open_path(f"s3://{BUCKET}/shared")
    job = LabelJob(there, out, "label_2")
    label_dataset(job, InlineEngine(), NAMES[:2])
    other = pickle.loads(pickle.dumps(job))
    assert label_dataset(other, InlineEngine()).frames == {Outcome.LABELLED: 3}
    with pytest.raises(OptionsError, match="made otherwise"):
        label_dataset(job, InlineEngine(version="9"))


def test_converted_from_bucket_to_bucket(dataset: Path, server: Server, tmp_path: Path) -> None:  # noqa: ARG001
    """One file that is written bit by bit, and a folder of files."""
    labels = open_path(f"s3://{BUCKET}/to-convert")
    label_dataset(LabelJob(dataset, labels, "label_2"), LocalEngine(1))
    table = open_path(f"s3://{BUCKET}/converted/labels.parquet")
    done = convert(labels, Format.ARGOVERSE2, table)
    assert done.boxes == sum(len(sweep.objects) for sweep in read_boxes(table)) > 0
    convert(labels, Format.OPENLABEL, table.parent / "openlabel")
    assert sorted(names_in(table.parent / "openlabel")) == [f"{name}.json" for name in NAMES]
    with suppress(RuntimeError), writing_whole(table) as file:
        file.write(b"half a file")
        raise RuntimeError
    assert len(read_boxes(table)) == len(NAMES)


def test_what_vanishes_is_told_and_costs_no_other(there: AnyPath) -> None:
    gone = there / "training" / "velodyne" / "000001.bin"
    source = open_source(there)
    assert list(source.names) == NAMES
    points = gone.read_bytes()
    gone.unlink()
    try:
        summary = label_dataset(
            LabelJob(there, open_path(f"s3://{BUCKET}/gone"), "label_2"), InlineEngine(), NAMES
        )
    finally:
        write_whole(gone, points)
    assert summary.frames == {Outcome.LABELLED: 2, Outcome.SKIPPED: 1}
    with pytest.raises(DatasetError, match=r"s3://fleet/nothing: the folder does not exist"):
        open_source(open_path(f"s3://{BUCKET}/nothing"))


def test_a_bucket_that_is_not_there(boxlift: Boxlift, dataset: Path, server: Server) -> None:  # noqa: ARG001
    ran = boxlift("label", dataset, "--out", "s3://no-such-bucket/x", "--prompts", "label_2")
    assert ran.status == 2
    assert ran.err.startswith("error: out: 's3://no-such-bucket/x' cannot be written")


def test_nobody_answers() -> None:
    """In a process of its own: s3fs keeps its connections, and looks at the environment once."""
    environment = {
        **os.environ,
        "AWS_ENDPOINT_URL": "http://127.0.0.1:9",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_MAX_ATTEMPTS": "1",
    }
    command = [str(Path(sys.executable).with_name("boxlift")), "label", "s3://nobody/x", "--out", "y"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)
    assert ran.returncode == 2
    assert ran.stderr.startswith("error: path: 's3://nobody/x' cannot be reached")


def test_other_protocols(tmp_path: Path) -> None:
    assert open_path(f"file://{tmp_path}") == tmp_path
    with pytest.raises(OptionsError, match=r"'ftpx://a/b' names a protocol that is not known"):
        open_path("ftpx://a/b")
    with pytest.raises(OptionsError, match=r"'gs://a/b' needs a library\. .*gcsfs"):
        open_path("gs://a/b")
