"""Where a training runs: this CPU or GPU, or several GPUs and mixed precision by Lightning Fabric."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor, nn

from boxlift.errors import MissingExtraError, OptionsError
from boxlift.network.config import MachineSettings

T = TypeVar("T")


class Machine(Protocol):
    """One of `processes` that train the same model; process 0 keeps the books."""

    rank: int
    processes: int

    def place(self, model: nn.Module, optimizer: torch.optim.Optimizer) -> tuple[nn.Module, Any]:
        """Model and optimiser where they are to work."""

    def to_device(self, batch: T) -> T:
        """A batch where the model is."""

    def backward(self, loss: Tensor) -> None:
        """Gradients of the loss, averaged over the processes."""

    def clip(self, model: nn.Module, optimizer: Any, largest_norm: float) -> None:
        """Shorten the gradient to this norm."""

    def mean(self, value: float) -> float:
        """The mean of a figure over the processes."""

    def wait(self) -> None:
        """Until all processes are here."""


def open_machine(settings: MachineSettings) -> Machine:
    """The machine that the settings ask for.

    Raises MissingExtraError where it needs Lightning Fabric and that is not installed, OptionsError where
    there is no such device.
    """
    torch.set_num_threads(settings.threads)
    if settings.accelerator == "gpu" and not torch.cuda.is_available():
        raise OptionsError("machine.accelerator", "this machine has no GPU.", "Give cpu or auto.")
    if settings.devices == 1 and settings.precision == "32-true":
        return _OneDevice(settings)
    return _Fabric(settings)


class _OneDevice:
    rank = 0
    processes = 1

    def __init__(self, settings: MachineSettings) -> None:
        on_gpu = settings.accelerator != "cpu" and torch.cuda.is_available()
        self._device = torch.device("cuda" if on_gpu else "cpu")

    def place(self, model: nn.Module, optimizer: torch.optim.Optimizer) -> tuple[nn.Module, Any]:
        model.to(self._device)
        return model, optimizer

    def to_device(self, batch: T) -> T:
        moved: T = _moved(batch, self._device)
        return moved

    def backward(self, loss: Tensor) -> None:
        torch.autograd.backward(loss)

    def clip(self, model: nn.Module, optimizer: Any, largest_norm: float) -> None:  # noqa: ARG002
        nn.utils.clip_grad_norm_(model.parameters(), largest_norm)

    def mean(self, value: float) -> float:
        return value

    def wait(self) -> None:
        pass


class _Fabric:
    """Lightning Fabric, which starts the other processes itself."""

    def __init__(self, settings: MachineSettings) -> None:
        try:
            fabric = importlib.import_module("lightning_fabric").Fabric
        except ModuleNotFoundError as error:
            raise MissingExtraError(error.name or "lightning-fabric", "train") from None
        self._fabric: Any = fabric(
            accelerator=settings.accelerator,
            devices=settings.devices,
            precision=settings.precision,
            strategy="ddp" if settings.devices > 1 else "auto",
        )
        self._fabric.launch()
        self.rank: int = self._fabric.global_rank
        self.processes: int = self._fabric.world_size

    def place(self, model: nn.Module, optimizer: torch.optim.Optimizer) -> tuple[nn.Module, Any]:
        placed, placed_optimizer = self._fabric.setup(model, optimizer)
        return placed, placed_optimizer

    def to_device(self, batch: T) -> T:
        moved: T = _moved(batch, self._fabric.device)
        return moved

    def backward(self, loss: Tensor) -> None:
        self._fabric.backward(loss)

    def clip(self, model: nn.Module, optimizer: Any, largest_norm: float) -> None:
        self._fabric.clip_gradients(model, optimizer, max_norm=largest_norm)

    def mean(self, value: float) -> float:
        return float(self._fabric.all_reduce(torch.tensor(value, dtype=torch.float64), reduce_op="mean"))

    def wait(self) -> None:
        self._fabric.barrier()


def _moved(value: Any, device: torch.device) -> Any:
    """Tensors within dicts, lists, tuples and dataclasses on a device; everything else as it is."""
    if isinstance(value, Tensor):
        return value.to(device)
    if isinstance(value, Mapping):
        return {key: _moved(item, device) for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*(_moved(item, device) for item in value))
    if isinstance(value, list | tuple):
        return type(value)(_moved(item, device) for item in value)
    if hasattr(value, "__dataclass_fields__"):
        return type(value)(
            **{name: _moved(getattr(value, name), device) for name in value.__dataclass_fields__}
        )
    return value
