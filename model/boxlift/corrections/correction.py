"""One thing that somebody said about one object."""

from __future__ import annotations

from datetime import datetime
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field

from boxlift.errors import BoxliftError
from boxlift.formats.details import BoxDetails

_LONGEST_SIDE_M = 100.0
_FARTHEST_M = 10_000.0


class Verdict(StrEnum):
    """What somebody thinks of an object."""

    OPEN = "open"  # nobody said anything, or it was taken back
    ACCEPTED = "accepted"
    CORRECTED = "corrected"
    REJECTED = "rejected"


class Opinion(BaseModel):
    """What is said: a verdict, and with CORRECTED the box and the class that are right.

    Raises ValidationError where box or class are missing with CORRECTED, or given with another verdict,
    or the box is none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    verdict: Verdict
    box: BoxDetails | None = None
    category: str | None = Field(None, min_length=1, max_length=64, pattern=r"^[^\s\x00]+$")

    def model_post_init(self, _: object) -> None:
        corrected = self.verdict is Verdict.CORRECTED
        if corrected != (self.box is not None) or corrected != (self.category is not None):
            raise ValueError("box and category belong to the verdict 'corrected', and to no other.")
        if self.box is not None:
            sides = (self.box.length_m, self.box.width_m, self.box.height_m)
            places = (*self.box.center_cam, self.box.rotation_y)
            if not all(0 < side <= _LONGEST_SIDE_M for side in sides):
                raise ValueError(f"the sides of a box are between 0 and {_LONGEST_SIDE_M:g} m.")
            if not all(abs(place) <= _FARTHEST_M for place in places):
                raise ValueError(f"a box lies within {_FARTHEST_M:g} m of the camera.")


class Correction(BaseModel):
    """An opinion with its author and time: the `revision`-th, from 1, of this object in its label set.

    request_id: made by whoever sent it, so that it can be sent again without counting twice. sequence: rises
    with every correction of the store.
    """

    model_config = ConfigDict(frozen=True)

    sequence: int
    frame: str
    object_index: int
    revision: int
    opinion: Opinion
    author: str
    made_at: datetime
    request_id: str


class CorrectionConflictError(BoxliftError):
    """Somebody else spoke since: `latest` is what they said (None: nothing is known of the object)."""

    def __init__(self, latest: Correction | None) -> None:
        by = "nobody" if latest is None else latest.author
        super().__init__(f"The object was changed in the meantime, by {by}.")
        self.latest = latest
