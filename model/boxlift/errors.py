"""What can go wrong, as a tree.

BoxliftError
├── InputError            wrong input: names the field, the value and the remedy
│   ├── CalibrationError  not numbers, missing, singular
│   ├── PointCloudError   truncated, unreadable, nothing finite in it
│   ├── ImageError        not a picture, wrong size
│   ├── PromptError       prompts that cannot be read (one unusable prompt is a result, no error)
│   ├── LabelFormatError  a label file that does not follow its format
│   ├── DatasetError      folders or frames that are not there
│   │   └── NoLidarError  a frame that has everything but points
│   ├── ModelFileError    a model file that is no ONNX model, or one of another interface
│   └── OptionsError      settings that do not exist or are out of range
└── MissingExtraError     a part of boxlift whose dependencies are not installed
"""

from __future__ import annotations


class BoxliftError(Exception):
    """Base of every error that boxlift raises on purpose."""


class InputError(BoxliftError):
    """Wrong input. `field` is where, `problem` what is wrong with which value, `remedy` what to do."""

    def __init__(self, field: str, problem: str, remedy: str) -> None:
        self.field = field
        self.problem = problem
        self.remedy = remedy
        super().__init__(field, problem, remedy)

    def __str__(self) -> str:
        return f"{self.field}: {self.problem} {self.remedy}"


def member(field: str, key: str) -> str:
    """What errors call a member of `field`; where its name cannot be printed, they name the field alone."""
    return f"{field}.{key:.40}" if key.isprintable() else field


class CalibrationError(InputError):
    """The calibration is missing, not numeric or singular."""


class PointCloudError(InputError):
    """The point cloud is truncated, of an unknown format or has no finite point."""


class ImageError(InputError):
    """The image cannot be decoded or has the wrong size."""


class PromptError(InputError):
    """The prompts, or their masks, cannot be read as a whole."""


class LabelFormatError(InputError):
    """A label file does not follow its format."""


class DatasetError(InputError):
    """A dataset folder or a frame in it is not there."""


class NoLidarError(DatasetError):
    """A frame has no LiDAR points, so that there is nothing to lift its prompts with."""


class ModelFileError(InputError):
    """A model file is not an ONNX model, lacks what its interface asks for, or fails when it runs."""


class OptionsError(InputError):
    """A setting does not exist or has a value out of range."""


class MissingExtraError(BoxliftError, ImportError):
    """A dependency of an optional part is not installed."""

    def __init__(self, module: str, extra: str) -> None:
        self.module = module
        self.extra = extra
        super().__init__(module, extra)

    def __str__(self) -> str:
        return f"{self.module} is not installed; install it with: pip install 'boxlift[{self.extra}]'."
