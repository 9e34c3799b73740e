"""What many frames of a drive know that one does not: objects tracked, seen from all sides, put back.

Sweeps are placed in the world (odometry), boxes of one object are linked (linking), its path is found
(paths), all that its frames saw is fused and fitted by the paper's losses (fused_fit), and every frame gets
the box (frame_pass).
"""

from boxlift.tracking.drive import DriveReader, Poses, SweepFrames
from boxlift.tracking.drive_tracker import DriveTracker
from boxlift.tracking.frame_pass import Fill
from boxlift.tracking.paths import Motion
from boxlift.tracking.tracked_objects import TrackedObject

__all__ = ["DriveReader", "DriveTracker", "Fill", "Motion", "Poses", "SweepFrames", "TrackedObject"]
