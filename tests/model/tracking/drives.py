"""Generated drives, labelled frame by frame, as a tracker reads them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

from boxlift.boxes import Boxes3D
from boxlift.datasets.generated import (
    KITTI_RIG,
    DriveSettings,
    GeneratedSweep,
    SceneSettings,
    generate_drive,
)
from boxlift.errors import NoLidarError
from boxlift.formats.details import (
    FrameDetails,
    ObjectDetails,
    boxes3d_of_details,
    details_of,
    view_details_of,
)
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.frame import Frame, Prompt
from boxlift.labeller import Labeller
from boxlift.overlap import iou_3d
from boxlift.tracking import SweepFrames

# A quarter of the rays: enough for cars within 40 m.
SMALL_RIG = replace(KITTI_RIG, azimuth_step_deg=0.35)


@dataclass(frozen=True)
class Drive:
    """What was generated, and what the labeller made of each frame. Reads as a DriveReader."""

    sweeps: tuple[GeneratedSweep, ...]
    labelled: dict[str, FrameDetails]
    unreadable: frozenset[str] = frozenset()
    loaded: list[str] = field(default_factory=list)

    @property
    def frames(self) -> list[SweepFrames]:
        """In the order of time."""
        return [
            SweepFrames((each.generated.frame.name,), round(1e8) * number)
            for number, each in enumerate(self.sweeps)
        ]

    def details(self, name: str) -> FrameDetails:
        return self.labelled[name]

    def load(self, name: str, prompts: tuple[Prompt, ...]) -> Frame:
        self.loaded.append(name)
        if name in self.unreadable:
            raise NoLidarError("points", f"frame {name!r} is gone.", "Skip it.")
        (frame,) = (e.generated.frame for e in self.sweeps if e.generated.frame.name == name)
        return replace(frame, prompts=prompts, instance_ids=None, image=None)

    def without(self, *dropped: tuple[str, int]) -> Drive:
        """The same without the prompts (frame, number), as a detector may miss them."""
        labelled = {
            name: details.model_copy(
                update={
                    "objects": tuple(
                        each for number, each in enumerate(details.objects) if (name, number) not in dropped
                    )
                }
            )
            for name, details in self.labelled.items()
        }
        return replace(self, labelled=labelled)


@cache
def drive(seed: int, sweeps: int = 14, people: float = 1.0) -> Drive:
    """The drive of a seed, the same object each time: not to be changed."""
    settings = DriveSettings(sweeps=sweeps, scene=SceneSettings(people=people))
    made = tuple(generate_drive(seed, SMALL_RIG, settings, with_images=False))
    labeller = Labeller()
    labelled = {}
    for each in made:
        frame = replace(each.generated.frame, instance_ids=None)
        details = details_of(labeller.label(frame))
        assert frame.view is not None
        labelled[frame.name] = details.model_copy(update={"view": view_details_of(frame.view)})
    return Drive(made, labelled)


def box_of(item: ObjectDetails) -> Boxes3D | None:
    """The box of one object's details."""
    return None if item.box is None else boxes3d_of_details([item.box])


def overlaps(sweep: GeneratedSweep, details: FrameDetails) -> dict[int, float]:
    """Track of the truth -> 3D IoU of the box of its prompt with it."""
    found = {}
    for number, (track, line) in enumerate(sweep.tracked):
        box = box_of(details.objects[number])
        found[track] = 0.0 if box is None else float(iou_3d(box, boxes3d_of([line]))[0])
    return found
