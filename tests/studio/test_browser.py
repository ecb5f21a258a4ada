"""The page in a headless browser, from its URL to a finished run.

TNST_MI_SHOTS may name a folder for pictures of it.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from studios import Studio, running

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.network.shipped import shipped_weights
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.masks import mask_tables

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = playwright.expect

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
if BROWSER is None:
    pytest.skip("there is no Chromium (apt-get install chromium)", allow_module_level=True)

#: Nothing is asked of the internet, and nothing of a GPU.
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
)

SIZES = ((1280, 720), (1920, 1080))

#: Milliseconds that anything on the page may take, such as a run on a busy machine.
PATIENCE = 60_000


@dataclass
class Page:
    """A page in the browser, and what went wrong on it."""

    page: Any
    troubles: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.page.set_default_timeout(PATIENCE)
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("console", self._heard)
        self.page.on("request", lambda request: self.hosts.add(request.url.split("/")[2].split(":")[0]))

    def _heard(self, message: Any) -> None:
        if message.type == "error":
            self.troubles.append(f"{message.text} {message.location['url']}")

    def view(self) -> np.ndarray:
        """The picture of the smoke, in [0, 1], without its edges, where there is text."""
        picture = Image.open(io.BytesIO(self.page.locator("#view").screenshot())).convert("L")
        return np.asarray(picture)[5:-40] / 255

    def settled(self) -> np.ndarray:
        """The picture once it is the one that is wanted."""
        # A page that has been resized hears of it with its next frame.
        self.page.wait_for_timeout(150)
        self.page.locator("#view[data-settled=yes]").wait_for()
        return self.view()

    def photographed(self, name: str) -> None:
        """Keep a picture of the page in the folder that TNST_MI_SHOTS names, in every size."""
        if folder := os.environ.get("TNST_MI_SHOTS"):
            for width, height in SIZES:
                self.page.set_viewport_size({"width": width, "height": height})
                self.settled()
                self.page.screenshot(path=f"{folder}/{name}_{width}x{height}.png")
            self.page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
            self.settled()

    def dragged(self, selector: str, right: int, down: int) -> None:
        """Drag from the middle of the left half of something."""
        box = self.page.locator(selector).bounding_box()
        x, y = box["x"] + box["width"] / 4, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        for step in range(1, 11):
            self.page.mouse.move(x + right * step / 10, y + down * step / 10)
            self.page.wait_for_timeout(20)
        self.page.mouse.up()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=BROWSER, args=list(FLAGS))
        yield started
        started.close()


@contextmanager
def studio_url(root: Path, out: Path, weights: Path) -> Iterator[str]:
    """The URL that the command prints; it ends as Ctrl-C would end it."""
    command = [sys.executable, "-m", "tnst_mi", "studio", str(root), "--out", str(out), "--weights", str(weights)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            word, url = process.stdout.readline().split()
            assert word == "studio" and url.startswith("http://127.0.0.1:")
            yield url
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A frame of smoke on the left side, that is no cube."""
    density = np.zeros((14, 20, 16), np.float32)
    density[3:11, 4:16, 2:8] = np.random.default_rng(0).random((8, 12, 6), np.float32)
    save_frames(tmp_path / "root", [Frame(density, name="smoke")])
    return tmp_path / "root"


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[[str], Page]]:
    """Opens pages at a URL, on which nothing may go wrong and which ask nobody but the studio."""
    contexts, pages = [], []

    def open_(url: str) -> Page:
        contexts.append(browser.new_context(viewport={"width": SIZES[0][0], "height": SIZES[0][1]}))
        pages.append(Page(contexts[-1].new_page()))
        pages[-1].page.goto(url)
        return pages[-1]

    yield open_
    for context in contexts:
        context.close()
    assert [page.troubles for page in pages] == [[] for _ in pages]
    assert {host for page in pages for host in page.hosts} <= {"127.0.0.1"}


def test_look_choose_try_and_compare(root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown = opened(url)
        page = shown.page
        # The token has left the address bar, and a tab without it sees nothing.
        assert page.url.endswith("/") and "token" not in page.url
        page.locator("#motifs img").first.wait_for()
        front = shown.settled()
        width = front.shape[1] // 2
        assert front[:, :width].sum() > 3 * front[:, width + 5 :].sum() > 0
        shown.photographed("1_opened")
        # Half a turn: what was on the left is on the right.
        shown.dragged("#view", 450, 0)
        back = shown.settled()
        assert back[:, width + 5 :].sum() > 3 * back[:, :width].sum()
        page.locator("#home").click()
        assert np.abs(shown.settled() - front).max() < 0.02
        page.locator("#cut").select_option("z")
        assert np.abs(shown.settled() - front).max() > 0.2
        page.locator("#cut").select_option("none")
        # Everything is in reach at both sizes, and nothing is wider than the page.
        for wide, high in SIZES:
            page.set_viewport_size({"width": wide, "height": high})
            for selector in ("#try", "#find", "#upload", "#home", "#knobs"):
                box = page.locator(selector).bounding_box()
                assert box["x"] >= 0 and box["x"] + box["width"] <= wide and box["y"] + box["height"] <= high, selector
            assert page.evaluate("document.documentElement.scrollWidth") == wide
        page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
        # A motif, and a slider, which a second tab hears of.
        assert page.locator("#try").is_disabled()
        page.locator("#find").fill("sp")
        page.locator("#motifs [data-key=style][data-goal=spirals]").click()
        page.locator("#goals .goal", has_text="style spirals").wait_for()
        for key, value in (("iterations", 6), ("octaves", 2), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        other = opened(url)
        other.page.locator("#goals .goal", has_text="style spirals").wait_for()
        assert other.page.locator("#knob-iterations").input_value() == "6"
        other.page.locator("#knob-iterations").fill("5")
        page.locator(".knob output", has_text="5").wait_for()
        # A picture from outside.
        Image.fromarray(np.random.default_rng(1).integers(0, 255, (40, 60), np.uint8)).save(tmp_path / "my fire.jpg")
        page.locator("#find").fill("")
        page.locator("#picture").set_input_files(tmp_path / "my fire.jpg")
        page.locator("#motifs [data-key=style].on", has_text="my_fire").wait_for()
        page.locator("#goals .goal", has_text="style my_fire").locator("button").click()
        # A try, whose loss falls while one looks on.
        page.locator("#try").click()
        page.locator(".job.running").wait_for()
        page.locator(".job.done").wait_for()
        assert "loss" in page.locator(".job p").first.inner_text()
        assert other.page.locator(".job.done").count() == 1
        shown.photographed("2_tried")
        page.locator(".job button[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        wiped = shown.settled()
        # On the left is what was there before, with the exposure of the run.
        page.locator("#mode-before").click()
        before = shown.settled()
        page.locator("#mode-wipe").click()
        shown.settled()
        assert np.abs(wiped[:, : width - 10] - before[:, : width - 10]).max() < 0.05
        left, right = (side[:, : width - 10].ravel() for side in (front, wiped))
        assert np.corrcoef(left, right)[0, 1] > 0.99
        for mode in ("after", "difference", "movement"):
            page.locator(f"#mode-{mode}").click()
            assert np.abs(shown.settled() - wiped).max() > 0.1
            shown.photographed(f"3_{mode}")
        # v* as arrows and as depth, with their scale; cuts have no arrows.
        for way, text in (("arrows", "cells"), ("depth", "towards you")):
            page.locator("#moved-as").select_option(way)
            assert np.abs(shown.settled() - wiped).max() > 0.1
            assert text in page.locator("#scale-text").inner_text() and page.locator("#wheel").is_hidden()
            shown.photographed(f"3_{way}")
        page.locator("#mode-before").click()
        page.locator("#moved-as").wait_for(state="hidden")
        assert page.locator("#error").is_hidden()
        # Before the studio ends: pages would complain.
        for tab in (shown, other):
            tab.page.context.close()


def test_motifs_are_found_by_a_picture_and_shown(root: Path, tmp_path: Path, opened: Callable[[str], Page]) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", shipped_weights()) as url:
        shown = opened(url)
        page = shown.page
        first = "#motifs h3:first-child + button"
        page.locator("#compared").set_input_files(STYLES / "flames.png")
        page.locator(f"{first}[data-goal=fire]").wait_for()
        shown.photographed("6_alike")
        page.locator("#find").fill("4b/pool_proj")
        page.locator("#motifs h3", has_text="deviation").wait_for()
        page.locator("#motifs h3", has_text="tags").wait_for(state="detached")
        # What is no picture is told, and names find as before.
        (tmp_path / "not.png").write_text("no picture")
        page.locator("#compared").set_input_files(tmp_path / "not.png")
        page.locator("#error", has_text="not a picture").wait_for()
        page.locator("#sample").wait_for(state="hidden")
        shown.troubles.clear()  # the browser's own word on the refusal
        # A dropped one is compared with where one searches, and is no style.
        page.locator("#find").fill("")
        page.evaluate(
            """async () => {
                const data = new DataTransfer();
                const picture = await (await fetch("thumbnail?style=spirals")).blob();
                data.items.add(new File([picture], "dropped.png"));
                document.querySelector("#find").dispatchEvent(
                    new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
            }"""
        )
        page.locator(f"{first}[data-goal=spiral]").wait_for()
        assert not (tmp_path / "out" / "pictures").exists()
        page.locator("#sample-end").click()
        page.locator(f"{first}[data-goal=cells]").wait_for()
        # What one tag looks like.
        page.locator("#find").fill("honeycomb")
        page.locator("#examples", has_text="what it looks like").click()
        page.locator("#motifs [data-key=tag] img").wait_for()
        page.locator("#examples").wait_for(state="hidden")
        shown.photographed("7_looks_like")
        shown.page.context.close()


def test_a_render_outlives_the_page_and_the_studio(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        page = opened(url).page
        page.locator("#motifs [data-key=style][data-goal=net]").click()
        for key, value in (("iterations", 40), ("octaves", 2), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#render").click()
        page.locator(".job.running p", has_text="loss").wait_for()
        page.context.close()
    with studio_url(root, tmp_path / "out", weights) as url:
        shown = opened(url)
        shown.page.locator(".job.done").wait_for()
        shown.photographed("4_outlived")
        shown.page.locator(".job button[data-action=open]").click()
        shown.page.locator("#mode-wipe.on").wait_for()
        shown.page.locator("#look").select_option("thick")
        shown.page.locator("#lit").check()
        shown.page.locator("#status", has_text="pass 4").wait_for()
        assert shown.view().std() > 0.05
        shown.page.locator("#lit").uncheck()
        shown.page.locator("#status", has_text="pass").wait_for(state="hidden")
        shown.photographed("5_reopened")
        shown.page.context.close()


def test_regions_are_shaped_and_painted_in_the_view(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown, other = opened(url), opened(url)
        page, drawing = shown.page, shown.page.locator("#gizmos")
        plain = shown.settled()
        page.locator("#add-box").click()
        page.locator(".part.on[data-form=box]").wait_for()
        # What is in the box is red, and so less bright; the rest is as it was.
        coloured = shown.settled()
        assert (coloured < plain - 0.1).sum() > 500
        shown.photographed("6_box")

        def handle(name: str) -> tuple[float, float]:
            box, places = page.locator("#view").bounding_box(), dict(json.loads(drawing.get_attribute("data-handles")))
            return box["x"] + places[name][0], box["y"] + places[name][1]

        def number(label: str) -> float:
            return float(page.get_by_label(label, exact=True).input_value())

        def dragged(name: str, right: float, down: float) -> None:
            x, y = handle(name)
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x + right, y + down, steps=5)
            page.mouse.up()
            shown.settled()

        # Pixels of a cell, by which a face moves if it is dragged, here and in perspective.
        (left, _), (right, _) = handle("low x"), handle("high x")
        pixels = (right - left) / (number("high x") - number("low x"))
        before = number("high x"), number("low x")
        dragged("high x", 3 * pixels, 20)
        assert number("high x") == pytest.approx(before[0] + 3, abs=0.1) and number("low x") == before[1]
        dragged("centre", -pixels, 2 * pixels)
        assert number("low x") == pytest.approx(before[1] - 1, abs=0.1)
        page.locator("#perspective").check()
        shown.settled()
        x, y = handle("high y")
        dragged("high y", 0, 2 * pixels)
        assert handle("high y") == pytest.approx((x, y + 2 * pixels), abs=1.5)
        shown.photographed("7_perspective")
        # A sphere, whose numbers can be typed, and which another tab has too.
        page.locator("#add-sphere").click()
        page.locator(".part.on[data-form=sphere]").wait_for()
        page.get_by_label("radius", exact=True).fill("6.5")
        page.get_by_label("radius", exact=True).press("Enter")
        other.page.locator(".part[data-form=sphere] .head button").first.click()
        playwright.expect(other.page.get_by_label("radius", exact=True)).to_have_value("6.5")
        dragged("edge", 20, 0)
        page.locator(".part.on [data-key=invert]").check()
        shown.settled()
        shown.photographed("8_sphere")
        page.locator(".part.on [data-key=invert]").uncheck()
        # Paint: a disc, where the view has been panned and zoomed; a stroke that is undone, and one that is erased.
        page.locator("#home").click()
        page.locator("#add-painting").click()
        assert not page.locator("#perspective").is_checked()
        area = page.locator("#view").bounding_box()
        x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
        page.mouse.move(x, y)
        page.mouse.wheel(0, -300)
        page.mouse.down(button="right")
        page.mouse.move(x + 90, y + 40, steps=3)
        page.mouse.up(button="right")
        shown.settled()
        camera = page.evaluate("view")
        page.locator("#brush-size").fill("0.25")
        page.locator("#brush-soft").fill("0")
        spot = x + 40, y + 100
        page.mouse.click(*spot)
        page.mouse.click(x - 130, y - 120)
        page.locator("#brush-undo").click()
        page.mouse.click(x - 130, y - 120)
        page.locator("#brush-erase").click()
        page.mouse.click(x - 130, y - 120)
        shown.photographed("9_painting")
        page.locator("#brush-done").click()
        page.locator(".part.on[data-form=image]").wait_for()
        shown.settled()
        shown.photographed("9_painted")
        # The cells that the disc covers, from the pixel alone.
        cell = camera["height"] / area["height"]
        across = camera["right"] + (spot[0] - x) * cell
        upwards = camera["up"] - (spot[1] - y) * cell
        with Image.open(tmp_path / "out" / "masks" / "0001.png") as kept:
            alpha = np.asarray(kept)[..., 1] / 255
        rows, columns = 20, 16
        places = [np.arange(n) - (n - 1) / 2 for n in (rows, columns)]
        distance = np.hypot(places[0][::-1, None] - upwards, places[1] - across)
        pixel = alpha.shape[0] / rows
        sampled = alpha[np.ix_(*[((np.arange(n) + 0.5) * pixel).astype(int) for n in (rows, columns)])]
        clear = np.abs(distance - 2.5) > 0.1
        assert 5 < (distance < 2.5).sum() < 30
        np.testing.assert_array_equal(sampled[clear], (distance < 2.5)[clear])
        # They are part of what is tried, and of what is opened again.
        page.locator("#share", has_text="is in all of these").wait_for()
        page.locator("#motifs [data-key=style][data-goal=net]").click()
        for key, value in (("iterations", 3), ("octaves", 1), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        page.locator(".job.done").wait_for()
        recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0001.toml")
        assert [part.get("shape", "image") for part in recipe.mask] == ["box", "sphere", "image"]
        assert recipe.mask[2]["image"] == str(tmp_path / "out" / "masks" / "0001.png")
        while page.locator(".part").count():
            count = page.locator(".part").count()
            page.locator(".part .head button[title=remove]").first.click()
            page.locator(".part").nth(count - 1).wait_for(state="detached")
        page.locator(".job button[data-action=open]").click()
        page.locator(".part[data-form=image]").wait_for()
        # Results are seen as they are; a part that is chosen is shown with its handles, until they are compared again.
        shows = page.locator("#masks-shown")
        expect(shows).not_to_be_checked()
        clear = shown.settled()
        page.locator(".part[data-form=box] .head button").first.click()
        expect(shows).to_be_checked()
        assert (np.abs(shown.settled() - clear) > 0.1).sum() > 500
        assert {name for name, _ in json.loads(drawing.get_attribute("data-handles"))} >= {"low x", "high x", "centre"}
        page.locator("#mode-after").click()
        expect(shows).not_to_be_checked()
        page.locator("#mode-wipe").click()
        assert np.abs(shown.settled() - clear).max() < 0.02
        other.page.locator(".part").nth(2).wait_for()
        shown.settled()
        shown.photographed("9_reopened")
        assert page.locator("#error").is_hidden()
        for tab in (shown, other):
            tab.page.context.close()


def test_tries_are_gone_on_from_and_deleted(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown, other = opened(url), opened(url)
        page = shown.page
        page.locator("#motifs [data-key=style][data-goal=spirals]").click()
        for key, value in (("iterations", 6), ("octaves", 3), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        first, second = (page.locator(f".job[data-id='tries/000{number}']") for number in (1, 2))
        page.locator(".job.done").wait_for()
        # From the end of the first octave, with the settings that may differ.
        first.locator("[data-action=branch]").click()
        assert first.locator(".states button").count() == 2
        first.locator(".states img").last.wait_for()
        shown.photographed("6_states")
        first.locator(".states [data-octave='0']").click()
        for tab in (page, other.page):
            tab.locator("#start", has_text="goes on from try 1, end of octave 1").wait_for()
        assert page.locator("#knob-motif_size").is_disabled() and page.locator("#knob-eta").is_enabled()
        # An address that means no cluster is told at once; of one that does, all tabs hear.
        page.locator("#cluster").fill("local:many")
        page.locator("#cluster").blur()
        page.locator("#cluster-error", has_text="expected local:N").wait_for()
        shown.troubles.clear()  # the browser's own words of the refusal
        page.locator("#cluster").fill("local:2")
        page.locator("#cluster").blur()
        expect(other.page.locator("#cluster")).to_have_value("local:2", timeout=PATIENCE)
        assert page.locator("#cluster-error").is_hidden()
        shown.photographed("7_going_on")
        for key, value in (("iterations", 60), ("views", 8)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        second.locator("p", has_text="from try 1, octave 2").wait_for()
        # All but the chosen, after a question; what runs is stopped first.
        first.locator("input[type=checkbox]").check()
        questions = []
        page.once("dialog", lambda dialog: questions.append(dialog.message) or dialog.dismiss())
        page.locator("#clear").click()
        page.once("dialog", lambda dialog: questions.append(dialog.message) or dialog.accept())
        assert second.count() == 1
        page.locator("#clear").click()
        second.wait_for(state="detached")
        question = "Delete the other try, all but the chosen? It is stopped first. This cannot be undone."
        assert questions == [question] * 2
        assert [other.page.locator(".job").count(), first.count()] == [1, 1]
        assert not (tmp_path / "out" / "tries" / "0002").exists()
        # Nothing goes on from what is gone.
        page.once("dialog", lambda dialog: dialog.accept())
        first.locator("[data-action=delete]").click()
        page.locator("#start").wait_for(state="hidden")
        shown.photographed("8_deleted")
        for tab in (shown, other):
            tab.page.context.close()


def address(studio: Studio) -> str:
    return f"http://127.0.0.1:{studio.server.server_port}/?token={studio.server.access.token}"


def sequence(folder: Path) -> None:
    values = np.random.default_rng(0).random((10, 16, 12), np.float32)
    save_frames(folder, [Frame(values * scale, name=f"f_{n}", number=n) for n, scale in ((7, 1.0), (8, 0.8), (9, 0.6))])


@pytest.fixture
def smoke(tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Studio]:
    """A studio that shows a sequence with a sphere as its region; what is begun fails at once."""
    sequence(tmp_path / "root" / "smoke")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=2, views=1, gamma=0.2)
        studio.post("/goal", key="style", goal="net")
        studio.post("/mask", action="add", values={"shape": "sphere", "centre": [5, 7, 4], "radius": 3})
        yield studio


def test_what_is_refused_keeps_work_from_beginning(
    smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]
) -> None:
    shown = opened(address(smoke))
    page = shown.page
    cards, field, radius = page.locator(".job"), page.locator("#cluster"), page.get_by_label("radius", exact=True)
    # It is refused before the button is released, or after.
    for wait in (200, 0):
        radius.fill("-5")
        page.locator("#try").click(delay=wait)
        page.locator("#error", has_text="radius").wait_for()
        page.locator("#try:not([disabled])").wait_for()
        assert cards.count() == 0 and radius.input_value() == "3"
    # Nothing is rendered elsewhere than the field says, however often one asks.
    field.press_sequentially("local:many")
    for _ in range(2):
        page.locator("#render").click()
        page.locator("#cluster-error", has_text="expected local:N").wait_for()
        page.locator("#render:not([disabled])").wait_for()
        page.locator("#cluster-error button").click()
    field.blur()
    smoke.post("/set", key="strength", value=0.5)
    page.locator(".knob.set", has_text="strength").wait_for()
    assert [field.input_value(), field.get_attribute("class"), cards.count()] == ["local:many", "wrong", 0]
    # Tries are done on this machine, and one is told of the cluster as long as that is not closed.
    field.press("End")
    field.press_sequentially("?")
    page.locator("#try").click()
    cards.nth(0).wait_for()
    page.locator("#cluster-error").wait_for()
    assert page.locator("#error", has_text="radius").is_visible()
    field.fill("local:2")
    page.locator("#render").click()
    cards.nth(1).wait_for()
    assert page.locator("#cluster-error").is_hidden() and field.get_attribute("class") == ""
    assert json.loads((tmp_path / "out" / "renders" / "0001.json").read_text())["cluster"] == "local:2"
    shown.troubles.clear()  # the browser's own words of the refusals
    page.context.close()


def test_what_is_being_changed_is_in_what_is_tried(
    smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]
) -> None:
    page = opened(address(smoke)).page
    page.locator("#view[data-settled=yes]").wait_for()
    changes = {
        # Dragged so fast that the latest waits for the first.
        "drag": "const { id } = parts()[0]; for (const radius of [4, 5]) editSoon(id, { radius });",
        "shape": "$('add-box').click();",
        "painting": "$('brush-done').click(); $('brush-done').click();",
    }
    for number, (what, script) in enumerate(changes.items(), 1):
        if what == "painting":
            page.locator("#add-painting").click()
            page.locator("#view").click(position={"x": 300, "y": 300})
        page.evaluate(f"() => {{ {script} $('try').click(); }}")
        page.locator(".job").nth(number - 1).wait_for()
        tried = Recipe.from_toml(tmp_path / "out" / "tries" / f"{number:04d}.toml")
        assert mask_tables(tried) == mask_tables(smoke.session.recipe()), what
        assert len(mask_tables(tried)[0]) == number and mask_tables(tried)[0][0]["radius"] == 5
    page.context.close()


def test_what_is_set_by_keys_outlasts_news(smoke: Studio, opened: Callable[[str], Page]) -> None:
    page = opened(address(smoke)).page
    slider = page.locator("#knob-lam")
    slider.focus()
    step = float(slider.get_attribute("step"))
    for value in range(12):  # news comes between them
        slider.press("ArrowRight")
        smoke.session.set("strength", 0.5 + value / 100)
        page.wait_for_timeout(35)
    page.evaluate("allIsSet()")
    assert smoke.session.recipe().lam == pytest.approx(12 * step)
    # Half a number is not taken for a whole one where another tab edits the same part.
    edge = page.get_by_label("edge", exact=True)
    edge.fill("")
    edge.press_sequentially("0.")
    smoke.post("/mask", action="change", part=0, values={"strength": 0.5, "centre": [5, 8, 4]})
    expect(page.get_by_label("strength", exact=True).and_(page.locator(".part input"))).to_have_value("0.5")
    edge.press_sequentially("7")
    edge.press("Tab")
    page.evaluate("allIsSet()")
    (part,) = mask_tables(smoke.session.recipe())[0]
    assert (part["edge"], part["strength"], part["centre"]) == (0.7, 0.5, (5, 8, 4))
    # What is fixed is so for all buttons of it.
    smoke.session.start = "tries/0001", 0
    smoke.post("/set", key="strength", value=0.7)
    page.locator("#knob-motif_size[disabled]").wait_for()
    motif_size = page.locator(".knob", has=page.locator("#knob-motif_size"))
    assert [motif_size.locator(f"button:text-is('{of}')").is_disabled() for of in ("auto", "↺")] == [True, True]
    page.context.close()


def test_cards_do_not_slip_under_a_second_click_and_new_ones_are_seen(
    smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]
) -> None:
    for number in range(1, 8):
        smoke.post("/work", action="try")
        smoke.session.workshop.work(f"tries/{number:04d}").process.wait(30)
    shown = opened(address(smoke))
    page = shown.page
    page.locator(".job.failed").nth(6).wait_for()
    page.locator("#work").evaluate("(list) => { list.scrollTop = list.scrollHeight; }")
    page.locator("#try").click()
    new = page.locator(".job[data-id='tries/0008']")
    new.wait_for()
    expect(new).to_be_in_viewport(ratio=0.9)
    # A button that has come to lie under the pointer is not pressed at once, but a little later.
    asked = []
    page.on("dialog", lambda dialog: asked.append(dialog.message) or dialog.dismiss())
    box = new.locator("[data-action=delete]").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def pressed(moved: int) -> None:
        page.mouse.move(x, y + moved, steps=2)
        if moved:
            page.evaluate(
                """(by) => {
                    const above = Object.assign(document.createElement("div"), { className: "above" });
                    above.style.height = `${by}px`;
                    $("work").before(above);
                }""",
                moved,
            )
        page.mouse.down()
        page.mouse.up()

    pressed(30)
    assert asked == []
    page.wait_for_timeout(450)
    page.mouse.down()
    page.mouse.up()
    assert asked == ["Delete try 8? This cannot be undone."]
    page.evaluate("document.querySelector('.above').remove()")
    pressed(0)
    assert len(asked) == 2
    # Keys have no place.
    page.keyboard.press("Tab")
    page.evaluate("cameAt = performance.now() + 1e6")
    new.locator("[data-action=delete]").press("Enter")
    assert len(asked) == 3
    # A help that opens at the edge is read.
    views = page.locator(".knob", has=page.locator("#knob-views"))
    views.locator(".key").click()
    expect(views.locator("p")).to_be_in_viewport(ratio=0.9)
    shown.photographed("13_help")
    page.context.close()


def test_news_is_of_what_is_there(smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]) -> None:
    smoke.session.notice = "this cannot be shown"
    shown = opened(address(smoke))
    page = shown.page
    page.locator("#notice", has_text="this cannot be shown").wait_for()
    page.locator("#motifs [data-key=style][data-goal=cells]").click()
    page.locator("#goals", has_text="cells").wait_for()
    assert page.locator("#notice").is_visible()
    smoke.post("/open", path="smoke")
    page.locator("#notice").wait_for(state="hidden")
    assert page.locator("#remark").is_hidden()
    sequence(tmp_path / "root" / "more")
    page.locator("#files").hover()
    # What was meant for other smoke stays, and can be taken back.
    page.locator("#files button[data-path=more]").click()
    page.locator("#all").click()
    page.locator("#remark", has_text="The goals and regions that were set stay.").wait_for()
    shown.photographed("11_stays")
    page.locator("#remark .clear").click()
    page.locator("#goals .goal").first.wait_for(state="detached")
    page.locator("#remark").wait_for(state="hidden")
    assert mask_tables(smoke.session.recipe()) == [[]] and smoke.session.recipe().views == 1
    # The network is told, and what has no such name.
    expect(page.locator("#network")).to_have_text("of the network bvlc")
    page.locator("#find").fill("zzz")
    page.locator("#motifs", has_text="nothing is called 'zzz'; a picture can be searched for too").wait_for()
    shown.photographed("12_not_found")
    page.context.close()


def test_tabs_that_nobody_sees_leave_room(smoke: Studio, browser: Any) -> None:
    """A browser has six connections to a host: with news for six tabs, nothing else would be answered."""
    context = browser.new_context(viewport={"width": SIZES[0][0], "height": SIZES[0][1]})
    look = """(as) => {
        Object.defineProperty(document, "visibilityState", { get: () => as, configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
    }"""
    tabs = []
    for _ in range(7):
        tabs.append(context.new_page())
        tabs[-1].set_default_timeout(PATIENCE)
        tabs[-1].goto(address(smoke))
        tabs[-1].locator("#goals .goal").wait_for()
        tabs[-1].evaluate(look, "hidden")
    tabs[-1].locator("#motifs button").first.wait_for()
    smoke.post("/goal", key="style", goal="cells")
    assert tabs[0].locator("#goals", has_text="cells").count() == 0
    tabs[0].evaluate(look, "visible")
    tabs[0].locator("#goals", has_text="cells").wait_for()
    smoke.post("/goal", key="style", goal="cells")
    tabs[0].locator("#goals", has_text="cells").wait_for(state="detached")
    context.close()


def test_a_frame_is_tried_again_and_again(
    tmp_path: Path, weights: Path, opened: Callable[[str], Page], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence(tmp_path / "root" / "smoke")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=2, views=1, gamma=0.2)
        studio.post("/goal", key="style", goal="net")
        shown = opened(address(studio))
        page = shown.page
        page.locator("#frame").fill("1")
        page.locator("#try").dblclick()
        job = page.locator(".job.done")
        job.wait_for()
        assert job.locator("b").inner_text() == "try 1: smoke, frame 8"
        assert job.locator("[data-action=finish]").inner_text() == "render this frame"
        assert "loss in the fixed views" in job.locator("p").first.inner_text()
        # It is opened among the frames of its input, and nothing plays on.
        page.locator("#play").click()
        job.locator("[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        assert page.locator("#play").inner_text() == "▶"
        assert [page.locator("#frame").get_attribute("max"), page.locator("#frame").input_value()] == ["2", "1"]
        page.locator("#status", has_text="try 1: smoke, frame 8").wait_for()
        assert page.locator(".job.shown").count() == 1
        page.locator("#frame").fill("0")
        page.locator("#status", has_text="was not in the try").wait_for()
        page.locator("#frame").fill("1")
        page.locator("#status", has_text="was not in the try").wait_for(state="hidden")
        # Two sliders, moved at once, are both in what is tried at once, which is that frame again.
        monkeypatch.setattr(sys, "executable", "/bin/false")
        assert page.locator("#only").is_visible()
        page.evaluate(
            """() => {
                for (const [key, value] of [["strength", 0.5], ["views", 2]]) {
                    $(`knob-${key}`).value = value;
                    $(`knob-${key}`).dispatchEvent(new Event("input"));
                }
                $("try").click();
            }"""
        )
        page.locator(".job.failed").wait_for()
        recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0002.toml")
        assert (recipe.frames, recipe.strength, recipe.views) == ("8", 0.5, 2)
        assert len(studio.session.state()["work"]) == 2
        shown.settled()
        # Without its input, what has come out is not called what was there before.
        (tmp_path / "root" / "smoke").rename(tmp_path / "root" / "moved")
        job.locator("[data-action=open]").click()
        page.locator("#mode-after.on").wait_for()
        assert "cannot be read again" in page.locator("#mode-before[disabled]").get_attribute("title")
        page.locator("#view").hover()
        page.mouse.wheel(0, -100)
        shown.settled()
        shown.photographed("10_without_input")
        page.locator("#notes", has_text="cannot be read again").locator("button").click()
        assert page.locator("#notes").is_hidden()
        # What the recipe is restricted to is told beside the buttons, and can be taken back.
        assert page.locator("#restricted").is_hidden()
        studio.session.settings.base = Recipe(frames="8")
        studio.post("/set", key="strength", value=0.4)
        expect(page.locator("#restricted-text")).to_have_text("frames 8 only")
        page.locator("#all-frames").click()
        page.locator("#restricted").wait_for(state="hidden")
        # Once it is deleted, nothing is shown, and the page begins anew.
        assert studio.post("/work", action="delete", ids=["tries/0001"]).status == 200
        page.locator("#hint").wait_for()
        page.locator("#messages", has_text="smoke").wait_for()
        page.context.close()


def test_what_is_typed_painted_and_said_outlasts_other_tabs(tmp_path: Path, opened: Callable[[str], Page]) -> None:
    sequence(tmp_path / "root" / "smoke")
    sequence(tmp_path / "root" / "other")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.post("/mask", action="add", values={"shape": "sphere", "centre": [5, 7, 4], "radius": 3})
        studio.post("/mask", action="add", values={"shape": "box", "low": [1, 1, 1], "high": [9, 9, 9]})
        shown = opened(address(studio))
        page = shown.page
        edge = page.get_by_label("edge", exact=True)
        edge.fill("0.2")
        # Another tab removes the part before it.
        studio.post("/mask", action="remove", part=0)
        page.locator(".part[data-form=sphere]").wait_for(state="detached")
        assert edge.input_value() == "0.2"
        page.keyboard.press("Enter")
        shown.settled()
        (part,) = mask_tables(studio.session.recipe())[0]
        assert (part["shape"], part["edge"]) == ("box", 0.2)
        # A refusal stays until it is closed, or something else is asked for.
        edge.fill("-5")
        page.keyboard.press("Enter")
        page.locator("#error", has_text="edge").wait_for()
        page.locator("#view").hover()
        page.mouse.wheel(0, -100)
        shown.settled()
        page.locator("#error button").click()
        assert page.locator("#error").is_hidden()
        shown.troubles.clear()  # the browser's own word on the refusal
        # Strokes wait for their smoke.
        page.locator("#add-painting").click()
        page.locator("#view").click(position={"x": 300, "y": 300})
        studio.post("/open", path="other")
        page.locator("#kept", has_text="painted over smoke is kept").wait_for()
        studio.post("/open", path="smoke")
        page.locator("#kept", has_text="paint goes on with it").wait_for()
        page.locator("#add-painting").click()
        assert page.evaluate("painting.strokes.length") == 1
        page.context.close()


def test_smoke_takes_on_colours_on_the_page(tmp_path: Path, weights: Path, opened: Callable[[str], Page]) -> None:
    (tmp_path / "root").mkdir()
    density = np.zeros((14, 20, 16), np.float32)
    density[3:11, 4:16, 3:13] = np.random.default_rng(0).random((8, 12, 10), np.float32)
    save_frames(tmp_path / "root", [Frame(density, name="smoke")])
    pixels = np.full((40, 40, 3), (255, 90, 0), np.uint8)
    pixels[::4] = (0, 0, 90)
    Image.fromarray(pixels).save(tmp_path / "ember.png")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=8, views=2, colour_eta=0.2)
        shown = opened(address(studio))
        page = shown.page
        studio.post("/open", path="smoke.npz")
        page.locator("#picture").set_input_files(tmp_path / "ember.png")
        page.locator("#goals .goal", has_text="ember").wait_for()
        shown.settled()
        assert page.locator("#in-colour").is_hidden()
        page.locator("#knob-colour").select_option("style")
        page.locator(".knob.set", has=page.locator("#knob-colour")).wait_for()
        page.locator("#knob-colour_weight").fill("2")
        page.locator("#try").click()
        page.locator(".job.done").wait_for()
        recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0001.toml")
        assert (recipe.colour, recipe.colour_weight) == ("style", 2.0)
        page.locator(".job button[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        page.locator("#mode-after").click()
        shown.settled()

        def picture() -> np.ndarray:
            seen = Image.open(io.BytesIO(page.locator("#view").screenshot())).convert("RGB")
            return np.asarray(seen, int)[50:-40]

        coloured = picture()
        assert (coloured[..., 0] - coloured[..., 2]).max() > 60
        assert page.locator("#knob-colour").input_value() == "style"
        shown.photographed("13_in_colour")
        page.locator("#mode-wipe").click()
        shown.settled()
        shown.photographed("14_wiped_in_colour")
        page.locator("#mode-after").click()
        page.locator("#coloured").uncheck()
        shown.settled()
        assert np.ptp(picture(), axis=-1).max() < 10
        # What was chosen can be taken back.
        back = page.locator(".knob", has=page.locator("#knob-colour")).get_by_title("as it was")
        back.wait_for(state="hidden")
        page.locator("#knob-colour").select_option("off")
        back.click()
        expect(page.locator("#knob-colour")).to_have_value("style")
        page.context.close()
