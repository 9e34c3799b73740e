"""Trainings by name: the key `task` of a TOML file says which, the rest of the file is its settings."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from boxlift.errors import OptionsError
from boxlift.network.checkpoint import CHECKPOINT_NAME, read_checkpoint, write_atomically
from boxlift.network.config import LifterSettings, MonocularSettings, Settings
from boxlift.network.task import Task

_REMEDY = "boxlift train --keys lists every key."


@dataclass(frozen=True)
class TaskKind:
    """Settings of a training, and how to make the training from them and the run's folder (for caches).

    export writes what was trained as a file of boxlift.monocular.interface: from the settings, the model's
    state dict, the file's path and what its metadata say besides.
    """

    settings: type[Settings]
    make: Callable[[Any, Path], Task[Any]]
    export: Callable[[Any, dict[str, Any], Path, dict[str, str]], None] | None = None


def _monocular(settings: MonocularSettings, folder: Path) -> Task[Any]:
    from boxlift.network.monocular_task import MonocularTask

    return MonocularTask(settings, folder)


def _lifter(settings: LifterSettings, folder: Path) -> Task[Any]:
    from boxlift.network.lifter_task import LifterTask

    return LifterTask(settings, folder)


def _export_monocular(
    settings: MonocularSettings, states: dict[str, Any], path: Path, description: dict[str, str]
) -> None:
    from boxlift.network.monocular_task import build_network
    from boxlift.network.paper_graph import export_paper_network
    from boxlift.network.paper_head import PaperNetwork

    categories = settings.data.categories
    network = build_network(settings.model.model_copy(update={"weights": None}), len(categories))
    if not isinstance(network, PaperNetwork):
        raise OptionsError(
            "model.network", "a one_stage network lifts no given 2D boxes.", "Export a two_stage one."
        )
    network.load_state_dict(states)
    export_paper_network(network, categories, path, description)


def _export_lifter(
    settings: LifterSettings, states: dict[str, Any], path: Path, description: dict[str, str]
) -> None:
    from boxlift.network.lifter_task import build_lifter
    from boxlift.network.monocular_export import export_monocular, monocular_graph

    lifter = build_lifter(settings.model)
    lifter.load_state_dict(states)
    export_monocular(monocular_graph(lifter), path, path.with_stem(f"{path.stem}_small"), description)


SETTINGS_NAME = "settings.json"
TASKS: dict[str, TaskKind] = {
    "monocular": TaskKind(MonocularSettings, _monocular, _export_monocular),
    "lifter": TaskKind(LifterSettings, _lifter, _export_lifter),
}


@dataclass(frozen=True)
class TrainingConfig:
    """A TOML file that was read: the task's name and its settings, of the type that TASKS has for it.

    Every task's settings have a `trainer`.
    """

    name: str
    settings: Any
    fingerprint: str

    def make_task(self, folder: Path) -> Task[Any]:
        """The training that the file describes; the run's folder is told which it is."""
        described = {"task": self.name, "settings": self.settings.model_dump(mode="json")}
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / CHECKPOINT_NAME).exists():
            write_atomically(folder / SETTINGS_NAME, json.dumps(described, indent=1).encode())
        return TASKS[self.name].make(self.settings, folder)


def export_run(folder: Path, path: Path, description: dict[str, str]) -> None:
    """Write what a run has trained so far as an ONNX file.

    Raises OptionsError where the folder holds no run, or one whose network is no monocular model.
    """
    try:
        described = json.loads((folder / SETTINGS_NAME).read_text(encoding="utf-8"))
        kind = TASKS[described["task"]]
        settings = kind.settings.model_validate(described["settings"])
    except (OSError, ValueError, KeyError) as error:
        raise OptionsError(
            str(folder), f"the folder holds no run ({error!s:.120}).", "Name the folder of `boxlift train`."
        ) from None
    checkpoint = read_checkpoint(folder / CHECKPOINT_NAME)
    if checkpoint is None:
        raise OptionsError(str(folder), "the run has not ended an epoch yet.", "Train on.")
    if kind.export is None:
        raise OptionsError(str(folder), f"task {described['task']!r} has no export.", "Name another run.")
    kind.export(settings, checkpoint.model, path, description)


def keys_of(name: str) -> list[str]:
    """Every key of a task's TOML file, a line each: key = default, and what it is."""
    return _keys(TASKS[name].settings, "")


def _keys(settings: type[BaseModel], prefix: str) -> list[str]:
    lines = []
    for name, field in settings.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            lines += _keys(inner, f"{prefix}{name}.")
            continue
        items = [item for item in get_args(inner) if isinstance(item, type) and issubclass(item, BaseModel)]
        if items:
            lines += [f"[[{prefix}{name}]]  {field.description}", *_keys(items[0], f"  {prefix}{name}[].")]
            continue
        default = "(needed)" if field.is_required() else json.dumps(field.default, default=str)
        lines.append(f"{prefix}{name} = {'(none)' if default == 'null' else default}  {field.description}")
    return lines


def read_config(path: Path) -> TrainingConfig:
    """Read a TOML file; its paths are relative to its folder. Raises OptionsError that names the key."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise OptionsError(
            str(path), f"the file cannot be read ({error.strerror}).", "Check the path."
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise OptionsError(str(path), f"the file is not TOML ({error!s:.120}).", _REMEDY) from None
    fingerprint = _fingerprint(values)
    name = values.pop("task", "monocular")
    if name not in TASKS:
        raise OptionsError(
            f"{path.name}.task", f"{name!r:.60} is no task.", f"Choose one of {sorted(TASKS)}."
        )
    try:
        settings: Any = TASKS[name].settings.model_validate(values, context={"folder": path.parent})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join((path.name, *(str(part) for part in first["loc"])))
        raise OptionsError(where, f"{first['msg']} (got {first['input']!r:.80}).", _REMEDY) from None
    return TrainingConfig(name, settings, fingerprint)


def _fingerprint(values: dict[str, Any]) -> str:
    """Changes with any setting but those of the machine, on which a run may go on elsewhere."""
    trainer = {key: value for key, value in values.get("trainer", {}).items() if key != "machine"}
    text = json.dumps({**values, "trainer": trainer}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
