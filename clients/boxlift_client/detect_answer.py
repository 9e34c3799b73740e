"""What POST /detect answers, read."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from boxlift.formats.details import FrameDetails, kitti_text


class _Answer(BaseModel):
    model_config = ConfigDict(frozen=True)


class UsedModel(_Answer):
    """A model that an answer was made with."""

    name: str = Field(description="Name of its file, without suffix.")
    digest: str = Field(description="SHA-256 of its file.")


class DetectedImage(FrameDetails):
    """What was found in one image. Members of later versions are ignored."""

    image_size: tuple[int, int] = Field(description="Width and height, pixels.")

    @property
    def kitti_text(self) -> str:
        """The boxes as KITTI result lines; empty for none."""
        return kitti_text(self)


class DetectAnswer(_Answer):
    """The objects of every image, in the order of the images, and with what they were found."""

    images: tuple[DetectedImage, ...]
    model: UsedModel = Field(description="The monocular model.")
    detector: UsedModel | None = Field(
        description="The service's own 2D detector, where it found the objects."
    )
    api_version: str = Field(description="Version of the HTTP interface.")
    boxlift_version: str = Field(description="Version of the package.")

    def details(self, index: int, name: str) -> FrameDetails:
        """What became of every object of one image, under a name of one's own."""
        image = self.images[index]
        return FrameDetails(
            frame=name, objects=image.objects, warnings=image.warnings, model_digest=self.model.digest
        )
