"""Recognition: the files of a sweep are fetched, each camera's objects are labelled, and told once.

What Xtreme1 sends and what it reads: github.com/xtreme1-io/xtreme1, backend/src/main/java/ai/basic/x1/
adapter/api/job/converter, PointCloudDetectionModelReqConverter.java and ModelResultConverter.java; and its
documentation, developer-reference/model-integration-guide.md.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import unquote

from boxlift.camera import Calibration
from boxlift.errors import CalibrationError, InputError
from boxlift.formats.calibration import to_kitti_text
from boxlift.formats.xtreme1 import Xtreme1Object, Xtreme1Results, merged, parse_camera_config
from boxlift_service.bodies.shared_parts import HeldBytes, Part, SharedParts
from boxlift_service.labelling.labelling import Labelling
from boxlift_service.labelling.tasks import AnswerFormat, LabelledFrame
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.recognition.answers import RecognisedData, failed, recognised
from boxlift_service.recognition.fetching import Fetcher
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.timing import RequestTimes
from boxlift_service.workers.deadline import Deadline, within

_log = logging.getLogger(__name__)

_LARGEST_CONFIG_BYTES = 2**20
_LONGEST_ID = 100
_LARGEST_ID = 2**63
# The folder of a camera's images in Xtreme1, now and in older versions.
_CAMERA_FOLDER = re.compile(r"(?:camera_)?image_?([0-9]{1,3})", re.ASCII)


@dataclass(frozen=True)
class _Image:
    """An image of a sweep: by which camera, where, and what errors call it."""

    camera: int
    url: str
    field: str


@dataclass(frozen=True)
class _Sweep:
    """One of the data of a request."""

    id: int | str
    point_cloud_url: str
    images: tuple[_Image, ...]
    camera_config_url: str


class Recognition:
    """Finds the objects of sweeps by `labelling`, in files from `fetcher`."""

    def __init__(
        self, labelling: Labelling, fetcher: Fetcher, settings: ServiceSettings, held: HeldBytes
    ) -> None:
        self._labelling = labelling
        self._fetcher = fetcher
        self._largest = settings.max_body_bytes
        self._most_images = settings.max_images
        self._held = held
        # One sweep more than can be labelled is fetched; the others wait as the few URLs that they are.
        self._places = asyncio.Semaphore(settings.label_workers + 1)

    async def recognise(
        self, data: object, times: RequestTimes, results: Counter[str], deadline: Deadline | None
    ) -> RecognisedData:
        """The objects of one of the data, or what went wrong with it. `times` and `results` are added to."""
        data_id = _id_of(data)
        try:
            sweep = _parse_sweep(data, self._most_images)
            async with within(deadline), self._places:
                objects, message = await self._objects_of(sweep, times, results, deadline)
            return recognised(data_id, objects, message)
        except (InputError, ProblemError) as error:
            return failed(data_id, error)
        # The last net: each of the data fails by itself, even for a reason that is ours.
        except Exception:
            _log.exception("a sweep was not recognised")
            problem, remedy = "It failed for a reason that is ours.", "The service's log holds the cause."
            return failed(data_id, ProblemError(Kind.INTERNAL_ERROR, problem, remedy))

    async def _objects_of(
        self, sweep: _Sweep, times: RequestTimes, results: Counter[str], deadline: Deadline | None
    ) -> tuple[list[Xtreme1Object], str]:
        """The objects, and doubts about the cameras; one after the other: of all images one is held."""
        config = await self._fetched(
            sweep.camera_config_url, "cameraConfigUrl", times, min(_LARGEST_CONFIG_BYTES, self._largest)
        )
        calibrations = await asyncio.to_thread(_calibrations, config, sweep.images)
        points = await self._fetched(sweep.point_cloud_url, "pointCloudUrl", times, self._largest)
        cloud = Part(points, _path_of(sweep.point_cloud_url)[-1])
        cameras, doubts = [], []
        for image, calibration in calibrations:
            parts = {
                "points": (cloud,),
                "calib": (Part(to_kitti_text(calibration).encode()),),
                "image": (Part(await self._fetched(image.url, image.field, times, self._largest)),),
                "name": (Part(f"{sweep.id} camera {image.camera}".encode()),),
            }
            labelled = await self._labelled(parts, image, times, deadline)
            results.update(labelled.results)
            found: Xtreme1Results = json.loads(labelled.content)
            cameras.append(found["objects"])
            doubts += [f"Camera {image.camera}: {warning}" for warning in found["warnings"]]
        return await asyncio.to_thread(merged, cameras), " ".join(doubts)

    async def _fetched(self, url: str, field: str, times: RequestTimes, max_bytes: int) -> bytes:
        with _added(times) as own_times, own_times.stage("fetch"):
            return await self._fetcher.fetch(url, field, max_bytes)

    async def _labelled(
        self,
        parts: Mapping[str, Sequence[Part]],
        image: _Image,
        times: RequestTimes,
        deadline: Deadline | None,
    ) -> LabelledFrame:
        try:
            with _added(times) as own_times, SharedParts.of(parts, self._held) as shared:
                return await self._labelling.label(
                    shared, AnswerFormat.XTREME1, own_times, wait=True, deadline=deadline
                )
        except InputError as error:
            raise _named_as_sent(error, image) from None


def _id_of(data: object) -> int | str | None:
    """The id of one of the data, None where it has none that could be told again."""
    match data.get("id") if isinstance(data, dict) else None:
        case bool():
            return None
        case int(number) if abs(number) < _LARGEST_ID:
            return number
        case str(text) if 0 < len(text) <= _LONGEST_ID and text.isprintable():
            return text
    return None


def _parse_sweep(data: object, max_images: int) -> _Sweep:
    """Raises InputError that names the key at fault."""
    if not isinstance(data, dict):
        raise InputError("datas", f"{data!r:.60} is no object.", "Give id, pointCloudUrl, imageUrls, ...")
    data_id = _id_of(data)
    if data_id is None:
        remedy = f"Give a whole number or 1 to {_LONGEST_ID} printable characters."
        raise InputError("id", f"{data.get('id')!r:.60} is no id.", remedy)
    urls = data.get("imageUrls") or []
    if not isinstance(urls, list) or not all(isinstance(url, str) for url in urls):
        raise InputError("imageUrls", f"{urls!r:.60} is no list of URLs.", "Give the images' URLs.")
    if not urls:
        raise InputError(
            "imageUrls",
            "there is no image.",
            "Give sweeps with cameras: objects are found in the images and lifted by the points.",
        )
    if len(urls) > max_images:
        raise InputError("imageUrls", f"there are {len(urls)} images.", f"Give at most {max_images}.")
    images = zip(_cameras_of(urls), urls, strict=True)
    return _Sweep(
        id=data_id,
        point_cloud_url=_url_of(data, "pointCloudUrl"),
        images=tuple(_Image(n, url, f"imageUrls[{i}]") for i, (n, url) in enumerate(images)),
        camera_config_url=_url_of(data, "cameraConfigUrl"),
    )


def _url_of(data: Mapping[str, object], key: str) -> str:
    url = data.get(key)
    if not isinstance(url, str):
        raise InputError(key, f"{url!r:.60} is no URL.", "Give the URL of the file.")
    return url


def _cameras_of(urls: Sequence[str]) -> Sequence[int]:
    """Which camera each image is of: as all their folders say, else as they come.

    Folders come in the order of their names, in which camera_image_10 is before camera_image_2.
    """
    folders = [_CAMERA_FOLDER.fullmatch(folder) for url in urls for folder in _path_of(url)[-2:-1]]
    numbers = [int(found[1]) for found in folders if found is not None]
    return numbers if len(set(numbers)) == len(urls) else range(len(urls))


def _path_of(url: str) -> list[str]:
    """What stands between the slashes of a URL, at least one text."""
    return [unquote(segment) for segment in url.partition("?")[0].split("/")]


def _calibrations(config: bytes, images: Sequence[_Image]) -> list[tuple[_Image, Calibration]]:
    """The images whose camera the configuration describes; the others are skipped, as Xtreme1 does.

    Intrinsics are in pixels of the image as it is: like the tool, this passes over `width` and `height`.
    """
    cameras = dict(enumerate(parse_camera_config(config, "cameraConfigUrl")))
    found = [
        (image, parsed.calibration) for image in images if (parsed := cameras.get(image.camera)) is not None
    ]
    if not found:
        raise CalibrationError(
            "cameraConfigUrl",
            f"it describes none of the cameras {sorted(image.camera for image in images)} of the images.",
            "Give a list of cameras, each with camera_external of 16 numbers, camera 0 first.",
        )
    return found


def _named_as_sent(error: InputError, image: _Image) -> InputError:
    """An error that names a part of POST /label -> one that names what came with the request."""
    part, _, rest = error.field.partition(".")
    sent = {"points": "pointCloudUrl", "image": image.field, "calib": f"cameraConfigUrl[{image.camera}]"}
    where = f"{sent[part]}.{rest}".rstrip(".") if part in sent else error.field
    return InputError(where, error.problem, error.remedy)


@contextmanager
def _added(times: RequestTimes) -> Iterator[RequestTimes]:
    """Times of a part of a request, which are added to its own in the end."""
    own = RequestTimes()
    try:
        yield own
    finally:
        for stage, seconds in own.seconds.items():
            times.seconds[stage] = times.seconds.get(stage, 0.0) + seconds
