"""Answers of POST /pointCloud/recognition, as Xtreme1 reads them, typed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from boxlift.errors import InputError
from boxlift.formats.xtreme1 import Xtreme1Object
from boxlift_service.problems import Kind, ProblemError


class _Answer(BaseModel):
    model_config = ConfigDict(frozen=True)


class RecognisedObject(_Answer):
    """A box in the LiDAR frame, metres and radians."""

    label: str = Field(description="Code of the class, e.g. CAR, TRUCK, PEDESTRIAN, BICYCLE.")
    confidence: float = Field(description="Confidence in the 3D box, 0 to 1.")
    x: float = Field(description="Geometric centre.")
    y: float
    z: float
    dx: float = Field(description="Length, along the heading.")
    dy: float = Field(description="Width.")
    dz: float = Field(description="Height.")
    rotX: float = Field(description="Angles about x, y and z, intrinsic in this order (R = Rx Ry Rz).")
    rotY: float
    rotZ: float


class RecognisedData(_Answer):
    """What became of one of the data."""

    id: int | str | None = Field(description="The id that it came with; null where it had none.")
    code: str = Field(description="OK, or the name of what went wrong, e.g. FETCH_FAILED.")
    message: str = Field(description="Empty, doubts about the cameras' parameters, or what went wrong.")
    objects: tuple[RecognisedObject, ...] = Field(description="The boxes, the most confident first.")


class RecognitionAnswer(_Answer):
    """The data in the order of the request; each is answered, or failed, by itself."""

    code: Literal["OK"] = "OK"
    message: str = ""
    data: tuple[RecognisedData, ...]


REQUEST_BODY = {
    "required": True,
    "content": {
        "application/json": {
            "schema": {
                "type": "object",
                "required": ["datas"],
                "properties": {
                    "datas": {
                        "type": "array",
                        "items": {
                            "type": "object",
                            "required": ["id", "pointCloudUrl", "imageUrls", "cameraConfigUrl"],
                            "properties": {
                                "id": {
                                    "type": ["integer", "string"],
                                    "description": "Comes back with the answer.",
                                },
                                "pointCloudUrl": {
                                    "type": "string",
                                    "description": "The point cloud: .pcd, or what POST /label takes.",
                                },
                                "imageUrls": {
                                    "type": "array",
                                    "items": {"type": "string"},
                                    "description": "PNG or JPEG; by which camera, its folder says "
                                    "(camera_image_3, image3), else its place in the list.",
                                },
                                "cameraConfigUrl": {
                                    "type": "string",
                                    "description": "The cameras' parameters, a JSON list.",
                                },
                            },
                        },
                    }
                },
            },
            "example": {
                "datas": [
                    {
                        "id": 1,
                        "pointCloudUrl": "http://minio:9000/xtreme1/lidar_point_cloud_0/000001.pcd",
                        "imageUrls": ["http://minio:9000/xtreme1/camera_image_0/000001.jpg"],
                        "cameraConfigUrl": "http://minio:9000/xtreme1/camera_config/000001.json",
                    }
                ]
            },
        }
    },
}


def recognised(data_id: int | str | None, objects: Sequence[Xtreme1Object], message: str) -> RecognisedData:
    """The answer to one of the data."""
    found = tuple(RecognisedObject.model_validate(item) for item in objects)
    return RecognisedData(id=data_id, code="OK", message=message, objects=found)


def failed(data_id: int | str | None, error: InputError | ProblemError) -> RecognisedData:
    """The answer to one that could not be answered."""
    kind = error.kind if isinstance(error, ProblemError) else Kind.INVALID_FIELD
    where = f"{error.field}: " if error.field else ""
    message = f"{where}{error.problem} {error.remedy}"
    return RecognisedData(id=data_id, code=kind.name, message=message, objects=())
