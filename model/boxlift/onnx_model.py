"""One ONNX file: checked before it is used, run by ONNX Runtime with as many threads as it is told.

>>> BRIGHTNESS = Interface(
...     inputs=(Tensor("image", "uint8", ("H", "W", 3)),),
...     outputs=(Tensor("mean", "float32", ()),),
...     remedy="Export it again.",
... )
>>> model = OnnxModel.open(Path("brightness.onnx"), BRIGHTNESS)  # doctest: +SKIP
>>> model.run({"image": image})["mean"]  # doctest: +SKIP
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift import extras
from boxlift.errors import ModelFileError

Array = NDArray[np.generic]

# ONNX Runtime's words for element types that numpy has.
_TYPES = {
    "tensor(bool)": "bool",
    "tensor(uint8)": "uint8",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
    "tensor(float16)": "float16",
    "tensor(float)": "float32",
    "tensor(double)": "float64",
}
# Protocol buffers hold no more; larger models keep their weights in a file beside.
_MOST_BYTES = 2**31
_MOST_THREADS = 1024
_CLASS_NAME_CHARACTERS = 100


@dataclass(frozen=True)
class Tensor:
    """An input or output by name.

    types: names of the numpy types that it may have. shape: a number is that very side; a letter is a
    side of any length, the same wherever the letter comes again.
    """

    name: str
    types: str | tuple[str, ...]
    shape: tuple[int | str, ...]
    optional: bool = False

    @property
    def type_names(self) -> tuple[str, ...]:
        """The types as a tuple."""
        return (self.types,) if isinstance(self.types, str) else self.types

    def __str__(self) -> str:
        return f"{' or '.join(self.type_names)} {_shape_text(self.shape)}"


@dataclass(frozen=True)
class Interface:
    """What a model file must offer, and what to do about one that does not.

    metadata: properties that it must have, each with the value that it must have (None: any).
    """

    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    remedy: str
    metadata: Mapping[str, str | None] = field(default_factory=dict)


class OnnxModel:
    """A model file that has the interface it was opened with.

    path: of the file. digest: SHA-256 of the file (and of its weights in `FILE.data`, where that is), as
    hexadecimal. metadata: its properties. Threads may share one.
    """

    def __init__(self, path: Path, interface: Interface, session: Any, digest: str) -> None:
        self.path = path
        self.digest = digest
        self._interface = interface
        self._session = session
        try:
            self.metadata: Mapping[str, str] = dict(session.get_modelmeta().custom_metadata_map)
            self._given_inputs = {node.name: node for node in session.get_inputs()}
            self._given_outputs = {node.name: node for node in session.get_outputs()}
        except UnicodeDecodeError:
            raise self._error("its names or metadata are no text; the file is damaged.") from None
        self._outputs = tuple(tensor for tensor in interface.outputs if tensor.name in self._given_outputs)

    @classmethod
    def open(cls, path: Path | str, interface: Interface, threads: int = 1) -> OnnxModel:
        """Load a file and check it; it computes in `threads` threads, that of the caller included.

        Threads that wait for work sleep: spinning, they would take the cores from whatever else runs.
        Raises ModelFileError where the file is none or has another interface, MissingExtraError without
        ONNX Runtime.
        """
        if not 1 <= threads <= _MOST_THREADS:
            raise ValueError(f"threads is {threads}, 1 to {_MOST_THREADS} are possible.")
        path = Path(path)
        runtime = extras.onnxruntime()
        digest = _digest(path)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        options.log_severity_level = 4  # what is wrong comes as an exception too
        for pool in ("intra_op", "inter_op"):
            options.add_session_config_entry(f"session.{pool}.allow_spinning", "0")
        try:
            session = runtime.InferenceSession(
                str(path),
                options,
                providers=["CPUExecutionProvider"],
                enable_fallback=False,  # there is nothing to fall back on, and it prints
            )
        # ONNX Runtime's errors are of a dozen types with no base but Exception.
        except Exception as error:
            raise ModelFileError(
                str(path), f"ONNX Runtime cannot load it ({_one_line(error)}).", "Give an ONNX model."
            ) from None
        model = cls(path, interface, session, digest)
        model._check_inputs()
        model._check_outputs()
        model._check_metadata()
        return model

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the interface's outputs that this file has: all but optional ones, in its order."""
        return tuple(tensor.name for tensor in self._outputs)

    def run(self, inputs: Mapping[str, Array]) -> dict[str, NDArray[Any]]:
        """Arrays of the interface's inputs by name -> arrays of its outputs by name.

        Raises ModelFileError where the model fails or answers something else than its interface says.
        """
        sides: dict[str, int] = {}
        for tensor in self._interface.inputs:
            if (problem := _mismatch(tensor, inputs[tensor.name], sides)) is not None:
                raise ValueError(f"input {tensor.name!r} {problem}")
        try:
            answers = self._session.run(self.output_names, dict(inputs))
        except Exception as error:  # as above
            shapes = ", ".join(f"{name} {_shape_text(value.shape)}" for name, value in inputs.items())
            raise self._error(f"the model fails on {shapes} ({_one_line(error)}).") from None
        for tensor, answer in zip(self._outputs, answers, strict=True):
            if (problem := _mismatch(tensor, answer, sides)) is not None:
                raise self._error(f"its output {tensor.name!r} {problem}")
        return dict(zip(self.output_names, answers, strict=True))

    def class_names(self) -> tuple[str, ...]:
        """The property `classes`: names by category number. Raises ModelFileError."""
        try:
            names = json.loads(self.metadata["classes"])
        except (KeyError, ValueError, RecursionError):
            names = None
        if not (
            isinstance(names, list)
            and names
            and all(isinstance(name, str) and _is_class_name(name) for name in names)
        ):
            given = self.metadata.get("classes", "")
            raise self._error(f"its property 'classes' is no JSON list of class names ({given!r:.80}).")
        return tuple(names)

    def _check_inputs(self) -> None:
        given = dict(self._given_inputs)
        for tensor in self._interface.inputs:
            node = given.pop(tensor.name, None)
            if node is None:
                raise self._error(f"the model has no input {tensor.name!r} ({self._names()}).")
            self._check_type(tensor, node, "input")
            # A side that may have any length must not have a fixed one in the model.
            wrong = node.shape and (
                len(node.shape) != len(tensor.shape)
                or any(
                    isinstance(mine, int) and mine != asked
                    for mine, asked in zip(node.shape, tensor.shape, strict=True)
                )
            )
            if wrong:
                raise self._error(
                    f"its input {tensor.name!r} has the shape {_shape_text(node.shape)}, "
                    f"{_shape_text(tensor.shape)} with letters for any length is needed."
                )
        if given:
            raise self._error(f"the model wants an input {next(iter(given))!r} that nobody gives it.")

    def _check_outputs(self) -> None:
        for tensor in self._interface.outputs:
            if tensor.name in self._given_outputs:
                self._check_type(tensor, self._given_outputs[tensor.name], "output")
            elif not tensor.optional:
                raise self._error(f"the model has no output {tensor.name!r} ({self._names()}).")

    def _check_type(self, tensor: Tensor, node: Any, role: str) -> None:
        if _TYPES.get(node.type) not in tensor.type_names:
            given = _TYPES.get(node.type, node.type)
            raise self._error(f"its {role} {tensor.name!r} is {given}, {tensor} is needed.")

    def _check_metadata(self) -> None:
        for key, value in self._interface.metadata.items():
            if key not in self.metadata:
                raise self._error(f"the model has no metadata property {key!r}.")
            if value not in (None, self.metadata[key]):
                raise self._error(f"its property {key!r} is {self.metadata[key]!r:.60}, not {value!r}.")

    def _names(self) -> str:
        inputs, outputs = ", ".join(self._given_inputs), ", ".join(self._given_outputs)
        return f"{inputs or 'nothing'} -> {outputs or 'nothing'}"[:200]

    def _error(self, problem: str) -> ModelFileError:
        return ModelFileError(str(self.path), problem, self._interface.remedy)


def _digest(path: Path) -> str:
    """SHA-256 of the file and of what torch's exporter puts beside it. Raises ModelFileError."""
    remedy = "Give the path of an ONNX model."
    if not path.is_file():
        what = "is a directory" if path.is_dir() else "is no file" if path.exists() else "does not exist"
        raise ModelFileError(str(path), f"the path {what}.", remedy)
    digest = hashlib.sha256()
    try:
        size = path.stat().st_size
        if size == 0:
            raise ModelFileError(str(path), "the file is empty.", remedy)
        if size >= _MOST_BYTES:
            raise ModelFileError(str(path), f"the file has {size} bytes, too many for an ONNX model.", remedy)
        weights = path.with_name(f"{path.name}.data")
        for part in (path, weights) if weights.is_file() else (path,):
            with part.open("rb") as file:
                while block := file.read(2**20):
                    digest.update(block)
    except OSError as error:
        raise ModelFileError(str(path), f"the file cannot be read ({error.strerror}).", remedy) from None
    return digest.hexdigest()


def _mismatch(tensor: Tensor, array: Any, sides: dict[str, int]) -> str | None:
    """How an array differs from what `tensor` says, None where it does not. Letters are noted in `sides`."""
    if not isinstance(array, np.ndarray):
        return f"is a {type(array).__name__}, {tensor} is needed."
    fits = array.dtype.name in tensor.type_names and array.ndim == len(tensor.shape)
    if fits:
        for length, side in zip(array.shape, tensor.shape, strict=True):
            expected = sides.setdefault(side, length) if isinstance(side, str) else side
            fits = fits and length == expected
    if fits:
        return None
    known = ", ".join(f"{side} = {sides[side]}" for side in tensor.shape if side in sides)
    needed = f"{tensor}{f' with {known}' if known else ''} is needed."
    return f"is {array.dtype.name} {_shape_text(array.shape)}, {needed}"


def _is_class_name(name: str) -> bool:
    return 0 < len(name) <= _CLASS_NAME_CHARACTERS and name.isprintable()


def _shape_text(shape: Sequence[object]) -> str:
    return f"({', '.join(str(side) if side is not None else '?' for side in shape)})"


def _one_line(error: Exception) -> str:
    """ONNX Runtime's message without its line breaks, at most 200 characters."""
    return " ".join(str(error).split())[:200] or type(error).__name__
