"""GET /models: what this service labels and detects with."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import APIRouter

import boxlift
from boxlift.settings import DEFAULT_PRESET, LabellerSettings
from boxlift_service.answers import LabellerModel, ModelsAnswer, OnnxModelAnswer
from boxlift_service.detection.detection import Detection
from boxlift_service.detection.models import ModelInfo
from boxlift_service.documentation import documentation
from boxlift_service.problems import Kind


def models_routes(detection: Detection, presets: Mapping[str, LabellerSettings]) -> APIRouter:
    """GET /models, which lists `presets` and the models of `detection`."""
    routes = APIRouter(tags=["state"])
    labellers = tuple(
        LabellerModel(preset=name, fingerprint=settings.fingerprint(), settings=settings)
        for name, settings in presets.items()
    )

    def answer() -> ModelsAnswer:
        infos = {"detector": detection.detector, "monocular": detection.monocular}
        return ModelsAnswer(
            boxlift_version=boxlift.__version__,
            labellers=labellers,
            default_preset=DEFAULT_PRESET,
            detector=_answer(detection.detector),
            monocular=_answer(detection.monocular),
            missing={name: info.missing for name, info in infos.items() if info.missing is not None},
        )

    @routes.get(
        "/models",
        summary="Presets of the labeller, and the models that find objects",
        responses=documentation.problem_responses(*documentation.GUARD_KINDS),
    )
    async def models() -> ModelsAnswer:
        """The settings of every preset, with their fingerprints; the digest of every model's file."""
        return answer()

    @routes.post(
        "/models:reload",
        summary="Read the model files again",
        responses=documentation.problem_responses(*documentation.GUARD_KINDS, Kind.NOT_RELOADED),
    )
    async def reload() -> ModelsAnswer:
        """The workers are replaced one by one, each by one that is ready: no request is lost or refused.

        Where a file cannot be used, those before stay. SIGHUP does the same.
        """
        await detection.reload()
        return answer()

    return routes


def _answer(info: ModelInfo) -> OnnxModelAnswer | None:
    if info.missing is not None:
        return None
    return OnnxModelAnswer(name=info.name, digest=info.digest, classes=info.classes, metadata=info.metadata)
