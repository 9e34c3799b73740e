"""docker/clusters: valid by their schemas, and commands that the command line understands."""

from __future__ import annotations

import re
import shlex
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest

from boxlift.datasets.generated import generate, write_dataset
from boxlift_client.cli import app
from boxlift_client.ledger import read_ledger
from boxlift_client.shard import parse_shard
from docker.files import DOCKER, ROOT, yaml_documents

_CLUSTERS = DOCKER / "clusters"
_VERSIONS = ("1.31", "1.37")


def document(name: str) -> dict[str, Any]:
    (content,) = yaml_documents(_CLUSTERS / name)
    assert isinstance(content, dict)
    return content


def pods() -> list[tuple[str, dict[str, Any]]]:
    ray = document("ray-job.yaml")["spec"]["rayClusterSpec"]
    workers = [(group["groupName"], group["template"]) for group in ray["workerGroupSpecs"]]
    return [("head", ray["headGroupSpec"]["template"]), *workers]


def options_of(command: list[str]) -> set[str]:
    """The options of a `boxlift label` command, after asking that it is one."""
    assert command[:2] == ["boxlift", "label"]
    return {word.split("=")[0] for word in command if word.startswith("--")}


def known_options() -> set[str]:
    import typer.main

    label = typer.main.get_command(app).commands["label"]  # type: ignore[attr-defined]
    return {name for parameter in label.params for name in parameter.opts}


@pytest.mark.parametrize("version", _VERSIONS)
def test_the_indexed_job_is_valid_by_the_strict_schema(version: str) -> None:
    assert kubernetes_validate.validate(document("indexed-job.yaml"), version, strict=True) == version


def test_the_indexed_job_labels_every_part_once() -> None:
    spec = document("indexed-job.yaml")["spec"]
    (container,) = spec["template"]["spec"]["containers"]
    command = container["args"]
    assert options_of(command) <= known_options()
    (shard,) = [word.removeprefix("--shard=") for word in command if word.startswith("--shard=")]
    count = spec["completions"]
    parts = [parse_shard(shard, {"JOB_COMPLETION_INDEX": str(index)}) for index in range(count)]
    assert [part.index for part in parts] == list(range(count))
    assert {part.count for part in parts} == {count}
    (workers,) = [word.removeprefix("--workers=") for word in command if word.startswith("--workers=")]
    assert workers == container["resources"]["requests"]["cpu"]
    rules = spec["podFailurePolicy"]["rules"]
    assert all(
        rule["onExitCodes"]["containerName"] == container["name"] for rule in rules if "onExitCodes" in rule
    )


@pytest.mark.parametrize(("name", "template"), pods())
def test_pods_of_the_ray_job_are_valid_by_the_strict_schema(name: str, template: dict[str, Any]) -> None:
    """KubeRay's own schema is not among Kubernetes'; of a RayJob the pods are what it knows."""
    pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name}, **template}
    assert kubernetes_validate.validate(pod, _VERSIONS[-1], strict=True) == _VERSIONS[-1]


def test_the_ray_job_runs_the_command_line_with_the_pinned_ray() -> None:
    spec = document("ray-job.yaml")["spec"]
    assert options_of(shlex.split(spec["entrypoint"])) <= known_options()
    pinned = re.search(r"^ray==(.+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert pinned is not None
    assert spec["rayClusterSpec"]["rayVersion"] == pinned[1]


def test_extras_that_the_manifests_ask_for_exist() -> None:
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    asked = [
        extra
        for path in _CLUSTERS.glob("*.yaml")
        for words in re.findall(r'EXTRAS="([^"]+)"', path.read_text())
        for extra in words.split()
    ]
    assert asked
    assert set(asked) <= set(extras)


def test_the_tasks_of_an_array_make_one_label_set(tmp_path: Path) -> None:
    """The script itself, as SLURM would run it: two tasks of an array that begins at 3."""
    write_dataset(tmp_path / "data", (generate(seed) for seed in range(3)))
    script = _CLUSTERS / "array.sbatch"
    assert script.stat().st_mode & stat.S_IRUSR
    for task in (3, 4):
        environment = {
            "PATH": "/usr/bin:/bin",
            "BOXLIFT": str(Path(sys.executable).with_name("boxlift")),
            "DATASET": str(tmp_path / "data"),
            "LABELS": str(tmp_path / "labels"),
            "OPTIONS": "--prompts label_2",
            "SLURM_ARRAY_TASK_ID": str(task),
            "SLURM_ARRAY_TASK_COUNT": "2",
            "SLURM_ARRAY_TASK_MIN": "3",
            "SLURM_CPUS_PER_TASK": "1",
        }
        ran = subprocess.run(
            ["bash", str(script)], env=environment, capture_output=True, text=True, check=False, timeout=120
        )
        assert ran.returncode == 0, ran.stderr
    assert len(read_ledger(tmp_path / "labels" / "ledger").done) == 3


def test_an_array_without_a_data_set_says_so() -> None:
    ran = subprocess.run(
        ["bash", str(_CLUSTERS / "array.sbatch")],
        env={"PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode != 0
    assert "name the data set" in ran.stderr
