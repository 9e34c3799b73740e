"""GET /models: what this service labels and detects with."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import APIRouter

from boxlift.settings import DEFAULT_PRESET, LabellerSettings
from boxlift_service.answers import LabellerModel, ModelsAnswer


def models_routes(presets: Mapping[str, LabellerSettings]) -> APIRouter:
    """GET /models, which lists `presets`."""
    routes = APIRouter(tags=["state"])
    answer = ModelsAnswer(
        labellers=tuple(
            LabellerModel(preset=name, fingerprint=settings.fingerprint(), settings=settings)
            for name, settings in presets.items()
        ),
        default_preset=DEFAULT_PRESET,
        detector=None,
    )

    @routes.get("/models", summary="Presets of the labeller, and the detector")
    async def models() -> ModelsAnswer:
        """The settings of every preset, with their fingerprints."""
        return answer

    return routes
