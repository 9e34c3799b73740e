"""Heavy dependencies, imported where they are used; a missing one names the extra that brings it."""

from __future__ import annotations

import importlib
import os
from typing import Any

from boxlift.errors import MissingExtraError


def open3d() -> Any:  # Open3D ships no types.
    """The open3d module. Raises MissingExtraError, or an ImportError that names a system library."""
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "open3d", "label") from None
    except ImportError as error:
        raise ImportError(
            f"Open3D is installed but a system library is missing ({error}). On Debian or Ubuntu: "
            "apt-get install libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"
        ) from None


def onnxruntime() -> Any:  # ONNX Runtime ships no types.
    """The onnxruntime module. Raises MissingExtraError."""
    # Its Linux wheels write to the home folder, and send what they see, unless they are told not to.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    return _module("onnxruntime", "detect")


def onnx() -> Any:
    """The onnx module, which builds and checks model files. Raises MissingExtraError."""
    return _module("onnx", "train")


def _module(name: str, extra: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or name, extra) from None
