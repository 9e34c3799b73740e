"""Every knob of a training, frozen, typed and documented once; a TOML file holds them.

The defaults are the paper's (WeakM3D, "Network Training", "Implementation Details" and the appendix "Network
and Running Time"): so an empty [model], [loss] and [trainer] is its training. What it leaves open is ours
and says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from boxlift.settings import LossSettings


class Settings(BaseModel):
    """Base of all settings."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _from_config_folder(path: Path, info: ValidationInfo) -> Path:
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / path


# A path in a file is relative to the file's folder.
ConfigPath = Annotated[Path, AfterValidator(_from_config_folder)]


class MachineSettings(Settings):
    """Where a training runs. More than one device, or mixed precision, needs Lightning Fabric."""

    accelerator: Literal["auto", "cpu", "gpu"] = Field("auto", description="auto: a GPU where there is one.")
    devices: int = Field(1, ge=1, le=64, description="GPUs (or, on a CPU, processes).")
    precision: Literal["32-true", "16-mixed", "bf16-mixed"] = Field(
        "32-true", description="As Lightning Fabric calls them."
    )
    threads: int = Field(1, ge=1, le=256, description="Threads of torch on the CPU; for decoding, too.")


class TrainerSettings(Settings):
    """How a model is trained."""

    seed: int = Field(0, ge=0, description="Of everything random.")
    epochs: int = Field(50, ge=1, le=100_000, description="Passes over the frames (paper: 50).")
    batch_size: int = Field(
        8, ge=1, le=100_000, description="Frames (or what a task counts) a batch (paper: 8)."
    )
    optimizer: Literal["adam", "adamw"] = Field("adam", description="Adam (paper) or AdamW.")
    learning_rate: float = Field(1e-4, gt=0, le=10, description="At the start (paper: 1e-4).")
    weight_decay: float = Field(0.0, ge=0, le=10, description="Decay of the weights.")
    schedule: Literal["constant", "cosine"] = Field(
        "constant", description="How the learning rate goes on, epoch by epoch (the paper says nothing)."
    )
    warmup_epochs: int = Field(0, ge=0, le=10_000, description="Epochs of rising learning rate before.")
    clip_norm: float | None = Field(None, gt=0, description="Longest gradient; none: any length.")
    evaluate_every: int = Field(1, ge=0, description="Epochs between evaluations; 0: only after the last.")
    machine: MachineSettings = MachineSettings()


class FrameSet(Settings):
    """Frames to train on or to judge on."""

    source: ConfigPath = Field(description="Folder as `boxlift label` takes it.")
    prompts: str = Field("label_2", description="2D boxes: label_2 or det_2d (in the source), or a folder.")
    frames: ConfigPath | None = Field(
        None, description="File with the frames to take, one a line; none: all."
    )
    masks: ConfigPath | None = Field(
        None,
        description="Folder of instance masks, as `boxlift label --masks` takes it (paper: Mask R-CNN's).",
    )
    labels: str = Field("label_2", description="Truth, read only to judge or where targets are label_2.")
    min_score: float = Field(0.0, ge=0, le=1, description="2D boxes of a lower score are left out.")


class DataSettings(Settings):
    """What is trained on."""

    train: tuple[FrameSet, ...] = Field((), description="[[data.train]] once per set of frames.")
    validate_on: tuple[FrameSet, ...] = Field((), description="Judged after epochs; needs labels.")
    categories: tuple[str, ...] = Field(("Car",), min_length=1, description="Classes (paper: cars).")
    targets: Literal["points", "paper", "accurate", "label_2"] = Field(
        "points",
        description="What supervises: object-LiDAR-points directly (paper), pseudo labels of a preset of the "
        "labeller, or drawn labels, for comparison.",
    )
    target_score_power: float = Field(
        1.0, ge=0, le=10, description="A pseudo label weighs its score to this power; 0: all the same."
    )


class AugmentationSettings(Settings):
    """Changes of a frame, image and geometry together; off by default, as in the paper."""

    flip: float = Field(0.0, ge=0, le=1, description="Chance to mirror the scene.")
    focal: float = Field(
        0.0, ge=0, lt=1, description="Resize the image by up to this share: another focal length, same scene."
    )
    scale: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Zoom by up to this share, same focal length: every object nearer or farther.",
    )
    color: float = Field(0.0, ge=0, lt=1, description="Change brightness, contrast and saturation.")


class ModelSettings(Settings):
    """The network."""

    network: Literal["two_stage", "one_stage"] = Field(
        "two_stage", description="RoI features of 2D boxes (paper), or in the manner of CenterNet."
    )
    backbone: Literal["resnet18", "resnet34", "resnet50", "nanodet"] = Field(
        "resnet50", description="ResNet without its last stage (paper), or NanoDet's trunk."
    )
    weights: ConfigPath | None = Field(
        None, description="State dict for the backbone (torchvision's names for ResNets); none: random."
    )
    freeze_backbone: bool = Field(False, description="Train the heads only.")
    roi_strides: tuple[Literal[8, 16], ...] = Field(
        (16,), min_length=1, max_length=2, description="Maps that RoI features come from (paper: the last)."
    )
    hidden: int = Field(
        256, ge=1, le=8192, description="Width of fully connected layers, or of heads (ours)."
    )
    sizes: Literal["frozen", "learned"] = Field(
        "frozen", description="Dimensions: each class's frozen ones (paper), or learned around them."
    )
    depth: Literal["features", "box_height"] = Field(
        "features",
        description="Depth from features alone (paper), or as a factor on f * height / box height in pixels.",
    )
    orientation_bins: int = Field(2, ge=1, le=36, description="Bins over half a turn (Deep3DBox: 2).")
    orientation_overlap: float = Field(
        0.1, ge=0, lt=1, description="How far a bin reaches into its neighbours, as a share of it (ours)."
    )


class DirectLossSettings(Settings):
    """The losses on object-LiDAR-points (paper, equations 2 to 6). Its ablations switch parts off here.

    Geometric alignment off: alignment.geometric_weight = 0; ray tracing off: alignment.ray_weight = 0;
    balancing off: alignment.balance_by_density = false; no disentanglement: model.sizes = "learned" and
    heading = "predicted".
    """

    alignment: LossSettings = LossSettings()
    heading: Literal["points", "predicted"] = Field(
        "points", description="Boxes are aligned with the heading from their points (paper), or their own."
    )
    y_weight: float = Field(1.0, ge=0, le=100, description="Of equation 6's y term (paper: 1).")
    orientation_weight: float = Field(
        1.0, ge=0, le=100, description="Of equation 6's orientation (paper: 1)."
    )
    box_weight: float = Field(
        1.0, ge=0, le=100, description="Of regression to boxes, where targets are boxes."
    )
    heat_weight: float = Field(1.0, ge=0, le=100, description="Of the heat map, one_stage (CenterNet: 1).")
    extent_weight: float = Field(
        0.1, ge=0, le=100, description="Of 2D width and height, one_stage (CenterNet)."
    )


class MonocularSettings(Settings):
    """The paper's training (task = "monocular"), and what it is compared with."""

    data: DataSettings = DataSettings()
    model: ModelSettings = ModelSettings()
    loss: DirectLossSettings = DirectLossSettings()
    augmentation: AugmentationSettings = AugmentationSettings()
    trainer: TrainerSettings = TrainerSettings()


class RowSettings(Settings):
    """How pseudo labels are cleaned, and rows to learn from are made of them; all ours."""

    views: int = Field(4, ge=1, le=64, description="Views of each frame; the first is the frame as it is.")
    shifts: int = Field(1, ge=0, le=32, description="Shifted copies of each box in each view.")
    shift_share: float = Field(
        0.05, ge=0, le=0.3, description="Standard deviation of a shifted edge, as a share of the side."
    )
    drawn: bool = Field(
        True,
        description="Also learn from boxes as people draw them: the pseudo label's, projected to the image.",
    )
    least_probability: float = Field(
        0.3, ge=0, le=1, description="Pseudo labels less sure than this teach no box."
    )
    largest_disagreement: float = Field(
        0.25,
        gt=0,
        le=5,
        description="Nor do those whose depth is off by more than this (logarithm) from their height's.",
    )
    duplicate_weight: float = Field(
        0.3, ge=0, le=1, description="Of the box of an object that has a surer 2D box."
    )


class LifterModelSettings(Settings):
    """The head that ships."""

    blind_voices: int = Field(4, ge=0, le=32, description="Small networks that hear geometry only.")
    seeing_voices: int = Field(4, ge=0, le=32, description="Small networks that see RoI features, too.")
    channels: int = Field(16, ge=1, le=256, description="Channels that RoI features are reduced to.")
    width: int = Field(96, ge=1, le=4096, description="Width of the layer that sees the RoI.")
    dropout: float = Field(0.3, ge=0, lt=1, description="Of what the RoI shows.")
    sizes: Literal["frozen", "learned"] = Field("frozen", description="Dimensions, as in [model] there.")


class LifterDataSettings(DataSettings):
    """What the head that ships is trained on: boxes of all its classes."""

    categories: tuple[str, ...] = Field(
        ("Car", "Truck", "Pedestrian", "Cyclist"), min_length=1, description="Classes; these, in this order."
    )
    targets: Literal["paper", "accurate", "label_2"] = Field(
        "accurate", description="What supervises: pseudo labels of a preset, or, for comparison, drawn ones."
    )


class LifterSettings(Settings):
    """The training of the head that ships (task = "lifter"): pseudo labels, NanoDet's frozen trunk."""

    data: LifterDataSettings = LifterDataSettings()
    rows: RowSettings = RowSettings()
    model: LifterModelSettings = LifterModelSettings()
    augmentation: AugmentationSettings = AugmentationSettings()
    share: float = Field(0.25, gt=0, le=1, description="Of the rows, drawn anew for every epoch.")
    trainer: TrainerSettings = TrainerSettings()
