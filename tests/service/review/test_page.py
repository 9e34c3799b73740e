"""The review page in a real browser, on frames that are dropped onto it."""

from __future__ import annotations

import hashlib
import json
import random
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Dialog, Page, Response, ViewportSize, expect, sync_playwright

from boxlift.datasets.generated import generate, write_dataset
from boxlift_service.guards.api_keys import add_key, new_key
from service.frames import WIDTH, SmallFrame
from service.review.label_sets import ACCEPTED, REJECTED, correct, drop
from service.running import RunningService, running_service

_ROOT = Path(__file__).parents[3]
# A sandbox of its own is nothing that root may have; the rest keeps the browser from calling home.
_SWITCHES = [
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-quic",
]
_LAPTOP: ViewportSize = {"width": 1366, "height": 768}


@pytest.fixture(scope="module")
def browser(chromium: Path) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=chromium, args=_SWITCHES)
        yield opened
        opened.close()


@contextmanager
def page_of(browser: Browser, service: RunningService, place: str = "", **options: Any) -> Iterator[Page]:
    """The page in a session of its own; in the end nothing may have gone wrong in it or left the machine."""
    context = browser.new_context(viewport=_LAPTOP, **options)
    page = context.new_page()
    wrong: list[str] = []
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda request: _note_foreign(request.url, service.url, wrong))
    page.goto(f"{service.url}/{place}")
    yield page
    context.close()
    # A browser logs every answer of 409, and being offline, as an error; the page shows both.
    assert [each for each in wrong if "409" not in each and "ERR_INTERNET_DISCONNECTED" not in each] == []


def _note_foreign(url: str, own: str, wrong: list[str]) -> None:
    if not url.startswith((own, "blob:", "data:")):
        wrong.append(f"asked {url}")


def frame_place(name: str) -> str:
    return f"#set=labels/dropped&frame={name}&object=0"


def wait_until_saved(page: Page) -> None:
    expect(page.locator("html")).to_have_attribute("data-saved", "true", timeout=60_000)


def test_upload_correct_reload_find(
    browser: Browser, reviewed: RunningService, folder: Path, tmp_path: Path
) -> None:
    """As a person would: choose the three files, see boxes, correct one, come back."""
    write_dataset(tmp_path, [generate(3)])
    files = [next((tmp_path / "training" / kind).iterdir()) for kind in ("velodyne", "calib", "image_2")]
    with page_of(browser, reviewed) as page:
        page.get_by_label("Your name").fill("ann")
        page.get_by_label("Your name").press("Enter")
        page.get_by_label("Add a frame").set_input_files(files)
        expect(page.locator("#status")).to_contain_text("have a box", timeout=60_000)
        expect(page.locator("#object-title")).to_contain_text("of 000000")
        box = page.locator("#facts dt:has-text('Box') + dd")
        before = box.inner_text()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Shift+ArrowUp")
        page.keyboard.press("f")
        expect(box).not_to_have_text(before)
        wait_until_saved(page)
        expect(page.locator("#status")).to_contain_text("Saved")
        corrected = box.inner_text()
        page.reload()
        expect(box).to_have_text(corrected)
        expect(page.locator("#facts")).to_contain_text("corrected by ann")
        page.keyboard.press("u")
        expect(box).to_have_text(before)
        wait_until_saved(page)
    (kept,) = (folder / "dropped" / "details").glob("000000.json")
    places = [each["box"]["center_cam"][0] for each in json.loads(kept.read_text())["objects"] if each["box"]]
    assert any(f"at {place:.2f}," in before for place in places)


def test_wrong_files_are_told(browser: Browser, reviewed: RunningService, tmp_path: Path) -> None:
    (tmp_path / "points.bin").write_bytes(bytes(160))
    (tmp_path / "notes.md").write_text("no frame")
    with page_of(browser, reviewed) as page:
        page.get_by_label("Add a frame").set_input_files(tmp_path / "points.bin")
        expect(page.locator("#status")).to_contain_text("calib and image missing")
        page.get_by_label("Add a frame").set_input_files(tmp_path / "notes.md")
        expect(page.locator("#status")).to_contain_text("notes.md is none of points")


def test_every_key_does_what_the_help_says(
    browser: Browser, reviewed: RunningService, frame: SmallFrame
) -> None:
    drop(reviewed, frame, "keys")
    with page_of(browser, reviewed, frame_place("keys")) as page:
        box = page.locator("#facts dt:has-text('Box') + dd")
        expect(page.locator("#object-title")).to_have_text("Object 0 of keys")
        place = r"at (-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m; ([\d.]+) × ([\d.]+) × ([\d.]+) m; (-?[\d.]+)°"

        def numbers() -> list[float]:
            match = re.fullmatch(place, box.inner_text())
            assert match is not None
            return [float(each) for each in match.groups()]

        # x, y, z, length, width, height, degrees
        steps = {
            "ArrowRight": (0, 0.05), "ArrowLeft": (0, -0.05), "Shift+ArrowRight": (0, 0.5),
            "PageDown": (1, 0.05), "PageUp": (1, -0.05), "ArrowUp": (2, 0.05), "ArrowDown": (2, -0.05),
            "]": (3, 0.05), "[": (3, -0.05), ".": (4, 0.05), ",": (4, -0.05), "=": (5, 0.05), "-": (5, -0.05),
            "e": (6, 1.0), "q": (6, -1.0),
        }  # fmt: skip
        for key, (which, step) in steps.items():
            before, text = numbers(), box.inner_text()
            page.keyboard.press(key)
            expect(box).not_to_have_text(text)
            expected = [value + (step if at == which else 0) for at, value in enumerate(before)]
            assert numbers() == pytest.approx(expected, abs=0.011), key
        page.keyboard.press("c")
        expect(page.get_by_label("Class")).to_be_focused()
        page.get_by_label("Class").select_option("Van")
        wait_until_saved(page)
        page.keyboard.press("r")
        expect(page.locator("#facts")).to_contain_text("rejected")
        page.keyboard.press("?")
        expect(page.get_by_role("dialog")).to_contain_text("Flip heading")
        page.keyboard.press("Escape")
        wait_until_saved(page)
    said = reviewed.client.get("/review/corrections", params={"set": "labels/dropped"}).json()
    verdicts = [each["opinion"]["verdict"] for each in said if each["frame"] == "keys"]
    assert verdicts[-1] == "rejected"
    assert "Van" in {each["opinion"]["category"] for each in said if each["frame"] == "keys"}


def test_two_people_lose_nothing(browser: Browser, reviewed: RunningService, frame: SmallFrame) -> None:
    drop(reviewed, frame, "shared")
    with (
        page_of(browser, reviewed, frame_place("shared")) as ann,
        page_of(browser, reviewed, frame_place("shared")) as bob,
    ):
        for page, name in ((ann, "ann"), (bob, "bob")):
            expect(page.locator("#object-title")).to_have_text("Object 0 of shared")
            page.get_by_label("Your name").fill(name)
            page.get_by_label("Your name").press("Tab")
        ann.keyboard.press("ArrowRight")
        wait_until_saved(ann)
        # Bob has not heard of it yet, or just has: either his edit is refused, or it builds on hers.
        bob.keyboard.press("a")
        expect(bob.locator("#status")).to_contain_text(re.compile("Theirs is shown|Saved|nothing more"))
        expect(bob.locator("#facts")).to_contain_text(re.compile("by (ann|bob)"))
    said = reviewed.client.get("/review/corrections", params={"set": "labels/dropped"}).json()
    shared = [each for each in said if each["frame"] == "shared"]
    assert shared[0]["author"] == "ann"
    assert [each["revision"] for each in shared] == list(range(1, len(shared) + 1))


def test_a_conflict_shows_what_the_other_said(
    browser: Browser, reviewed: RunningService, frame: SmallFrame
) -> None:
    drop(reviewed, frame, "conflict")
    with page_of(browser, reviewed, frame_place("conflict")) as page:
        expect(page.locator("#object-title")).to_have_text("Object 0 of conflict")
        # Between two heartbeats of the page, somebody else is faster.
        page.route("**/review/heartbeat", lambda route: route.abort())
        assert correct(reviewed.client, "conflict", REJECTED, author="bob").status_code == 201
        page.keyboard.press("ArrowRight")
        expect(page.locator("#facts")).to_contain_text("rejected by bob")
        said = reviewed.client.get("/review/corrections", params={"set": "labels/dropped"}).json()
        assert [each["author"] for each in said if each["frame"] == "conflict"] == ["bob"]
        page.unroute("**/review/heartbeat")
        page.goto("about:blank")


def test_a_name_is_no_script(browser: Browser, reviewed: RunningService, frame: SmallFrame) -> None:
    drop(reviewed, frame, "script")
    name = "<img src=x onerror=alert(1)>"
    assert correct(reviewed.client, "script", ACCEPTED, author=name).status_code == 201
    with page_of(browser, reviewed, frame_place("script")) as page:
        expect(page.locator("#facts")).to_contain_text(f"accepted by {name}")
        assert page.locator("#facts img").count() == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(
    browser: Browser, reviewed: RunningService, frame: SmallFrame, scheme: str
) -> None:
    drop(reviewed, frame, "axe")
    with page_of(browser, reviewed, frame_place("axe"), color_scheme=scheme) as page:
        expect(page.locator("#object-title")).to_have_text("Object 0 of axe")
        for dialog in ("", "#help"):
            if dialog:
                page.locator(dialog).click()
            violations = Axe().run(page).response["violations"]
            serious = [each for each in violations if each["impact"] in ("serious", "critical")]
            assert [(each["id"], each["nodes"][0]["html"]) for each in serious] == []


def test_the_page_asks_for_the_key(browser: Browser, tmp_path: Path) -> None:
    secret, key = new_key("studio")
    add_key(tmp_path / "keys", key)
    with running_service(label_sets=str(tmp_path), api_keys=str(tmp_path / "keys")) as service:
        context = browser.new_context()
        page = context.new_page()
        page.goto(service.url)
        dialog = page.get_by_role("dialog")
        for given, sentence in (("wrong", "not known here"), (secret, "")):
            dialog.get_by_label("Key").fill(given)
            dialog.get_by_role("button").click()
            if sentence:
                expect(dialog).to_contain_text(sentence)
        expect(dialog).to_be_hidden()
        expect(page.get_by_label("Your name")).to_have_value("studio")
        context.close()


def test_corrections_that_the_page_confirmed_outlive_a_kill(
    browser: Browser, tmp_path: Path, frame: SmallFrame
) -> None:
    """100 corrections; the server dies at a random moment and comes back, and the page goes on by itself."""
    seed = random.randrange(10**6)
    fate = random.Random(seed)
    labels = str(tmp_path / "labels")
    confirmed: list[str] = []

    def note(response: Response) -> None:
        if response.url.endswith("/review/corrections") and response.status == 201:
            confirmed.append(json.loads(response.request.post_data or "")["request_id"])

    with running_service(label_sets=labels) as service:
        port = service.url.rsplit(":", 1)[1]
        drop(service, frame, "many", cars=2)
        context = browser.new_context()
        page = context.new_page()
        page.on("response", note)
        page.goto(f"{service.url}/{frame_place('many')}")
        expect(page.locator("#object-title")).to_have_text("Object 0 of many")
        killed_at = fate.randrange(20, 80)
        for count in range(100):
            if count == killed_at:
                time.sleep(fate.random() * 0.05)
                service.process.send_signal(signal.SIGKILL)
                service.process.wait()
            page.keyboard.press("r")
            page.wait_for_timeout(10)
    assert confirmed, f"seed {seed}"
    with running_service(label_sets=labels, port=port) as service:
        wait_until_saved(page)
        said = service.client.get("/review/corrections", params={"set": "labels/dropped"}).json()
        context.close()
    kept = [each["request_id"] for each in said]
    assert set(confirmed) <= set(kept), f"seed {seed}"
    assert len(kept) == len(set(kept)) == 100, f"seed {seed}"


def test_by_mouse_by_link_and_on_a_narrow_screen(
    browser: Browser, reviewed: RunningService, frame: SmallFrame
) -> None:
    other = {"class": "Pedestrian", "box": [100, 150, 160, 250]}
    drop(reviewed, frame, "mouse", more=[other])
    drop(reviewed, frame, "linked")
    with page_of(browser, reviewed, frame_place("mouse")) as page:
        title = page.locator("#object-title")
        expect(title).to_have_text("Object 0 of mouse")
        image = page.locator("#image").bounding_box()
        assert image is not None
        scale = image["width"] / WIDTH
        page.mouse.click(image["x"] + 130 * scale, image["y"] + 200 * scale)
        expect(title).to_have_text("Object 1 of mouse")
        above = page.locator("#birds-eye")
        at = above.bounding_box()
        assert at is not None
        middle = at["x"] + at["width"] / 2, at["y"] + at["height"] / 2
        seen = [above.screenshot()]
        page.mouse.move(*middle)
        page.mouse.wheel(0, -400)
        page.wait_for_timeout(300)
        seen.append(above.screenshot())
        page.mouse.down()
        page.mouse.move(middle[0] + 60, middle[1] + 40, steps=3)
        page.mouse.up()
        page.wait_for_timeout(300)
        seen.append(above.screenshot())
        assert len(set(seen)) == 3
        page.evaluate("place => { location.hash = place; }", frame_place("linked"))
        expect(title).to_have_text("Object 0 of linked")
        files = page.evaluate_handle(
            """() => {
                const files = new DataTransfer();
                files.items.add(new File(["?"], "notes.doc"));
                return files;
            }"""
        )
        page.dispatch_event("main", "drop", {"dataTransfer": files})
        expect(page.locator("#status")).to_contain_text("notes.doc is none of points")
        page.set_viewport_size({"width": 600, "height": 800})
        page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= 600


def test_without_the_service_nothing_is_lost(
    browser: Browser, reviewed: RunningService, frame: SmallFrame
) -> None:
    """What could not be sent is sent when the service is back; whoever leaves before is asked."""
    drop(reviewed, frame, "offline")
    with page_of(browser, reviewed, frame_place("offline")) as page:
        expect(page.locator("#object-title")).to_have_text("Object 0 of offline")
        page.context.set_offline(True)
        page.keyboard.press("r")
        expect(page.locator("#status")).to_contain_text("the service does not answer", timeout=15_000)
        asked: list[str] = []

        def stay(dialog: Dialog) -> None:
            asked.append(dialog.type)
            dialog.dismiss()

        page.on("dialog", stay)
        page.close(run_before_unload=True)
        page.wait_for_timeout(500)
        assert asked == ["beforeunload"]
        page.context.set_offline(False)
        wait_until_saved(page)
    said = reviewed.client.get("/review/corrections", params={"set": "labels/dropped"}).json()
    assert [each["opinion"]["verdict"] for each in said if each["frame"] == "offline"] == ["rejected"]


def test_the_built_page_is_of_these_sources() -> None:
    """See service/review_page/build.mjs."""
    page = _ROOT / "service" / "review_page"
    digest = hashlib.sha256()
    for path in sorted((page / "src").iterdir()):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    digest.update((page / "package-lock.json").read_bytes())
    built = _ROOT / "service" / "boxlift_service" / "review" / "static"
    assert (built / "page.js").read_text().startswith(f"// sources {digest.hexdigest()}\n")
