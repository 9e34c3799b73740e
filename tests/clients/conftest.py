"""A small generated dataset, the command line and the real service on a port of its own, for all tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from boxlift.datasets.generated import generate, write_dataset
from boxlift_client.cli import main
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import LabelJob
from boxlift_client.runner import label_dataset
from boxlift_client.service_process import running_service
from clients.command import Boxlift, Ran


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Root of three generated frames 000000 to 000002 in KITTI object layout. Copy it to change it."""
    root = tmp_path_factory.mktemp("dataset")
    write_dataset(root, (generate(seed) for seed in range(3)))
    return root


@pytest.fixture(scope="session")
def labelled(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The label set of these frames, prompts from their truth. Copy it to change it."""
    out = tmp_path_factory.mktemp("labelled") / "labels"
    label_dataset(LabelJob(dataset, out, "label_2"), LocalEngine(1))
    return out


@pytest.fixture
def boxlift(capfd: pytest.CaptureFixture[str]) -> Boxlift:
    """Runs `boxlift ARGUMENTS...`."""

    def run(*arguments: object) -> Ran:
        with pytest.raises(SystemExit) as exit_:
            main([str(argument) for argument in arguments])
        return Ran(exit_.value.code, *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def service_url() -> Iterator[str]:
    """Where the real service answers."""
    with running_service() as url:
        yield url


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    """As in every worker: threads of torch that wait for each other cost a busy machine seconds."""
    torch.set_num_threads(1)
