"""Every knob of the labeller, frozen, typed and documented once; CLI help and OpenAPI derive from here.

`paper` follows Peng et al., "WeakM3D: Towards Weakly Supervised Monocular 3D Object Detection" (ICLR
2022); each constant names its equation or section. `release` follows the authors' published code.
Where both are silent the number is ours and says so. The release also drops masks with a score below 0.7:
which prompts to send is the caller's choice here.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import reduce
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from boxlift.errors import OptionsError, member
from boxlift.priors import SIZE_PRIORS, ClassName, SizePrior


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class GroundSettings(_Settings):
    """RANSAC ground plane (paper, section 3.1 'Object-LiDAR-points'; Open3D).

    It is fitted to the points in the image, so that a sweep cropped to the camera's view labels alike.
    """

    remove: bool = Field(True, description="Remove ground points before clustering.")
    shape: Literal["plane", "surface"] = Field(
        "plane", description="One plane (paper), or a surface that follows slopes and crests."
    )
    cell_m: float = Field(2.0, ge=0.5, le=10, description="Cell of the surface (ours).")
    max_slope: float = Field(
        0.08, gt=0, le=1, description="Steepest rise of the surface against the first plane (ours)."
    )
    inlier_distance_m: float = Field(
        0.2, gt=0, le=2, description="Points this close to the plane are ground (ours)."
    )
    iterations: int = Field(200, ge=1, le=2_000, description="RANSAC iterations (ours).")
    max_tilt_deg: float = Field(
        15.0, gt=0, le=90, description="A plane steeper than this against the camera is a wall (ours)."
    )


class ObjectPointSettings(_Settings):
    """From a prompt to object-LiDAR-points (paper, appendix 'Details of Object-LiDAR-points')."""

    cluster_radius_m: float = Field(
        0.8, gt=0, le=10, description="DBSCAN radius (release; the paper gives none)."
    )
    cluster_min_points: int = Field(
        5, ge=1, le=1000, description="DBSCAN core point threshold (ours; release: 10)."
    )
    min_points: int = Field(
        5, ge=1, le=1000, description="Objects with fewer points are refused (ours; release: 10)."
    )
    vertical_filter: Literal["median", "mid_range", "none"] = Field(
        "median",
        description="Keep points at or below this height of the cluster: the lower half (paper, appendix).",
    )
    vertical_filter_min_points: int = Field(
        0, ge=0, le=1000, description="Where the filter would leave fewer, all points stay (release: 10)."
    )
    sample_count: int = Field(
        100, ge=3, le=1000, description="Object points sampled at random (paper, appendix)."
    )
    sample_with_replacement: bool = Field(False, description="Sample with replacement (release).")


class HeadingSettings(_Settings):
    """Heading from pair directions (paper, equation 7 and appendix 'Orientation Analysis')."""

    direction: Literal["histogram", "rounded"] = Field(
        "histogram",
        description="Mean direction within the highest bin (paper), or the multiple of bin_rad that most "
        "directions round to (release).",
    )

    bin_rad: float = Field(
        0.1,
        ge=0.001,
        le=1,
        description="Histogram bin of the pair directions (release: 0.1; the paper gives none).",
    )
    fold_low_rad: float = Field(
        0.7853981633974483, ge=0, le=1.5707963267948966, description="Lower end of the fold (pi/4, paper)."
    )
    x_extent_threshold_m: float = Field(3.0, gt=0, le=100, description="C in equation 7 (paper: 3 m).")
    x_extent_of: Literal["used", "cluster"] = Field(
        "used", description="Measure d_x on the points that are used (paper) or the whole cluster (release)."
    )


class LossSettings(_Settings):
    """Balanced loss (paper, equations 2 to 5)."""

    density_radius_m: float = Field(0.4, gt=0, le=10, description="R in equation 4 (paper: 0.4 m).")
    balance_by_density: bool = Field(True, description="Divide by the density of equation 4.")
    geometric_weight: float = Field(1.0, ge=0, le=100, description="Weight of equation 2 (paper: 1).")
    ray_weight: float = Field(1.0, ge=0, le=100, description="Weight of equation 3 (paper: 1).")
    center_weight: float = Field(0.1, ge=0, le=100, description="Lambda in equation 5 (paper: 0.1).")
    center_norm: Literal["euclidean", "l1"] = Field("euclidean", description="Norm of the centre loss.")
    ray_average: Literal["all", "hits"] = Field(
        "all", description="Average the ray loss over all points (paper) or over hitting ones (release)."
    )
    ray_min_hits: int = Field(0, ge=0, le=1000, description="Fewer hits: no ray loss (release: 3).")
    ray_min_depth_m: float = Field(
        0.0, ge=0, le=100, description="Box centres up to this depth: no ray loss (release: 3 m)."
    )
    ray_origin: Literal["camera", "lidar"] = Field(
        "camera", description="Where the rays of equation 3 start (paper: the camera's optical centre)."
    )


class FitSettings(_Settings):
    """Minimisation over (x, z) with heading and size frozen."""

    method: Literal["search", "adam"] = Field(
        "search", description="Global search with refinement, or Adam from the points' centroid."
    )
    grid_steps: int = Field(
        24, ge=2, le=100, description="Grid steps from the middle of the search to each of its sides."
    )
    reach_m: float | None = Field(
        None, gt=0, le=20, description="How far to each side; half the box's diagonal and more where none."
    )
    beam_width: int = Field(
        96, ge=1, le=1_000, description="Cells that the search splits further at every level."
    )
    levels: int = Field(
        6, ge=0, le=12, description="Times that the search halves its cells: 6 end at 4 mm for a car."
    )
    adam_steps: int = Field(500, ge=1, le=5_000, description="Steps of Adam.")
    adam_learning_rate: float = Field(0.05, gt=0, le=10, description="Learning rate of Adam, metres.")


class ConsistencySettings(_Settings):
    """Vertical position (paper, section 3.5 and 'Implementation Details': 2D-3D consistency)."""

    y_from: Literal["used", "cluster"] = Field(
        "used", description="Mean y of the points that are used (paper) or of the whole cluster (release)."
    )
    adjust_y: bool = Field(True, description="Fit y to the top and bottom edge of the prompt.")
    adjust_x: bool = Field(False, description="Also fit x to the side edges (release).")
    adjust_height: bool = Field(False, description="Also fit the height (release).")
    max_shift_m: float | None = Field(
        None, gt=0, le=10, description="Largest shift; unlimited where none (release: 0.3 m)."
    )


class DetectionSettings(_Settings):
    """Which of a detector's boxes become prompts, where no prompts are given."""

    min_score: float = Field(
        0.3, ge=0, le=1, description="Detections with a lower score are left out (ours)."
    )


def _over_the_built_in(sizes: dict[str, SizePrior]) -> dict[str, SizePrior]:
    """In the order of names, so that the same sizes have the same fingerprint."""
    return dict(sorted({**SIZE_PRIORS, **sizes}.items()))


class RepairSettings(_Settings):
    """What the preset `accurate` does beyond the paper; each can be switched off (benchmarks/ablation.py)."""

    claim: bool = Field(
        True, description="Near to far: points that a chosen box explains are not offered again."
    )
    cluster_scales: tuple[float, ...] = Field(
        (1.0, 0.5),
        min_length=1,
        max_length=4,
        description="Clusters at these multiples of the radius: the finer part cars that touch.",
    )
    max_clusters: int = Field(4, ge=1, le=20, description="Likeliest clusters of a prompt that are tried.")
    closeness: bool = Field(
        True, description="Besides the pair directions, try the heading of the best L shape."
    )
    perpendicular: bool = Field(True, description="Try each heading's perpendicular too.")
    prompt_placement: bool = Field(
        True, description="Also try where a box of the class's height fills the prompt."
    )
    fits: int = Field(4, ge=1, le=50, description="Hypotheses per object that are fitted.")
    choose: Literal["evidence", "loss"] = Field(
        "evidence", description="Choose by all evidence, or by the loss of the fit alone."
    )
    edges: bool = Field(True, description="Compare the edges of the projected box with the prompt's.")
    exclusion_weight: float = Field(
        10.0, ge=0, le=1_000, description="Cost of two boxes in one place; 0 lets them overlap."
    )
    polish: bool = Field(True, description="After the fit, move position, heading and size a little.")
    size: Literal["refined", "fixed"] = Field(
        "refined", description="Refined from the class's typical size, or fixed to its frozen one."
    )


class LabellerSettings(_Settings):
    """All settings of a Labeller."""

    preset: str = Field("paper", description="Name of the preset these settings started from.")
    ground: GroundSettings = GroundSettings()
    points: ObjectPointSettings = ObjectPointSettings()
    heading: HeadingSettings = HeadingSettings()
    loss: LossSettings = LossSettings()
    fit: FitSettings = FitSettings()
    consistency: ConsistencySettings = ConsistencySettings()
    repairs: RepairSettings | None = Field(
        None, description="Beyond the paper; none in the presets `paper` and `release`."
    )
    detection: DetectionSettings = DetectionSettings()
    sizes: Annotated[dict[ClassName, SizePrior], AfterValidator(_over_the_built_in)] = Field(
        SIZE_PRIORS,
        validate_default=True,
        description="Frozen size per class with its source. What is given lies over the built-in classes, "
        "each class as a whole.",
    )

    def fingerprint(self) -> str:
        """Sixteen hex digits that change when any setting does."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:16]

    def with_options(self, options: dict[str, Any]) -> LabellerSettings:
        """These settings with `options` laid over them, e.g. {"fit": {"method": "adam"}}.

        Raises OptionsError where an option does not exist or is out of range.
        """
        try:
            # A size is one thing with its source: it is replaced, not mixed with another one.
            own = self.model_dump(exclude={"sizes"} if "sizes" in options else None)
            return LabellerSettings.model_validate(_overlay(own, options))
        except ValidationError as error:
            first = error.errors()[0]
            name = reduce(member, map(str, first["loc"]), "options")
            raise OptionsError(
                name,
                f"{first['msg']} (got {first['input']!r:.80}).",
                "GET /openapi.json and boxlift/settings.py list every option and its range.",
            ) from None

    def with_sizes(self, sizes: Mapping[str, SizePrior]) -> LabellerSettings:
        """These settings with `sizes` laid over the built-in ones. Raises OptionsError."""
        return self.with_options({"sizes": dict(sizes)})


PAPER = LabellerSettings(preset="paper")

RELEASE = LabellerSettings(
    preset="release",
    ground=GroundSettings(remove=False),
    points=ObjectPointSettings(
        cluster_min_points=10,
        min_points=10,
        vertical_filter="mid_range",
        vertical_filter_min_points=10,
        sample_with_replacement=True,
    ),
    heading=HeadingSettings(
        direction="rounded", fold_low_rad=0.39269908169872414, x_extent_threshold_m=4.0, x_extent_of="cluster"
    ),
    loss=LossSettings(
        density_radius_m=0.2, center_norm="l1", ray_average="hits", ray_min_hits=3, ray_min_depth_m=3.0
    ),
    consistency=ConsistencySettings(y_from="cluster", adjust_x=True, adjust_height=True, max_shift_m=0.3),
)

ACCURATE = LabellerSettings(
    preset="accurate",
    ground=GroundSettings(shape="surface", iterations=50),
    points=ObjectPointSettings(min_points=2, sample_count=60),
    fit=FitSettings(grid_steps=3, reach_m=1.0, beam_width=6, levels=3),
    repairs=RepairSettings(),
)

PRESETS = {"accurate": ACCURATE, "paper": PAPER, "release": RELEASE}
DEFAULT_PRESET = "accurate"


def preset(name: str) -> LabellerSettings:
    """The settings of a preset by name. Raises OptionsError for a name that is none."""
    try:
        return PRESETS[name]
    except KeyError:
        raise OptionsError("preset", f"{name!r} is no preset.", f"Choose one of {sorted(PRESETS)}.") from None


def _overlay(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        nested = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _overlay(merged[key], value) if nested else value
    return merged
