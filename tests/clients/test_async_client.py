from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from boxlift.datasets import load_prompts, open_source
from boxlift.errors import InputError
from boxlift.formats.details import details_of
from boxlift.formats.image import decode_image
from boxlift.frame import Frame
from boxlift.labeller import Labeller
from boxlift.settings import RELEASE
from boxlift_client.async_client import AsyncClient
from boxlift_client.client import Client
from boxlift_client.errors import ServiceUnreachableError
from clients.scripted import Scripted, scripted


@pytest.fixture(scope="module")
def frame(dataset: Path) -> Frame:
    source = open_source(dataset)
    return source.load("000002", load_prompts("label_2", source, "000002"))


def test_both_clients_have_the_same_methods() -> None:
    def calls(client: type) -> dict[str, list[inspect.Parameter]]:
        return {
            name: [parameter.replace(annotation=None) for parameter in _parameters(method)]
            for name, method in vars(client).items()
            if callable(method) and (not name.startswith("_") or name == "__init__")
        }

    assert calls(AsyncClient) == calls(Client)
    assert "label_batch" in calls(Client)


def test_frames_files_and_images(dataset: Path, service_url: str, frame: Frame) -> None:
    split = dataset / "training"
    image, calib = split / "image_2" / "000002.png", split / "calib" / "000002.txt"
    pixels = decode_image(image)

    async def ask() -> None:
        async with AsyncClient(f"{service_url}/") as client:
            assert client.base_url == service_url
            await client.wait_until_ready()
            assert await client.health()
            assert await client.ready()
            labelled, by_files, detected, picture = await asyncio.gather(
                client.label(frame, RELEASE),
                client.label_files(
                    split / "velodyne" / "000002.bin",
                    calib,
                    frame.prompts,
                    image=image,
                    options={"preset": "release"},
                ),
                client.detect_files([image], [calib]),
                client.detect(pixels, frame.calibration),
            )
        assert labelled.details == details_of(Labeller(RELEASE).label(frame))
        assert by_files.frame == "000002"
        assert len(by_files.objects) == len(frame.prompts)
        assert detected.images[0].objects == picture.images[0].objects

    asyncio.run(ask())


def test_frames_may_come_from_a_loop_or_from_files(service_url: str, frame: Frame) -> None:
    async def from_a_loop() -> AsyncIterator[Frame]:
        for _ in range(2):
            await asyncio.sleep(0)
            yield frame

    def that_fail() -> Iterator[Frame]:
        yield frame
        raise InputError("frames", "the disk is gone.", "Mount it.")

    async def ask() -> None:
        async with AsyncClient(service_url) as client:
            outcomes = [outcome async for outcome in client.label_batch(from_a_loop(), RELEASE)]
            assert sorted(outcome.index for outcome in outcomes) == [0, 1]
            with pytest.raises(InputError, match="the disk is gone"):
                [outcome async for outcome in client.label_batch(that_fail(), RELEASE)]

    asyncio.run(ask())


def test_the_loop_goes_on_while_a_client_waits_to_ask_again() -> None:
    busy = Scripted(503, b"{}", {"retry-after": "30"})

    async def ask() -> None:
        async with AsyncClient(script.url) as client:
            asking = asyncio.create_task(client.label_files(b"", b""))
            while not script.asked:
                await asyncio.sleep(0.01)
            asking.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asking

    with scripted(busy) as script:
        asyncio.run(ask())
    assert len(script.asked) == 1


def test_nobody_answers() -> None:
    async def ask() -> None:
        async with AsyncClient("http://127.0.0.1:9") as client:
            assert not await client.health()
            with pytest.raises(ServiceUnreachableError, match="no boxlift service answers"):
                await client.wait_until_ready(60)

    asyncio.run(ask())


def _parameters(method: object) -> list[inspect.Parameter]:
    assert callable(method)
    return list(inspect.signature(method).parameters.values())
