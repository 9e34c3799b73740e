"""Examples of JSON answers, for the OpenAPI document."""

from __future__ import annotations

from typing import Any

import boxlift
from boxlift.formats.details import (
    BoxDetails,
    KittiDetails,
    LossDetails,
    ObjectDetails,
    PointDetails,
)
from boxlift.settings import ACCURATE
from boxlift_service.answers import API_VERSION, DetectAnswer, ImageAnswer, LabelAnswer, UsedModel


def with_answer_examples(document: dict[str, Any]) -> dict[str, Any]:
    """The OpenAPI document with examples of JSON answers; FastAPI would strip their nulls."""
    for path, example in (("/label", _label_answer_example()), ("/detect", _detect_answer_example())):
        answer = document["paths"][path]["post"]["responses"]["200"]["content"]["application/json"]
        answer["example"] = example
    return document


def _label_answer_example() -> dict[str, Any]:
    """An object that has a box and one that has none."""
    fitted = ObjectDetails(
        category="Car",
        index=0,
        prompt_box_px=(587.0, 173.3, 614.1, 200.1),
        prompt_score=0.97,
        result="FITTED",
        sentence="A box was fitted.",
        score=0.8714,
        flags=(),
        box=BoxDetails(
            center_cam=(-0.712, 1.081, 25.1), length_m=4.0, width_m=1.8, height_m=1.6, rotation_y=-1.66
        ),
        kitti=KittiDetails(
            type="Car",
            truncated=-1,
            occluded=-1,
            alpha=-1.63,
            bbox=(587.0, 173.3, 614.1, 200.1),
            dimensions=(1.6, 1.8, 4.0),
            location=(-0.71, 1.88, 25.1),
            rotation_y=-1.66,
            score=0.8714,
        ),
        losses=LossDetails(geometric=0.0512, ray_tracing=0.0731, center=1.2043, total=0.2447),
        points=PointDetails(in_prompt=181, above_ground=164, in_cluster=152, used=77),
        rejected=(),
    )
    unusable = ObjectDetails(
        category="Car",
        index=1,
        prompt_box_px=(10.0, 180.0, 16.0, 184.0),
        prompt_score=0.41,
        result="TOO_FEW_POINTS",
        sentence="Too few LiDAR points inside the 2D box (3, at least 10 are needed).",
        score=0.0,
        flags=(),
        box=None,
        kitti=None,
        losses=None,
        points=PointDetails(in_prompt=3, above_ground=0, in_cluster=0, used=0),
        rejected=(),
    )
    answer = LabelAnswer(
        frame="000123",
        objects=(fitted, unusable),
        warnings=(),
        dropped_points=0,
        preset=ACCURATE.preset,
        settings_fingerprint=ACCURATE.fingerprint(),
        model_digest=None,
        api_version=API_VERSION,
        boxlift_version=boxlift.__version__,
    )
    return answer.model_dump(mode="json", by_alias=True)


def _detect_answer_example() -> dict[str, Any]:
    """One image with one object."""
    predicted = ObjectDetails(
        category="Car",
        index=0,
        prompt_box_px=(587.0, 173.3, 614.1, 200.1),
        prompt_score=0.81,
        result="PREDICTED",
        sentence="The model predicted a box.",
        score=0.4913,
        depth_spread=0.041,
        flags=("heading_ambiguous",),
        box=BoxDetails(
            center_cam=(-0.731, 1.13, 43.4), length_m=3.88, width_m=1.63, height_m=1.53, rotation_y=-1.57
        ),
        kitti=KittiDetails(
            type="Car",
            truncated=-1,
            occluded=-1,
            alpha=-1.55,
            bbox=(587.0, 173.3, 614.1, 200.1),
            dimensions=(1.53, 1.63, 3.88),
            location=(-0.73, 1.9, 43.4),
            rotation_y=-1.57,
            score=0.4913,
        ),
        losses=None,
        points=PointDetails(in_prompt=0, above_ground=0, in_cluster=0, used=0),
        rejected=(),
    )
    image = ImageAnswer(frame="000123", image_size=(1242, 375), objects=(predicted,), warnings=())
    answer = DetectAnswer(
        images=(image,),
        model=UsedModel(name="monocular", digest="0" * 64),
        detector=None,
        api_version=API_VERSION,
        boxlift_version=boxlift.__version__,
    )
    return answer.model_dump(mode="json", by_alias=True)
