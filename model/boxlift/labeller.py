"""The labeller: frames in, labels out."""

from __future__ import annotations

from boxlift.accurate import label_accurately
from boxlift.faithful import label_faithfully
from boxlift.frame import Frame, FrameLabels
from boxlift.rig_check import check_rig
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift.stage_times import StageTimes

__all__ = ["Labeller", "StageTimes"]


class Labeller:
    """2D boxes and LiDAR in, 3D boxes out, by the losses of WeakM3D and without any training."""

    def __init__(self, settings: LabellerSettings = ACCURATE) -> None:
        self.settings = settings

    def label(self, frame: Frame, times: StageTimes | None = None) -> FrameLabels:
        """Label every prompt of a frame: a box, or the sentence why there is none."""
        times = times or StageTimes()
        with times.stage("rig"):
            warnings = check_rig(frame, self.settings.sizes)
        label = label_faithfully if self.settings.repairs is None else label_accurately
        return FrameLabels(frame.name, label(frame, self.settings, times), warnings)
