"""docs/calibration-mistakes.md and its pictures: what `boxlift show` draws of a wrong calibration."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from PIL import Image

from boxlift.camera import Calibration
from boxlift.datasets.generated import KITTI_RIG, generate, generate_drive
from boxlift.drawing import draw_frame
from boxlift.frame import Frame
from boxlift.object_points import points_in_image
from boxlift.priors import SIZE_PRIORS
from boxlift.rig_check import check_rig
from rig_check import WRONG, in_millimetres, rotation, with_rotation, with_transform

_SEED = 11
# A LiDAR above and behind the camera, turned a little, as real ones are.
_RIG = replace(KITTI_RIG, lidar_turn_deg=(0.6, -1.1, 1.4), lidar_in_cam_m=(0.3, -0.4, -0.7))
_WIDTH_PX, _QUALITY = 960, 80
_HEAD = """# Calibration mistakes, and how they look

`boxlift show DATASET NAME --out NAME.png` draws the points onto the image, red near and blue far, before
anything is labelled. These are its pictures of one generated frame, right and with the mistakes that people
make. What boxlift itself says is what `boxlift label`, the HTTP answer and the review page say of that frame,
2D boxes given.

"""


@dataclass(frozen=True)
class _Mistake:
    """What was done to a right frame, and where to look."""

    name: str
    title: str
    look: str
    done: Callable[[Frame], Frame]


def _focal_length(frame: Frame) -> Frame:
    projection = frame.calibration.image_P_cam.copy()
    projection[[0, 1], [0, 1]] *= 1.08
    return replace(frame, calibration=Calibration(projection, frame.calibration.cam_SE3_velo))


def _translation_turned(frame: Frame) -> Frame:
    cam_SE3_velo = frame.calibration.cam_SE3_velo.copy()
    cam_SE3_velo[:3, 3] *= -1
    return with_transform(frame, cam_SE3_velo)


def _turned(frame: Frame) -> Frame:
    turn = rotation(1, np.deg2rad(2.0))
    return with_rotation(frame, turn @ frame.calibration.cam_SE3_velo[:3, :3])


def _half_size(frame: Frame) -> Frame:
    halved = WRONG["image/2"](frame)
    assert frame.image is not None
    small = Image.fromarray(frame.image).resize(halved.image_size_px)
    return replace(halved, image=np.asarray(small))


def _another_moment(frame: Frame) -> Frame:
    """The frame's own scene is of one moment: a drive's image with the points of half a second before."""
    del frame
    sweeps = [sweep.generated.frame for sweep in islice(generate_drive(_SEED, _RIG), 6)]
    return replace(sweeps[5], points_velo=sweeps[0].points_velo)


_MISTAKES = (
    _Mistake(
        "right",
        "Right",
        "Every object wears its points like a skin; edges of depth lie on the edges in the image.",
        lambda frame: frame,
    ),
    _Mistake(
        "turned",
        "The rotation is two degrees off",
        "All points are off by the same way and the same number of pixels, near and far alike: see "
        "the poles and the edges of the houses. At 20 m two degrees are 70 cm. The data do not tell, only "
        "the eye does.",
        _turned,
    ),
    _Mistake(
        "sign",
        "The translation has the wrong sign",
        "What is far fits, what is near does not: the nearer, the more.",
        _translation_turned,
    ),
    _Mistake(
        "focal",
        "The focal length is of another image size, or the lens's distortion was not taken out",
        "Points fit in the middle of the image and drift outwards (or inwards) towards its edges.",
        _focal_length,
    ),
    _Mistake(
        "moment",
        "Image and sweep are half a second apart",
        "Everything is too large or too small around the point that the vehicle drives to; what moves by "
        "itself is off by another way than what stands.",
        _another_moment,
    ),
    _Mistake(
        "half",
        "The image was halved, P2 was not",
        "Points fall into the image as if it were the upper left quarter of a larger one.",
        _half_size,
    ),
    _Mistake(
        "degrees",
        "Angles in degrees were read as radians",
        "Points are somewhere, turned in a way that nothing in the image explains.",
        WRONG["deg>rad"],
    ),
    _Mistake(
        "inverted",
        "The transform is inverted (camera to LiDAR instead of LiDAR to camera)",
        "Rings of the ground stand upright, or no point is seen at all.",
        WRONG["inverted"],
    ),
    _Mistake(
        "axes",
        "Axes are left as the LiDAR's (x forward, z up) and not turned into the camera's",
        "The same: the world lies on its side.",
        WRONG["axes"],
    ),
    _Mistake(
        "millimetres",
        "The translation is in millimetres",
        "Few points or none; those that are seen are far away.",
        in_millimetres,
    ),
)


def made() -> dict[str, str | bytes]:
    """The page, and a picture for every mistake, by their paths below docs/."""
    right = generate(_SEED, _RIG).frame
    files: dict[str, str | bytes] = {}
    page = [_HEAD]
    for mistake in _MISTAKES:
        frame = mistake.done(right)
        shown = "No point falls into the image."
        if len(points_in_image(frame).cam):
            picture = f"pictures/calibration/{mistake.name}.jpg"
            files[picture] = _picture(frame)
            shown = f"![{mistake.title}]({picture})"
        said = [warning.sentence for warning in check_rig(frame, SIZE_PRIORS)]
        says = " ".join(said) if said else "nothing."
        page.append(f"## {mistake.title}\n\n{mistake.look}\n\n{shown}\n\n*boxlift says:* {says}\n\n")
    page.append(
        "How often mistakes are noticed on real frames: `python benchmarks/rig_check.py`, and the README.\n"
    )
    files["calibration-mistakes.md"] = "".join(page)
    return files


def _picture(frame: Frame) -> bytes:
    """The image's part of what `boxlift show` draws, as JPEG."""
    bare = replace(frame, prompts=(), instance_ids=None)
    drawn = Image.fromarray(draw_frame(bare))
    width, height = frame.image_size_px
    drawn = drawn.crop((0, 0, drawn.width, round(height * drawn.width / width)))
    drawn = drawn.resize((_WIDTH_PX, round(drawn.height * _WIDTH_PX / drawn.width)))
    file = io.BytesIO()
    drawn.save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()
